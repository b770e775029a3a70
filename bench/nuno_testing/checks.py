"""The checks of each kind of plugin, by entry-point group: those of all kinds, and its own."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import fsum
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from trimesh.creation import box

from nuno.plugin_contract import registry
from nuno.runtime.stepper import check_kept
from nuno_schemas.bodies import BOX, MESH, Geometry, Poses, no_rows
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem, Isotherm, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.operation import Beside, Outcome
from nuno_schemas.pictures import Mesh, frame
from nuno_schemas.system import System, Term
from nuno_schemas.vectors import face_areas
from nuno_testing import bodies, integrators
from nuno_testing.subject import Subject, made_twice

# The contract of forces, tested on a sheet without springs with nuno's own solvers.

BUILT_IN = {"kinetic", "gravitational", "springs", "hinges"}
FEW, MANY = 6, 66
"""Vertices along a side of the sheet; with MANY a solver uses several threads."""


def sheet(side: int) -> Fabric:
    """Return an uneven square of side x side vertices, 1 m wide, without springs."""
    axis = np.linspace(0.0, 1.0, side)
    x = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.zeros((side, side))], axis=-1).reshape(-1, 3)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    halves = [
        np.stack([corner, corner + side, corner + side + 1], 1),
        np.stack([corner, corner + side + 1, corner + 1], 1),
    ]
    x += 0.1 / side * np.random.default_rng(1).standard_normal(x.shape)
    mass = np.full(len(x), 0.3 / len(x))
    return Fabric("sheet", x, np.zeros_like(x), mass, mass == 0.0, np.concatenate(halves).astype(np.int32))


class Probe:
    """A single force prepared for a sheet, evaluated by a solver."""

    def __init__(self, subject: Subject, side: int = FEW, solver: str = "symplectic_euler", threads: int = 1) -> None:
        self.fabric = sheet(side)
        term = subject.plugin.prepare(subject.config, self.fabric, 0)
        self.system = System(self.fabric, np.zeros(3), 0.0, (term,), threads)
        self.solver = registry.load("nuno.integrators", solver)
        fields = {"residual": 1e-9} if "residual" in self.solver.Config.model_fields else {}
        self.config, self.start = self.solver.Config(**fields), State(self.fabric.position.copy(), self.fabric.velocity)

    def memory(self) -> Any:
        return self.solver.prepare(self.config, self.system, self.start)

    def forces(self, x: Float, v: Float) -> Float:
        """Return the forces (n, 3) [N] at x, v (n, 3)."""
        forces = self.solver.forces(self.system, State(x.copy(), v.copy()), self.memory(), None)
        return np.asarray(forces.acceleration * self.fabric.mass[:, None])

    def energy(self, x: Float) -> float | None:
        """Return the energy [J] at x (n, 3), None for a force without energy."""
        report = self.solver.advance(self.system, State(x.copy(), 0.0 * x), self.memory(), None, 0, 0.0)
        energies = [joules for kind, joules in report.energy.items() if kind not in BUILT_IN]
        return sum(energies) if energies else None

    def advance(self, v: Float, dt: float, *frames: int) -> tuple[State, list[Any]]:
        """Return the state after frames of these numbers of steps from velocities v (n, 3), and the reports."""
        state = State(self.start.x.copy(), v.copy())
        return state, [self.solver.advance(self.system, state, self.memory(), None, n, dt) for n in frames]


def random_state(probe: Probe) -> tuple[Float, Float]:
    """Return random positions and velocities."""
    rng, x = np.random.default_rng(7), probe.fabric.position
    return x + 0.02 * rng.standard_normal(x.shape), rng.standard_normal(x.shape)


def the_same_state_is_pushed_alike(subject: Subject) -> None:
    """Prepared and evaluated twice, also on another thread, the force is the same; its arguments are not changed."""
    x, v = random_state(Probe(subject))
    forces = made_twice(lambda: Probe(subject).forces(x, v), x, v)
    assert np.isfinite(forces).all()


def it_is_the_downhill_slope_of_its_energy(subject: Subject) -> None:
    """The central difference of its energy along random directions is minus the work of the force.

    A force without energy passes.
    """
    probe = Probe(subject)
    x, _ = random_state(probe)
    if probe.energy(x) is None:
        return
    force, step = probe.forces(x, 0.0 * x), 1e-5
    for seed in range(4):
        d = np.random.default_rng(seed).standard_normal(x.shape)
        difference = (probe.energy(x + step * d) - probe.energy(x - step * d)) / (2.0 * step)  # type: ignore[operator]
        assert abs(difference + (force * d).sum()) < 1e-6 * np.abs(force * d).sum() + 1e-12


def frames_cut_anywhere_end_in_the_same_bytes(subject: Subject) -> None:
    """So does leapfrog, which keeps an acceleration for the next step unless a force declares to read velocities."""
    probe = Probe(subject, solver="leapfrog")
    _, v = random_state(probe)
    (whole, _), (cut, _) = probe.advance(v, 1e-3, 4), probe.advance(v, 1e-3, 1, 3)
    assert (whole.x.tobytes(), whole.v.tobytes()) == (cut.x.tobytes(), cut.v.tobytes())


def an_implicit_step_ends_where_its_equation_says(subject: Subject) -> None:
    """The equation of backward Euler holds: m (v1 - v0) / h is the force at the end, by an explicit solver."""
    explicit, probe = Probe(subject), Probe(subject, solver="implicit_euler")
    rates = explicit.solver.limit(explicit.config, explicit.system, explicit.start)
    h = 0.5 / max(rates.omega, rates.damping, 50.0)
    _, v = random_state(probe)
    end, (report,) = probe.advance(v, h, 1)
    assert report.status == "ok"
    assert report.totals["halvings"] == 0
    inertia, force = probe.fabric.mass[:, None] * (end.v - v) / h, explicit.forces(end.x, end.v)
    assert np.abs(inertia - force).max() < 1e-6 * np.abs(force).max() + 1e-12


def any_number_of_threads_gives_the_same_bits(subject: Subject) -> None:
    """One and two threads give the same bits on a sheet large enough for two."""
    one, two = (Probe(subject, MANY, threads=threads) for threads in (1, 2))
    if not two.memory().about.startswith("2 threads"):
        pytest.skip("one thread is all there is")
    x, v = random_state(one)
    assert one.forces(x, v).tobytes() == two.forces(x, v).tobytes()


FORCES = (
    the_same_state_is_pushed_alike,
    it_is_the_downhill_slope_of_its_energy,
    frames_cut_anywhere_end_in_the_same_bytes,
    an_implicit_step_ends_where_its_equation_says,
    any_number_of_threads_gives_the_same_bits,
)


# The contract of plugins of dye: solvers and isotherms.

D0, LANGMUIR = 1e-9, Isotherm("langmuir", 2.0)


def cloth(side: int) -> Cells:
    """Return random cells; paste or binding leaves some of them little or no capacity."""
    rng, shape = np.random.default_rng(11), (2, side, side + 1)
    up = rng.random(shape[1:]) > 0.5
    porosity, resist = rng.uniform(0.2, 0.8, shape), rng.random(shape) * (rng.random(shape) > 0.7)
    return Cells(
        rng.random(shape) > 0.3, np.stack([~up, up]), porosity, rng.random(shape), resist, 1e-4,
        Tortuosity(0.5, 0.3, 0.6, 1.0, 0.8, 0.4),
    )  # fmt: skip


def make_system(side: int = 14, threads: int = 1, law: Isotherm | None = LANGMUIR) -> DyeSystem:
    """Return a cloth with one dye."""
    return DyeSystem(cloth(side), (Dye("blue", D0, 0.06 if law else 0.0, law),), threads)


def start(system: DyeSystem) -> DyeState:
    """Return a state with random full cells."""
    room = system.cells.mobile_room[None]
    return DyeState(room * (np.random.default_rng(2).random(room.shape) > 0.6), 0.0 * room)


def spread(subject: Subject, system: DyeSystem, seconds: float, *frames: int) -> DyeState:
    """Return the amounts after frames of these numbers of steps, and check the reported totals."""
    state, total = start(system), start(system).phi.sum()
    memory = subject.plugin.prepare(subject.config, system, state)
    for steps in frames:
        report = subject.plugin.advance(system, state, memory, steps, seconds / sum(frames))
        assert report.status == "ok"
        check_kept(memory, memory.arrays)
        for totals, amounts in ((report.mobile, state.phi), (report.fixed, state.fixed)):
            assert abs(totals[0] - fsum(amounts.reshape(-1))) <= 1e-13 * total
    return state


def stable_step(subject: Subject, system: DyeSystem) -> float:
    """Return a stable step [s]: the solver's limit, or at most the time scale of diffusion between neighbours."""
    state = DyeState(*np.zeros((2, 1, *system.cells.fibre.shape)))
    subject.plugin.prepare(subject.config, system, state)
    return float(min(subject.plugin.limit(subject.config, system), system.cells.size**2 / D0))


def dye_is_kept_within_its_bounds(subject: Subject) -> None:
    """The total is conserved, every cell stays between 0 and its capacity, and some dye is fixed."""
    system = make_system()
    steps, t = 40, 40.0 * stable_step(subject, system)
    end, total = spread(subject, system, t, steps), fsum(start(system).phi.reshape(-1))
    kept = fsum(end.phi.reshape(-1)) + fsum(end.fixed.reshape(-1))
    assert abs(kept - total) <= 1e-13 * np.sqrt(steps) * total
    assert end.phi.min() >= 0.0 and end.fixed.min() >= 0.0 and end.fixed.max() > 0.0
    assert (end.phi[0] <= system.cells.mobile_room).all() and (end.fixed[0] <= system.cells.fixed_room).all()


def frames_and_threads_change_no_bit(subject: Subject) -> None:
    """A run gives the same bits when repeated, cut into frames, and on two threads if the cloth is large enough."""
    system = make_system(160)
    t = 12.0 * stable_step(subject, system)
    whole = made_twice(lambda: spread(subject, system, t, 12), system.cells)
    for other in (spread(subject, system, t, 4, 4, 4), spread(subject, replace(system, threads=2), t, 12)):
        assert (other.phi.tobytes(), other.fixed.tobytes()) == (whole.phi.tobytes(), whole.fixed.tobytes())


def shorter_steps_come_to_one_end(subject: Subject) -> None:
    """For pure diffusion, the change by halving the step falls at least as for a method of first order."""
    system = make_system(law=None)
    t = 8.0 * stable_step(subject, system)
    ends = [spread(subject, system, t, steps).phi for steps in (32, 64, 128)]
    coarse, fine = (np.abs(a - b).max() for a, b in itertools.pairwise(ends))
    assert fine < 0.6 * coarse


SOLVERS = (dye_is_kept_within_its_bounds, frames_and_threads_change_no_bit, shorter_steps_come_to_one_end)


def largest_fixed(law: Isotherm, phi: Float, room: Float) -> Float:
    """Return A_d by the formula of each kind in the schema."""
    if law.law is not None:
        return np.asarray(law.law.limit(phi, room))
    formulas = {
        "partition": law.first * phi,
        "freundlich": law.first * phi**law.second,
        "langmuir": room * law.first * phi / (1.0 + law.first * phi),
    }
    return formulas[law.kind]


def more_dye_beside_it_never_fixes_less(subject: Subject) -> None:
    """The largest fixed amount is 0 without mobile dye and never falls with more of it; arrays are not changed."""
    law = subject.plugin.prepare(subject.config)
    phi, room = np.tile(np.linspace(0.0, 1.0, 101), (2, 3, 1)), np.full((2, 3, 101), 0.6)
    fixed = made_twice(lambda: largest_fixed(law, phi, room), phi, room)
    assert fixed.shape == phi.shape
    assert (fixed[..., 0] == 0.0).all() and (np.diff(fixed, axis=-1) >= 0.0).all() and fixed.max() > 0.0


ISOTHERMS = (more_dye_beside_it_never_fixes_less,)


# The contract of renderers.

FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)


def scene() -> list[Mesh]:
    """Return a tent over a block, as two meshes."""
    tent = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]])
    colours = np.linspace(0, 1, 15).reshape(5, 3)
    return [Mesh(tent, FACES, colours=colours), Mesh(tent * 0.5, FACES, two_sided=False)]


def a_picture_has_the_size_asked_for(subject: Subject) -> None:
    """A picture has the size of the camera, down to a single pixel."""
    for size in ((64, 48), (31, 57), (1, 1)):
        picture = subject.plugin.render(subject.config, scene(), frame(scene(), size=size))
        assert picture.shape == (size[1], size[0], 3)


def the_same_scene_is_drawn_alike(subject: Subject) -> None:
    """Drawn twice, meshes give the same picture of more than one colour, and are not changed."""
    meshes = scene()
    camera = frame(meshes, size=(64, 48))
    picture = made_twice(lambda: subject.plugin.render(subject.config, meshes, camera), meshes, camera)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def nothing_to_draw_is_a_picture_too(subject: Subject) -> None:
    """Without meshes, or with one without triangles, the picture is the empty background."""
    camera, no_triangles = frame(scene(), size=(64, 48)), Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    empty, bare = (subject.plugin.render(subject.config, meshes, camera) for meshes in ([], [no_triangles]))
    assert (empty == bare).all()


def a_face_of_vertices_that_are_not_there_is_refused(subject: Subject) -> None:
    """The error names the mesh of the face."""
    tent = scene()[0]
    for index in (-1, 5):
        bad = Mesh(tent.vertices, np.array([[0, 1, index]], np.int32))
        with pytest.raises(BadInput, match=r"meshes\[0\]\.faces"):
            subject.plugin.render(subject.config, [bad], frame([tent], size=(16, 12)))


RENDERERS = (
    a_picture_has_the_size_asked_for,
    the_same_scene_is_drawn_alike,
    nothing_to_draw_is_a_picture_too,
    a_face_of_vertices_that_are_not_there_is_refused,
)


# The contract of contacts, tested with single grains that fall on a block.

GRAVITY, STEP = np.array([0.0, -9.81, 0.0]), 2e-4
BOX_MESH = box((6.0, 1.0, 6.0))
CORNERS, SIDES = np.asarray(BOX_MESH.vertices) - [0.0, 0.5, 0.0], np.asarray(BOX_MESH.faces, np.int32)


def block(kind: int, friction: float) -> Geometry:
    """Return a body with its top at height 0: a box, or its triangles."""
    low, high = CORNERS.min(axis=0)[None], CORNERS.max(axis=0)[None]
    a, b = (0.5 * (low + high), 0.5 * (high - low)) if kind == BOX else (low, high)
    zero, one = np.zeros(1, np.int32), np.ones(1)
    triangles = (CORNERS, SIDES, np.zeros(len(SIDES), np.int32)) if kind == MESH else ()
    return Geometry(
        ("block",), ("block/world",), np.array([kind], np.int8), zero, zero, a, b, 0.0 * one, np.nan * one, 0.5 * one,
        friction * one, *triangles,
    )  # fmt: skip


def contact_term(subject: Subject, grains: Fabric, friction: float) -> Term:
    """Return the contact's term with a block of a kind that the contact supports."""
    try:
        term: Term = subject.plugin.prepare(subject.config, grains, block(BOX, friction), GRAVITY)
    except BadInput:
        term = subject.plugin.prepare(subject.config, grains, block(MESH, friction), GRAVITY)
    return term


def throw_grains(subject: Subject, x: Float, v: Float, friction: float, seconds: float) -> State:
    """Return the state, after some seconds, of grains of one gram that start at x, v (n, 3)."""
    grains = Fabric("grains", x, v, np.full(len(x), 1e-3), np.zeros(len(x), bool), no_rows(np.int32, 3))
    system, state = System(grains, GRAVITY, 0.0, (contact_term(subject, grains, friction),)), State(x.copy(), v.copy())
    solver, pose = registry.load("nuno.integrators", "symplectic_euler"), Poses(0.0, np.eye(4)[:1], np.zeros((1, 3)))
    memory = solver.prepare(solver.Config(), system, state)
    assert solver.advance(system, state, memory, (pose, pose), round(seconds / STEP), STEP).status == "ok"
    check_kept(memory, memory.arrays)
    return state


def what_falls_on_a_body_comes_to_rest_on_it(subject: Subject) -> None:
    """A grain rests on the surface to a millimetre; grains in the air or beside the body fall freely."""
    x = np.array([[0.0, 0.01, 0.0], [1.0, 1.0, 1.0], [4.0, 0.01, 0.0]])
    end = made_twice(lambda: throw_grains(subject, x, 0.0 * x, 0.3, 0.4), x)
    assert abs(end.x[0, 1]) < 1e-3
    assert np.abs(end.v[0]).max() < 1e-2
    assert np.abs(end.x[1:, 1] - (x[1:, 1] - 0.5 * 9.81 * 0.4**2)).max() < 1e-3
    assert (end.x[1:, [0, 2]] == x[1:, [0, 2]]).all()


def what_slides_is_slowed_as_coulomb_says(subject: Subject) -> None:
    """Friction decelerates a sliding grain by mu g, and without friction there is no force along the surface."""
    x, v = np.array([[-1.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]])
    for friction in (0.0, 0.4):
        end = throw_grains(subject, x, v, friction, 0.2)
        assert abs(end.v[0, 0] - (1.0 - friction * 9.81 * 0.2)) < 0.03 * friction + 1e-9
        assert abs(end.v[0, 2]) < 1e-9


CONTACTS = (what_falls_on_a_body_comes_to_rest_on_it, what_slides_is_slowed_as_coulomb_says)


# The contract of models and operations.


def torso() -> tuple[Any, Any]:
    """Return vertices and faces of nuno's own body, for models that are drawn over a body."""
    collider = registry.load("nuno.colliders", "mesh")
    shape = collider.build(collider.Config(shape="torso", resolution=48), None, None)
    return shape.vertices, shape.faces


def build_fabric(subject: Subject) -> Fabric:
    """Build the fabric; a model that is drawn over a body gets nuno's own."""
    model, over = subject.plugin, getattr(type(subject.plugin._plugin), "over", None)
    if over is None or model.over(subject.config) is None:
        fabric: Fabric = model.build(subject.config, subject.files, 0)
        return fabric
    drawn: Fabric = model.build_over(subject.config, subject.files, 0, *torso())
    return drawn


def it_is_built_the_same_again(subject: Subject) -> None:
    """Built twice, the fabric is the same, with the number of vertices that `count` returns."""
    fabric = made_twice(lambda: build_fabric(subject))
    assert fabric.number == subject.plugin.count(subject.config, subject.files)


def each_spring_and_hinge_is_there_once(subject: Subject) -> None:
    """No two springs join the same vertices, and no two hinges."""
    fabric = build_fabric(subject)
    springs = [] if fabric.springs is None else [np.sort(fabric.springs.pairs(), axis=1)]
    hinges = [] if fabric.hinges is None else [np.sort(fabric.hinges.quads(), axis=1)]
    for corners in (*springs, *hinges):
        assert len(np.unique(corners, axis=0)) == len(corners)


def triangles_face_one_way(subject: Subject) -> None:
    """Each triangle has an area, and neighbours run along their common edge in opposite directions."""
    fabric = build_fabric(subject)
    x, faces = fabric.position, fabric.faces
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert (face_areas(x[faces]) > 0.0).all()
    assert len(np.unique(edges, axis=0)) == len(edges)


MODELS = (it_is_built_the_same_again, each_spring_and_hinge_is_there_once, triangles_face_one_way)


def apply_operation(subject: Subject, fabric: Fabric) -> Outcome:
    """Apply an operation to a fabric at rest, without bodies, or on the surface of a body if it needs one."""
    state = State(fabric.position.copy(), 0.0 * fabric.position)

    def make() -> Outcome:
        if not hasattr(subject.plugin, "apply_beside"):
            made: Outcome = subject.plugin.apply(subject.config, fabric, state, None)
            return made
        pose = np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)), np.zeros((1, fabric.number))
        on_body: Outcome = subject.plugin.apply_beside(subject.config, fabric, state, Beside(("body",), *pose))
        return on_body

    made: Outcome = made_twice(make, fabric, state)
    return made


def it_makes_the_same_again_and_leaves_its_arguments_alone(subject: Subject) -> None:
    """Applied twice to a knitted tube or a sheet of triangles, it makes the same finite numbers and sound curves."""
    knit, sheet = (registry.load("nuno.models", name) for name in ("knit", "sheet"))
    try:
        made = apply_operation(subject, knit.build(knit.Config(form="tube", wales=8, courses=15), None, 0))
    except BadInput:
        made = apply_operation(subject, sheet.build(sheet.Config(cells="triangles", pin=("top-left",)), None, 0))
    assert np.isfinite(list(made.facts.values())).all()
    if (curves := made.curves) is None:
        return
    n = len(curves.points)
    assert curves.points.shape == curves.normal.shape == (n, 3) and np.isfinite(curves.points).all()
    assert curves.ptr[0] == 0 and curves.ptr[-1] == n and (np.diff(curves.ptr) >= 2).all()
    assert len(curves.radius) == len(curves.kind) == len(curves.ptr) - 1
    assert set(curves.kind.tolist()) <= set(range(len(curves.names)))
    assert np.isin(np.round(np.linalg.norm(curves.normal, axis=1), 12), (0.0, 1.0)).all()
    assert all(len(values) == n for values in made.arrays.values())


OPERATIONS = (it_makes_the_same_again_and_leaves_its_arguments_alone,)


def answers_to_its_entry_point(subject: Subject) -> None:
    """The plugin has the name under which it is installed, and holds no state."""
    plugin = registry.installed(subject.group)[subject.name].load()()
    assert plugin.name == subject.name
    assert vars(plugin) == {}


def refuses_unknown_fields_by_name(subject: Subject) -> None:
    """An unknown field is refused by its name; the configuration has a JSON Schema, and can be written as JSON."""
    config = subject.plugin.Config
    with pytest.raises(ValidationError, match="no_such_field"):
        config.model_validate(subject.config.model_dump(exclude_unset=True) | {"no_such_field": 1})
    schema = json.loads(json.dumps(config.model_json_schema()))
    assert schema["additionalProperties"] is False
    assert set(schema.get("properties", {})) == set(config.model_fields)
    assert config.model_validate_json(subject.config.model_dump_json(exclude_unset=True)) == subject.config


ALL = (answers_to_its_entry_point, refuses_unknown_fields_by_name)
OWN: Mapping[str, tuple[Callable[[Subject], None], ...]] = {
    "nuno.models": MODELS,
    "nuno.operations": OPERATIONS,
    "nuno.forces": FORCES,
    "nuno.integrators": integrators.INTEGRATORS + integrators.RIDES,
    "nuno.colliders": bodies.COLLIDERS,
    "nuno.motions": bodies.MOTIONS,
    "nuno.contacts": CONTACTS,
    "nuno.renderers": RENDERERS,
    "nuno.dye_solvers": SOLVERS,
    "nuno.isotherms": ISOTHERMS,
}
"""Checks of each kind; other kinds have only those of all kinds."""


def checks_of(group: str) -> tuple[Callable[[Subject], None], ...]:
    """Return the checks of a kind of plugin."""
    return ALL + OWN.get(group, ())
