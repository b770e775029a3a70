"""What errors are measured against: exact motions, two solvers that must agree, and how long they can be trusted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from line_net import problem_of, reference_of, write_net
from scenes import write_scene

from nuno_bench.precision.errors import POSITIONS, measure_errors
from nuno_bench.problem.closed_form import exponential, find_linear
from nuno_bench.problem.horizon import DISTURBANCE, LOST, find_horizon
from nuno_bench.problem.stepped import stepped_reference
from nuno_schemas.errors import BadInput


def test_exponential_of_a_damped_oscillator() -> None:
    omega, damping, t = 40.0, 3.0, 0.7
    slow = np.sqrt(omega**2 - damping**2 / 4.0)
    c, s, fade = np.cos(slow * t), np.sin(slow * t) / slow, np.exp(-damping * t / 2.0)
    exact = fade * np.array([[c + damping / 2 * s, s], [-(omega**2) * s, c - damping / 2 * s]])
    measured = exponential(np.array([[0.0, 1.0], [-(omega**2), -damping]]) * t)
    assert np.abs(measured - exact).max() < 1e-12 * omega


def test_the_exact_motion_is_what_the_solvers_converge_to(tmp_path: Path) -> None:
    problem = problem_of(write_net(tmp_path))
    reference = reference_of(problem)
    tight = reference.twin(np.zeros((3, 3)))
    assert "exact" in reference.how
    assert np.abs(tight.series.x - reference.run.series.x).max() < 1e-10
    assert np.abs(tight.series.parts - reference.run.series.parts).max() < 1e-9
    # Bent by a hair it is linear no more.
    assert find_linear(problem_of(write_net(tmp_path, gravity=[1e-6, -9.81, 0.0]))) is None


def test_free_fall_without_springs_is_exact_in_all_directions(tmp_path: Path) -> None:
    path, drag, v, g = write_net(tmp_path), 0.1, np.array([1.0, 2.0, -3.0]), np.array([0.0, -9.81, 0.0])
    arrays = dict(np.load(tmp_path / "line.npz"))
    arrays |= {"springs": np.zeros((0, 2), int), "k": np.zeros(0), "rest": np.zeros(0), "c": np.zeros(0)}
    np.savez(tmp_path / "line.npz", **(arrays | {"v": np.tile(v, (3, 1)), "pinned": np.zeros(3, bool)}))
    run = reference_of(problem_of(path)).run.series
    lost = -np.expm1(-drag * run.t)[:, None] / drag
    way = v * lost + g / drag * (run.t[:, None] - lost)
    assert np.abs(run.x - run.x[0] - way[:, None]).max() < 1e-12
    assert np.abs(run.values["drop"][:, 0] + way[:, 1]).max() < 1e-12


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
