"""Cloth meets cloth under implicit solvers, at steps as long as a frame: what rests, sticks, slides, presses, folds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sheets import DOWN, Pile, heap, pace, sheet, sliding

from nuno_cloth.fabrics.material import resolve
from nuno_cloth.models.delaunay import fill_outline
from nuno_cloth.models.membrane import build_elements
from nuno_cloth.models.triangles import find_edges
from nuno_contact.offset.places import CUT, STEPS, TOUCHING
from nuno_schemas.fabric import Fabric, Float

pytestmark = pytest.mark.full
SOLVERS = ("implicit_euler", "tr_bdf2")
FRAME = 1.0 / 60.0


def test_nothing_passes_through_in_steps_of_a_frame() -> None:
    """Three uneven sheets at up to 16 m/s to each other, which go 10 cm in a step, and lie on each other after it; at
    most one step of a vertex in a thousand is cut short.
    """
    pile = heap("implicit_euler", 1, dt=FRAME)
    for _ in range(10):
        pile.go(1)
        assert not pile.crossed
    assert pile.meeting.number[TOUCHING] > 20
    assert pile.meeting.so_far[CUT] <= 1e-3 * pile.meeting.so_far[STEPS] * pile.fabric.number


def test_cloth_at_rest_is_solved_like_cloth_that_hardly_moves() -> None:
    """What it will touch is in the first matrix already: as many Newton steps, to the same place."""
    found = []
    for speed in (0.0, 1e-9):
        falling = sheet(at=np.array([0.003, 1.05e-3, 0.002]), v=np.array([0.0, -speed, 0.0]))
        pile = Pile(sheet(pinned=True), falling, solver="implicit_euler", dt=FRAME)
        found.append((pile.go(1).totals["newton_steps"], pile.state.x))
    assert found[0][0] == found[1][0]
    np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-9)


def test_what_contact_cannot_push_apart_is_left_and_counted() -> None:
    """Sheets that meet at 16 m/s in steps of 1/30 s: no frame takes thousands of Newton steps, for at most two steps of
    vertices in a hundred that are cut short.
    """
    pile = heap("implicit_euler", 3, dt=2.0 * FRAME)
    for _ in range(12):
        pile.go(1)
        assert not pile.crossed
        assert pile.memory.work.stage.counts.newton < 1000  # type: ignore[attr-defined]
    assert 0 < pile.meeting.so_far[CUT] < 0.02 * pile.meeting.so_far[STEPS] * pile.fabric.number


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_pile_comes_to_rest_and_presses_with_its_weight(solver: str) -> None:
    """Four sheets on a held one, within half a second; no step is cut short."""
    pieces = [sheet(pinned=k == 0, at=np.array([0.002 * k, 1.01e-3 * k, 0.001 * k])) for k in range(5)]
    pile = Pile(*pieces, damping=1.0, solver=solver, dt=FRAME)
    for _ in range(30):
        pile.go(1)
    assert np.abs(pile.state.v).max() < 1e-3
    assert pile.meeting.so_far[CUT] == 0
    found = pile.solver.forces(pile.system, pile.state, pile.memory, None).parts["cloth_contact"]
    weight = 9.81 * pile.fabric.mass[~pile.fabric.pinned].sum()
    assert -found[pile.fabric.pinned, 1].sum() == pytest.approx(weight, rel=0.01)
    assert np.abs(found.sum(axis=0)).max() < 1e-12


def test_a_sheet_sticks_just_if_friction_holds_it() -> None:
    """tan(slope) = mu (1 +- 0.01), in steps of a frame."""
    mu = 0.5
    for share, sticks in ((0.99, True), (1.01, False)):
        slope = math.atan(mu * share)
        pile = sliding(mu, slope, solver="implicit_euler", dt=FRAME)
        pile.go(20)
        start, speed = pile.state.x.mean(axis=0), pace(pile)[0]
        pile.go(30)
        gained = 9.81 * (math.sin(slope) - mu * math.cos(slope)) * 30 * FRAME
        if sticks:
            assert np.abs(pile.state.x.mean(axis=0) - start).max() < 1e-6
        else:
            assert pace(pile)[0] - speed > 0.8 * gained
        assert pile.meeting.so_far[CUT] == 0


def test_a_sheet_slides_as_coulomb_says() -> None:
    """With g (sin - mu cos), within 1 %, at a tenth of a frame."""
    mu, slope, dt = 0.2, math.radians(30.0), 0.1 * FRAME
    pile = sliding(mu, slope, solver="implicit_euler", dt=dt)
    pile.go(10)
    before = pace(pile)[0]
    pile.go(100)
    expected = 9.81 * (math.sin(slope) - mu * math.cos(slope))
    assert (pace(pile)[0] - before) / (100 * dt) == pytest.approx(expected, rel=0.01)


def folded(spacing: float = 0.012, size: float = 0.2) -> Fabric:
    """An uneven net of triangles, folded over: its lower half is held, the upper one hangs 1 cm above it."""
    ends = np.linspace(0.0, size, round(size / spacing), endpoint=False)
    none = np.zeros_like(ends)
    outline = np.concatenate([
        np.stack([ends, none], 1), np.stack([none + size, ends], 1),
        np.stack([size - ends, none + size], 1), np.stack([none, size - ends], 1),
    ])  # fmt: skip
    points, faces = fill_outline(outline, spacing)
    rng = np.random.default_rng(7)
    points[len(outline) :] += 0.15 * spacing * rng.standard_normal((len(points) - len(outline), 2))
    flat = np.stack([points[:, 0], np.zeros(len(points)), points[:, 1]], 1)
    elements = build_elements(resolve("jacket"), flat, faces, find_edges(faces), np.array([1.0, 0.0, 0.0]))
    radius = 0.005
    along = flat[:, 0] - 0.5 * (size - math.pi * radius)
    angle = np.clip(along / radius, 0.0, math.pi)
    beyond = np.maximum(along - math.pi * radius, 0.0)
    bent: Float = np.stack([
        np.minimum(along, 0.0) + radius * np.sin(angle) - beyond, radius * (1.0 - np.cos(angle)), flat[:, 2]
    ], 1)  # fmt: skip
    fabric = sheet()
    return replace(
        fabric, name="folded", position=bent, velocity=np.zeros_like(bent), pinned=along < 0.0, uv=None,
        **elements._asdict(),
    )  # fmt: skip


def test_a_fold_of_uneven_triangles_rests_on_itself() -> None:
    """The upper half falls on the lower one, comes to rest there, and no step is cut short."""
    pile = Pile(folded(), solver="implicit_euler", dt=FRAME, gravity=DOWN, damping=1.0)
    for _ in range(40):
        pile.go(1)
        assert not pile.crossed
    assert pile.meeting.number[TOUCHING] > 50
    assert pile.meeting.so_far[CUT] == 0
    assert np.abs(pile.state.v).max() < 1e-2


def test_a_run_goes_on_from_a_checkpoint_in_the_same_bits() -> None:
    """In the middle of contact, by a solver's memory alone."""
    whole, cut, on = (heap("implicit_euler", 1, dt=0.25 * FRAME) for _ in range(3))
    for _ in range(6):
        whole.go(2)
    for _ in range(3):
        cut.go(2)
    on.state.x[...], on.state.v[...], on.state.t = cut.state.x, cut.state.v, cut.state.t
    for name, values in cut.memory.arrays.items():
        on.memory.arrays[name] = values.copy()
    for _ in range(3):
        on.go(2)
    assert cut.meeting.anchored.any()
    assert (on.state.x.tobytes(), on.state.v.tobytes()) == (whole.state.x.tobytes(), whole.state.v.tobytes())
