"""The contract of forces, tested on a sheet without springs with nuno's own solvers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nuno.plugin_contract import registry
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System
from nuno_testing.subject import Subject, made_twice

BUILT_IN = {"kinetic", "gravitational", "springs", "hinges"}
FEW, MANY = 6, 66
"""Vertices along a side of the sheet; with MANY a solver uses several threads."""


def sheet(side: int) -> Fabric:
    """Return an uneven square of side x side vertices, 1 m wide, without springs."""
    axis = np.linspace(0.0, 1.0, side)
    x = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.zeros((side, side))], axis=-1).reshape(-1, 3)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    halves = [
        np.stack([corner, corner + side, corner + side + 1], 1),
        np.stack([corner, corner + side + 1, corner + 1], 1),
    ]
    x += 0.1 / side * np.random.default_rng(1).standard_normal(x.shape)
    mass = np.full(len(x), 0.3 / len(x))
    return Fabric("sheet", x, np.zeros_like(x), mass, mass == 0.0, np.concatenate(halves).astype(np.int32))


class Probe:
    """A single force prepared for a sheet, evaluated by a solver."""

    def __init__(self, subject: Subject, side: int = FEW, solver: str = "symplectic_euler", threads: int = 1) -> None:
        self.fabric = sheet(side)
        term = subject.plugin.prepare(subject.config, self.fabric, 0)
        self.system = System(self.fabric, np.zeros(3), 0.0, (term,), threads)
        self.solver = registry.load("nuno.integrators", solver)
        fields = {"residual": 1e-9} if "residual" in self.solver.Config.model_fields else {}
        self.config, self.start = self.solver.Config(**fields), State(self.fabric.position.copy(), self.fabric.velocity)

    def memory(self) -> Any:
        return self.solver.prepare(self.config, self.system, self.start)

    def forces(self, x: Float, v: Float) -> Float:
        """Return the forces (n, 3) [N] at x, v (n, 3)."""
        forces = self.solver.forces(self.system, State(x.copy(), v.copy()), self.memory(), None)
        newtons: Float = forces.acceleration * self.fabric.mass[:, None]
        return newtons

    def energy(self, x: Float) -> float | None:
        """Return the energy [J] at x (n, 3), None for a force without energy."""
        report = self.solver.advance(self.system, State(x.copy(), 0.0 * x), self.memory(), None, 0, 0.0)
        energies = [joules for kind, joules in report.energy.items() if kind not in BUILT_IN]
        return sum(energies) if energies else None

    def advance(self, v: Float, dt: float, *frames: int) -> tuple[State, list[Any]]:
        """Return the state after frames of these numbers of steps from velocities v (n, 3), and the reports."""
        state = State(self.start.x.copy(), v.copy())
        return state, [self.solver.advance(self.system, state, self.memory(), None, n, dt) for n in frames]


def random_state(probe: Probe) -> tuple[Float, Float]:
    """Return random positions and velocities."""
    rng, x = np.random.default_rng(7), probe.fabric.position
    return x + 0.02 * rng.standard_normal(x.shape), rng.standard_normal(x.shape)


def the_same_state_is_pushed_alike(subject: Subject) -> None:
    """Prepared and evaluated twice, also on another thread, the force is the same; its arguments are not changed."""
    x, v = random_state(Probe(subject))
    forces = made_twice(lambda: Probe(subject).forces(x, v), x, v)
    assert np.isfinite(forces).all()


def it_is_the_downhill_slope_of_its_energy(subject: Subject) -> None:
    """The central difference of its energy along random directions is minus the work of the force.

    A force without energy passes.
    """
    probe = Probe(subject)
    x, _ = random_state(probe)
    if probe.energy(x) is None:
        return
    force, step = probe.forces(x, 0.0 * x), 1e-5
    for seed in range(4):
        d = np.random.default_rng(seed).standard_normal(x.shape)
        difference = (probe.energy(x + step * d) - probe.energy(x - step * d)) / (2.0 * step)  # type: ignore[operator]
        assert abs(difference + (force * d).sum()) < 1e-6 * np.abs(force * d).sum() + 1e-12


def frames_cut_anywhere_end_in_the_same_bytes(subject: Subject) -> None:
    """So does leapfrog, which keeps an acceleration for the next step unless a force declares to read velocities."""
    probe = Probe(subject, solver="leapfrog")
    _, v = random_state(probe)
    (whole, _), (cut, _) = probe.advance(v, 1e-3, 4), probe.advance(v, 1e-3, 1, 3)
    assert (whole.x.tobytes(), whole.v.tobytes()) == (cut.x.tobytes(), cut.v.tobytes())


def an_implicit_step_ends_where_its_equation_says(subject: Subject) -> None:
    """The equation of backward Euler holds: m (v1 - v0) / h is the force at the end, by an explicit solver."""
    explicit, probe = Probe(subject), Probe(subject, solver="implicit_euler")
    rates = explicit.solver.limit(explicit.config, explicit.system, explicit.start)
    h = 0.5 / max(rates.omega, rates.damping, 50.0)
    _, v = random_state(probe)
    end, (report,) = probe.advance(v, h, 1)
    assert report.status == "ok"
    assert report.totals["halvings"] == 0
    inertia, force = probe.fabric.mass[:, None] * (end.v - v) / h, explicit.forces(end.x, end.v)
    assert np.abs(inertia - force).max() < 1e-6 * np.abs(force).max() + 1e-12


def any_number_of_threads_gives_the_same_bits(subject: Subject) -> None:
    """One and two threads give the same bits on a sheet large enough for two."""
    one, two = (Probe(subject, MANY, threads=threads) for threads in (1, 2))
    if not two.solver.about(two.system).startswith("2 threads"):
        pytest.skip("one thread is all there is")
    x, v = random_state(one)
    assert one.forces(x, v).tobytes() == two.forces(x, v).tobytes()


FORCES = (
    the_same_state_is_pushed_alike,
    it_is_the_downhill_slope_of_its_energy,
    frames_cut_anywhere_end_in_the_same_bytes,
    an_implicit_step_ends_where_its_equation_says,
    any_number_of_threads_gives_the_same_bits,
)
