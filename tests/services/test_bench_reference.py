"""What errors are measured against: two solvers that must agree and are exact, and how long they can be trusted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from line_net import problem_of, reference_of, write_net
from scenes import write_scene
from scipy.linalg import expm

from nuno_bench.precision.sweep import measure_errors
from nuno_bench.problem import POSITIONS
from nuno_bench.reference import DISTURBANCE, LOST, find_horizon, stepped_reference
from nuno_schemas.errors import BadInput


def test_the_reference_is_the_exact_motion_where_that_is_known(tmp_path: Path) -> None:
    """On a line positions and velocities obey z' = a z + b, whose solution is an exponential of a, extended by b."""
    run = reference_of(problem_of(write_net(tmp_path))).run.series
    k, c, mass, drag = (
        1e2 * np.array([[15.0, -5.0], [-5.0, 5.0]]),
        0.3 * np.array([[1.0, -1.0], [-1.0, 1.0]]),
        0.01,
        0.1,
    )
    b = np.array([-9.81 - (10.0 * 0.1 - 5.0 * 0.15) / mass, -9.81 - 5.0 * 0.15 / mass])
    a = np.block([[np.zeros((2, 2)), np.eye(2), np.zeros((2, 1))], [-k, -c - drag * np.eye(2), b[:, None]]])
    step, z = expm(0.02 * np.vstack([a, np.zeros(5)])), np.array([-0.1, -0.25, 0.2, -0.1, 1.0])
    for y in run.x[:, :, 1]:
        assert np.abs(y - z[:2]).max() < 1e-10
        z = step @ z


@pytest.mark.full
def test_an_oscillator_can_be_predicted_for_the_whole_run(tmp_path: Path) -> None:
    """No part of a disturbance of a linear system grows beyond the condition of its modes."""
    problem = problem_of(write_net(tmp_path, duration=20))
    horizon = find_horizon(problem, reference_of(problem))
    assert horizon.whole and horizon.t == pytest.approx(20.0)
    assert horizon.growth < 10.0


def test_a_flailing_chain_cannot(tmp_path: Path) -> None:
    """Masses that swing over the top are chaotic: the disturbance is lost before the end, and not before it grew."""
    problem = problem_of(write_scene(tmp_path, duration=6, frame_rate=20))
    reference = reference_of(problem)
    horizon = find_horizon(problem, reference)
    assert not horizon.whole
    assert horizon.distance[0] == pytest.approx(DISTURBANCE, rel=1e-3)
    assert (horizon.distance[: horizon.frames] <= LOST).all() and horizon.distance[horizon.frames] > LOST
    scales = problem.scales(reference.run.series)
    floors = measure_errors(reference.check.series, reference.run.series, scales, horizon.frames)
    longer = measure_errors(reference.check.series, reference.run.series, scales, problem.frames + 1)
    assert floors[POSITIONS].linf < longer[POSITIONS].linf


def test_a_reference_by_fixed_steps_is_as_good_as_it_says(tmp_path: Path) -> None:
    """Where adaptive methods do not end in time. Its floor, the check's own error, bounds what it is off by."""
    problem = problem_of(write_scene(tmp_path, duration=0.5, frame_rate=20))
    stepped, tight = stepped_reference(problem, 60.0, lambda text: None), reference_of(problem)
    off = np.abs(stepped.run.series.x - tight.run.series.x).max()
    floor = np.abs(stepped.check.series.x - stepped.run.series.x).max()
    assert 0.0 < off < 0.1 * floor < 1e-3 * problem.size
    with pytest.raises(BadInput, match="no reference"):
        stepped_reference(problem, 1e-9, lambda text: None)


def test_errors_are_the_stated_norms(tmp_path: Path) -> None:
    problem = problem_of(write_net(tmp_path))
    run = reference_of(problem).run.series
    scales = problem.scales(run)
    moved = run.x.copy()
    moved[1:, 0] += np.array([0.0, 0.0, 3e-3])
    moved[-1, 1] += np.array([4e-3, 0.0, 0.0])
    error = measure_errors(type(run)(run.t, moved, run.values, run.parts), run, scales, len(run.t))[POSITIONS]
    assert problem.size == pytest.approx(0.25)
    assert error.final * 0.25 == pytest.approx(np.sqrt((3e-3**2 + 4e-3**2) / 2))
    assert error.linf * 0.25 == pytest.approx(4e-3)
    assert error.l2 * 0.25 == pytest.approx(np.sqrt((3e-3**2 * 20 + 4e-3**2) / 2 / 20))


def test_a_scene_in_which_nothing_can_move_is_refused(tmp_path: Path) -> None:
    path = write_net(tmp_path)
    arrays = dict(np.load(tmp_path / "line.npz"))
    np.savez(tmp_path / "line.npz", **(arrays | {"pinned": np.ones(3, bool)}))
    with pytest.raises(BadInput, match="can move"):
        problem_of(path)


def test_a_run_whose_frames_do_not_fit_in_memory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="do not fit in memory"):
        problem_of(write_net(tmp_path, duration=1e9))
