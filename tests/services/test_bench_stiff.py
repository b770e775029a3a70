"""What the comparison with SciPy rests on: the same forces, and times read off at the same error."""

from __future__ import annotations

import numpy as np
import pytest

from nuno import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.stiff import SMOOTH, _fastest


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


def test_time_at_an_error_lies_on_the_curve_between_its_points() -> None:
    """time = error^-1/2: a straight line on logarithmic scales."""
    curve = [(e, e**-0.5) for e in (1e-2, 1e-4, 1e-8)]
    found = _fastest({"slow": [(1e-9, 1e9)], "own": curve}, 1e-6)
    assert found is not None
    assert found[0] == "own"
    assert found[1] == pytest.approx(1e3)
    assert _fastest({"own": curve}, 1e-9) is None
