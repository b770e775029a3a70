"""Building of the simulated system of a loaded scene: one fabric, one set of bodies, one system."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

from nuno.collision.bodies import Bodies, build_bodies, surface, vertex_normals
from nuno.runtime.stepper import require_memory
from nuno.scene.chosen_plugins import Chosen
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import with_doubts
from nuno.simulation.start_checks import check_wearer, check_worn
from nuno_schemas.bodies import OF_TRIANGLES, SKIN, Geometry, Poses, rotation_matrices, units_for
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import (
    Bending,
    BendingFriction,
    Binding,
    Corners,
    Fabric,
    Float,
    Hinges,
    Int,
    Membrane,
    Panels,
    Springs,
    State,
    Yarns,
)
from nuno_schemas.operation import Surface, arranges
from nuno_schemas.plugin import Rested
from nuno_schemas.scene import Fading, Scene
from nuno_schemas.system import Carried, System, Term
from nuno_schemas.vectors import turn

# An uneven start, which flat cloth needs to leave its plane.
#
# In a plane, no force pushes cloth out of it: without unevenness a hung sheet keeps z = 0 forever, and a strip of any
# length stands on its edge. Rejected: noise for each vertex, which has more and steeper bumps on a finer mesh, so that
# its springs would start strained; waves in space are the same unevenness on any mesh.

WAVES, SHORTEST = 64, 8.0
"""Number of waves in the sum, with lengths from the diagonal of the cloth's bounding box to this fraction of it."""


def roughen(fabric: Fabric, height: float, seed: int) -> Fabric:
    """Return the fabric with its free vertices moved along their normals by `height` [m], root mean square.

    Springs and hinges are unchanged: at rest the cloth is as flat as before. Raises BadInput without faces.
    """
    if len(fabric.faces) == 0:
        raise BadInput("only cloth with triangles has a normal to be rough along", remedy="leave it out")
    moved = height * _waves(fabric.position, np.random.default_rng(seed))
    held = fabric.pinned.copy()
    for binding in fabric.bindings:
        held[binding.vertices] = True
    moved[held] = 0.0
    return replace(fabric, position=fabric.position + moved[:, None] * vertex_normals(fabric.position, fabric.faces))


def _waves(x: Float, random: np.random.Generator) -> Float:
    """Return a sum of waves (n,) at places (n, 3), with mean square 1; the order of the sum is fixed."""
    size = math.hypot(*np.ptp(x, axis=0).tolist()) or 1.0
    total = np.zeros(len(x))
    for _ in range(WAVES):
        number = 2.0 * math.pi / size * SHORTEST ** random.uniform()
        up, turn, phase = random.uniform(-1.0, 1.0), *random.uniform(0.0, 2.0 * math.pi, 2)
        level = math.sqrt(1.0 - up**2)
        along = level * math.cos(turn) * x[:, 0] + up * x[:, 1] + level * math.sin(turn) * x[:, 2]
        total += np.cos(number * along + phase)
    return math.sqrt(2.0 / WAVES) * total


# Operations that arrange all cloth of a scene before the first step.


@dataclass(frozen=True)
class Start:
    """The fabric of each object at the start, and the report of each operation that arranged it: operation, object (""
    for all) and facts.
    """

    fabrics: list[Fabric]
    facts: list[dict[str, Any]]


def arrange(loaded: Loaded, fabrics: list[Fabric], bodies: Surface | None) -> Start:
    """Apply the scene's operations that arrange the start, in order, around the bodies of the cloth contact. Raises
    BadInput.

    An operation on one object moves only that: all others are held.
    """
    scene, facts = loaded.scene, list[dict[str, Any]]()
    stops = np.cumsum([0, *(fabric.number for fabric in fabrics)]).tolist()
    names = [spec.name for spec in scene.objects]
    objects = {name: np.arange(a, b, dtype=np.int32) for name, (a, b) in zip(names, pairwise(stops), strict=True)}
    meet = scene.meet() if scene.meets else np.ones((len(names), len(names)), np.bool_)
    thickness = getattr(loaded.cloth_contact.config, "thickness", None) if loaded.cloth_contact else None
    for i, (applied, chosen) in enumerate(zip(scene.operations, loaded.operations, strict=True)):
        if not arranges(chosen.plugin):
            continue
        whole = join_fabrics(fabrics, scene.name)
        if applied.object is not None:
            held = np.ones(whole.number, np.bool_)
            held[objects[applied.object]] = False
            whole = replace(whole, pinned=whole.pinned | held)
        with loaded.errors_at(f"operations[{i}]"):
            moved = chosen.plugin.arrange(chosen.config, whole, objects, meet, thickness, bodies)
        fabrics = [replace(f, position=moved.position[a:b]) for f, (a, b) in zip(fabrics, pairwise(stops), strict=True)]
        facts.append({"operation": chosen.name, "object": applied.object or "", "facts": dict(moved.facts)})
    return Start(fabrics, facts)


BYTES_PER_VERTEX = 400
"""Most memory of a run per vertex, for springs and hinges in runs along rows, as on grids;
`nuno bench speed` measures it. Models with separate elements have their own estimate."""


@dataclass(frozen=True)
class Piece:
    """Range of one object's vertices in the joined fabric."""

    name: str
    start: int
    stop: int
    texture: str | None = None
    colour: str | None = None


def estimate_memory(loaded: Loaded) -> tuple[int, int]:
    """Return the number of the scene's vertices, and the most memory of a run [bytes]. Raises BadInput.

    A model whose memory is not proportional to its vertices has a method
    `memory(config, files, vertices)`, in bytes.
    """
    total, size = 0, 0
    for i, model in enumerate(loaded.models):
        try:
            vertices = model.plugin.count(model.config, loaded.files)
            estimate = getattr(model.plugin, "memory", None)
            size += estimate(model.config, loaded.files, vertices) if estimate else vertices * BYTES_PER_VERTEX
        except BadInput as error:
            raise with_doubts(loaded, f"objects[{i}].model", error) from None
        total += vertices
    return total, size


def check_memory(loaded: Loaded) -> None:
    """Raise BadInput, before anything is allocated, if the scene cannot fit in memory."""
    vertices, size = estimate_memory(loaded)
    require_memory(loaded, "objects", vertices, "vertices", size, "lower the resolution, or take springs away")


def build_fabric(
    loaded: Loaded, geometry: Geometry | None = None, poses: Poses | None = None
) -> tuple[Fabric, list[Piece]]:
    """Build all objects as one fabric, and return also their ranges in it. Raises BadInput."""
    return build_with_facts(loaded, geometry, poses)[:2]


def build_with_facts(
    loaded: Loaded, geometry: Geometry | None, poses: Poses | None, rested: Sequence[Rested] = ()
) -> tuple[Fabric, list[Piece], list[dict[str, Any]]]:
    """Build as `build_fabric`, and return also the `facts` of `Start`. Raises BadInput."""
    start = build_start(loaded, geometry, poses, rested)
    return join_fabrics(start.fabrics, loaded.scene.name), place_pieces(loaded, start.fabrics), start.facts


def place_pieces(loaded: Loaded, fabrics: list[Fabric]) -> list[Piece]:
    """Return the range of each object in the joined fabric."""
    stops = np.cumsum([fabric.number for fabric in fabrics]).tolist()
    each = zip(loaded.scene.objects, fabrics, stops, strict=True)
    return [Piece(spec.name, stop - f.number, stop, f.texture, spec.colour) for spec, f, stop in each]


VAST = 20.0
"""Size of a mesh from which another unit of its file is likelier [m]."""


def size_warnings(loaded: Loaded, pieces: Sequence[Piece], x: Float) -> list[str]:
    """Return warnings of meshes, of all cloth at x (n, 3) [m], that are far too large for cloth in metres."""
    warnings = []
    for model, piece in zip(loaded.models, pieces, strict=True):
        size = float(np.ptp(x[piece.start : piece.stop], axis=0).max(initial=0.0))
        scale = getattr(model.config, "scale", None)
        if scale is not None and size > VAST:
            units = " or ".join(f"{unit} ({long:.3g} m long)" for unit, long in units_for(size / scale).items())
            remedy = f": is its file in {units}? State it as the model's `scale`" if units else ""
            warnings.append(f"{piece.name} is {size:.3g} m long{remedy}")
    return warnings


def build_fabrics(
    loaded: Loaded, geometry: Geometry | None = None, poses: Poses | None = None, rested: Sequence[Rested] = ()
) -> list[Fabric]:
    """Build the fabric of each object at the start, as `build_start`. Raises BadInput."""
    return build_start(loaded, geometry, poses, rested).fabrics


def build_start(
    loaded: Loaded, geometry: Geometry | None = None, poses: Poses | None = None, rested: Sequence[Rested] = ()
) -> Start:
    """Build the fabric of each object, and apply the operations that arrange the start.

    Bodies, with their poses at the start, are built for objects that are drawn over one, unless they are given;
    `rested` are the objects' coarse states at rest, if any. Raises BadInput.
    """
    arranging = loaded.scene.met_bodies and any(arranges(operation.plugin) for operation in loaded.operations)
    if geometry is None and loaded.colliders and (arranging or any(map(drawn_over, loaded.models))):
        bodies = build_bodies(loaded)
        geometry, poses = bodies.geometry, bodies.poses(0.0)
    fabrics = _build_models(loaded, geometry, poses, rested)
    if not arranging or geometry is None or poses is None:
        return arrange(loaded, fabrics, None)
    bodies_met = surface(geometry.of_bodies(loaded.scene.met_bodies))
    return arrange(loaded, fabrics, Surface(bodies_met.at(poses), bodies_met.faces))


def _build_models(
    loaded: Loaded, geometry: Geometry | None, poses: Poses | None, rested: Sequence[Rested]
) -> list[Fabric]:
    check_memory(loaded)
    over = [drawn_over(model) for model in loaded.models]
    fabrics: list[Fabric] = []
    for i, (model, spec) in enumerate(zip(loaded.models, loaded.scene.objects, strict=True)):
        try:
            arguments: tuple[Any, ...] = (model.config, loaded.files, loaded.scene.seed + i)
            if (name := over[i]) is None:
                fabric = model.plugin.build(*arguments)
            else:
                inner = [one for one, body in zip(fabrics, over, strict=False) if body == name and len(one.faces)]
                coarse_state = {"rested": rested[i]} if rested and hasattr(model.plugin, "coarser") else {}
                x, faces = mesh_of(name, geometry, poses)
                check_wearer(loaded, name, x)
                fabric = model.plugin.build_over(*arguments, x, faces, inner, **coarse_state)
            if loaded.scene.dye is not None and loaded.scene.dye.object == spec.name:
                check_texture(fabric, spec.name)
        except BadInput as error:
            raise with_doubts(loaded, f"objects[{i}].model", error) from None
        if spec.roughness and not rested:
            with loaded.errors_at(f"objects[{i}].roughness"):
                fabric = roughen(fabric, spec.roughness, loaded.scene.seed + i)
        if rested and not hasattr(model.plugin, "coarser"):
            fabric = replace(fabric, position=rested[i].x)
        fabrics.append(fabric)
    return fabrics


def drawn_over(model: Chosen) -> str | None:
    """Return the name of the body that a model is drawn over, None without one."""
    over = getattr(model.plugin, "over", None)
    return over(model.config) if over else None


def no_body(name: str, bodies: Sequence[str]) -> BadInput:
    """Return the error for cloth over a body that the scene does not have."""
    remedy = nearest(name, bodies)
    return BadInput("there is no such body to draw it over", field="over.body", value=name, remedy=remedy)


def mesh_of(name: str, geometry: Geometry | None, poses: Poses | None) -> tuple[Float, Int]:
    """Return vertices (v, 3) [m] in the world and faces (f, 3) of a body that is one mesh. Raises BadInput."""
    if geometry is None or poses is None or name not in geometry.bodies:
        raise no_body(name, geometry.bodies if geometry else ())
    primitives = np.flatnonzero(geometry.body == geometry.bodies.index(name))
    if len(primitives) != 1 or geometry.kind[primitives[0]] not in OF_TRIANGLES:
        remedy = "give the body collider: {plugin: mesh, ...}"
        raise BadInput("only a mesh can be drawn over", field="over.body", value=name, remedy=remedy)
    return geometry.placed(int(primitives[0]), poses)


def bind(
    loaded: Loaded, fabric: Fabric, pieces: list[Piece], geometry: Geometry | None, poses: Poses | None
) -> list[Carried]:
    """Return the bound vertices, and their coordinates in the frames that carry them.

    Local coordinates are those of the start, so cloth is attached where the scene places it; later attachments have
    their own. Raises BadInput for a body or frame that does not exist, or that the cloth is far from.
    """
    carried = []
    for binding in fabric.bindings:
        x = fabric.position[binding.vertices]
        try:
            skinned = skin_of(binding, geometry)
            index, local = frame_of(binding, geometry.frames if geometry else (), skinned), binding.local
            assert geometry is not None and poses is not None
            if local is None:
                check_worn(x, geometry, poses, index)
        except BadInput as error:
            vertex = int(binding.vertices[0])
            piece = next(i for i, piece in enumerate(pieces) if vertex < piece.stop)
            raise loaded.at(f"objects[{piece}].model.attach", error) from None
        skin = None
        if local is None and skinned is not None:
            body_skin = geometry.skin(skinned)
            assert body_skin is not None
            skin = body_skin.beside(x, *geometry.placed(skinned, poses))
            frames = slice(index, index + len(skin.place))
            local = skin.unbend(x, poses.rotation[frames], poses.translation[frames])
        elif local is None:
            inverse = rotation_matrices(poses.rotation[index]).T
            local = turn(inverse, x - poses.translation[index])
        carried.append(Carried(binding.vertices, local, np.full(len(local), index, np.int32), skin))
    return carried


def skin_of(binding: Binding, geometry: Geometry | None) -> int | None:
    """Return the primitive whose skin carries bound vertices: that of their body, if the binding names no frame."""
    if binding.frame is not None or geometry is None or binding.body not in geometry.bodies:
        return None
    primitives = (geometry.kind == SKIN) & (geometry.body == geometry.bodies.index(binding.body))
    return int(np.argmax(primitives)) if primitives.any() else None


def frame_of(binding: Binding, frames: Sequence[str], skinned: int | None = None) -> int:
    """Return the index of the frame, each BODY/FRAME, that carries bound vertices; the body's first if the primitive
    `skinned` carries them. Raises BadInput for an unknown frame, and if a body with several frames needs a name.
    """
    names_of = [name for name in frames if name.startswith(f"{binding.body}/")]
    if binding.frame is None and len(names_of) > 1 and skinned is None:
        problem = "the body has several frames, and cloth moves with one"
        names = ", ".join(name.removeprefix(f"{binding.body}/") for name in names_of)
        raise BadInput(problem, value=binding.body, limit=names, remedy="name it: attach: {body: ..., frame: ...}")
    name = names_of[0] if binding.frame is None and names_of else "/".join(filter(None, (binding.body, binding.frame)))
    if name not in frames:
        remedy = nearest(name, frames)
        raise BadInput("cloth is attached to a frame that no body has", value=name, remedy=remedy)
    return frames.index(name)


def build_system(
    loaded: Loaded, fabric: Fabric, pieces: list[Piece], geometry: Geometry | None, poses: Poses | None, threads: int
) -> System:
    """Build the system of the fabric and all forces on it; poses are those of t = 0. Raises BadInput."""
    gravity = np.array(loaded.scene.gravity)
    carried = tuple(bind(loaded, fabric, pieces, geometry, poses))
    attaching = any(hasattr(one.plugin, "apply_beside") for one in loaded.operations)
    if not carried and attaching:  # steps are compiled for later attachments
        empty = np.zeros(0, np.int32)
        carried = (Carried(empty, np.zeros((0, 3)), empty),)
    terms = []
    for i, force in enumerate(loaded.forces):
        terms.append(_prepare_term(loaded, f"forces[{i}]", force, fabric, loaded.scene.seed + 1000 + i))
    fields = {body.name: by.field for body, by in zip(loaded.scene.bodies, loaded.contacts, strict=True)}
    for contact, numbers in group_contacts(loaded):
        if geometry is not None and len((bodies_of_contact := geometry.of_bodies(numbers)).kind):
            term = _prepare_term(loaded, contact.field, contact, fabric, bodies_of_contact, gravity, fields=fields)
            terms.append(replace(term, bodies=bodies_of_contact.bodies))
    met_bodies = loaded.scene.met_bodies
    if (meeting := loaded.cloth_contact) is not None:
        if not len(fabric.faces):
            problem = "only cloth of triangles meets cloth, and bodies as it meets cloth: here is none"
            raise loaded.at("cloth_contact", BadInput(problem, remedy="leave cloth_contact out"))
        objects = {piece.name: np.arange(piece.start, piece.stop, dtype=np.int32) for piece in pieces}
        met = geometry is not None and (met_bodies or SKIN in geometry.kind)
        bodies = [geometry.of_bodies(met_bodies), poses] if geometry is not None and met else []
        term = _prepare_term(loaded, meeting.field, meeting, fabric, objects, loaded.scene.meet(), gravity, *bodies)
        terms.append(replace(term, bodies=tuple(loaded.scene.bodies[i].name for i in met_bodies)))
    return System(fabric, gravity, _most_damping(loaded.scene), tuple(terms), threads, carried)


def build_scene(loaded: Loaded, threads: int) -> tuple[System, Bodies | None]:
    """Build a scene's cloth, bodies and forces at the start. Raises BadInput."""
    fabric, pieces = build_fabric(loaded)
    bodies = build_bodies(loaded) if loaded.colliders else None
    geometry, poses = (bodies.geometry, bodies.poses(0.0)) if bodies else (None, None)
    return build_system(loaded, fabric, pieces, geometry, poses, threads), bodies


def group_contacts(loaded: Loaded) -> list[tuple[Chosen, list[int]]]:
    """Return the contacts of a scene with the numbers of their bodies; equal ones are merged. Bodies of the cloth
    contact are in none.
    """
    groups: list[tuple[Chosen, list[int]]] = []
    for i, contact in enumerate(loaded.contacts):
        if i in loaded.scene.met_bodies:
            continue
        equal = (bodies for other, bodies in groups if (other.name, other.config) == (contact.name, contact.config))
        if (bodies := next(equal, None)) is None:
            groups.append((contact, bodies := []))
        bodies.append(i)
    return groups


def _most_damping(scene: Scene) -> float:
    """Return the largest damping of a run [1/s]."""
    if isinstance(scene.damping, Fading):
        return max(scene.damping.first, scene.damping.last)
    return 3.0 * scene.frame_rate if scene.damping == "auto" else scene.damping


def _prepare_term(
    loaded: Loaded, field: str, chosen: Chosen, *args: object, fields: Mapping[str, str] = MappingProxyType({})
) -> Term:
    """Return a plugin's term; an error is located at `field`, or at the one of `fields` for the body that it names."""
    try:
        term: Term = chosen.plugin.prepare(chosen.config, *args)
    except BadInput as error:
        raise loaded.at(fields.get(error.field or "", field), error) from None
    return term


def start_state(fabric: Fabric) -> State:
    """Return the state at the start, with velocity 0 of pinned vertices."""
    velocity = np.array(fabric.velocity, np.float64, order="C")
    velocity[fabric.pinned] = 0.0
    return State(np.array(fabric.position, np.float64, order="F"), velocity, 0.0)


# Joining of several fabrics into one.


def join_fabrics(fabrics: list[Fabric], name: str) -> Fabric:
    """Join fabrics in order; a single one is returned unchanged."""
    if len(fabrics) == 1:
        return fabrics[0]
    starts = np.cumsum([0, *(f.number for f in fabrics)])
    moved = list(zip(fabrics, starts, strict=False))
    springs = [replace(f.springs, first=(f.springs.first + at).astype(np.int32)) for f, at in moved if f.springs]
    hinges = [(f.hinges, at) for f, at in moved if f.hinges]
    before = np.cumsum([0, *(f.springs.number if f.springs else 0 for f in fabrics)]).tolist()
    membranes = [replace(f.membrane, faces=f.membrane.faces + np.int32(at)) for f, at in moved if f.membrane]
    bending = [(f.bending.pairs + np.int32(at), f.bending.weight) for f, at in moved if f.bending]
    friction = [replace(f.friction, vertices=f.friction.vertices + np.int32(at)) for f, at in moved if f.friction]
    cells = [f.cells + at for f, at in moved if f.cells is not None]
    yarns = [(f.yarns, at) for f, at in zip(fabrics, before, strict=False) if f.yarns]
    empty, no_uv = np.zeros((0, 3)), np.zeros((0, 2), np.float32)
    return Fabric(
        name,
        np.concatenate([empty, *(f.position for f in fabrics)]),
        np.concatenate([empty, *(f.velocity for f in fabrics)]),
        np.concatenate([np.zeros(0), *(f.mass for f in fabrics)]),
        np.concatenate([np.zeros(0, bool), *(f.pinned for f in fabrics)]),
        np.concatenate([np.zeros((0, 3), np.int32), *((f.faces + at).astype(np.int32) for f, at in moved)]),
        Springs.join(springs) if springs else None,
        _join_hinges(hinges) if hinges else None,
        np.concatenate([no_uv, *(np.zeros((f.number, 2), np.float32) if f.uv is None else f.uv for f in fabrics)]),
        tuple(replace(b, vertices=(b.vertices + at).astype(np.int32)) for f, at in moved for b in f.bindings),
        yarns=Yarns.join(yarns) if yarns else None,
        cells=np.concatenate(cells).astype(np.int32) if cells else None,
        membrane=_join_membranes(membranes) if membranes else None,
        friction=BendingFriction.join(friction) if friction else None,
        corners=_join_corners(moved) if any(f.corners is not None for f in fabrics) else None,
        bending=Bending(*map(np.concatenate, zip(*bending, strict=True))) if bending else None,
    )


def _join_corners(moved: list[tuple[Fabric, np.int64]]) -> Corners:
    """Join corners; a fabric without any has one for each vertex, at its texture coordinates."""
    parts = [f.laid_out or Corners(np.zeros((f.number, 2), np.float32), np.arange(f.number, dtype=np.int32), f.faces)
             for f, _ in moved]  # fmt: skip
    before = np.cumsum([0, *(len(part.vertex) for part in parts)])
    return Corners(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.vertex + at for part, (_, at) in zip(parts, moved, strict=True)]).astype(np.int32),
        np.concatenate([part.faces + at for part, at in zip(parts, before, strict=False)]).astype(np.int32),
        _join_panels(parts, before.tolist()) if any(part.panels for part in parts) else None,
    )


def _join_panels(parts: list[Corners], before: list[int]) -> Panels:
    """Join panels; triangles of a fabric without panels belong to none."""
    free = np.full((max(len(part.faces) for part in parts), 3), -1, np.int32)
    plain = [Panels((), free[: len(c.faces), 0], free[: len(c.faces)], np.empty(0), free[:0, :2], free[:0, 0])
             for c in parts]  # fmt: skip
    all_ = [part.panels or empty for part, empty in zip(parts, plain, strict=True)]
    names = np.cumsum([0, *(len(panels.names) for panels in all_)]).tolist()
    seams = np.cumsum([0, *(int(panels.seam.max(initial=-1)) + 1 for panels in all_)]).tolist()
    return Panels(
        tuple(name for panels in all_ for name in panels.names),
        np.concatenate([np.where(p.of < 0, -1, p.of + at) for p, at in zip(all_, names, strict=False)]).astype(
            np.int32
        ),
        np.concatenate([panels.edge for panels in all_]),
        np.concatenate([panels.unit for panels in all_]),
        np.concatenate([p.pairs + at for p, at in zip(all_, before, strict=False)]).astype(np.int32),
        np.concatenate([p.seam + at for p, at in zip(all_, seams, strict=False)]).astype(np.int32),
    )


def _join_membranes(parts: list[Membrane]) -> Membrane:
    faces, along, across, area = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("faces", "along", "across", "area")
    )
    moduli, damping = (np.concatenate([getattr(p, name) for p in parts], axis=1) for name in ("moduli", "damping"))
    return Membrane(faces, along, across, area, moduli, damping)


def _join_hinges(parts: list[tuple[Hinges, int]]) -> Hinges:
    per_run = all(h.k.shape == h.rest.shape == h.count.shape for h, _ in parts)
    values = [(h.k, h.rest) if per_run else (h.per_hinge(h.k), h.per_hinge(h.rest)) for h, _ in parts]
    return Hinges(
        np.concatenate([(h.first + at).astype(np.int32) for h, at in parts]),
        np.concatenate([h.count for h, _ in parts]),
        np.concatenate([h.stride for h, _ in parts]),
        np.concatenate([k for k, _ in values]),
        np.concatenate([rest for _, rest in values]),
    )


# Texture coordinates of cloth: their check, and the size of the texture, which a print or a dyed pattern has.

UV_ROUNDING = 1e-6
"""Texture coordinates are float32, and files round them."""


def texture_size(fabric: Fabric) -> tuple[float, float]:
    """Return width and height [m] of the whole texture, [0, 1] x [0, 1], on cloth at its start: means of |dx/du| and
    |dx/dv| over its triangles, by area. Raises ValueError for cloth without texture coordinates.
    """
    corners = fabric.laid_out
    if corners is None:
        raise ValueError("cloth without texture coordinates")
    points, faces = corners.points[corners.faces], fabric.faces
    # x = x0 + (dx/du) u + (dx/dv) v on each triangle, so that its two sides have [e1 e2] = [dx/du dx/dv] [t1 t2].
    sides = np.diff(fabric.position[faces], axis=1)
    t = np.diff(points.astype(np.float64), axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    det = t[:, 0, 0] * t[:, 1, 1] - t[:, 0, 1] * t[:, 1, 0]
    flat = det != 0.0
    along_u = (sides[flat, 0] * t[flat, 1, 1:] - sides[flat, 1] * t[flat, 0, 1:]) / det[flat, None]
    along_v = (sides[flat, 1] * t[flat, 0, :1] - sides[flat, 0] * t[flat, 1, :1]) / det[flat, None]
    width, height = (float(np.average(np.linalg.norm(per, axis=1), weights=area[flat])) for per in (along_u, along_v))
    return width, height


def check_texture(fabric: Fabric, name: str) -> None:
    """Raise BadInput for a fabric without texture coordinates in [0, 1] x [0, 1], which dye cells need."""
    corners = fabric.laid_out
    if corners is None:
        remedy = "dye a sheet or a skirt, or give the mesh texture coordinates"
        raise BadInput("what is dyed needs texture coordinates, and this has none", value=name, remedy=remedy)
    low, high = float(corners.points.min(initial=0.0)), float(corners.points.max(initial=1.0))
    if not (low >= -UV_ROUNDING and high <= 1.0 + UV_ROUNDING):
        problem = "texture coordinates leave the cloth that is dyed"
        remedy = "lay the mesh's texture out without repeating it"
        raise BadInput(problem, value=f"{low:g} to {high:g}", limit="0 to 1", remedy=remedy)
