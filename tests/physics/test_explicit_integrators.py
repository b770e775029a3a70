"""Explicit integrators: critical step, frames, forces in Python, threads, failures, adaptive steps."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from explicit_methods import ALL, METHODS, name
from nets import grid_springs, make_fabric, make_hinges, make_system, random_net, run, start
from yarn_nets import chains, locking

from nuno_cloth.wind import WindLists, prepare_wind
from nuno_integrators.explicit.adaptive import AT, BEFORE, NEXT, PENDING, Dop853, Dopri5, take
from nuno_integrators.explicit.fixed_step import Leapfrog, SymplecticEuler
from nuno_integrators.explicit.runge_kutta import RK4, RK4Printed
from nuno_integrators.packing import pack
from nuno_kernels.forces.hinges import HingeLists
from nuno_kernels.forces.springs import SpringLists
from nuno_kernels.forces.yarns import YarnLists
from nuno_kernels.step.blocks import BLOCK
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Springs, State
from nuno_schemas.system import System, Term


def oscillator(omega: float, damping: float, x: Float, v: Float) -> System:
    """A particle on a spring of rest length 0 to a pinned one: x'' = -omega^2 x - damping x'."""
    springs = Springs.from_pairs(np.array([[0, 1]], np.int32), np.array([2.0 * omega**2]), np.zeros(1), np.zeros(1))
    pinned = np.array([True, False])
    fabric = make_fabric(np.stack([0 * x, x]), springs, mass=2.0, pinned=pinned, velocity=np.stack([0 * v, v]))
    return make_system(fabric, damping=damping)


def test_printed_slips_of_rk4_cost_three_orders_and_double_gravity() -> None:
    plugin, errors, counts = RK4Printed(), [], (50, 100, 200, 400)
    for count in counts:
        system = oscillator(2.0, 0.8, np.array([1.0, 0.0, 0.0]), np.zeros(3))
        state = start(system)
        run(plugin, system, state, count, 1.0 / count)
        rate = np.sqrt(4.0 - 0.16)
        exact = np.exp(-0.4) * (np.cos(rate) + 0.4 / rate * np.sin(rate))
        errors.append(abs(state.x[1, 0] - exact))
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 1.0) < 0.1
    falling = make_system(make_fabric(np.zeros((1, 3))), np.array([0.0, -9.81, 0.0]))
    state = start(falling)
    run(plugin, falling, state, 100, 0.01)
    assert abs(state.v[0, 1] + 2 * 9.81) < 1e-12


def pinned_net(n: int) -> tuple[System, float]:
    """n x n free vertices inside a pinned frame, springs of rest length 0 to the 4 neighbours.

    Linear, with modes sin(p pi i/(n + 1)) sin(q pi j/(n + 1)) and squared frequencies
    4 k/m (sin^2(p pi/(2 n + 2)) + sin^2(q pi/(2 n + 2))), in each coordinate alike. Returns the
    system displaced along its fastest mode, and that frequency.
    """
    k, m, side = 3.0, 0.01, n + 2
    position, springs = grid_springs(side, side, 1.0, k)
    near = springs.kind == 0
    pairs = Springs(
        springs.first[near], springs.count[near], springs.stride[near], springs.k[near],
        0.0 * springs.rest[near], springs.c[near], springs.kind[near],
    )  # fmt: skip
    row, column = np.divmod(np.arange(side * side), side)
    pinned = (row == 0) | (row == side - 1) | (column == 0) | (column == side - 1)
    mode = np.sin(n * np.pi * row / (n + 1)) * np.sin(n * np.pi * column / (n + 1)) * ~pinned
    position[:, 2] = 1e-3 * mode
    omega = np.sqrt(8.0 * k / m) * np.sin(n * np.pi / (2 * n + 2))
    return make_system(make_fabric(position, pairs, mass=m, pinned=pinned)), float(omega)


@pytest.mark.parametrize(
    ("plugin", "limit"),
    [(SymplecticEuler(), 2.0), (Leapfrog(), 2.0), (RK4(), 2.0 * np.sqrt(2.0))],
    ids=["symplectic_euler", "leapfrog", "rk4"],
)
def test_normal_modes_are_bounded_below_the_critical_step_and_grow_above(plugin: Any, limit: float) -> None:
    for share, grows in ((0.999, False), (1.001, True)):
        system, omega = pinned_net(7)
        state = start(system)
        run(plugin, system, state, 500, share * limit / omega, frames=4)
        amplitude = np.abs(state.x[:, 2]).max() / 1e-3
        assert amplitude > 1e3 if grows else amplitude < 30.0
        measured = plugin.limit(plugin.Config(), system, start(system))
        assert omega <= measured.omega <= 1.05 * omega
        assert 0.95 * limit / omega <= measured.dt <= limit / omega


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
        out[13, 1] += np.nan if t > 2.9e-3 - 1e-9 else 0.0

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


FRAME = 0.1
BOTH = pytest.mark.parametrize("plugin", [Dopri5(), Dop853()], ids=lambda p: p.name)


def with_both(test: Callable[..., None]) -> Callable[..., None]:
    """Both pairs go through one loop, which is compiled for each."""
    return pytest.mark.quick(plugin=["dop853"])(BOTH(test))


def pendulums(damping=0.0, far=0.0) -> System:
    """Three masses on stiff springs, swinging from a pinned vertex: no closed form, several frequencies."""
    x = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.9, 0.3, 0.1], [2.4, -0.4, 0.5]]) + far
    pairs = np.array([[0, 1], [1, 2], [2, 3]], np.int32)
    springs = Springs.from_pairs(pairs, np.array([400.0, 900.0, 100.0]), np.full(3, 0.9), np.full(3, 0.2))
    pinned = np.array([True, False, False, False])
    fabric = Fabric(
        "chain", x, np.zeros((4, 3)), np.array([1.0, 1.0, 0.5, 2.0]), pinned, np.zeros((0, 3), np.int32), springs
    )
    return System(fabric, np.array([0.0, -9.81, 0.0]), damping)


def begin(plugin, system, tolerance):
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    return state, plugin.prepare(plugin.Config(tolerance=tolerance), system, state)


def frames(plugin, system, state, memory, count):
    path, totals = [], {"steps": 0, "rejected_steps": 0}
    for _ in range(count):
        report = plugin.advance(system, state, memory, None, 1, FRAME)
        assert report.status == "ok"
        totals = {name: totals[name] + report.totals[name] for name in totals}
        path.append(state.x.copy())
    return np.array(path), totals


@with_both
def test_error_at_frames_follows_the_tolerance(plugin):
    system = pendulums(0.3)
    exact, _ = frames(Dop853(), system, *begin(Dop853(), system, 1e-13), 20)
    tolerances = np.array([1e-5, 1e-6, 1e-7, 1e-8, 1e-9])
    errors = []
    for tolerance in tolerances:
        path, totals = frames(plugin, system, *begin(plugin, system, tolerance), 20)
        errors.append(np.abs(path - exact).max())
        assert totals["steps"] > 40, "frames would all end a step, and no output inside of one be seen"
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.85 < slope < 1.15
    assert np.all(np.array(errors) < 300 * tolerances)


@with_both
def test_frames_do_not_shorten_steps(plugin):
    system = pendulums()
    whole = begin(plugin, system, 1e-8)
    report = plugin.advance(system, *whole, None, 1, 2.0)
    _, totals = frames(plugin, system, *begin(plugin, system, 1e-8), 20)
    assert totals["steps"] <= report.steps + 1


@with_both
@pytest.mark.parametrize("at", [1, 7, 12])
def test_a_resume_inside_of_a_step_ends_in_the_same_bytes(plugin, at):
    system = pendulums(0.1)
    state, memory = begin(plugin, system, 1e-7)
    frames(plugin, system, state, memory, at)
    kept = State(state.x.copy(), state.v.copy(), state.t), {k: a.copy() for k, a in memory.arrays.items()}
    frames(plugin, system, state, memory, 6)
    again, fresh = kept[0], plugin.prepare(plugin.Config(tolerance=1e-7), system, kept[0])
    for key, array in kept[1].items():
        np.copyto(fresh.arrays[key], array)
    assert fresh.arrays["control"][1] > 0.0, "no step was pending"
    frames(plugin, system, again, fresh, 6)
    assert again.x.tobytes() == state.x.tobytes()
    assert again.v.tobytes() == state.v.tobytes()


@with_both
def test_a_step_pending_under_other_forces_is_dropped(plugin):
    system = pendulums()
    state, memory = begin(plugin, system, 1e-9)
    frames(plugin, system, state, memory, 3)
    lighter = replace(system, gravity=np.array([0.0, -1.6, 0.0]))
    kept, again = memory.arrays, state.copy()
    fresh = plugin.prepare(plugin.Config(tolerance=1e-9), lighter, state)
    for key, array in kept.items():
        np.copyto(fresh.arrays[key], array)
    clean = plugin.prepare(plugin.Config(tolerance=1e-9), lighter, again)
    frames(plugin, lighter, state, fresh, 3)
    frames(plugin, lighter, again, clean, 3)
    assert np.abs(state.x - again.x).max() < 1e-7


@with_both
def test_a_force_in_python_is_met_at_its_own_times(plugin):
    """x'' = cos(3 t): steps end with the frames, and the closed form comes out."""

    def push(x, v, t, out):
        out[:, 0] += np.cos(3.0 * t)

    fabric = Fabric(
        "mass", np.zeros((1, 3)), np.zeros((1, 3)), np.ones(1), np.zeros(1, bool), np.zeros((0, 3), np.int32)
    )
    system = System(fabric, np.zeros(3), 0.0, (Term("python", push),))
    state, memory = begin(plugin, system, 1e-10)
    frames(plugin, system, state, memory, 13)
    assert abs(state.x[0, 0] - (1.0 - np.cos(3.0 * 1.3)) / 9.0) < 1e-8


@with_both
def test_a_tolerance_below_rounding_is_refused(plugin):
    with pytest.raises(BadInput, match="rounded more"):
        begin(plugin, pendulums(far=1e6), 1e-10)


@with_both
def test_steps_without_end_are_given_up_by_name(plugin):
    def wall(x, v, t, out):
        out[:, 0] += np.where(x[:, 0] > 0.0, np.nan, 1.0)

    fabric = Fabric(
        "mass", -np.ones((1, 3)), np.zeros((1, 3)), np.ones(1), np.zeros(1, bool), np.zeros((0, 3), np.int32)
    )
    system = System(fabric, np.zeros(3), 0.0, (Term("python", wall),))
    state, memory = begin(plugin, system, 1e-6)
    report = plugin.advance(system, state, memory, None, 1, 10.0)
    assert report.status == "unconverged"
    assert "no step above" in report.message
    assert np.isfinite(state.x).all()
    assert state.x[0, 0] < 1e-6


def test_a_step_after_one_that_was_refused_is_no_longer_than_it() -> None:
    """Hairer, Norsett & Wanner 1993, section II.4: else it would be refused again; without a refusal it grows."""
    control = np.zeros(4)
    lengths = {}
    for again in (False, True):
        control[AT], control[PENDING], control[NEXT], control[BEFORE] = 0.0, 0.0, 1e-3, 0.5
        take(control, 1e-3, 1e-3, 0.17, again)
        lengths[again] = control[NEXT]
        assert control[PENDING] == 1e-3
    assert lengths[True] == 1e-3 < lengths[False]
