"""XPBD: springs, hinges and contact as compliant constraints, swept over in small steps.

A step is backward Euler's, solved not by Newton's method but by a fixed number of Gauss-Seidel sweeps
(Macklin, Mueller & Chentanez 2016; "small steps": Macklin et al. 2019, SCA, 2:1-2:7). It is stable at any
step and costs about what an explicit one does, but is softer than the fabric where the sweeps do not
reach: in a chain under tension each sweep takes over 1/(1 + z) of what a spring still lacks, z = (omega h / 2)^2,
so that a share (z / (1 + z))^sweeps is missing at the end.
One constraint is solved exactly, hence the amplification is backward Euler's; a warm start with the last
step's tensions would make rest exact as well, but a force that lags behind grows stiff modes.

Viscous damping is part of the mass, m (1 + h damping), and so is solved exactly. Forces whose type has no
role `constraints` (nuno_kernels.terms), as wind, the bending of meshes and its friction, and those in Python act as
at the step's start, and limit the step as they do in symplectic Euler.

Weighed: Newton's XPBD on Warp, in single precision: `nuno bench peers` finds it accurate at no setting of the stiff
sheet, on which `nuno bench speed stiff` measures this one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from nuno_integrators.compiled import Compiled, StepResult, Work, lacking
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_integrators.packing import silence, silence_bodies
from nuno_integrators.stability import measure_rates, stable_step
from nuno_kernels import block_kernel, kernel, shared_source
from nuno_kernels.forces.constraints import Constraints, clear, forget, pack_constraints, sweep
from nuno_kernels.step.acceleration import Packed, commit, evaluate
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import Displaced, Terms, call_each, each, kernels_of, over_blocks
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.plugin import Config
from nuno_schemas.system import StepLimit, System

# The phases of an XPBD step: free displacement, sweeps over constraints and contact, new state.

carry = each("carry", "moved, s")
project = each("project", "moved, s, held, threads")


@block_kernel
def predict_block(
    block: int, v: Float, u: Float, a: Float | None, mobility: Float, inverse_mass: Float, gravity: Float,
    damping: float, dt: float,
) -> None:  # fmt: skip
    """Displacement u without constraints, and mobility h^2 / (m (1 + h damping)), on a block's vertices.

    `a` (3, n) holds gravity and explicit forces, or is None. Pinned vertices move at their velocity.
    """
    low, high = block * BLOCK, min((block + 1) * BLOCK, u.shape[1])
    slowing = 1.0 / (1.0 + dt * damping)
    for i in range(np.uint64(low), np.uint64(high)):
        mobility[0, i] = dt * dt * slowing * inverse_mass[i]
    for row in range(3):
        g = gravity[row]
        for i in range(np.uint64(low), np.uint64(high)):
            pull = g if a is None else a[row, i]
            free = slowing * (dt * v[row, i] + dt * dt * pull)
            u[row, i] = free if inverse_mass[i] > 0.0 else dt * v[row, i]


@block_kernel
def arrive_block(block: int, x: Float, v: Float, u: Float, inverse_step: float) -> None:
    """x += u and v = u / h on a block's vertices."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, u.shape[1])
    for row in range(3):
        for i in range(np.uint64(low), np.uint64(high)):
            x[row, i] += u[row, i]
            v[row, i] = u[row, i] * inverse_step


predict_blocks = over_blocks(predict_block, "v, u, a, mobility, inverse_mass, gravity, damping, dt")
arrive_blocks = over_blocks(arrive_block, "x, v, u, inverse_step")


@kernel
def predict(
    v: Float, u: Float, a: Float | None, mobility: Float, inverse_mass: Float, gravity: Float, damping: float,
    dt: float, threads: int | None,
) -> None:  # fmt: skip
    """Compute u (3, n) and mobility (1, n)."""
    blocks = (u.shape[1] + BLOCK - 1) // BLOCK
    predict_blocks(v, u, a, mobility, inverse_mass, gravity, damping, dt, blocks, threads)


@kernel
def arrive(x: Float, v: Float, u: Float, inverse_step: float, threads: int | None) -> None:
    """Move x, v (3, n) by u."""
    arrive_blocks(x, v, u, inverse_step, (u.shape[1] + BLOCK - 1) // BLOCK, threads)


@shared_source
def evaluate_others(x: Float, v: Float, s: float, a: Float, others: Packed | None) -> None:
    """Acceleration [m/s^2] of the forces without constraint, where there are any."""
    if others is not None:
        evaluate(x, v, s, a, others)


@shared_source
def felt(a: Float, others: Packed | None) -> Float | None:
    """Return the result of `evaluate_others`, None where there is none."""
    return None if others is None else a


class Swept(NamedTuple):
    """Scratch and settings of an XPBD step besides the system."""

    others: Packed | None
    """forces without a constraint, None where there are none"""
    constraints: Constraints
    mobility: Float
    """(1, n) scratch"""
    held: Float | None
    """(3, n) scratch, or None: see nuno_contact.penalty.projection"""
    iterations: int


@kernel
def advance_xpbd(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, own: Swept) -> None:
    """Take `steps` steps of x, v (3, n); stages (4, 3, n) is scratch."""
    c, inverse_step = own.constraints, 1.0 / dt
    moved = Displaced(x, stages[0], stages[1], stages[2], own.mobility, inverse_step)
    for step in range(steps):
        if p.leave[0] != 0:
            break
        evaluate_others(x, v, step / steps, stages[3], own.others)
        force = felt(stages[3], own.others)
        predict(v, moved.u, force, own.mobility, p.inverse_mass, p.gravity, p.damping, dt, p.threads)
        end = (step + 1) / steps
        carry(p.bodies, p.bodies_on, moved, end)
        forget(c.kinds, c.on)
        clear(own.held)
        for _ in range(own.iterations):
            sweep(moved, c, p.threads)
            project(p.bodies, p.bodies_on, moved, end, own.held, p.threads)
        arrive(x, v, moved.u, inverse_step, p.threads)
        commit(x, v, end, p.bodies, p.bodies_on, p.threads)


AT_REST = 1e-9
"""step [s] that stands for 0 where a step's cost is measured: a displacement over no time is no velocity"""


class XPBDConfig(Config):
    """The number of sweeps."""

    iterations: int = Field(1, ge=1, le=100_000, description="sweeps over all constraints in a step")
    residual: float = Field(
        0.1,
        ge=1e-12,
        lt=1,
        description="share of a spring's force that may be missing where `dt: auto` chooses the step",
    )


def unconstrained(fabric: Fabric) -> list[str]:
    """Return the names of a fabric's forces that have no constraint."""
    parts = {"bending": fabric.bending, "bending_friction": fabric.friction}
    return [name for name, part in parts.items() if part is not None]


@dataclass
class XPBDWork(Work):
    """Scratch of the compiled loop, and the last step [s]: (1,), 0 before the first one."""

    own: Swept
    last: Float

    def state_arrays(self) -> dict[str, Float]:
        """Return the step: the forces that bodies are reported to feel depend on it."""
        return {"last_step": self.last}


class XPBD(Compiled):
    """Sweeps over compliant constraints."""

    name: ClassVar[str] = "xpbd"
    Config: ClassVar[type[XPBDConfig]] = XPBDConfig
    order: ClassVar[int] = 1
    explicit: ClassVar[bool] = False

    def make_work(self, config: XPBDConfig, system: System, packed: Packed) -> XPBDWork:
        n, repeated = system.fabric.number, config.iterations > 1
        for term in packed.forces:
            if not kernels_of(term).lags:
                raise BadInput(
                    "xpbd has no constraint for tension that passes along yarns",
                    field="solver.plugin",
                    value=self.name,
                    remedy="use an explicit or implicit solver, or set mu to 0",
                )
        others = None
        if lacking(system.terms, "constraints") or unconstrained(system.fabric):
            solved = (kernels_of(term).name for term in packed.forces if "constraints" in kernels_of(term))
            others = silence_bodies(silence(packed, *solved))._replace(damping=0.0)
        held = np.zeros((3, n)) if repeated and any("project" in kernels_of(term) for term in packed.bodies) else None
        roles, given = packed.bodies.roles, packed.bodies.given
        given = given if held is None else (*given, "held")
        packed = packed._replace(bodies=Terms(packed.bodies, (*roles, "carry", "project"), given))
        own = Swept(others, pack_constraints(packed, repeated), np.empty((1, n)), held, config.iterations)
        return XPBDWork(packed, np.empty((4, 3, n)), own, np.zeros(1))

    def limit(self, config: XPBDConfig, system: System, state: State) -> StepLimit:
        """Return the limit of the forces without a constraint; `resolved` follows from config.residual."""
        omega, damping = measure_rates(system, state)
        explicit = tuple(term for term in system.terms if lacking([term], "constraints"))
        dt = np.inf
        if explicit or unconstrained(system.fabric):
            bare = replace(system.fabric, springs=None, hinges=None, membrane=None)
            rates = measure_rates(replace(system, fabric=bare, terms=explicit, damping=0.0), state)
            dt = stable_step(SymplecticEuler().amplification, *rates, 0.0)
        missing = config.residual ** (1.0 / config.iterations)
        reach = 2.0 * np.sqrt(missing / (1.0 - missing))
        return StepLimit(float(dt), omega, damping, float(reach / omega) if omega > 0.0 else np.inf)

    def about(self, system: System) -> str:
        """Describe the threads, and which forces have no constraint."""
        names = sorted([*lacking(system.terms, "constraints"), *unconstrained(system.fabric)])
        explicit_names = f"; without a constraint, as at the start of each step: {', '.join(names)}" if names else ""
        return super().about(system) + explicit_names

    def go(self, work: XPBDWork, packed: Packed, steps: int, dt: float) -> StepResult:
        call_each(packed, "approach", 1.0 / dt)
        work.last[0] = dt if steps else work.last[0]
        advance_xpbd(work.x, work.v, work.stages, steps, dt, packed, work.own)
        return StepResult(steps, "", {"iterations": steps * work.own.iterations})

    def free_forces(self, system: System, work: XPBDWork, packed: Packed) -> Float | None:
        """Return the forces of a step like the last one, since sweeps end before springs are at their law."""
        slid = np.array(["unbalance" in kernels_of(term) for term in packed.bodies], np.bool_)
        dt = float(work.last[0])
        if not slid.any() or not 0.0 < dt < np.inf:
            return None
        x, v = work.x.copy(), work.v.copy()
        call_each(packed, "approach", 1.0 / dt)
        free = packed._replace(bodies_on=packed.bodies_on & ~slid)
        advance_xpbd(x, v, work.stages, 1, dt, free, work.own)
        call_each(packed, "approach", np.inf)
        return np.asarray(system.fabric.mass[:, None] * (v - work.v).T * (1.0 / dt + packed.damping))

    def steps_of(self, work: XPBDWork) -> Any:
        def at_rest(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed) -> None:
            c, others = work.own.constraints, work.own.others
            if others is not None:
                others = others._replace(forces=p.forces, forces_on=others.forces_on & p.forces_on)
                others = others._replace(bodies=p.bodies, bodies_on=others.bodies_on & p.bodies_on)
            acting = {kernels_of(term).name for term, on in zip(p.forces, p.forces_on, strict=True) if on}
            c = c._replace(on=np.array([kernels_of(kind).name in acting for kind in c.kinds], np.bool_))
            own = work.own._replace(others=others, constraints=c)
            advance_xpbd(x, v, stages, steps, AT_REST, p, own)

        return at_rest
