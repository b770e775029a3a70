"""Cloth meets bodies of triangles as it meets cloth: no edge passes through; weight, friction, bits, pinching."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from closed_meshes import box, sphere
from met_bodies import Met, Motion, Shape, still
from sheets import sheet

from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.piles import Oracle, pile
from nuno_contact.offset.contact_state import CLOSE, HELD_CUT, LEFT_OUT, LISTED, NEAR, TOUCHING
from nuno_contact.offset.impulse import SWEEPS, apply_impulses
from nuno_contact.offset.plugin import find_pinched
from nuno_integrators import packing
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

SOLVERS = ("symplectic_euler", "respa", "leapfrog", "rk4", "dopri5", "xpbd", "implicit_euler", "tr_bdf2")
ASIDE = np.array([0.002, 0.0, 0.001])
"""So that nothing lies above anything exactly."""
BALL, CUBE = sphere(16, 0.03), box((0.04, 0.04, 0.04))


def above(height: float, side: int = 8, size: float = 0.1, speed: float = 0.0, **settings: Any) -> Any:
    """A level sheet at a height [m] that falls at a speed [m/s]."""
    return sheet(side, size, at=ASIDE + np.array([0.0, height, 0.0]), v=np.array([0.0, -speed, 0.0]), **settings)


def run(met: Met, frames: int, steps: int) -> None:
    """Step; nothing passes through at any frame's end, and in all but one at most no vertex is behind its body."""
    late = 0
    for _ in range(frames):
        met.go(steps)
        assert not met.crossed
        late += met.behind > 0
    assert late <= 1 and met.meeting.so_far[LEFT_OUT] == 0


@pytest.mark.parametrize("shape", [BALL, CUBE], ids=["ball", "cube"])
def test_a_coarse_sheet_lies_on_a_body_without_an_edge_through_it(shape: Shape) -> None:
    """Edges of 14 mm over a ball whose edges are 6 mm, and over the corners of a cube; without, edges pass through."""
    met = Met(above(0.04), shapes=[shape])
    run(met, 20, 100)
    assert met.meeting.counts[TOUCHING] > 5
    x = met.state.x
    assert x[:, 1].min() < 0.01 and np.linalg.norm(x.mean(axis=0)) < 0.05


def test_small_cloth_runs_on_several_threads_where_it_meets_a_fine_body(monkeypatch: pytest.MonkeyPatch) -> None:
    """64 vertices over a ball of hundreds; not where both are few, nor where hardly any are the cloth's."""
    system = replace(Met(above(0.04), shapes=[BALL]).system, threads=2)
    monkeypatch.setattr(packing, "threads_available", lambda: (2, "here"))
    for several, from_, of_cloth in ((True, 200, 60), (False, 10_000, 60), (False, 200, 65)):
        monkeypatch.setattr(packing, "PARALLEL_FROM", from_)
        monkeypatch.setattr(packing, "OF_CLOTH", of_cloth)
        assert (packing.thread_count(system) > 1) is several


def tent(side: int) -> Any:
    """A sheet whose vertices are all outside of the cube, and which is clear of it where its edges are short."""
    cloth = above(0.04, side)
    x = cloth.position.copy()
    x[:, 1] = 0.021 - 1.5 * np.maximum(0.0, np.abs(x[:, 0]) - 0.0195)
    return replace(cloth, position=x)


def test_shorter_edges_are_advised_where_edges_go_in_and_out_again_and_help() -> None:
    """Not where vertices are inside, which no shorter edge brings out."""
    with pytest.raises(BadInput, match=r"passes through .* where it starts") as refused:
        Met(tent(8), shapes=[CUBE])
    assert "shorter edges" in str(refused.value.remedy) and "untangle" not in str(refused.value.remedy)
    Met(tent(64), shapes=[CUBE])
    with pytest.raises(BadInput, match=r"passes through .* where it starts") as refused:
        Met(above(0.0), shapes=[BALL])
    assert "untangle" in str(refused.value.remedy) and "shorter edges" not in str(refused.value.remedy)


def test_what_contact_of_vertices_lets_through_is_seen() -> None:
    """The judge: the same sheet, laid over the cube so that its vertices are outside, has edges through it."""
    met = Met(above(0.04), shapes=[CUBE])
    met.state.x[:] = tent(8).position
    assert (np.abs(met.state.x) > 0.02).any(axis=1).all()
    assert met.crossed


def spinning(t: float) -> tuple[float, Float]:
    """6 rad/s about a level axis."""
    return 6.0 * t, np.zeros(3)


def rising(t: float) -> tuple[float, Float]:
    """10 m/s upwards, turning."""
    return 3.0 * t, np.array([0.0, 10.0 * t, 0.0])


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_bodies_that_move_push_cloth_before_them(solver: str) -> None:
    """A cube whose edges turn under a sheet, and a ball that hits one at 10 m/s, at 2 mm a step of 1 mm's thickness."""
    run(Met(above(0.04, 12, 0.15), shapes=[box((0.05, 0.05, 0.05))], motions=[spinning], solver=solver), 15, 50)
    hit = Met(above(0.03), shapes=[sphere(12, 0.02)], motions=[rising], solver=solver)
    run(hit, 4, 50)
    assert hit.state.v[:, 1].mean() == pytest.approx(10.0, abs=2.0)


@pytest.mark.quick(solver=["respa"])
@pytest.mark.parametrize("solver", ["symplectic_euler", "respa", "xpbd"])
@pytest.mark.parametrize("shape", [CUBE, pytest.param(BALL, marks=pytest.mark.full)], ids=["cube", "ball"])
def test_taut_cloth_comes_to_rest_on_a_body(shape: Shape, solver: str) -> None:
    """Held all round, and pushed up by 3 cm, it pulls harder than contact resists, and vertices are held off the body
    step by step. Each time they set out with no more velocity than they came with; else 1 to 2 m/s are left for good.
    """
    cloth = above(0.035)
    away = np.abs((cloth.position - cloth.position.mean(axis=0))[:, [0, 2]]).max(axis=1)
    cloth = replace(cloth, pinned=away > 0.045)

    def risen(t: float) -> tuple[float, Float]:
        return 0.0, np.array([0.0, 0.6 * min(t, 0.05), 0.0])

    met = Met(cloth, shapes=[shape], motions=[risen], solver=solver)
    met.system = replace(met.system, damping=20.0)
    met.memory = met.solver.prepare(met.solver.Config(), met.system, met.state)
    run(met, 16, 100)
    assert met.meeting.counts[TOUCHING] > 5
    assert np.linalg.norm(met.state.v, axis=1).max() < 0.4


@pytest.mark.full
@pytest.mark.parametrize(("shape", "side"), [(CUBE, 12), (BALL, 16)], ids=["cube", "ball"])
def test_a_free_sheet_lands_on_a_body_in_steps_of_a_frame(shape: Shape, side: int) -> None:
    """Bodies stay where they are, so that cloth on them resists to be moved as a whole, which Newton's method knows."""
    met, newton = Met(above(0.04, side, 0.15), shapes=[shape], solver="implicit_euler", dt=1.0 / 60.0), 0
    for _ in range(20):
        met.go(1)
        assert not met.crossed
        newton += met.memory.work.stage.counts.newton  # type: ignore[attr-defined]
    assert met.meeting.counts[TOUCHING] > 10
    assert newton < 1000


def test_a_sheet_presses_on_a_body_with_its_weight() -> None:
    """At rest on a table of two triangles that is larger, and on one of many: m g within 1 %."""
    coarse = box((0.3, 0.02, 0.3))
    for shape in (coarse, fine_table(0.3, 24)):
        met = Met(above(0.01 + 1.01e-3), shapes=[shape], damping=1.0, rough=0.3)
        for _ in range(8):
            met.go(500)
            met.state.v *= 0.5
        poses = met.poses(met.state.t)
        found = met.solver.forces(met.system, met.state, met.memory, (poses, poses)).parts["cloth_contact"]
        assert found[:, 1].sum() == pytest.approx(9.81 * met.fabric.mass.sum(), rel=0.01)


def fine_table(size: float, side: int) -> Shape:
    """A flat box of 2 cm whose top is of many triangles, finer than cloth above it."""
    along = size * (np.arange(side + 1) / side - 0.5)
    x = np.stack([*np.meshgrid(along, [0.01], along, indexing="ij")], axis=-1).reshape(-1, 3)
    number = np.arange(len(x)).reshape(side + 1, side + 1)
    a, b, c, d = number[:-1, :-1].ravel(), number[:-1, 1:].ravel(), number[1:, :-1].ravel(), number[1:, 1:].ravel()
    top = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    rim = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    after, foot = np.roll(rim, -1), len(x)
    sides = np.stack([rim, np.full(len(rim), foot), after], axis=1)
    return np.concatenate([x, [[0.0, -0.01, 0.0]]]), np.concatenate([top, sides]).astype(np.int32)


@pytest.mark.parametrize("side", [None, pytest.param(24, marks=pytest.mark.full)], ids=["coarse", "fine"])
def test_a_sheet_slides_on_a_body_as_coulomb_says(side: int | None) -> None:
    """With g (sin - mu cos) of the body's friction, not of the cloth's, within 1 %; and sticks where that holds it."""
    mu, slope = 0.2, math.radians(30.0)
    shape = box((0.6, 0.02, 0.6)) if side is None else fine_table(0.6, 2 * side)
    gravity = 9.81 * np.array([math.sin(slope), -math.cos(slope), 0.0])
    met = Met(above(0.01 + 1.01e-3), shapes=[shape], gravity=gravity, rough=mu, friction=5.0)
    met.go(300)
    before = met.state.v[:, 0].mean()
    met.go(700)
    gained = (met.state.v[:, 0].mean() - before) / (700 * met.dt)
    assert gained == pytest.approx(9.81 * (math.sin(slope) - mu * math.cos(slope)), rel=0.01)
    met = Met(above(0.01 + 1.01e-3), shapes=[shape], gravity=gravity, rough=1.01 * math.tan(slope), friction=0.0)
    met.go(1500)
    place = met.state.x.mean(axis=0)
    met.go(1500)
    assert np.abs(met.state.x.mean(axis=0) - place).max() < 1e-6


def closing(speed: float, side: float) -> Motion:
    """Towards the middle from above or below."""
    return lambda t: (0.0, np.array([0.004 * side, side * (0.03 - speed * min(t, 0.2)), 0.0]))


@pytest.mark.full
def test_cloth_that_bodies_crush_is_counted_and_nothing_blows_up() -> None:
    """Two cubes go 1 cm into each other with a sheet between: their vertices stay behind, and are counted. No cloth is
    held here.
    """
    met = Met(above(0.0), shapes=[box((0.05, 0.05, 0.05))] * 2, motions=[closing(0.05, 1.0), closing(0.05, -1.0)])
    counted, fastest = 0, 0.0
    for _ in range(25):
        report = met.go(50)
        counted = max(counted, report.counts["body_vertices_behind"])
        fastest = max(fastest, float(np.abs(met.state.v).max()))
        # Of cloth nothing passes through cloth, and no plane that keeps it off the vertices that are behind is lost.
        assert (met.behind == 0) <= (not met.crossed)
    assert counted > 0 and met.meeting.so_far[HELD_CUT] == 0
    assert fastest < 20.0


def test_bodies_that_part_again_set_cloth_free() -> None:
    """What stayed behind is where its body is once that has turned back."""
    there_and_back = [
        lambda t, side=side: (0.0, np.array([0.004 * side, side * (0.0235 + 0.1 * abs(t - 0.05)), 0.0]))
        for side in (1.0, -1.0)
    ]
    met = Met(above(0.0), shapes=[box((0.05, 0.05, 0.05))] * 2, motions=there_and_back)
    behind = [(met.go(50), met.behind)[1] for _ in range(15)]
    assert max(behind) > 0 and behind[-1] == 0 and not met.crossed


@pytest.mark.full
def test_one_thread_and_several_and_a_resumed_run_have_the_same_bits() -> None:
    """In the middle of contact with a body that turns."""

    def begun(threads: int = 1) -> Met:
        sheet_above = above(0.024, 65, 0.2, speed=0.6)
        return Met(sheet_above, shapes=[CUBE], motions=[spinning], threads=threads, thickness=5e-4, dt=5e-5)

    ends = []
    for threads in (1, 2):
        met = begun(threads)
        for _ in range(4):
            met.go(40)
        ends.append(met.state.x.tobytes() + met.state.v.tobytes())
    assert met.meeting.counts[TOUCHING] > 0
    cut, on = begun(), begun()
    for _ in range(2):
        cut.go(40)
    on.state.x[...], on.state.v[...], on.state.t = cut.state.x, cut.state.v, cut.state.t
    for name, values in cut.memory.arrays.items():
        on.memory.arrays[name] = values.copy()
    for _ in range(2):
        on.go(40)
    ends.append(on.state.x.tobytes() + on.state.v.tobytes())
    assert ends[0] == ends[1] == ends[2]


def test_cloth_that_never_comes_near_a_body_keeps_its_bits() -> None:
    """As without one, to the last bit."""
    ends = []
    for shapes in ([], [CUBE]):
        met = Met(above(1.0), shapes=shapes) if shapes else Met(above(1.0), shapes=[CUBE], contact=False)
        met.go(200)
        ends.append(met.state.x.tobytes() + met.state.v.tobytes())
    assert ends[0] == ends[1]


def test_a_start_in_or_through_a_body_is_refused() -> None:
    def refused(*pieces: Any, shapes: list[Shape], **settings: Any) -> BadInput:
        with pytest.raises(BadInput) as caught:
            Met(*pieces, shapes=shapes, motions=[still], **settings)
        return caught.value

    through = refused(above(0.0), shapes=[CUBE])
    assert "0 passes through body 0 where it starts" in through.problem and through.field == "bodies"
    within = refused(above(0.0, size=0.02), shapes=[CUBE])
    assert "64 of 64" in within.problem and "starts inside of body 0" in within.problem
    assert "0 touches body 0" in refused(above(0.02 + 5e-9), shapes=[CUBE]).problem
    speared = refused(above(0.0, 2, 0.1), shapes=[(CUBE[0] * [0.1, 1.0, 0.1], CUBE[1])])
    assert "passes through body 0" in speared.problem


H, DT, SPEED = 2e-3, 1e-3, 3.0


def approach(share: float, held: int) -> tuple[Any, Float]:
    """A meeting in which vertex 0, which nothing moves, comes at SPEED towards a triangle, above the point with this
    share of its last corner, whose first `held` corners are held; and the velocities (3, n).
    """
    (term,) = pile(sheet(3, 0.1), sheet(3, 0.1, at=np.array([0.0, 0.2, 0.0])), thickness=H).terms[-1].data
    m = packing.copy_term(term)
    i, j, k = m.tree.faces[-1]
    weights = 0.5 * (1.0 - share), 0.5 * (1.0 - share), share
    under = sum(w * m.surface.start[:, v] for w, v in zip(weights, (i, j, k), strict=True))
    m.last[:] = m.surface.start
    m.last[:, 0] = under + np.array([0.0, 0.5 * H, 0.0])
    m.surface.mass[[0, *(i, j, k)[:held]]] = 0.0
    pairs = m.pairs
    pairs.vertices[0], pairs.face[0], pairs.close[0] = (0, i, j, k), len(m.tree.faces) - 1, 0
    pairs.reach[0], pairs.normal[0] = H, (0, 1, 0)
    m.counts[[LISTED, NEAR, CLOSE]] = 1
    v = np.zeros((3, m.last.shape[1]))
    v[1, 0] = -SPEED
    return m, v


@pytest.mark.full
@pytest.mark.parametrize("share", [0.9, 0.5, 0.1, 1e-2, 1e-4])
def test_no_vertex_beside_what_is_held_is_thrown_by_a_lever(share: float) -> None:
    """It would have to go at SPEED / share for the point to give way, ten thousand times as fast as what pushes it."""
    m, v = approach(share, 2)
    apply_impulses(m, v, DT, SWEEPS[1], None)
    moved = np.linalg.norm(v[:, m.tree.faces[-1, 2]])
    assert 0.0 < moved < 8.0 * SPEED
    if share >= 0.5:
        assert share * moved * DT == pytest.approx(SPEED * DT - 0.25 * H, rel=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("share", [0.9, 1.0 / 3.0, 1e-4])
def test_a_triangle_that_is_free_gives_way_as_far_as_it_must(share: float) -> None:
    """The point below stops what comes at a quarter of the thickness: whichever corners it is shared by."""
    m, v = approach(share, 0)
    apply_impulses(m, v, DT, SWEEPS[1], None)
    weights = np.array([0.5 * (1.0 - share), 0.5 * (1.0 - share), share])
    gap = 0.5 * H + DT * (v[1, 0] - weights @ v[1, m.tree.faces[-1]])
    assert gap == pytest.approx(0.25 * H, rel=1e-9)


@pytest.mark.full
def test_what_is_pinched_is_named() -> None:
    m, _ = approach(0.5, 2)
    m.share[:] = 1.0
    assert len(find_pinched(m)[0]) == 0
    m.share[[0, 11]] = 0.3
    pieces, places = find_pinched(m)
    assert pieces.tolist() == [0, 1] and np.array_equal(places, m.last[:, [0, 11]].T)


@pytest.mark.full
def test_bodies_that_pass_through_each_other_are_named_where_nothing_moves() -> None:
    """The two sheets taken for bodies, the second turned upright through the first."""
    m, _ = approach(0.5, 2)
    m = m._replace(bodies=m.bodies._replace(law=np.zeros((2, 2))))
    second = m.surface.piece == 1
    m.last[:] = m.surface.start
    m.last[:, second] = m.surface.start[:, second][[0, 2, 1]] - np.array([[0.0], [0.02], [0.18]])
    boxes = m.tree.boxes.copy()
    m.share[:] = 0.0
    pieces, places = find_pinched(m)
    assert set(pieces.tolist()) == {0, 1}
    assert np.abs(np.median(places, axis=0) - [0.0, 0.0, 0.02]).max() < 0.06
    assert np.array_equal(boxes, m.tree.boxes, equal_nan=True), "a step that goes on meanwhile has its own"


@pytest.mark.full
def test_a_waist_that_a_walking_body_comes_through_throws_nothing_about(tmp_path: Path) -> None:
    """Held by one joint of a body that bends, it pinches the body's vertices from the 33rd frame on. Before impulses
    were bounded the 34th left millions of pairs out, cut the free cloth three thousand times short, and threw vertices
    metres far in a step.
    """
    (tmp_path / "walk.bvh").write_bytes((Path(__file__).resolve().parents[2] / "scenes" / "walk.bvh").read_bytes())
    over, attach = {"body": "walker", "ease": "1 cm"}, {"body": "walker", "frame": "Hips"}
    model = {"plugin": "skirt", "over": over, "attach": attach, "length": "55 cm", "columns": 96, "rows": 36}
    collider = {"plugin": "skin", "shape": "person", "resolution": 64}
    scene = {
        "nuno": 1, "name": "pinched", "duration": "4 s", "frame_rate": 60, "solver": "respa", "damping": 4,
        "objects": [{"name": "skirt", "model": model | {"fabric": "denim"}}],
        "bodies": [{"name": "walker", "collider": collider, "friction": 0.3,
                    "motion": {"plugin": "bvh", "file": "walk.bvh", "end": "loop"}}],
        "cloth_contact": {"plugin": "offset", "thickness": "2 mm", "bodies": ["walker"]},
    }  # fmt: skip
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    simulation = Simulation.with_bodies(scene_file.read(tmp_path / "scene.yaml"), 1)
    while simulation.frame < 36:
        counts = simulation.step().report.counts
    assert counts["body_vertices_behind"] > 0 and counts["held_cut_short"] > 0
    assert counts["pairs_left_out"] == counts["steps_without_motion"] == 0 and counts["cut_short"] < 100
    assert np.linalg.norm(simulation.state.v, axis=1).max() < 50.0
    assert re.fullmatch(r"\d+ vertices of walker pinched near \(.*\) m: .*", simulation.holds())
    m: Any = simulation.memory.work.packed.bodies[-1]  # type: ignore[attr-defined]
    assert not Oracle(m.surface.start.T, m.tree.faces).crossed(np.ascontiguousarray(m.last.T))
