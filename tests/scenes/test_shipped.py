"""Every shipped scene runs: finite, held together, the same twice; dye is kept, knits settle."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from nuno.bus.encodings import encode_arrays
from nuno.collision.bodies import build_bodies
from nuno.collision.distance import penetration
from nuno.dye.painter import DyePainter
from nuno.dye.run import DyeRun
from nuno.scene import scene_file, shipped
from nuno.simulation import cloth
from nuno.simulation.run import Simulation
from nuno_integrators.implicit import linear_solve as solver
from nuno_integrators.implicit.plugin import ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.step.acceleration import evaluate
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System

FRAMES = 5
SCENES = shipped.scenes("") | shipped.scenes("contact")
QUICK = ("hanging-sheet", "skirt-hula")
"""Scenes that have between them what shipped scenes are made of; each other one compiles its own kernels."""
STRETCH = 0.25
"""No shipped scene stretches a spring further than this in its first frames."""
DEPTH = 5e-3
"""No shipped scene lets cloth deeper into a body than this [m] in its first frames."""


def simulate(name: str) -> tuple[Simulation, list[float], list[float]]:
    """A few frames: the simulation, and the largest stretch and depth of each frame."""
    loaded = scene_file.read(SCENES[name])
    bodies = build_bodies(loaded) if loaded.scene.bodies else None
    start = bodies.poses(0.0) if bodies else None
    simulation = Simulation(loaded, bodies.geometry if bodies else None, start, 1)
    stretches, depths = [], []
    for frame in range(1, FRAMES + 1):
        end = bodies.poses(frame / loaded.scene.frame_rate) if bodies else None
        report = simulation.advance(start, end).report
        assert report.status == "ok"
        stretches.append(report.stretch)
        if bodies and end:
            depths.append(float(penetration(simulation.state.x, bodies.geometry, end).max()))
        start = end
    return simulation, stretches, depths


@pytest.mark.quick(name=QUICK)
@pytest.mark.parametrize("name", sorted(SCENES))
def test_scene_holds_together_and_runs_the_same_twice(name: str) -> None:
    first, stretches, depths = simulate(name)
    assert np.isfinite(first.state.x).all()
    assert max(stretches) < STRETCH
    assert max(depths, default=0.0) < DEPTH
    assert simulate(name)[0].digest() == first.digest()


@pytest.mark.quick(name=["skirt-hula"])
@pytest.mark.parametrize("name", ["skirt-hula", "skirt-walk", "skirt-paper"])
def test_waist_follows_its_frame(name: str) -> None:
    simulation, _, _ = simulate(name)
    bodies = build_bodies(simulation.loaded)
    binding = simulation.fabric.bindings[0]
    index = bodies.geometry.frames.index(f"{binding.body}/{binding.frame}")
    rate = simulation.loaded.scene.frame_rate
    place = [bodies.poses(frame / rate) for frame in (0, FRAMES)]
    waist = [simulation.fabric.position[binding.vertices], simulation.state.x[binding.vertices]]
    local = [
        (x - p.translation[index]) @ cloth.rotation_matrices(p.rotation[index])
        for x, p in zip(waist, place, strict=True)
    ]
    np.testing.assert_allclose(local[1], local[0], atol=1e-12)


FOLDER = shipped.scenes("")["skirt-walk"].parent
MESHES = tuple(f"contact/{name}.obj" for name in ("funnel", "knot-left", "knot-right", "scarf", "star", "table"))
SCRIPTS = {
    "make_walk.py": ("walk.bvh",), "make_pattern.py": ("seigaiha.png",), "make_net.py": ("pendulum.npz",),
    "contact/make_cards.py": ("contact/cards.yaml",), "contact/make_meshes.py": MESHES,
}  # fmt: skip
"""And what they make."""


@pytest.mark.quick(script=[script for script in SCRIPTS if script != "make_pattern.py"])
@pytest.mark.parametrize("script", SCRIPTS)
def test_files_are_what_their_scripts_make(script: str, tmp_path: Path) -> None:
    copy = tmp_path / script
    copy.parent.mkdir(exist_ok=True)
    copy.write_text((FOLDER / script).read_text())
    subprocess.run([sys.executable, str(copy)], check=True, cwd=tmp_path)
    for made in SCRIPTS[script]:
        if made.endswith(".png"):
            from PIL import Image

            new, old = (np.asarray(Image.open(path / made)) for path in (tmp_path, FOLDER))
            np.testing.assert_array_equal(new, old)
        elif made.endswith(".npz"):  # the arrays' own bytes: how they are packed is the zip library's matter
            with zipfile.ZipFile(tmp_path / made) as new_file, zipfile.ZipFile(FOLDER / made) as old_file:
                assert new_file.namelist() == old_file.namelist()
                for member in old_file.namelist():
                    assert new_file.read(member) == old_file.read(member), member
        else:
            assert (tmp_path / made).read_text() == (FOLDER / made).read_text()


def test_every_shipped_data_file_has_its_script() -> None:
    data = [path for path in FOLDER.iterdir() if path.suffix not in (".yaml", ".py") and path.is_file()]
    data += [path for path in (FOLDER / "contact").iterdir() if path.suffix not in (".yaml", ".py")]
    made = {name for names in SCRIPTS.values() for name in names if not name.endswith(".yaml")}
    assert {str(path.relative_to(FOLDER)) for path in data} == made


NAMES = ("drops", "folded", "halo", "ikat", "photograph")
DYE_SCENES = [Path(__file__).parents[2] / "scenes" / "dye" / f"{name}.yaml" for name in NAMES]


@pytest.mark.quick(path=[path for path in DYE_SCENES if path.stem in ("drops", "folded", "photograph")])
@pytest.mark.parametrize("path", DYE_SCENES, ids=lambda path: path.stem)
def test_a_scene_of_dye_runs_and_shows_its_dye(path: Path) -> None:
    loaded = scene_file.read(path)
    dyeing, painter = DyeRun(loaded, 0), DyePainter(loaded)
    cells = dyeing.cells
    painter.prepare(cells, cells.size)
    frame = dyeing.advance()
    assert frame.report.status == "ok" and dyeing.balance(frame.report) < 1e-12
    state = dyeing.state
    assert state.phi.min() >= 0.0 and (state.phi.sum(axis=(1, 2, 3)) > 0.0).all()
    dyed, bare = (
        painter.draw(encode_arrays({name: np.float32(share * getattr(state, name)) for name in ("phi", "fixed")}))
        for share in (1.0, 0.0)
    )
    assert 0.01 < (dyed != bare).any(axis=2).mean() <= 1.0


@pytest.mark.full
def test_what_diffuses_faster_where_it_is_thin_keeps_a_core_and_sends_a_halo() -> None:
    """Of as much dye as the even drop beside it: more at its darkest, and more of it farther than twice the drop."""
    dyeing = DyeRun(scene_file.read(DYE_SCENES[NAMES.index("halo")]), 0)
    while not dyeing.finished:
        assert dyeing.advance().report.status == "ok"
    even, thinning = dyeing.state.phi.sum(axis=1)
    assert thinning.sum() == pytest.approx(even.sum(), rel=1e-12)
    assert thinning.max() > 1.2 * even.max()
    y, x = np.mgrid[0:130, 0:260]
    far_even, far_thinning = (
        amount[np.hypot(x - middle, y - 64.5) > 40].sum() / amount.sum()
        for amount, middle in ((even, 64.5), (thinning, 194.5))
    )
    assert far_thinning > 1.2 * far_even


LEGS = 90
"""Of 9 courses and 10 columns; arcs follow."""


def simulate_knit(name: str, frames: int) -> tuple[Simulation, list[Float]]:
    """Positions after each frame; a frame is a step."""
    simulation = Simulation(scene_file.read(shipped.scenes("knit")[f"knit/{name}"]), None, None, 1)
    assert simulation.steps == 1
    positions = []
    for _ in range(frames):
        assert simulation.advance(None, None).report.status == "ok"
        positions.append(simulation.state.x.copy())
    return simulation, positions


def balance(system: System) -> Float:
    """(n, 3) where all forces vanish, by Newton's method with a derivative taken by differences."""
    fabric, packed = system.fabric, pack(system)
    free = np.flatnonzero(np.repeat(~fabric.pinned, 3))
    x = fabric.position.reshape(-1).copy()

    def force(x: Float) -> Float:
        out = np.zeros((3, fabric.number))
        evaluate(to_rows(x.reshape(-1, 3)), 0.0 * out, 0.0, out, packed)
        return np.asarray((out.T * fabric.mass[:, None]).reshape(-1)[free])

    for _ in range(12):
        slope = np.empty((free.size, free.size))
        for column, i in enumerate(free):
            ahead, behind = x.copy(), x.copy()
            ahead[i] += 1e-6
            behind[i] -= 1e-6
            slope[:, column] = (force(ahead) - force(behind)) / 2e-6
        x[free] -= np.linalg.solve(slope, force(x))
    assert np.abs(force(x)).max() < 1e-12
    return x.reshape(-1, 3)


def test_the_panel_settles_in_a_hundred_steps() -> None:
    simulation, positions = simulate_knit("stitch-10x10", 100)
    assert simulation.fabric.number == 100 and simulation.fabric.pinned.sum() == 36
    rest = balance(simulation.system)
    left = np.linalg.norm(positions[-1] - rest) / np.linalg.norm(simulation.fabric.position - rest)
    assert 0.01 < left < 0.05


def test_it_comes_to_rest_where_newton_says() -> None:
    simulation, positions = simulate_knit("stitch-10x10", 1400)
    assert np.abs(positions[-1] - balance(simulation.system)).max() < 1e-8


@pytest.mark.parametrize(("patience", "most"), [(solver.PATIENCE, 12), (0.0, 7)], ids=["gradients", "factorised"])
def test_newton_finds_rest_in_few_steps(monkeypatch: pytest.MonkeyPatch, patience: float, most: int) -> None:
    """One step of 1e10 s, to a residual of 1e-12: with the matrix of links alone it takes 28."""
    monkeypatch.setattr(solver, "PATIENCE", patience)
    system, plugin = simulate_knit("stitch-10x10", 0)[0].system, ImplicitEuler()
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    memory = plugin.prepare(plugin.Config(residual=1e-12, most_iterations=100), system, state)
    report = plugin.advance(system, state, memory, None, 1, 1e10)
    assert report.status == "ok" and report.totals["newton_steps"] <= most
    assert np.abs(state.x - balance(system)).max() < 1e-10


@cache
def settled(direction: str) -> tuple[Fabric, Float]:
    simulation, positions = simulate_knit(f"stitch-stretch-{direction}", 600)
    assert np.abs(positions[-1] - positions[-2]).max() < 1e-4
    return simulation.fabric, positions[-1]


def elongation(fabric: Fabric, x: Float, k: float, arcs: bool) -> float:
    """Mean |d| / L - 1 of the legs or the arcs of stiffness k."""
    assert fabric.springs is not None
    pairs = fabric.springs.pairs()
    stretch = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / fabric.springs.rest - 1.0
    mine = (fabric.springs.k == k) & ((np.arange(len(pairs)) >= LEGS) == arcs)
    return float(stretch[mine].mean())


@pytest.mark.parametrize(("direction", "arcs"), [("course", True), ("wale", False)])
def test_soft_yarn_takes_the_stretch_along_it(direction: str, arcs: bool) -> None:
    """Links of the two yarns are in series both ways, and the soft ones open by several times the stiff ones."""
    fabric, x = settled(direction)
    assert elongation(fabric, x, 1.0, arcs) > 0.5
    assert elongation(fabric, x, 1.0, arcs) > 4.0 * elongation(fabric, x, 10.0, arcs) > 0.0


def zigzag(x: Float) -> float:
    """Mean second difference to the side, in rest lengths, along the middle four columns: 0 of a straight wale."""
    grid = x.reshape(10, 10, 3)
    return float(np.abs(np.diff(grid[:, 3:7, 0], n=2, axis=0)).mean())


def test_stitches_deform_differently_by_direction() -> None:
    """Figure 9. Stretched along the courses, soft arcs lie above stiff ones and the wales zigzag; along the wales
    whole courses open and the wales stay straight.
    """
    (_, along), (_, up) = settled("course"), settled("wale")
    assert zigzag(along) > 5.0 * zigzag(up)
    heights = np.diff(up.reshape(10, 10, 3)[:, 3:7, 1], axis=0).mean(axis=1)
    assert (heights[0::2] > 1.5 * heights[1::2].max()).all()
    heights = np.diff(along.reshape(10, 10, 3)[1:-1, 3:7, 1], axis=0).mean(axis=1)
    assert heights.max() < 1.5 * heights.min()
