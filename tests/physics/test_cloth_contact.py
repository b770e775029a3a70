"""Cloth meets cloth, by explicit and implicit solvers and XPBD: nothing passes through; friction, weight, bits."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys
from sheets import DOWN, Pile, heap, pace, sheet, sliding

from nuno.simulation.cloth import join_fabrics
from nuno_bench import piles
from nuno_cloth.fabrics.material import resolve
from nuno_cloth.models.delaunay import fill_outline
from nuno_cloth.models.membrane import build_elements
from nuno_cloth.models.triangles import find_edges
from nuno_contact.offset.candidate_pairs import AHEAD, is_quiet, make_list
from nuno_contact.offset.contact_state import CUT, LEFT_OUT, LISTED, LISTS_MADE, STEPS, TOUCHING
from nuno_contact.offset.plugin import Offset, OffsetConfig
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State

SOLVERS = ("symplectic_euler", "respa", "leapfrog", "rk4", "dopri5", "xpbd", "implicit_euler")


USUAL = 1.0 / 960.0
"""Sixteen steps in a frame [s]."""
THICKNESS = piles.THICKNESS
IMPLICIT_SOLVERS = ("implicit_euler", "tr_bdf2")
FRAME = 1.0 / 60.0


def held() -> int:
    """Arrays that compiled code has made and not let go."""
    found = rtsys.get_allocation_stats()
    return int(found.alloc - found.free)


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_run_takes_no_more_memory_the_longer_it_is(solver: str) -> None:
    """Steps in which lists are made and cloth touches leave no array behind."""
    _nrt_python.memsys_enable_stats()
    pile = heap(solver, 1)
    pile.go(10)
    before, lists, most = held(), int(pile.meeting.counts[LISTS_MADE]), 0
    for _ in range(10):
        pile.go(20)
        most = max(most, int(pile.meeting.counts[TOUCHING]))
    assert pile.meeting.counts[LISTS_MADE] > lists
    assert most > 20
    assert held() == before


@pytest.mark.full
def test_a_wider_list_has_the_pairs_of_a_narrower_in_the_same_order() -> None:
    """In which constraints are solved: what rests would creep if another list had them in another."""
    pile = Pile(*piles.stack(), dt=1e-3)
    pile.go(1)
    m, keys = pile.meeting, []
    for share in (0.5, 2.0, 5.0):
        m.plan.spread[0] = share * m.surface.law[0]
        make_list(m, None)
        keys.append(m.pairs.key[: m.counts[LISTED]].tolist())
    for narrow, wide in pairwise(keys):
        assert len(narrow) < len(wide)
        known = set(narrow)
        assert [key for key in wide if key in known] == narrow


def test_a_list_is_made_for_longer_only_while_hardly_a_vertex_strays() -> None:
    """Strays grow as the square of the time: of 100 vertices 4 may need more room than there is at least, not 5."""
    unrest, window, least = np.zeros(100), 2.0, 4e-3
    edge = least / (AHEAD * window * window)
    for restless, quiet in ((4, True), (5, False)):
        unrest[:restless] = 1.01 * edge
        unrest[restless:] = 0.99 * edge
        assert is_quiet(unrest, window, least) == quiet
    assert is_quiet(unrest, 0.99 * window, least) and not is_quiet(unrest, 1.02 * window, least)


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_nothing_passes_through(solver: str) -> None:
    """Of three sheets at up to 16 m/s to each other, which without contact do, at a step that moves them by 3 mm."""
    free = heap(solver, 1, contact=False)
    crossed = [(free.go(5), free.crossed)[1] for _ in range(8)]
    assert any(crossed)
    for seed in (1, 2):
        pile = heap(solver, seed)
        for _ in range(30):
            pile.go(10)
            assert not pile.crossed
        assert pile.meeting.so_far[LEFT_OUT] == 0
        assert pile.meeting.so_far[STEPS] > 0


def test_amid_many_contacts_no_vertex_is_thrown_to_and_fro() -> None:
    """Twenty dashpots at a vertex are together faster than the step, while each alone is slow enough."""
    pieces = []
    for k in range(5):
        piece, turn = sheet(5, 0.05, pinned=k == 0), 0.12 * k
        x, y, z = piece.position.T
        x, z = math.cos(turn) * x + math.sin(turn) * z, math.cos(turn) * z - math.sin(turn) * x
        pieces.append(replace(piece, position=np.stack([x, y + piles.REST * k, z], axis=1)))
    pile = Pile(*pieces, dt=1.27e-4)
    pile.go(4000)
    before = pile.state.v.copy()
    pile.go(1)
    assert pile.meeting.counts[TOUCHING] > 4 * pile.fabric.number
    assert np.abs(pile.state.v - before).max() < np.abs(before).max()


def test_forces_are_those_of_the_state_that_is_asked_for() -> None:
    """Not of the one that the solver knows: of sheets that are then lifted off each other, none."""
    pile = Pile(sheet(pinned=True), sheet(at=np.array([0.003, 0.004, 0.002])), thickness=3e-3, damping=1.0)
    for _ in range(20):
        pile.go(20)
    state = State(pile.state.x.copy(), pile.state.v.copy())
    asked = (pile.system, state, pile.memory, None)
    assert np.abs(pile.solver.forces(*asked).parts["cloth_contact"]).max() > 0.0
    state.x[~pile.fabric.pinned, 1] += 3e-3
    assert np.abs(pile.solver.forces(*asked).parts["cloth_contact"]).max() == 0.0
    pile.go(20)


def collision(damping: float) -> Pile:
    """Two free sheets that fly at each other, without gravity and friction."""
    return Pile(*piles.collision(), gravity=np.zeros(3), friction=0.0, damping=damping, dt=5e-5)


def test_friction_changes_the_moment_of_momentum_by_the_gap_alone() -> None:
    """Two sheets that rub keep their momentum to rounding. Friction, equal and opposite on both sides of the gap, is a
    couple: what one sheet loses along it, times a part of the thickness.
    """
    pile = Pile(*piles.collision(), gravity=np.zeros(3), friction=0.3, damping=0.5, dt=5e-5)
    mass, upper = pile.fabric.mass[:, None], pile.state.v[:, 1] < 0.0
    pile.state.v[:, 0] += np.where(upper, 1.0, -1.0) * np.abs(pile.state.v).max()

    def kept() -> tuple[Float, Float, float]:
        along = mass * pile.state.v
        return along.sum(axis=0), np.cross(pile.state.x, along).sum(axis=0), float(along[upper, 0].sum())

    before = kept()
    pile.go(400)
    after = kept()
    lost = before[2] - after[2]
    assert lost > 0.05 * before[2]
    assert np.abs(after[0] - before[0]).max() < 1e-12 * before[2]
    change = after[1] - before[1]
    assert 0.5 * piles.THICKNESS * lost < abs(change[2]) < piles.THICKNESS * lost
    assert np.abs(change[:2]).max() < 0.01 * abs(change[2])


def test_an_undamped_bounce_gains_no_energy() -> None:
    """Once the sheets have parted; in between, what passes from feature to feature changes it by some hundredths."""
    pile = collision(0.0)
    begun = sum(pile.go(0).energy.values())
    energy = [sum(pile.go(20).energy.values()) for _ in range(30)]
    assert max(energy) < 1.05 * begun
    assert pile.meeting.counts[TOUCHING] == 0
    assert 0.95 * begun < energy[-1] <= begun
    damped = collision(1.0)
    assert sum([damped.go(20) for _ in range(30)][-1].energy.values()) < 0.9 * begun


def test_a_start_in_which_cloth_meets_is_refused() -> None:
    def refused(*pieces: object, **settings: object) -> BadInput:
        with pytest.raises(BadInput) as caught:
            Pile(*pieces, **settings)  # type: ignore[arg-type]
        return caught.value

    upright = sheet(at=np.array([0.003, 0.002, 0.001]))
    upright.position[:, [1, 2]] = upright.position[:, [2, 1]]
    assert "0 passes through 1 where it starts" in refused(sheet(), upright).problem
    assert "0 touches 1 where it starts" in refused(sheet(), sheet(at=np.array([0.003, 5e-9, 0.002]))).problem
    assert "shortest edge" in refused(sheet(), thickness=0.02).problem


@pytest.mark.parametrize("aside", [(0.003, 0.002), (0.1, 0.0)], ids=["layers", "seam"])
def test_one_object_that_starts_in_one_plane_twice_is_refused(aside: tuple[float, float]) -> None:
    """No edge goes through a triangle, and yet the layers of it are not apart."""
    both = join_fabrics([sheet(), sheet(at=np.array([aside[0], 0.0, aside[1]]))], "both")
    objects = {"both": np.arange(both.number, dtype=np.int32)}
    with pytest.raises(BadInput, match="both touches itself where it starts"):
        Offset().prepare(OffsetConfig(), both, objects, np.ones((1, 1), bool), DOWN)


def test_objects_that_may_pass_through_each_other_do() -> None:
    """As `allow` says; each alone does not pass through itself."""
    one, two = sheet(), sheet(at=np.array([0.0, 1e-4, 0.0]))
    fabric = join_fabrics([one, two], "both")
    objects = {"one": np.arange(64, dtype=np.int32), "two": np.arange(64, 128, dtype=np.int32)}
    Offset().prepare(OffsetConfig(), fabric, objects, np.eye(2, dtype=bool), DOWN)


def triangle(size: float, height: float, pinned: bool = False) -> Fabric:
    """Three vertices of a tenth of a gram, level, without springs."""
    angle = np.radians([90.0, 210.0, 330.0])
    place = np.stack([size * np.cos(angle), np.full(3, height), size * np.sin(angle)], axis=1)
    return replace(
        sheet(), name="triangle", position=place, velocity=np.zeros((3, 3)), mass=np.full(3, 1e-4),
        pinned=np.full(3, pinned), faces=np.array([[0, 1, 2]], np.int32), springs=None, hinges=None, uv=None,
    )  # fmt: skip


def gaps(layers: int, dt: float, iterations: int = 1) -> tuple[Float, Float]:
    """Gaps between layers at rest on a held one, from below, and those of the force law. Each is smaller than the one
    it lies on, so that vertices are what meets: of k = half of what they can bear, each bears m g of all above it.
    """
    pieces = [triangle(0.05 - 0.01 * k, 1.001 * THICKNESS * k, k == 0) for k in range(layers + 1)]
    pile = Pile(*pieces, solver="xpbd", dt=dt, damping=1.0)
    pile.memory = pile.solver.prepare(pile.solver.Config(iterations=iterations), pile.system, pile.state)
    pile.go(round(0.5 / dt))
    assert pile.meeting.so_far[CUT] == 0
    found = np.diff(pile.state.x[:, 1].reshape(-1, 3).mean(axis=1))
    load = 1e-4 * 9.81 * np.arange(layers, 0, -1)
    return found, THICKNESS - load / (0.5 * pile.meeting.surface.stiffness[-1])


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 480.0])
def test_a_layer_rests_where_the_force_law_has_it(dt: float) -> None:
    """At any step: what is solved is the law itself, and acts once."""
    found, expected = gaps(1, dt)
    assert found == pytest.approx(expected, abs=1e-6 * THICKNESS)


def test_a_stack_bears_its_weight() -> None:
    """As the law says, to second order in the step with the sweeps of one iteration, and to rounding with more."""
    errors = []
    for dt in (1.0 / 240.0, 1.0 / 480.0, 1.0 / 960.0):
        found, expected = gaps(3, dt)
        errors.append(float(np.abs(found - expected).max()) / THICKNESS)
    assert errors[0] < 0.1
    assert errors[1] < 0.25 * errors[0]
    assert errors[2] < 0.25 * errors[1]
    found, expected = gaps(3, 1.0 / 240.0, 16)
    assert found == pytest.approx(expected, abs=1e-5 * THICKNESS)


@pytest.mark.full
def test_a_pile_presses_with_its_weight_to_second_order() -> None:
    """Four sheets with springs lie too near each other by what sweeps leave: a fourth of it at half the step."""
    errors = []
    for dt in (2.0 * USUAL, USUAL):
        pile = Pile(*piles.stack(), solver="xpbd", dt=dt, damping=1.0)
        for _ in range(8):
            pile.go(round(0.1 / dt))
            pile.state.v *= 0.5
        pile.go(round(0.4 / dt))
        assert pile.meeting.so_far[CUT] == 0
        assert np.abs(pile.state.v).max() < 1e-6
        found = pile.solver.forces(pile.system, pile.state, pile.memory, None).parts["cloth_contact"]
        weight = 9.81 * pile.fabric.mass[~pile.fabric.pinned].sum()
        errors.append(abs(-found[pile.fabric.pinned, 1].sum() / weight - 1.0))
    assert errors[1] < 0.02
    assert errors[1] < 0.25 * errors[0]


def test_a_sheet_sticks_on_an_incline_just_if_friction_holds_it() -> None:
    """tan(slope) = mu (1 +- 0.01), at the usual step: what sticks comes to rest and does not creep."""
    mu = 0.5
    for share, sticks in ((0.99, True), (1.01, False)):
        slope = math.atan(mu * share)
        pile = sliding(mu, slope, solver="xpbd", dt=USUAL)
        pile.go(300)
        start, speed = pile.state.x.mean(axis=0), pace(pile)[0]
        pile.go(400)
        gained = 9.81 * (math.sin(slope) - mu * math.cos(slope)) * 400 * USUAL
        if sticks:
            assert np.abs(pile.state.x.mean(axis=0) - start).max() < 1e-12
        else:
            assert pace(pile)[0] - speed == pytest.approx(gained, rel=0.1)
        assert pile.meeting.so_far[CUT] == 0


def test_a_sheet_slides_as_coulomb_says() -> None:
    """With g (sin - mu cos), within 1 %, in steps of a 240th of a second, too."""
    mu, slope = 0.2, math.radians(30.0)
    for dt in (USUAL, 4.0 * USUAL):
        pile = sliding(mu, slope, solver="xpbd", dt=dt)
        pile.go(round(0.06 / dt))
        before, steps = pace(pile)[0], round(0.14 / dt)
        pile.go(steps)
        expected = 9.81 * (math.sin(slope) - mu * math.cos(slope))
        assert (pace(pile)[0] - before) / (steps * dt) == pytest.approx(expected, rel=0.01)


def test_momentum_is_kept_in_a_collision() -> None:
    """To rounding; its moment to first order, as by backward Euler, whose forces are those of the step's end."""
    lost = []
    for dt in (4e-4, 2e-4):
        pile = Pile(*piles.collision(), solver="xpbd", gravity=np.zeros(3), friction=0.0, dt=dt)
        mass = pile.fabric.mass[:, None]
        before, moment = pile.momentum, (mass * np.cross(pile.state.x, pile.state.v)).sum(axis=0)
        size, most = np.abs(mass * pile.state.v).sum(), 0
        for _ in range(20):
            pile.go(round(1e-3 / dt))
            most = max(most, int(pile.meeting.counts[TOUCHING]))
        assert most > 100
        assert np.abs(pile.momentum - before).max() < 1e-13 * size
        change = (mass * np.cross(pile.state.x, pile.state.v)).sum(axis=0) - moment
        lost.append(float(np.abs(change).max() / np.abs(mass * np.cross(pile.state.x, pile.state.v)).sum()))
    assert lost[0] < 2e-3
    assert lost[0] / lost[1] == pytest.approx(2.0, rel=0.05)


def test_xpbd_an_undamped_bounce_gains_no_energy() -> None:
    """And loses what backward Euler does, less in shorter steps."""
    left = []
    for dt in (4e-4, 1e-4):
        pile = Pile(*piles.collision(), solver="xpbd", gravity=np.zeros(3), friction=0.0, damping=0.0, dt=dt)
        begun = sum(pile.go(0).energy.values())
        energy = [sum(pile.go(round(2e-3 / dt)).energy.values()) for _ in range(15)]
        assert pile.meeting.counts[TOUCHING] == 0
        assert max(energy) < 1.05 * begun
        left.append(energy[-1] / begun)
    assert left[0] < left[1] <= 1.0


def test_nothing_passes_through_in_long_steps() -> None:
    """Of three uneven sheets at up to 16 m/s to each other, which go 7 cm in a step, by ipctk; at most one step of a
    vertex in fifty is cut short.
    """
    pile = heap("xpbd", 1, dt=1.0 / 240.0)
    for _ in range(30):
        pile.go(4)
        assert not pile.crossed
    assert pile.meeting.counts[TOUCHING] > 20
    assert pile.meeting.so_far[CUT] < 0.02 * pile.meeting.so_far[STEPS] * pile.fabric.number


@pytest.mark.full
def test_the_same_bits_whatever_the_threads() -> None:
    """Of two sheets of so many vertices that several threads step them."""
    ends = []
    for threads in (1, 2):
        pieces = [sheet(46, 0.5, pinned=True), sheet(46, 0.48, at=np.array([0.003, 0.003, 0.002]))]
        pile = Pile(*pieces, solver="xpbd", dt=USUAL, threads=threads)
        pile.go(60)
        assert (pile.memory.work.tuning is None) == (threads == 1)  # type: ignore[attr-defined]
        assert pile.meeting.counts[TOUCHING] > 1000
        ends.append(pile.state.x.tobytes() + pile.state.v.tobytes())
    assert ends[0] == ends[1]


@pytest.mark.full
def test_nothing_passes_through_in_steps_of_a_frame() -> None:
    """Three uneven sheets at up to 16 m/s to each other, which go 10 cm in a step, and lie on each other after it; at
    most one step of a vertex in a thousand is cut short.
    """
    pile = heap("implicit_euler", 1, dt=FRAME)
    for _ in range(10):
        pile.go(1)
        assert not pile.crossed
    assert pile.meeting.counts[TOUCHING] > 20
    assert pile.meeting.so_far[CUT] <= 1e-3 * pile.meeting.so_far[STEPS] * pile.fabric.number


@pytest.mark.full
def test_cloth_at_rest_is_solved_like_cloth_that_hardly_moves() -> None:
    """What it will touch is in the first matrix already: as many Newton steps, to the same place."""
    found = []
    for speed in (0.0, 1e-9):
        falling = sheet(at=np.array([0.003, 1.05e-3, 0.002]), v=np.array([0.0, -speed, 0.0]))
        pile = Pile(sheet(pinned=True), falling, solver="implicit_euler", dt=FRAME)
        found.append((pile.go(1).totals["newton_steps"], pile.state.x))
    assert found[0][0] == found[1][0]
    np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-9)


@pytest.mark.full
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


@pytest.mark.full
@pytest.mark.parametrize("solver", IMPLICIT_SOLVERS)
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


@pytest.mark.full
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


@pytest.mark.full
def test_implicit_a_sheet_slides_as_coulomb_says() -> None:
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


@pytest.mark.full
def test_a_fold_of_uneven_triangles_rests_on_itself() -> None:
    """The upper half falls on the lower one, comes to rest there, and no step is cut short."""
    pile = Pile(folded(), solver="implicit_euler", dt=FRAME, gravity=DOWN, damping=1.0)
    for _ in range(40):
        pile.go(1)
        assert not pile.crossed
    assert pile.meeting.counts[TOUCHING] > 50
    assert pile.meeting.so_far[CUT] == 0
    assert np.abs(pile.state.v).max() < 1e-2


@pytest.mark.quick(solver=["symplectic_euler", "xpbd"])
@pytest.mark.parametrize(
    ("solver", "seed", "dt", "steps"),
    [("symplectic_euler", 3, 2e-4, 10), ("xpbd", 1, USUAL, 10), ("implicit_euler", 1, 0.25 * FRAME, 2)],
)
def test_a_run_goes_on_from_a_checkpoint_in_the_same_bits(solver: str, seed: int, dt: float, steps: int) -> None:
    """In the middle of contact, with anchors and plans, by a solver's memory alone."""
    whole, cut, on = (heap(solver, seed, dt=dt) for _ in range(3))
    for _ in range(8):
        whole.go(steps)
    for _ in range(3):
        cut.go(steps)
    on.state.x[...], on.state.v[...], on.state.t = cut.state.x, cut.state.v, cut.state.t
    for name, values in cut.memory.arrays.items():
        on.memory.arrays[name] = values.copy()
    for _ in range(5):
        on.go(steps)
    assert cut.meeting.anchored.any()
    assert (on.state.x.tobytes(), on.state.v.tobytes()) == (whole.state.x.tobytes(), whole.state.v.tobytes())
