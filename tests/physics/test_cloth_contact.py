"""Cloth meets cloth: nothing passes through, whatever solver and step; friction, weight, momentum, energy, bits."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys
from sheets import DOWN, Pile, heap, sheet

from nuno.cloth.join import join_fabrics
from nuno_bench.problem import piles
from nuno_contact.offset.candidate_pairs import make_list
from nuno_contact.offset.places import LEFT_OUT, LISTED, LISTS_MADE, STEPS, TOUCHING
from nuno_contact.offset.plan import AHEAD, is_quiet
from nuno_contact.offset.plugin import Offset, OffsetConfig
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, State

SOLVERS = ("symplectic_euler", "respa", "leapfrog", "rk4", "dopri5", "xpbd", "implicit_euler")


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
    before, lists, most = held(), int(pile.meeting.number[LISTS_MADE]), 0
    for _ in range(10):
        pile.go(20)
        most = max(most, int(pile.meeting.number[TOUCHING]))
    assert pile.meeting.number[LISTS_MADE] > lists
    assert most > 20
    assert held() == before


@pytest.mark.full
def test_a_wider_list_has_the_pairs_of_a_narrower_in_the_same_order() -> None:
    """In which constraints are solved: what rests would creep if another list had them in another."""
    pile = Pile(*piles.stack(), dt=1e-3)
    pile.go(1)
    m, keys = pile.meeting, []
    for share in (0.5, 2.0, 5.0):
        m.spread[0] = share * m.law[0]
        make_list(m, None)
        keys.append(m.key[: m.number[LISTED]].tolist())
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
    """Twenty dashpots at a vertex are together faster than the step, each of which alone is slow enough."""
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
    assert pile.meeting.number[TOUCHING] > 4 * pile.fabric.number
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
    assert pile.meeting.number[TOUCHING] == 0
    assert 0.95 * begun < energy[-1] <= begun
    damped = collision(1.0)
    assert sum([damped.go(20) for _ in range(30)][-1].energy.values()) < 0.9 * begun


def test_a_run_goes_on_from_a_checkpoint_in_the_same_bits() -> None:
    """In the middle of contact, with anchors and plans, by a solver's memory alone."""
    whole, cut = heap("symplectic_euler", 3), heap("symplectic_euler", 3)
    for _ in range(8):
        whole.go(10)
    for _ in range(3):
        cut.go(10)
    on = heap("symplectic_euler", 3)
    on.state.x[...], on.state.v[...], on.state.t = cut.state.x, cut.state.v, cut.state.t
    for name, values in cut.memory.arrays.items():
        on.memory.arrays[name] = values.copy()
    for _ in range(5):
        on.go(10)
    assert cut.meeting.anchored.any()
    assert (on.state.x.tobytes(), on.state.v.tobytes()) == (whole.state.x.tobytes(), whole.state.v.tobytes())


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
