"""Kicks of soft forces between steps of tension: how often, how precise, and where they would resonate."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import entry_points
from typing import Any, Literal

import numpy as np
import pytest
from nets import make_fabric, make_system
from pydantic import ValidationError

from nuno.plugin_contract import registry
from nuno_contact.offset.plugin import Offset, OffsetConfig
from nuno_integrators.explicit.fixed_step import NoConfig, SymplecticEuler
from nuno_integrators.explicit.respa import (
    SAFE,
    STRETCHED,
    Respa,
    RespaConfig,
    at_start,
    both_rates,
    divide,
    feeds,
    feeds_stretched,
    steps_a_kick,
)
from nuno_schemas.fabric import Float, Hinges, Springs, State
from nuno_schemas.system import System, Term

EDGE, STIFF, MASS = 0.02, 400.0, 2e-4


def strip(columns: int = 14, damping: float = 0.0, bend: float = 2e-5, gravity: float = 9.81) -> System:
    """A strip of triangles that is held at one end, its springs damped by `damping` [N s/m]."""
    along, across = np.meshgrid(np.arange(columns), np.arange(3), indexing="ij")
    x = EDGE * np.stack([along.ravel(), 0.0 * along.ravel(), across.ravel()], axis=1)
    at = np.arange(3 * columns).reshape(columns, 3)
    ends = (at[1:], at[:-1]), (at[:, 1:], at[:, :-1]), (at[1:, 1:], at[:-1, :-1])
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ends]).astype(np.int32)
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    springs = Springs.from_pairs(pairs, np.full(len(pairs), STIFF), rest, np.full(len(pairs), damping))
    quads = np.stack([at[1:-1, :-1], at[1:-1, 1:], at[2:, 1:], at[:-2, :-1]], axis=-1).reshape(-1, 4).astype(np.int32)
    one = np.ones(len(quads), np.int32)
    hinges = Hinges(quads, one, one, np.full(len(quads), bend), np.zeros(len(quads)))
    fabric = make_fabric(x, springs, hinges, MASS, x[:, 0] < 0.5 * EDGE)
    return make_system(fabric, np.array([0.0, -gravity, 0.0]), 0.5)


def end(system: System, plugin: Any, config: object, steps: int, duration: float) -> Float:
    """(2, n, 3) where a system is after so long, and how fast."""
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    memory = plugin.prepare(config, system, state)
    report = plugin.advance(system, state, memory, None, steps, duration / steps)
    assert report.status == "ok"
    return np.stack([state.x, state.v])


def test_tension_alone_is_symplectic_eulers_to_the_last_bit() -> None:
    system = strip()
    system = replace(system, fabric=replace(system.fabric, hinges=None))
    one, other = end(system, Respa(), RespaConfig(), 500, 0.05), end(system, SymplecticEuler(), NoConfig(), 500, 0.05)
    assert one.tobytes() == other.tobytes()


def test_what_hangs_in_the_air_stands_still_at_its_static_stretch() -> None:
    """Tension carries the weight below each row: gravity is no kick where nothing may rest on anything."""
    hung = replace(strip(columns=8, damping=0.02), gravity=np.array([9.81, 0.0, 0.0]), damping=30.0)
    config, step = RespaConfig(), 0.5 * Respa().limit(RespaConfig(), hung, at_start(hung)).dt
    assert Respa().steps_a_kick(config, hung, step, 2.0) > 8
    x, v = end(hung, Respa(), config, int(2.0 / step), 2.0)
    other, _ = end(hung, SymplecticEuler(), NoConfig(), int(2.0 / step), 2.0)
    assert np.abs(v).max() < 1e-9
    start, stretched = (part[:, 0] - hung.fabric.position[:, 0] for part in (x, other))
    assert start == pytest.approx(stretched, rel=1e-6, abs=1e-12) and stretched.max() > 1e-6


@pytest.mark.parametrize(("damping", "order"), [(0.0, 2.0), (5.0, 1.0)])
def test_what_kicks_leave_out_falls_with_the_time_between_them(damping: float, order: float) -> None:
    """Against a kick in every step as short: with its square, since kicks stand for half of the time before and half of
    that after, but for what goes by velocities, which are those of just before.
    """
    system, duration = replace(strip(damping=0.02), damping=damping), 0.1
    errors, counts = [], (1000, 2000, 4000)
    for steps in counts:
        often = end(system, Respa(), RespaConfig(every=1), steps, duration)
        errors.append(np.abs(end(system, Respa(), RespaConfig(every=5), steps, duration) - often)[0].max())
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - order) < 0.3, errors


def test_a_shorter_step_brings_kicks_nearer_too() -> None:
    """The error, against a kick in every step extrapolated to none, falls with the step though many make a kick."""
    system, duration = strip(damping=0.02), 0.1
    state = State(system.fabric.position, system.fabric.velocity)
    fewest = int(np.ceil(duration / (SAFE * Respa().limit(RespaConfig(), system, state).dt)))
    kicks = {n: Respa().steps_a_kick(RespaConfig(), system, duration / n, duration) for n in (fewest, 8 * fewest)}
    assert kicks[fewest] == kicks[8 * fewest] > 1
    often = [end(system, Respa(), RespaConfig(every=1), k * fewest, duration) for k in (16, 32)]
    exact = 2.0 * often[1] - often[0]
    counts = [fewest << k for k in range(5)]
    errors = [np.abs(end(system, Respa(), RespaConfig(), n, duration) - exact)[0].max() for n in counts]
    assert errors[0] < 1e-5 and errors == sorted(errors, reverse=True)
    assert abs(-np.polyfit(np.log(counts[2:]), np.log(errors[2:]), 1)[0] - 1.0) < 0.2, errors


def test_kicks_stand_for_many_steps_of_damped_springs() -> None:
    """And where they are not damped, for no more than half a period of the fastest mode."""
    for damping, least in ((0.05, 8), (0.0, 1)):
        system = strip(damping=damping)
        state = State(system.fabric.position, system.fabric.velocity)
        dt = 0.25 * Respa().limit(RespaConfig(), system, state).dt
        fast, slow = both_rates(system, state)
        assert slow[0] < 0.2 * fast[0]
        kicks = steps_a_kick(fast, slow, dt)
        assert kicks >= least
        if damping == 0.0:
            assert 1 < kicks <= np.pi / (dt * fast[0])


@pytest.mark.full
def test_a_kick_every_half_period_of_an_undamped_spring_feeds_it() -> None:
    """As the trace of its matrix has it, by w_s^2 H / (2 w) a kick; as often as `auto` has them, none does."""
    omega, slow, kicks = 100.0, 20.0, 60
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    spring = Springs.from_pairs(np.array([[0, 1]], np.int32), np.array([omega**2]), np.ones(1), np.zeros(1))
    fabric = make_fabric(
        x, spring, mass=1.0, pinned=np.array([True, False]), velocity=np.array([[0.0] * 3, [1e-3, 0, 0]])
    )

    def pull(x: Float, v: Float, t: float, out: Float) -> None:
        out[1, 0] -= slow**2 * (x[1, 0] - 1.0)

    system, state = make_system(fabric), State(fabric.position, fabric.velocity)
    system = replace(system, terms=(Term("pull", pull),))
    every = 16
    span = np.pi / omega

    def grown(every: int, dt: float, kicks: int = kicks) -> float:
        x, v = end(system, Respa(), RespaConfig(every=every), kicks * every, kicks * every * dt)
        return float(np.hypot(omega * (x[1, 0] - 1.0), v[1, 0]) / 1e-3)

    # At which time between kicks modes meet them: about half a period, a little less for the pull adds to the spring.
    times = np.linspace(0.95, 1.0, 21) * span / every
    rate = max(np.log(grown(every, dt, 2 * kicks) / grown(every, dt)) / kicks for dt in times)
    assert abs(rate / (slow**2 * span / (2.0 * omega)) - 1.0) < 0.1
    dt = span / every
    assert grown(steps_a_kick(*both_rates(system, state), dt), dt, 10 * kicks) < 3.0


@pytest.mark.parametrize("every", [1, 4])
def test_a_force_in_python_that_does_nothing_changes_nothing(every: int) -> None:
    """The same loop runs interpreted then; to the last digits, for its parts are compiled one by one."""
    system = strip(damping=0.02)
    idle = replace(system, terms=(Term("idle", lambda x, v, t, out: None),))
    plain, other = (end(each, Respa(), RespaConfig(every=every), 300, 0.05) for each in (system, idle))
    assert np.abs(plain - other).max() < 1e-12


@pytest.mark.parametrize("every", ["auto", 4])
@pytest.mark.parametrize("damping", [20.0, 300.0, 1000.0])
def test_viscous_damping_by_kicks_feeds_nothing(damping: float, every: Literal["auto"] | int) -> None:
    """It turns no velocity round, though modes swing more than once between kicks."""
    system = replace(strip(damping=0.0, gravity=0.0), damping=damping)
    start = 1e-3 * np.random.default_rng(3).standard_normal(system.fabric.position.shape)
    start[system.fabric.pinned] = 0.0
    system = replace(system, fabric=replace(system.fabric, velocity=start))
    dt = 0.7 * Respa().limit(RespaConfig(), system, State(system.fabric.position, start)).dt
    speed = end(system, Respa(), RespaConfig(every=every), 5000, 5000 * dt)[1]
    assert np.abs(speed).max() < np.abs(start).max()


def test_what_rests_on_a_damped_support_does_not_stir() -> None:
    """Its weight and what bears it are one kick; the support's damping would feel any fall in between."""
    support, rate = 1000.0**2, 1000.0
    sag = 9.81 / support
    system = strip(damping=0.02)
    lying = replace(system.fabric, pinned=np.zeros(system.fabric.number, np.bool_))

    def bear(x: Float, v: Float, t: float, out: Float) -> None:
        out[:, 1] -= MASS * (support * x[:, 1] + rate * v[:, 1])

    start = lying.position - [0.0, sag, 0.0]
    system = replace(system, fabric=replace(lying, position=start), terms=(Term("support", bear, support, rate),))
    x, v = end(system, Respa(), RespaConfig(every=4), 400, 0.04)
    assert np.abs(v).max() < 1e-9
    assert np.abs(x - start).max() < 1e-12


def folded(bend: float, thickness: float = 4e-3) -> System:
    """The strip above itself, half as far as cloth contact reaches; without gravity and undamped, but for springs."""
    one = strip(damping=0.05, bend=bend, gravity=0.0)
    n, fabric = one.fabric.number, one.fabric
    assert fabric.springs is not None and fabric.hinges is not None
    pairs, quads = fabric.springs.pairs(), fabric.hinges.quads()
    pairs, quads = np.concatenate([pairs, pairs + np.int32(n)]), np.concatenate([quads, quads + np.int32(n)])
    alike, rest = np.ones(len(quads), np.int32), np.tile(fabric.springs.rest, 2)
    faces = np.unique(np.sort(np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 1, 3]]]), axis=1), axis=0)
    both = make_fabric(
        np.concatenate([fabric.position, fabric.position + np.array([0.0, 0.5 * thickness, 0.0])]),
        Springs.from_pairs(pairs, 0.0 * rest + STIFF, rest, 0.0 * rest + 0.05),
        Hinges(quads, alike, alike, np.full(len(quads), bend), np.zeros(len(quads))),
        MASS,
        np.tile(fabric.pinned, 2),
    )
    both = replace(both, faces=faces.astype(np.int32))
    objects = {"under": np.arange(n, dtype=np.int32), "over": np.arange(n, 2 * n, dtype=np.int32)}
    config = OffsetConfig(thickness=thickness, friction=0.0, damping=0.0)
    contact = Offset().prepare(config, both, objects, True, one.gravity)
    return replace(make_system(both, one.gravity, 0.0), terms=(contact,))


def test_bending_that_is_faster_than_contact_acts_in_every_step() -> None:
    """Contact is then found as seldom as by itself; where it is slower, or there is none, bending is a kick."""
    for bend, always in ((2e-2, True), (1e-5, False)):
        system = folded(bend)
        (contact,) = system.terms
        division, alone = divide(system), divide(replace(system, terms=()))
        assert ("hinges" in division.always) is always and "hinges" not in alone.always
        assert not always or division.slow[0] == pytest.approx(np.sqrt(contact.omega_squared), rel=1e-6)
        fast, slow = both_rates(system, State(system.fabric.position, system.fabric.velocity))
        dt = 0.7 * Respa().limit(RespaConfig(), system, State(system.fabric.position, system.fabric.velocity)).dt
        kicks = division.steps_a_kick(dt, dt)
        assert kicks > steps_a_kick(fast, slow, dt) if always else kicks == steps_a_kick(fast, slow, dt)


@pytest.mark.parametrize("slow", [2000.0, 4000.0])
def test_kicks_that_feed_swings_of_stretched_cloth_are_told_by_their_matrix(slow: float) -> None:
    """As by the eigenvalues of modes up to the greatest that such cloth has, undamped."""
    fast, told = 21_500.0, []
    for span in np.linspace(1e-4, 6e-4, 40):
        told.append(feeds_stretched(fast, slow, span))
        assert told[-1] == feeds((np.sqrt(STRETCHED) * fast, 0.0), (slow, 0.0), span)
    assert 0 < sum(told) < len(told)


@pytest.mark.parametrize("bend", [1e-3, 1e-2, 3e-2])
def test_kicks_of_contact_feed_no_bending(bend: float) -> None:
    """Of two strips that contact pushes apart, and keeps apart where they are held: bending has no damping."""
    system = folded(bend)
    state, plugin = State(system.fabric.position.copy(), system.fabric.velocity.copy()), Respa()
    dt = 0.7 * plugin.limit(RespaConfig(), system, state).dt
    kicks, (_, slow), (contact,) = (
        plugin.steps_a_kick(RespaConfig(), system, dt, dt),
        both_rates(system, state),
        system.terms,
    )
    # They come at least twice as often as would meet a mode of bending alone.
    assert 1 < kicks <= 0.5 * np.pi / np.sqrt(slow[0] ** 2 - contact.omega_squared) / dt
    memory = plugin.prepare(RespaConfig(), system, state)
    energy = []
    for _ in range(40):
        report = plugin.advance(system, state, memory, None, 250, dt)
        assert report.status == "ok"
        energy.append(sum(report.energy.values()))
    assert max(energy) < 1.001 * energy[0], energy


@pytest.mark.parametrize("bend", [1e-4, 3e-4, 1e-3])
def test_kicks_of_bending_between_those_of_contact_feed_neither(bend: float) -> None:
    """Bending kicks more seldom than contact, neither is damped; three times as seldom, kicks feed it."""
    system, plugin, config = folded(bend), Respa(), RespaConfig()
    dt = 0.7 * plugin.limit(config, system, at_start(system)).dt
    division = divide(system)
    kicks = division.steps_a_kick(dt, dt)
    seldom = division.steps_a_soft_kick(dt, dt, kicks)
    assert seldom >= 2 * kicks and seldom % kicks == 0

    def grown(every: int) -> float:
        state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
        memory = plugin.prepare(config, system, state)
        work: Any = memory.work
        work.dt, work.kicks, work.soft_kicks = dt, kicks, every
        reports = [plugin.advance(system, state, memory, None, 504, dt) for _ in range(20)]
        energy = [sum(report.energy.values()) for report in reports]
        return max(energy) / energy[0]

    assert grown(seldom) < 1.001
    assert bend < 1e-3 or grown(3 * seldom) > 1.1


@pytest.mark.parametrize("every", [0, -1, 1.5, "often"])
def test_kicks_stand_for_whole_steps(every: object) -> None:
    with pytest.raises(ValidationError):
        RespaConfig.model_validate({"every": every})


def test_rates_are_told_apart() -> None:
    """Tension's without bending, and bending's without tension."""
    system = strip(damping=0.05)
    state = State(system.fabric.position, system.fabric.velocity)
    fast, slow = both_rates(system, state)
    softer = both_rates(replace(system, fabric=replace(system.fabric, hinges=replace(
        system.fabric.hinges, k=system.fabric.hinges.k / 4.0))), state)  # type: ignore[type-var, union-attr]  # fmt: skip
    assert softer[0] == fast
    assert abs(softer[1][0] / slow[0] - 0.5) < 0.02


@pytest.mark.quick(name=["respa"])
@pytest.mark.parametrize("name", sorted(point.name for point in entry_points(group="nuno.integrators")))
def test_no_solver_moves_otherwise_where_its_loop_is_interpreted(name: str) -> None:
    """As a force in Python has it: what compiled code alone can call would do nothing."""
    system, plugin = strip(damping=0.02), registry.load("nuno.integrators", name)
    idle = replace(system, terms=(Term("idle", lambda x, v, t, out: None),))
    plain, other = (end(each, plugin, plugin.Config(), 20, 1e-3) for each in (system, idle))
    assert np.abs(plain - other).max() < 1e-6 * np.abs(plain[1]).max()
