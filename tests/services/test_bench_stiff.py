"""What the comparison with SciPy rests on: the same forces, and times read off at the same error."""

from __future__ import annotations

import numpy as np
import pytest

from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.speed.steps.scipy import SMOOTH, _fastest, implicit, slopes_by_vertex, structure
from nuno_bench.speed.steps.sliced import SlicedCloth


def test_others_are_given_the_forces_that_our_steps_take() -> None:
    """Symplectic Euler's first step is v + h a: the acceleration it took is the one handed out."""
    over = (*SMOOTH, "objects.0.model.resolution=[6, 6]", "solver={plugin: symplectic_euler, dt: 0.1 ms}")
    simulation = Simulation(
        scene_file.read(scene_file.find("stiff-sheet"), (*over, "frame_rate=10 kHz")), None, None, 1
    )
    x, v = simulation.state.x.copy(), simulation.state.v.copy()
    out = np.empty((3, 36))
    accelerate = simulation.loaded.integrator.plugin.slopes(simulation.memory)
    accelerate(np.ascontiguousarray(x.T), np.ascontiguousarray(v.T), out)
    simulation.advance(None, None)
    np.testing.assert_allclose(simulation.state.v, v + 1e-4 * out.T, atol=1e-15)
    assert np.abs(out).max() > 1.0


def test_numpy_gives_the_accelerations_of_the_kernels() -> None:
    """Damped springs whose constants differ at the edges, drag, gravity and pins, on a grid that is not square."""
    over = ("objects.0.model.resolution=[9, 7]", "objects.0.model.size=[0.8, 0.6]")
    simulation = Simulation(scene_file.read(scene_file.find("stiff-sheet"), over), None, None, 1)
    draw = np.random.default_rng(3)
    x = np.ascontiguousarray(simulation.state.x.T) + draw.normal(0.0, 0.01, (3, 63))
    v = draw.normal(0.0, 1.0, (3, 63)) * ~simulation.fabric.pinned
    own, other = np.empty((3, 63)), np.empty((3, 63))
    simulation.loaded.integrator.plugin.slopes(simulation.memory)(x, v, own)
    system = simulation.system
    assert system.damping > 0.0
    SlicedCloth(simulation.fabric, np.asarray(system.gravity), system.damping).accelerate(x, v, other)
    np.testing.assert_allclose(other, own, rtol=0, atol=1e-12 * np.abs(own).max())


@pytest.fixture
def small() -> Simulation:
    over = (*SMOOTH, "objects.0.model.resolution=[6, 5]")
    return Simulation(scene_file.read(scene_file.find("stiff-sheet"), over), None, None, 1)


def test_implicit_methods_are_told_of_every_entry_of_the_matrix(small: Simulation) -> None:
    """Differences of the slopes, column by column; what they touch lies in the band and in the sparsity."""
    n, draw = small.fabric.number, np.random.default_rng(5)
    slopes = slopes_by_vertex(small.loaded.integrator.plugin.slopes(small.memory), n)
    y = np.stack([small.state.x + draw.normal(0.0, 0.02, (n, 3)), small.state.v], axis=1).reshape(-1)
    columns = [(slopes(0.0, y + 1e-6 * unit) - slopes(0.0, y)) / 1e-6 for unit in np.eye(6 * n)]
    rows, across = np.nonzero(np.abs(np.column_stack(columns)) > 1e-3)
    band, sparsity = structure(small.fabric)
    assert np.abs(rows - across).max() <= band < 6 * n - 1
    assert sparsity.toarray()[rows, across].all()
    assert rows.size > 0.1 * sparsity.nnz


def test_methods_that_take_too_long_are_named_with_the_reason(small: Simulation) -> None:
    ends, notes = implicit(small, small.loaded.integrator.plugin.slopes(small.memory), 0.0)
    assert ends == {}
    assert [note.partition(" ")[0] for note in notes] == ["LSODA", "Radau"]
    assert all("not done after 0 s (0 s of the second done)" in note for note in notes)


def test_time_at_an_error_lies_on_the_curve_between_its_points() -> None:
    """time = error^-1/2: a straight line on logarithmic scales."""
    curve = [(e, e**-0.5) for e in (1e-2, 1e-4, 1e-8)]
    found = _fastest({"slow": [(1e-9, 1e9)], "own": curve}, 1e-6)
    assert found is not None
    assert found[0] == "own"
    assert found[1] == pytest.approx(1e3)
    assert _fastest({"own": curve}, 1e-9) is None
