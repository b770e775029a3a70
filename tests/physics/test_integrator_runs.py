"""Every explicit integrator in a run: frames, forces in Python, threads, checkpoints, failures."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from explicit_methods import ALL, METHODS, name
from nets import grid_springs, make_fabric, make_hinges, make_system, random_net, run, start
from yarn_nets import chains, locking

from nuno_cloth.wind.plugin import WindLists, prepare_wind
from nuno_integrators.explicit.leapfrog import Leapfrog
from nuno_integrators.explicit.rk4 import RK4
from nuno_kernels.forces.hinges import HingeLists
from nuno_kernels.forces.springs import SpringLists
from nuno_kernels.forces.yarns import YarnLists
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.step.packing import pack
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.system import Term


@pytest.mark.quick(plugin=["symplectic_euler"])
@pytest.mark.parametrize("plugin", ALL, ids=name)
@pytest.mark.parametrize("damping", [0.0, 0.4])
def test_interpreted_steps_equal_compiled_ones(plugin: Any, damping: float) -> None:
    """A force written in Python that adds nothing changes no bit, and is called at the stages' times."""
    position, springs = random_net(30, 150, 3)
    times = []

    def nothing(x: Float, v: Float, t: float, out: Float) -> None:
        assert x.shape == v.shape == out.shape == (30, 3)
        times.append(t)

    ends = []
    for terms in ((), (Term("python", nothing),)):
        system = make_system(make_fabric(position, springs, mass=1.0), np.array([0, -9.81, 0]), damping, terms)
        state = start(system)
        run(plugin, system, state, 4, 0.01, frames=2)
        ends.append(state.x.tobytes() + state.v.tobytes())
    assert ends[0] == ends[1]
    assert 0.0 in times
    assert max(times) <= 0.08 + 1e-12


def test_force_in_python_acts_in_newtons() -> None:
    def push(x: Float, v: Float, t: float, out: Float) -> None:
        out[:, 0] += 3.0 * t

    system = make_system(make_fabric(np.zeros((2, 3)), mass=0.5), terms=(Term("python", push),))
    state = start(system)
    run(RK4(), system, state, 10, 0.02, frames=5)
    assert np.abs(state.x[:, 0] - 1.0).max() < 1e-12
    assert np.abs(state.v[:, 0] - 3.0).max() < 1e-12


@pytest.mark.parametrize("plugin", METHODS, ids=name)
def test_divergence_is_said(plugin: Any) -> None:
    position, springs = grid_springs(6, 6, 0.01, k=1e6)
    position[:, 2] += 1e-3 * np.random.default_rng(1).standard_normal(36)
    velocity = np.zeros((36, 3))
    velocity[[0, 20, 21]] = [[0.0, 5.0, 0.0], [0.0, -3.0, 4.0], [1.0, 0.0, 0.0]]
    system = make_system(make_fabric(position, springs, pinned=np.arange(36) % 6 == 0, velocity=velocity))
    report = run(plugin, system, start(system), 4000, 1.0)
    assert report.status == "diverged"
    assert report.message.startswith("36 of 36 vertices have no finite position or velocity")
    assert "vertex 20, at 5 m/s" in report.message, "the fastest of those that can move"


@pytest.mark.quick(plugin=["symplectic_euler"])
@pytest.mark.parametrize("plugin", METHODS, ids=name)
def test_the_first_vertex_without_a_number_is_named(plugin: Any) -> None:
    """Not the fastest of all those that it takes along by the frame's end."""

    def spoil(x: Float, v: Float, t: float, out: Float) -> None:
        out[13, 1] += np.nan if t > 2.9e-3 else 0.0

    position, springs = grid_springs(6, 6, 0.01)
    velocity = np.zeros((36, 3))
    velocity[34] = [0.0, 0.0, 0.1]
    system = make_system(make_fabric(position, springs, velocity=velocity), terms=(Term("python", spoil),))
    message = run(plugin, system, start(system), 40, 1e-4).message
    assert message.startswith("36 of 36 vertices have no finite position")
    found = re.search(r"vertex (\d+), at", message)
    assert found and int(found[1]) in (1, 7, 12, 13, 14, 19, 25), message  # within a step only neighbours are reached
    assert re.search(r"in step (29|30|31) of 40", message), message


@pytest.mark.parametrize("count", [1, 2])
def test_a_force_in_python_may_do_what_it_likes_to_what_it_is_given(count: int) -> None:
    """x and v are copies, also of one vertex."""

    def spoil(x: Float, v: Float, t: float, out: Float) -> None:
        x[...], v[...] = 7.0, 9.0

    system = make_system(make_fabric(np.ones((count, 3))), terms=(Term("python", spoil),))
    state = start(system)
    run(Leapfrog(), system, state, 3, 0.1)
    assert state.x.tolist() == np.ones((count, 3)).tolist()
    assert not state.v.any()


def test_terms_without_kernels_are_refused() -> None:
    class Magnets(NamedTuple):
        strength: float

    system = make_system(make_fabric(np.zeros((1, 3))), terms=(Term("magnets", (Magnets(1.0),)),))
    with pytest.raises(BadInput, match="Magnets"):
        RK4().prepare(RK4.Config(), system, start(system))


@pytest.mark.full
@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core")
def test_forces_by_lists_give_equal_bytes_for_one_and_two_threads() -> None:
    """Springs that lock, yarns, hinges and wind; those that lie in runs, of a sheet, are tested with whole runs."""
    n = 2 * BLOCK + 100
    fabric, rng = locking(chains(n, 300, 5, c=0.2)), np.random.default_rng(6)
    corners = rng.permuted(np.tile(np.arange(n), (300, 1)), axis=1)[:, :4].astype(np.int32)
    fabric = replace(fabric, faces=corners[:, :3], hinges=make_hinges(corners, np.full(300, 2.0), np.full(300, 0.4)))
    wind = Term("wind", prepare_wind(fabric.faces, n, np.array([1.0, 0.5, 3.0]), 1.2, 1.0, 0.1))
    ends = []
    for threads in (1, 2):
        system = make_system(fabric, terms=(wind,), threads=threads)
        packed = pack(system)
        assert (packed.threads is None) == (threads == 1)
        assert [type(term) for term in packed.forces] == [SpringLists, HingeLists, YarnLists, WindLists]
        state = start(system)
        run(Leapfrog(), system, state, 10, 1e-3)
        ends.append(state.x.tobytes() + state.v.tobytes())
    assert ends[0] == ends[1]
    assert not np.array_equal(state.x, fabric.position)
