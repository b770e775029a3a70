"""What forces owe: measured on a sheet without springs, through solvers that come with nuno."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nuno import registry
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System
from nuno_testing.subject import Subject, made_twice

BUILT_IN = {"kinetic", "gravitational", "springs", "hinges"}
FEW, MANY = 6, 66
"""Vertices along the sheet; with many of them a solver uses several threads."""


def sheet(side: int) -> Fabric:
    """An uneven square of side x side vertices, 1 m wide, that nothing holds together."""
    place = np.linspace(0.0, 1.0, side)
    x = np.stack([*np.meshgrid(place, place, indexing="ij"), np.zeros((side, side))], axis=-1).reshape(-1, 3)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    halves = [
        np.stack([corner, corner + side, corner + side + 1], 1),
        np.stack([corner, corner + side + 1, corner + 1], 1),
    ]
    x += 0.1 / side * np.random.default_rng(1).standard_normal(x.shape)
    mass = np.full(len(x), 0.3 / len(x))
    return Fabric("sheet", x, np.zeros_like(x), mass, mass == 0.0, np.concatenate(halves).astype(np.int32))


class Measured:
    """A force by itself: prepared for a sheet, and what a solver makes of it."""

    def __init__(self, subject: Subject, side: int = FEW, solver: str = "symplectic_euler", threads: int = 1) -> None:
        self.fabric = sheet(side)
        term = subject.plugin.prepare(subject.config, self.fabric, 0)
        self.system = System(self.fabric, np.zeros(3), 0.0, (term,), threads)
        self.solver = registry.load("nuno.integrators", solver)
        named = {"residual": 1e-9} if "residual" in self.solver.Config.model_fields else {}
        self.config, self.start = self.solver.Config(**named), State(self.fabric.position.copy(), self.fabric.velocity)

    def memory(self) -> Any:
        return self.solver.prepare(self.config, self.system, self.start)

    def forces(self, x: Float, v: Float) -> Float:
        """(n, 3) [N] at x, v (n, 3)."""
        found = self.solver.forces(self.system, State(x.copy(), v.copy()), self.memory(), None)
        newtons: Float = found.acceleration * self.fabric.mass[:, None]
        return newtons

    def energy(self, x: Float) -> float | None:
        """Energy [J] at x (n, 3), None for a force that has none."""
        report = self.solver.advance(self.system, State(x.copy(), 0.0 * x), self.memory(), None, 0, 0.0)
        own = [joules for kind, joules in report.energy.items() if kind not in BUILT_IN]
        return sum(own) if own else None

    def advance(self, v: Float, dt: float, *frames: int) -> tuple[State, list[Any]]:
        """The state after frames of so many steps from a start at v (n, 3), and the reports."""
        state = State(self.start.x.copy(), v.copy())
        return state, [self.solver.advance(self.system, state, self.memory(), None, n, dt) for n in frames]


def state_of(measured: Measured) -> tuple[Float, Float]:
    """Positions and velocities in disorder."""
    rng, x = np.random.default_rng(7), measured.fabric.position
    return x + 0.02 * rng.standard_normal(x.shape), rng.standard_normal(x.shape)


def the_same_state_is_pushed_alike(subject: Subject) -> None:
    """Prepared and asked again, also on another thread; what it is given is left alone."""
    x, v = state_of(Measured(subject))
    found = made_twice(lambda: Measured(subject).forces(x, v), x, v)
    assert np.isfinite(found).all()


def it_is_the_downhill_slope_of_its_energy(subject: Subject) -> None:
    """Its energy's central difference along random directions is minus the work that the force does.

    A force without energy promises none.
    """
    measured = Measured(subject)
    x, _ = state_of(measured)
    if measured.energy(x) is None:
        return
    force, step = measured.forces(x, 0.0 * x), 1e-5
    for seed in range(4):
        d = np.random.default_rng(seed).standard_normal(x.shape)
        difference = (measured.energy(x + step * d) - measured.energy(x - step * d)) / (2.0 * step)  # type: ignore[operator]
        assert abs(difference + (force * d).sum()) < 1e-6 * np.abs(force * d).sum() + 1e-12


def frames_cut_anywhere_end_in_the_same_bytes(subject: Subject) -> None:
    """With leapfrog, which keeps an acceleration for the next step unless a force says that it reads velocities."""
    measured = Measured(subject, solver="leapfrog")
    _, v = state_of(measured)
    (whole, _), (cut, _) = measured.advance(v, 1e-3, 4), measured.advance(v, 1e-3, 1, 3)
    assert (whole.x.tobytes(), whole.v.tobytes()) == (cut.x.tobytes(), cut.v.tobytes())


def an_implicit_step_ends_where_its_equation_says(subject: Subject) -> None:
    """Backward Euler's: m (v1 - v0) / h is the force at the end, which an explicit solver is asked for."""
    explicit, measured = Measured(subject), Measured(subject, solver="implicit_euler")
    rates = explicit.solver.limit(explicit.config, explicit.system, explicit.start)
    h = 0.5 / max(rates.omega, rates.damping, 50.0)
    _, v = state_of(measured)
    end, (report,) = measured.advance(v, h, 1)
    assert report.status == "ok"
    assert report.totals["halvings"] == 0
    inertia, force = measured.fabric.mass[:, None] * (end.v - v) / h, explicit.forces(end.x, end.v)
    assert np.abs(inertia - force).max() < 1e-6 * np.abs(force).max() + 1e-12


def any_number_of_threads_gives_the_same_bits(subject: Subject) -> None:
    """On a sheet large enough for two."""
    one, two = (Measured(subject, MANY, threads=threads) for threads in (1, 2))
    if not two.solver.about(two.system).startswith("2 threads"):
        pytest.skip("one thread is all there is")
    x, v = state_of(one)
    assert one.forces(x, v).tobytes() == two.forces(x, v).tobytes()


FORCES = (
    the_same_state_is_pushed_alike,
    it_is_the_downhill_slope_of_its_energy,
    frames_cut_anywhere_end_in_the_same_bytes,
    an_implicit_step_ends_where_its_equation_says,
    any_number_of_threads_gives_the_same_bits,
)
