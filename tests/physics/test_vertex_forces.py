"""Forces on each vertex alone: their time against a closed form, their energy and what they are said to depend on."""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from nets import NO_GRAVITY, make_fabric, make_system, run, start

from nuno_integrators.explicit.adaptive import Dopri5
from nuno_integrators.explicit.fixed_step import Leapfrog, SymplecticEuler
from nuno_integrators.explicit.respa import Respa
from nuno_integrators.explicit.runge_kutta import RK4
from nuno_integrators.implicit.plugin import ImplicitEuler
from nuno_kernels import kernel
from nuno_kernels.forces.vertex import vertex_force
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import kernels_of, register
from nuno_schemas.fabric import Float, State
from nuno_schemas.system import System, Term

Triple = tuple[float, float, float]


@vertex_force("gust")
class Gust(NamedTuple):
    """A force along x that swings with the time."""

    strength: float
    rate: float

    def force(self, t: float) -> Triple:
        return self.strength * math.cos(self.rate * t), 0.0, 0.0


@vertex_force("pull")
class Pull(NamedTuple):
    """A damped spring of length 0 from each vertex to one place."""

    centre: Annotated[Float, 3]
    stiffness: float

    def force(self, v: Triple, x: Triple) -> Triple:
        c, k = self.centre, self.stiffness
        return k * (c[0] - x[0] - v[0]), k * (c[1] - x[1] - v[1]), k * (c[2] - x[2] - v[2])

    def energy(self, x: Triple) -> float:
        c = self.centre
        return 0.5 * self.stiffness * ((c[0] - x[0]) ** 2 + (c[1] - x[1]) ** 2 + (c[2] - x[2]) ** 2)


class Blocks(NamedTuple):
    """The same, by a kernel over blocks."""

    centre: Annotated[Float, 3]
    stiffness: float


@kernel
def add_pull(pull: Blocks, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    for c in range(min(BLOCK, x.shape[1] - origin)):
        for row in range(3):
            force[row, c] += pull.stiffness * (pull.centre[row] - x[row, origin + c] - v[row, origin + c])


register(Blocks, name="blocks", reads_velocity=lambda pull: True, block=add_pull)

FRAMES, RATE, MASS, STRENGTH = 4, 9.0, 0.5, 3.0


def forced(term: Any, number: int = 2) -> System:
    x = np.random.default_rng(3).standard_normal((number, 3))
    return make_system(make_fabric(x, mass=MASS), NO_GRAVITY, terms=(Term("force", (term,)),))


@pytest.mark.quick(plugin=["symplectic_euler", "leapfrog", "rk4"])
@pytest.mark.parametrize(
    ("plugin", "config", "steps"),
    [
        (SymplecticEuler(), {}, (40, 80, 160)),
        (Leapfrog(), {}, (20, 40, 80)),
        (RK4(), {}, (4, 8, 16)),
        (Respa(), {"every": 2}, (20, 40, 80)),
        (Dopri5(), {"tolerance": 1.0}, (2, 4, 8)),
        (ImplicitEuler(), {"residual": 1e-12}, (40, 80, 160)),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_force_of_the_time_moves_a_free_vertex_as_the_closed_form(plugin: Any, config: Any, steps: Any) -> None:
    """m x'' = F cos(w t): x = F / (m w^2) (1 - cos w t), to the method's order; kicks of respa are of order 2 here."""
    errors = []
    for count in steps:
        system = forced(Gust(STRENGTH, RATE))
        state = start(system)
        memory = plugin.prepare(plugin.Config(**config), system, state)
        for _ in range(FRAMES):
            assert plugin.advance(system, state, memory, None, count, 1.0 / FRAMES / count).status == "ok"
        moved = state.x - system.fabric.position
        errors.append(np.abs(moved[:, 0] - STRENGTH / (MASS * RATE**2) * (1.0 - math.cos(RATE))).max())
        assert not moved[:, 1:].any()
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order > plugin.order - 0.15
    assert not memory.timeless


def test_a_force_is_what_it_takes() -> None:
    gust, pull = kernels_of(Gust(1.0, 1.0)), kernels_of(Pull(np.zeros(3), 1.0))
    assert gust.reads_time and not gust.reads_velocity(None)
    assert pull.reads_velocity(None) and not pull.reads_time
    with pytest.raises(TypeError, match="takes y: there are x, v, t"):
        vertex_force("wrong")(type("Wrong", (), {"force": lambda self, y: y}))


def test_it_gives_the_bits_of_a_kernel_over_blocks_and_its_energy() -> None:
    ends = []
    for kind in (Pull, Blocks):
        system = forced(kind(np.array([0.1, 0.2, 0.3]), 2.0), BLOCK + 100)
        state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
        report = run(Leapfrog(), system, state, 10, 1e-2)
        ends.append(state.x.tobytes() + state.v.tobytes())
        if kind is Pull:
            away = state.x - np.array([0.1, 0.2, 0.3])
            assert abs(report.energy["pull"] - (away * away).sum()) < 1e-12 * (away * away).sum()
    assert ends[0] == ends[1]
