"""Tension at two rates: what acts in every second step is twice as strong, and feeds nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nets import make_fabric, make_system

from nuno_integrators.explicit import respa
from nuno_integrators.explicit import two_rates as module
from nuno_integrators.explicit.fixed_step import NoConfig, SymplecticEuler
from nuno_integrators.explicit.respa import Respa, RespaConfig, at_start, divide
from nuno_integrators.explicit.two_rates import two_rates
from nuno_integrators.packing import pack
from nuno_kernels.step.acceleration import evaluate
from nuno_schemas.fabric import Float, Springs, State
from nuno_schemas.system import System, Term

EDGE = 0.02


def sheet(light: float, damping: float = 0.0, per_run: bool = False, locks: bool = False) -> System:
    """A net, held at one side, some of whose columns have lighter vertices; a weak pull towards a floor on all."""
    rows, columns = 9, 40
    k, i = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    x = EDGE * np.stack([i.ravel(), 0.1 * np.sin(i.ravel() + k.ravel()), k.ravel()], axis=1)
    at = np.arange(rows * columns).reshape(rows, columns)
    if per_run:
        first = np.concatenate([at[:, :2], np.stack([at[:-1, 0], at[1:, 0]], axis=1)]).astype(np.int32)
        count = np.concatenate([np.full(rows, columns - 1), np.full(rows - 1, columns)]).astype(np.int32)
        one = np.ones(len(first))
        stiff = np.where(np.arange(len(first)) < 3, 4000.0, 400.0)
        springs = Springs(
            first, count, one.astype(np.int32), stiff, EDGE * one, damping * one, np.zeros(len(first), np.int8)
        )
    else:
        pairs = np.concatenate([np.stack([at[:, :-1].ravel(), at[:, 1:].ravel()], axis=1),
                                np.stack([at[:-1].ravel(), at[1:].ravel()], axis=1)])  # fmt: skip
        rest = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
        stiff = np.full(len(pairs), 400.0)
        lock = (np.full(len(pairs), 1e-3), 2.0 * stiff) if locks else (None, None)
        springs = Springs.from_pairs(pairs, stiff, rest, np.full(len(pairs), damping), 0, *lock)
    mass = np.where((i.ravel() >= 10) & (i.ravel() < 16), light, 1.0) * 2e-4
    fabric = replace(make_fabric(x, springs, None, 2e-4, k.ravel() == 0), mass=mass)

    def bear(x: Float, v: Float, t: float, out: Float) -> None:
        out -= 0.05 * (x - fabric.position)

    system = make_system(fabric, np.array([0.0, -9.81, 0.0]), 0.0)
    return replace(system, terms=(Term("support", bear, 0.05 / mass.min(), 0.0),))


def run(system: System, plugin: Any, config: object, steps: int, duration: float) -> State:
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    memory = plugin.prepare(config, system, state)
    report = plugin.advance(system, state, memory, None, steps, duration / steps)
    assert report.status == "ok"
    return state


@pytest.mark.parametrize(
    ("per_run", "locks", "damping"), [(False, False, 0.0), (False, True, 0.01), (True, False, 0.02)]
)
def test_two_steps_have_the_tension_of_two(per_run: bool, locks: bool, damping: float) -> None:
    """Wherever vertices are, however fast, also beyond what locks springs."""
    system = sheet(0.03, damping, per_run, locks)
    rng = np.random.default_rng(0)
    packed = pack(replace(system, terms=()))
    rates = two_rates(system, packed, at_start(system), lambda fast, slow: True)
    assert rates is not None
    n = system.fabric.number
    x = np.ascontiguousarray((system.fabric.position + rng.normal(0.0, 2e-3, (n, 3))).T)
    v, found = rng.normal(0.0, 1.0, (3, n)), []
    for one in (packed, *rates.parts(packed)):
        found.append(np.empty_like(x))
        evaluate(x, v, 0.0, found[-1], one._replace(gravity=np.zeros(3)))
    whole, twice, quick = found
    assert np.abs(twice + quick - 2.0 * whole).max() < 1e-12 * np.abs(whole).max()
    assert np.abs(quick).max() > 0.0 and np.abs(quick - whole).max() > 1e-3 * np.abs(whole).max()


def test_even_springs_act_at_one_rate() -> None:
    system = sheet(1.0)
    assert two_rates(system, pack(system), at_start(system), lambda fast, slow: True) is None


def grown(system: System, frames: int = 20) -> float:
    """The greatest energy [J] at the end of any thousand steps, over what gravity and the start had to give."""
    plugin, config, fabric = Respa(), RespaConfig(), system.fabric
    dt = 0.7 * plugin.limit(config, system, at_start(system)).dt
    state = State(fabric.position.copy(), fabric.velocity.copy())
    memory, most = plugin.prepare(config, system, state), 0.0
    work: Any = memory.work
    assert work.rates is not None
    for _ in range(frames):
        report = plugin.advance(system, state, memory, None, 1000, dt)
        if report.status != "ok":
            return np.inf
        support = 0.025 * float(((state.x - fabric.position) ** 2).sum())
        inner = sum(value for name, value in report.energy.items() if name != "gravitational") + support
        fallen = float(fabric.mass[~fabric.pinned] @ ((state.x - fabric.position)[~fabric.pinned] @ system.gravity))
        most = max(most, inner - fallen)
    return most / float(fabric.mass.sum() * 9.81 * EDGE)


@pytest.mark.parametrize("light", [0.03, 0.1])
def test_slower_springs_feed_nothing(light: float) -> None:
    """Undamped, for 20,000 steps."""
    assert grown(sheet(light)) < 0.02


def test_springs_that_would_feed_the_others_act_with_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are refused; taken all the same, they add energy without end."""
    system = sheet(0.5)
    monkeypatch.setattr(module, "SHARES", (0.6,))
    packed, division = pack(system), divide(system)
    assert two_rates(system, packed, at_start(system), division.bears) is None
    assert two_rates(system, packed, at_start(system), lambda fast, slow: True) is not None
    monkeypatch.setattr(respa.Division, "bears", lambda self, fast, slow: True)
    assert grown(system) > 1.0


def test_the_error_falls_with_the_step() -> None:
    """Against symplectic Euler at steps a sixteenth as long: to half, or less."""
    system, duration = sheet(0.03, 0.01), 0.05
    fewest = int(np.ceil(duration / (0.7 * Respa().limit(RespaConfig(), system, at_start(system)).dt)))
    true = run(system, SymplecticEuler(), NoConfig(), 16 * fewest, duration).x
    errors = [np.abs(run(system, Respa(), RespaConfig(), n * fewest, duration).x - true).max() for n in (1, 2, 4)]
    assert errors[1] < 0.65 * errors[0] and errors[2] < 0.65 * errors[1], errors
