"""The number of threads follows what is faster just now, and a step in one pass has the bits of one in two."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nuno.scene import scene_file, shipped
from nuno.simulation.cloth import build
from nuno_integrators.compiled import BETTER, TRY_AGAIN, ThreadTuning
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_schemas.system import System, Term


def frames(pace: ThreadTuning, number: int, seconds: dict[int, float]) -> list[int]:
    """Threads of each frame where a step takes so long with 1 and with 2."""
    used = []
    for _ in range(number):
        used.append(pace.choose())
        pace.took(100 * seconds[used[-1]], 100)
    return used


@pytest.mark.parametrize("faster", [1, 2])
def test_takes_what_is_faster(faster: int) -> None:
    used = frames(ThreadTuning(2), 10 * TRY_AGAIN, {faster: 1.0, 3 - faster: 3.0})
    assert used.count(3 - faster) <= 12
    assert {1, 2} == set(used[:3])


def test_notices_that_the_machine_has_changed() -> None:
    pace = ThreadTuning(2)
    assert frames(pace, 10, {1: 2.0, 2: 1.0})[-1] == 2
    assert frames(pace, 2 * TRY_AGAIN, {1: 2.0, 2: 9.0})[-2] == 1
    assert frames(pace, 2 * TRY_AGAIN, {1: 2.0, 2: 1.0})[-2] == 2


def test_changes_for_no_difference_that_is_noise() -> None:
    close = (1.0 + BETTER) / 2.0
    assert frames(ThreadTuning(2), 5 * TRY_AGAIN, {1: close, 2: 1.0}).count(1) <= 7


def test_a_single_slow_frame_changes_nothing() -> None:
    pace = ThreadTuning(2)
    frames(pace, 10, {1: 1.5, 2: 1.0})
    assert frames(pace, 1, {1: 1.5, 2: 9.0}) == [2]
    assert set(frames(pace, 5, {1: 1.5, 2: 1.0})) == {2}


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_one_pass_has_the_bits_of_two(steps: int) -> None:
    """A force in Python that adds nothing takes the way by forces first and updates after."""
    overrides = ("objects.0.model.resolution=[9, 8]", "objects.0.model.velocity=[0.1, 0.2, 0.3]", "damping=0.5")
    loaded = scene_file.read(Path(shipped.find("stiff-sheet")), overrides)
    fabric, _ = build.build_fabric(loaded)
    plain = System(fabric, np.array([0.0, -9.81, 0.0]), 0.5)
    nothing = replace(plain, terms=(Term("python", lambda x, v, t, out: None),))
    ends = []
    for system in (plain, nothing):
        method, state = SymplecticEuler(), build.start_state(fabric)
        memory = method.prepare(method.Config(), system, state)
        for _ in range(3):
            method.advance(system, state, memory, None, steps, 1e-4)
        ends.append(state)
    assert np.array_equal(ends[0].x, ends[1].x) and np.array_equal(ends[0].v, ends[1].v)
    assert not np.array_equal(ends[0].x, build.start_state(fabric).x)
