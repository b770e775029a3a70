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
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from nuno_integrators.compiled import Compiled, Told, Work, lacking, source_of
from nuno_integrators.explicit.symplectic_euler import SymplecticEuler
from nuno_integrators.stability import measure_rates, stable_step
from nuno_integrators.xpbd.step import Swept, advance_xpbd
from nuno_kernels.forces.constraint_packing import pack_constraints
from nuno_kernels.step.acceleration import Extra, Packed
from nuno_kernels.step.packing import call_each, silence, silence_bodies
from nuno_kernels.terms import kernels_of
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.plugin import Config
from nuno_schemas.system import StepLimit, System

AT_REST = 1e-9
"""Step [s] in place of none where a step's cost is measured: a displacement over no time is no velocity."""


class XPBDConfig(Config):
    """How far the sweeps go."""

    iterations: int = Field(1, ge=1, le=100_000, description="sweeps over all constraints in a step")
    residual: float = Field(
        0.1,
        ge=1e-12,
        lt=1,
        description="share of a spring's force that may be missing where `dt: auto` chooses the step",
    )


def unconstrained(fabric: Fabric) -> list[str]:
    """What of a fabric has no constraint."""
    parts = {"bending": fabric.bending, "bending_friction": fabric.friction}
    return [name for name, part in parts.items() if part is not None]


@dataclass
class XPBDWork(Work):
    """What the compiled loop works on, and the last step [s]: (1,), 0 before the first one."""

    own: Swept
    last: Float

    def kept(self) -> dict[str, Float]:
        """The step is part of the state for what bodies are said to feel."""
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
            solved = (kernels_of(term).name for term in packed.forces if kernels_of(term).constraints is not None)
            others = silence_bodies(silence(packed, *solved))._replace(damping=0.0)
        held = np.zeros((3, n)) if repeated and any(kernels_of(term).project for term in packed.bodies) else None
        x, v = np.empty((2, 3, n))
        own = Swept(others, pack_constraints(packed, repeated), np.empty((1, n)), held, config.iterations)
        return XPBDWork(packed, x, v, np.empty((4, 3, n)), own, np.zeros(1))

    def limit(self, config: XPBDConfig, system: System, state: State) -> StepLimit:
        """Only forces without a constraint limit the step; `resolved` follows from config.residual."""
        omega, damping = measure_rates(system, state)
        kept = tuple(term for term in system.terms if lacking([term], "constraints"))
        dt = np.inf
        if kept or unconstrained(system.fabric):
            bare = replace(system.fabric, springs=None, hinges=None, membrane=None)
            rates = measure_rates(replace(system, fabric=bare, terms=kept, damping=0.0), state)
            dt = stable_step(SymplecticEuler().amplification, *rates, 0.0)
        missing = config.residual ** (1.0 / config.iterations)
        reach = 2.0 * np.sqrt(missing / (1.0 - missing))
        return StepLimit(float(dt), omega, damping, float(reach / omega) if omega > 0.0 else np.inf)

    def about(self, system: System) -> str:
        """Threads, and which forces have no constraint."""
        names = sorted([*lacking(system.terms, "constraints"), *unconstrained(system.fabric)])
        told = f"; without a constraint, as at the start of each step: {', '.join(names)}" if names else ""
        return super().about(system) + told

    def go(self, work: XPBDWork, packed: Packed, extra: Extra, steps: int, dt: float) -> Told:
        call_each(packed, "approach", 1.0 / dt)
        work.last[0] = dt if steps else work.last[0]
        source_of(advance_xpbd, extra)(work.x, work.v, work.stages, steps, dt, packed, extra, work.own)
        return Told(steps, "", {"iterations": steps * work.own.iterations})

    def free_forces(self, system: System, work: XPBDWork, packed: Packed, extra: Extra) -> Float | None:
        """By a step like the last one: sweeps end before springs are at their law. A step takes damping at its end."""
        slid = np.array([kernels_of(term).unbalance is not None for term in packed.bodies], np.bool_)
        dt = float(work.last[0])
        if not slid.any() or not 0.0 < dt < np.inf:
            return None
        x, v = work.x.copy(), work.v.copy()
        call_each(packed, "approach", 1.0 / dt)
        free = packed._replace(bodies_on=packed.bodies_on & ~slid)
        source_of(advance_xpbd, extra)(x, v, work.stages, 1, dt, free, extra, work.own)
        call_each(packed, "approach", np.inf)
        return np.asarray(system.fabric.mass[:, None] * (v - work.v).T * (1.0 / dt + packed.damping))

    def compile(self, work: XPBDWork, packed: Packed, extra: Extra) -> None:
        self.go(work, packed, extra, 0, 1.0)

    def step_at_rest(self, work: XPBDWork, extra: Extra) -> Any:
        def at_rest(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, force: Extra) -> None:
            c, others = work.own.constraints, work.own.others
            if others is not None:
                others = others._replace(forces=p.forces, forces_on=others.forces_on & p.forces_on)
                others = others._replace(bodies=p.bodies, bodies_on=others.bodies_on & p.bodies_on)
            acting = {kernels_of(term).name for term, on in zip(p.forces, p.forces_on, strict=True) if on}
            c = c._replace(on=np.array([kernels_of(kind).name in acting for kind in c.kinds], np.bool_))
            own = work.own._replace(others=others, constraints=c)
            source_of(advance_xpbd, force)(x, v, stages, steps, AT_REST, p, force, own)

        return at_rest

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        """(2, 2) matrix of one step on x'' = -omega^2 x - damping x', state (x, v): backward Euler's.

        With m' = m (1 + h damping) the displacement without the spring is h v / (1 + h damping); the spring's
        tension after one sweep is k |x + h v / (1 + h damping)| / (1 + k h^2 / m'), and a second finds
        nothing missing. Put together, (1 + h damping + omega^2 h^2) v' = v - omega^2 h x and x' = x + h v'.
        """
        return np.asarray(np.linalg.inv(np.array([[1.0, -dt], [omega * omega * dt, 1.0 + damping * dt]])))
