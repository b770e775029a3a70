"""Cloth meets cloth under xpbd, by constraints: what rests, bears, sticks, slides, collides, in its own long steps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sheets import Pile, heap, pace, sheet, sliding

from nuno_bench.problem import piles
from nuno_contact.offset.places import CUT, STEPS, TOUCHING
from nuno_schemas.fabric import Fabric, Float

USUAL = 1.0 / 960.0
"""Sixteen steps in a frame [s]."""
THICKNESS = piles.THICKNESS


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
    return found, THICKNESS - load / (0.5 * pile.meeting.stiffness[-1])


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
            most = max(most, int(pile.meeting.number[TOUCHING]))
        assert most > 100
        assert np.abs(pile.momentum - before).max() < 1e-13 * size
        change = (mass * np.cross(pile.state.x, pile.state.v)).sum(axis=0) - moment
        lost.append(float(np.abs(change).max() / np.abs(mass * np.cross(pile.state.x, pile.state.v)).sum()))
    assert lost[0] < 2e-3
    assert lost[0] / lost[1] == pytest.approx(2.0, rel=0.05)


def test_an_undamped_bounce_gains_no_energy() -> None:
    """And loses what backward Euler does, less in shorter steps."""
    left = []
    for dt in (4e-4, 1e-4):
        pile = Pile(*piles.collision(), solver="xpbd", gravity=np.zeros(3), friction=0.0, damping=0.0, dt=dt)
        begun = sum(pile.go(0).energy.values())
        energy = [sum(pile.go(round(2e-3 / dt)).energy.values()) for _ in range(15)]
        assert pile.meeting.number[TOUCHING] == 0
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
    assert pile.meeting.number[TOUCHING] > 20
    assert pile.meeting.so_far[CUT] < 0.02 * pile.meeting.so_far[STEPS] * pile.fabric.number


def test_a_run_goes_on_from_a_checkpoint_in_the_same_bits() -> None:
    """In the middle of contact, by a solver's memory alone."""
    whole, cut, on = (heap("xpbd", 1, dt=USUAL) for _ in range(3))
    for _ in range(8):
        whole.go(10)
    for _ in range(3):
        cut.go(10)
    on.state.x[...], on.state.v[...], on.state.t = cut.state.x, cut.state.v, cut.state.t
    for name, values in cut.memory.arrays.items():
        on.memory.arrays[name] = values.copy()
    for _ in range(5):
        on.go(10)
    assert cut.meeting.anchored.any()
    assert (on.state.x.tobytes(), on.state.v.tobytes()) == (whole.state.x.tobytes(), whole.state.v.tobytes())


@pytest.mark.full
def test_the_same_bits_whatever_the_threads() -> None:
    """Of two sheets of so many vertices that several threads step them."""
    ends = []
    for threads in (1, 2):
        pieces = [sheet(46, 0.5, pinned=True), sheet(46, 0.48, at=np.array([0.003, 0.003, 0.002]))]
        pile = Pile(*pieces, solver="xpbd", dt=USUAL, threads=threads)
        pile.go(60)
        assert (pile.memory.work.tuning is None) == (threads == 1)  # type: ignore[attr-defined]
        assert pile.meeting.number[TOUCHING] > 1000
        ends.append(pile.state.x.tobytes() + pile.state.v.tobytes())
    assert ends[0] == ends[1]
