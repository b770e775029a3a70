"""r-RESPA: tension in every step of symplectic Euler, contact as kicks every few steps, what is softer as kicks every
few of those. Order 1.

Verlet-I or the reversible reference system propagator (Grubmueller et al. 1991, Mol. Simul. 6, 121-142; Tuckerman,
Berne & Martyna 1992, J. Chem. Phys. 97, 1990-2001). Cloth hardly stretches: what limits an explicit step is tension
alone, whose force is cheap to find. Bending, wind and contact are softer by an order of magnitude or more and cost
several times as much. A kick of theirs is as strong as the steps that it stands for, and cloth is held off itself
and off bodies once for each kick, along the straight way since the last one.

A shorter step takes no more steps to a kick than the step that `dt: auto` takes: both are refined together, or the
error of the kicks would remain whatever the step.

How long a kick may stand for follows from three bounds. Kicks alone are stable, with the share SAFE of the limit left;
they are no farther apart than the share SMOOTH of a radian of the fastest motion that they cause; and they feed no mode
of tension. Kicks of a force with the frequency w_s let a mode w that they meet once in half of its period grow by
w_s^2 H / (2 w) each (its matrix has the trace 2 cos w H - w_s^2 H / w sin w H), against which its damping takes
d H / 2. Springs damp modes in proportion to w^2, so that the slowest such mode, w = pi / H, is the one that has to be
damped enough: w_s^2 / w <= d_max (w / w_max)^2. Undamped, none may be met at all: H w_max <= pi. Together with their
damping, which takes from each mode but shifts its phase, `feeds` looks at all modes.

Kicks go by the velocity just before them. The mean velocity since the last kick would be free of the tremor that kicks
cause themselves, but comes too late for modes that swing within that time, which it drives: half as many steps a kick.
Gravity is a kick for this reason where cloth may rest on a body or on cloth: what does feels one force of contact and
weight, and does not stir. What hangs there stirs instead: at the ends of frames, after half a kick, its velocity is off
by up to g H / 2 and its strain by that over the speed of sound. Elsewhere gravity acts in every step.

Where contact is the stiffest of the kicks, bending, wind and foreign forces that declare no stiffness need not be found
as often as it: they kick at every few of its kicks. Their time follows from the same bounds with their own rates. Cloth
in contact swings on it as on a spring, whose damping may be none: they may meet none of those modes, either.

Bending grows with the fourth power of how small triangles are: beside gathers and short edges it may be faster than
contact, which then would be found in every step for its sake. Where it is, it acts with tension in every step, for a
twentieth of what contact takes. It is not damped, so that kicks may meet none of its modes: they stay so near to each
other that what they meet is twice as fast as it, and its stiffness a quarter of that mode's.

Not chosen: kicks filtered by the fast motion (mollified impulses, Izaguirre et al. 1999), which bear longer times
between kicks, but need the derivatives of positions that they average over.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from nuno_integrators.compiled import Compiled, StepResult, Work
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_integrators.explicit.two_rates import TwoRates, two_rates
from nuno_integrators.explicit.updates import add, average, rejoin
from nuno_integrators.packing import parts, silence
from nuno_integrators.stability import measure_rates, stable_step
from nuno_kernels import kernel
from nuno_kernels.step.acceleration import Packed, add_forces, commit, credit, evaluate, place
from nuno_kernels.step.blocks import copy_rows
from nuno_kernels.terms import kernels_of
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.plugin import Config
from nuno_schemas.system import StepLimit, System, Term

# How many steps of tension one kick of all other forces may stand for.

SAFE, SMOOTH = 0.7, 0.75
"""shares of the stable step, and of a radian"""
MOST, MODES = 64, 200
"""steps for each kick, and modes of tension that are examined"""
STRETCHED, FED = 0.35, 50.0
"""strain up to which kicks of contact feed no swing of cloth across itself, which no spring damps; the rate [1/s] at
which they may, since the strain is another soon: w_s^2 H / (2 pi) where they meet a mode once in half of its period"""
DEAR, SHORTEST = 3.0, 0.5
"""A kick with cloth contact is taken to cost so many steps of tension, and more on bodies of many triangles; a step is
shortened to no less than this share of the safe one for the sake of fewer kicks."""


def steps_a_kick(fast: tuple[float, float], slow: tuple[float, float], dt: float) -> int:
    """Return for how many steps of dt [s] one kick may stand, of forces with the rates (omega, damping) [1/s]."""
    most = max(1, int(min(MOST, longest_kick(fast, slow) / dt)))
    for steps in range(2, most + 1):
        if feeds(fast, slow, steps * dt):
            return steps - 1
    return most


@lru_cache
def longest_kick(fast: tuple[float, float], slow: tuple[float, float]) -> float:
    """Return for how long [s] one kick may stand, whatever the step, but for what it feeds."""
    longest = SAFE * stable_step(SymplecticEuler().amplification, *slow, 0.0)
    if slow[0] > 0.0 and fast[0] > 0.0:
        resonant = math.pi * max(1.0 / fast[0], (fast[1] / slow[0] / slow[0] / fast[0] / fast[0]) ** (1.0 / 3.0))
        longest = min(longest, SMOOTH / slow[0], resonant)
    return longest


def feeds(fast: tuple[float, float], slow: tuple[float, float], span: float) -> bool:
    """Whether kicks that are `span` [s] apart let any mode of tension grow, with all of their damping or with none."""
    share = np.arange(1, MODES + 1) / MODES
    if fast[0] == 0.0:
        return False
    w, d = share * fast[0], share**2 * fast[1]
    # Between kicks: x'' = -w^2 x - d x', overdamped modes taken as just not swinging.
    swing = np.sqrt(np.maximum(w * w - 0.25 * d * d, 1e-12 * w * w))
    fade, c, s = np.exp(-0.5 * d * span), np.cos(swing * span), np.sin(swing * span) / swing
    xx, xv = fade * (c + 0.5 * d * s), fade * s
    vx, vv = -fade * w * w * s, fade * (c - 0.5 * d * s)
    k, most = slow[0] ** 2 * span, 0.0
    for kept in (1.0, 1.0 - slow[1] * span):
        # A kick, and the way to the next one.
        matrix = np.moveaxis(np.array([[xx - xv * k, xv * kept], [vx - vv * k, vv * kept]]), 2, 0)
        most = max(most, float(np.abs(np.linalg.eigvals(matrix)).max()))
    return most > 1.0 + 1e-9


def feeds_stretched(fast: float, slow: float, span: float) -> bool:
    """Whether kicks of a force of the frequency `slow` [1/s], `span` [s] apart, let swings grow of cloth that is
    stretched by up to STRETCHED, whose tension has the greatest frequency `fast` [1/s].

    The matrix of an undamped mode w has the trace 2 cos a - (w_s H)^2 sin a / a, a = w H: at least -2 while
    (w_s H)^2 <= 2 a / tan(a / 2), which falls with a.
    """
    a = math.sqrt(STRETCHED) * fast * span
    if slow * slow * span <= 2.0 * math.pi * FED or a == 0.0:
        return False
    return a >= math.pi or (slow * span) ** 2 > 2.0 * a / math.tan(0.5 * a)


TENSION, BENDING = ("springs", "membrane", "yarns"), ("hinges", "bending")
"""kinds of force that act in every step, and those that do so if they are faster than contact"""
ROUNDS = 8
"""number of fixed-point iterations for a velocity; each halves the error, of what dashpots slow it down in a kick"""


class RespaConfig(Config):
    """The number of steps between kicks."""

    every: Annotated[int, Field(ge=1)] | Literal["auto"] = Field(
        default="auto", description="steps of tension for each kick of the other forces; auto: as many as are stable"
    )


class Tension(NamedTuple):
    """The system of tension, and those of every second step and of the steps between, where it acts at two rates."""

    whole: Packed
    twice: Packed
    quick: Packed


class Kicks(NamedTuple):
    """The systems of forces that kick every so many steps: the `soft` ones at a multiple of the others' number."""

    slow: Packed
    every: int
    soft: Packed
    soft_every: int


@kernel
def advance_respa(x: Float, v: Float, stages: Float, steps: int, dt: float, tension: Tension, kicks: Kicks) -> None:
    """Take `steps` steps of x, v (3, n); stages (5, 3, n).

    Kicks stand for half of the steps before and half of those after. Contact, which holds cloth off bodies and off
    itself, acts on the mean velocity u since the last kick, by which vertices came to where they are. The velocity
    beyond u is reduced by the same share as the way.

    Tension is evaluated halfway through each step: symplectic Euler's steps, from positions half a step ahead.
    """
    p, slow, every, soft, soft_every = tension.whole, kicks.slow, kicks.every, kicks.soft, kicks.soft_every
    here_x, here_v, to_x, to_v, a, u, last = x, v, stages[0], stages[1], stages[2], stages[3], stages[4]
    step, before, soft_before = 0, 0, 0
    while steps > 0:
        after = min(every, steps - step)
        evaluate(here_x, here_v, step / steps, a, slow)
        if soft_every > every and (step % soft_every == 0 or after == 0):
            soft_after = min(soft_every, steps - step)
            evaluate(here_x, here_v, step / steps, u, soft)
            add(here_v, here_v, 0.5 * (soft_before + soft_after) * dt, u, p.threads)
            soft_before = soft_after
        add(here_v, here_v, 0.5 * (before + after) * dt, a, p.threads)
        if after == 0 or p.leave[0] != 0:
            break
        place(slow.bodies, slow.bodies_on, here_x, here_v, step / steps)
        copy_rows(here_x, last)
        add(here_x, here_x, 0.5 * dt, here_v, p.threads)
        for one in range(step, step + after):
            if one % 2 == 1:
                add_forces(here_x, here_v, 0.0, to_x, to_v, dt, tension.quick)
            else:
                add_forces(here_x, here_v, 0.0, to_x, to_v, dt, tension.twice if one + 1 < steps else p)
            here_x, here_v, to_x, to_v = to_x, to_v, here_x, here_v
        add(here_x, here_x, -0.5 * dt, here_v, p.threads)
        step, before = step + after, after
        average(u, here_v, here_x, last, 1.0 / (after * dt), p.threads)
        copy_rows(here_x, to_x)
        commit(here_x, u, step / steps, slow.bodies, slow.bodies_on, p.threads)
        rejoin(here_v, u, here_x, to_x, last, a, p.threads)
        credit(slow.bodies, slow.bodies_on, a)
    if steps % 2 == 1:
        copy_rows(here_x, x)
        copy_rows(here_v, v)


@dataclass(frozen=True)
class Division:
    """Kinds of force that act in every step; rates [1/s], the greatest angular frequency and damping, of these and of
    the others; the longest step that `dt: auto` takes, and the largest time between kicks of the others [s].
    """

    always: tuple[str, ...]
    fast: tuple[float, float]
    slow: tuple[float, float]
    safe: float = math.inf
    longest: float = math.inf
    rests: bool = True
    """whether a term is stiff, so that cloth may rest on it: gravity is a kick then"""
    stiff: frozenset[str] = frozenset()
    """kinds of force of such terms"""
    soft: tuple[float, float] = (0.0, 0.0)
    """rates of the kicks that are not stiff"""

    def fast_part(self, p: Packed) -> Packed:
        """Return the system of what acts in every step."""
        gravity = np.zeros(3) if self.rests else p.gravity
        others = [name for name in parts(p) if name not in self.always]
        return silence(p, *others)._replace(bodies_on=np.zeros_like(p.bodies_on), damping=0.0, gravity=gravity)

    def slow_part(self, p: Packed) -> Packed:
        """Return the system of what acts as kicks."""
        slow = silence(p, *self.always)
        return slow if self.rests else slow._replace(gravity=np.zeros(3))

    def split_kicks(self, p: Packed) -> tuple[Packed, Packed]:
        """Return the systems of kicks that are stiff, and of those that are not: forces by blocks."""
        slow = self.slow_part(p)
        names = {kernels_of(term).name for term in p.forces} - self.stiff
        soft = slow._replace(bodies_on=np.zeros_like(p.bodies_on), damping=0.0, gravity=np.zeros(3))
        return slow._replace(forces_on=silence(slow, *names).forces_on), silence(soft, *self.stiff)

    def steps_a_kick(self, dt: float, span: float) -> int:
        """Return for how many steps of dt [s] one kick may stand, in an interval of `span` [s] of whole steps: at most
        the number of the longest safe step.
        """
        return min(map(self._kicks, self._steps(dt, span)))

    def _kicks(self, dt: float) -> int:
        kicks = min(steps_a_kick(self.fast, self.slow, dt), int(min(MOST, self.longest / dt)))
        while self.rests and kicks > 1 and feeds_stretched(self.fast[0], self.slow[0], kicks * dt):
            kicks -= 1
        return max(1, kicks)

    def _steps(self, dt: float, span: float) -> tuple[float, float]:
        """Return a step and the longest safe one [s] of whole steps in `span` [s]."""
        return dt, max(dt, span / max(1, math.ceil(span / self.safe)))

    def bears(self, fast: tuple[float, float], slow: tuple[float, float]) -> bool:
        """Whether kicks with the rates `slow` in every second safe step are stable, and feed nothing with `fast`."""
        stable_alone = 2.0 * self.safe <= SAFE * stable_step(SymplecticEuler().amplification, *slow, 0.0)
        return stable_alone and not feeds((fast[0], 0.0), slow, 2.0 * self.safe)

    def steps_a_soft_kick(self, dt: float, span: float, kicks: int) -> int:
        """Return for how many steps one kick of forces that are not stiff may stand, a multiple of `kicks`."""
        if not self.rests:
            return kicks
        pressed = math.sqrt(max(0.0, self.slow[0] ** 2 - self.soft[0] ** 2)), 0.0
        most = (min(steps_a_kick(one, self.soft, h) for one in (self.fast, pressed)) for h in self._steps(dt, span))
        return kicks * max(1, min(most) // kicks)

    def at_least_cost(self) -> Division:
        """Return the same with the safe step at which steps and DEAR kicks together cost the least."""
        steps = self.safe * np.linspace(1.0, SHORTEST, 51)
        best = min(steps, key=lambda dt: (1.0 + DEAR / self._kicks(dt)) / dt)
        return replace(self, safe=float(best))


@dataclass
class RespaWork(Work):
    """Facts of the system: steps for each kick where they are given, and how its forces divide."""

    every: int | None
    division: Division
    rates: TwoRates | None
    """None where tension acts at one rate: also where gravity acts in every step, which it is to balance there"""
    kicks: int = 1
    dt: float = 0.0
    """steps for each kick, and the step [s], of the last steps"""
    soft_kicks: int = 1
    """steps for each kick of forces that are not stiff"""
    last: tuple[int, int] = (0, 0)
    """steps that the last kicks stood for, stiff or not"""


class Respa(Compiled):
    """r-RESPA: limited by tension alone, where tension is the limit."""

    name: ClassVar[str] = "respa"
    Config: ClassVar[type[RespaConfig]] = RespaConfig
    order: ClassVar[int] = 1
    explicit: ClassVar[bool] = True
    holds: ClassVar[bool] = False

    def make_work(self, config: RespaConfig, system: System, packed: Packed) -> RespaWork:
        every = None if config.every == "auto" else config.every
        division = divide(system)
        rates = (
            two_rates(system, packed, at_start(system), division.bears) if division.rests and every is None else None
        )
        return RespaWork(packed, np.empty((5, 3, system.fabric.number)), every, division, rates)

    def limit(self, config: RespaConfig, system: System, state: State) -> StepLimit:
        """Return the limit of all forces with the damping of tension, and of the other forces alone."""
        if has_sliding(system.terms):
            return SymplecticEuler().limit(config, system, state)
        fast, slow = both_rates(system, state)
        step, whole = stable(fast, slow, system.damping), math.hypot(fast[0], slow[0])
        if config.every != "auto" and math.isfinite(step) and step > 0.0:
            step *= min(1.0, divide(system).steps_a_kick(step, step) / config.every)
        chosen = config.every == "auto" and math.isfinite(step) and step > 0.0 and any(map(_lists, system.terms))
        resolved = divide(system).safe if chosen else math.inf
        return StepLimit(step, whole, max(fast[1] + system.damping, slow[1]), resolved)

    def steps_a_kick(self, config: RespaConfig, system: System, dt: float, span: float) -> int:
        """Return the steps of dt [s] for each kick in this system, in frames of `span` [s]."""
        if has_sliding(system.terms):
            return 1
        return divide(system).steps_a_kick(dt, span) if config.every == "auto" else config.every

    def go(self, work: RespaWork, packed: Packed, steps: int, dt: float) -> StepResult:
        if dt != work.dt:
            span, division = steps * dt, work.division
            work.kicks = work.soft_kicks = division.steps_a_kick(dt, span) if work.every is None else work.every
            if work.every is None:
                work.soft_kicks = division.steps_a_soft_kick(dt, span, work.kicks)
            work.dt = dt
        self.steps_of(work)(work.x, work.v, work.stages, steps, dt, packed)
        work.last = (steps - 1) % work.kicks + 1, (steps - 1) % work.soft_kicks + 1
        return StepResult(steps)

    def compile(self, work: RespaWork, packed: Packed) -> None:
        self.steps_of(work)(work.x, work.v, work.stages, 0, 0.0, packed)

    def felt_at(self, work: RespaWork, packed: Packed) -> Float:
        """Return the velocity v before the last kicks, by iteration: a kick changes it by H / 2 a(v)."""
        kicks = work.division.split_kicks(packed)
        a, v = np.empty_like(work.v), work.v
        for _ in range(ROUNDS if any(work.last) and not _slides(work.packed) else 0):
            before = work.v.copy()
            for part, last in zip(kicks, work.last, strict=True):
                evaluate(work.x, v, 1.0, a, part)
                before -= 0.5 * last * work.dt * a
            v = before
        return v

    def unkicked(self, work: RespaWork) -> Collection[str]:
        return work.division.always

    def steps_of(self, work: RespaWork) -> Any:
        """Return the loop of a system divided into tension and all other forces; symplectic Euler's if there is no
        division, or if vertices slide on bodies, where contact changes their velocities in each step.
        """
        always = work.division.always
        alone = not work.packed.bodies and not set(parts(work.packed)) - set(always)
        if alone or _slides(work.packed):
            return SymplecticEuler().steps_of(work)

        def loop(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed) -> None:
            fast, (slow, soft) = work.division.fast_part(p), work.division.split_kicks(p)
            if work.soft_kicks == work.kicks:
                slow = work.division.slow_part(p)
            at_two = work.rates is not None and dt <= work.division.safe * (1.0 + 1e-9)
            tension = Tension(fast, *(work.rates.parts(fast) if work.rates and at_two else (fast, fast)))
            advance_respa(x, v, stages, steps, dt, tension, Kicks(slow, work.kicks, soft, work.soft_kicks))

        return loop

    def about(self, system: System) -> str:
        """Describe the threads, and which forces are kicks."""
        return super().about(system) + "; all but tension as kicks every few steps"


def has_sliding(terms: Sequence[Term]) -> bool:
    """Whether vertices slide on bodies."""
    return any("slow" in kernels_of(part) for term in terms for part in _parts(term))


def _slides(packed: Packed) -> bool:
    return any("slow" in kernels_of(term) for term in packed.bodies)


def at_start(system: System) -> State:
    """Return the fabric's initial state, so that a resumed run chooses the same kicks again."""
    return State(system.fabric.position, np.zeros_like(system.fabric.position))


def divide(system: System) -> Division:
    """Divide the forces by their rates at the start; the damping of tension is the least that any mode has."""
    fast, slow = both_rates(system, at_start(system))
    always: tuple[str, ...]
    always, longest, safe = TENSION, math.inf, SAFE * stable(fast, slow, system.damping)
    dear = sum(term.omega_squared for term in system.terms if _lists(term))
    bending = max(0.0, slow[0] ** 2 - sum(term.omega_squared for term in system.terms))
    if 0.0 < dear < bending:
        always, longest = TENSION + BENDING, 0.5 * math.pi / math.sqrt(bending)
        fast, slow = both_rates(system, at_start(system), always)
    fast = fast[0], min(fast[1], least_damping(system.fabric, fast[0]))
    stiff, soft = [term for term in system.terms if term.omega_squared > 0.0], (0.0, 0.0)
    if stiff:
        others = tuple(term for term in system.terms if term.omega_squared == 0.0 and not callable(term.data))
        fabric = _without(system.fabric, always)
        soft = measure_rates(replace(system, fabric=fabric, terms=others, damping=0.0), at_start(system))
    names = frozenset(kernels_of(part).name for term in stiff for part in _parts(term))
    division = Division(always, fast, slow, safe, longest, bool(stiff), names, soft)
    return division.at_least_cost() if dear > 0.0 and 0.0 < safe < math.inf else division


def stable(fast: tuple[float, float], slow: tuple[float, float], damping: float) -> float:
    """Return the longest stable step [s] under all forces with the damping of tension, and under the others alone."""
    whole = math.hypot(fast[0], slow[0]), fast[1] + damping
    return min(stable_step(SymplecticEuler().amplification, *rates, damping) for rates in (whole, slow))


def _parts(term: Term) -> Sequence[Any]:
    return () if callable(term.data) else term.data


def _lists(term: Term) -> bool:
    return any(kernels_of(part).lists for part in _parts(term))


def both_rates(
    system: System, state: State, always: tuple[str, ...] = TENSION
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return bounds on angular frequency and damping rate [1/s] of the forces of every step, and of all others."""
    fabric, kicks = system.fabric, [name for name in (*BENDING, "friction") if name not in always]
    fast = replace(system, fabric=_without(fabric, kicks), terms=(), damping=0.0)
    return measure_rates(fast, state), measure_rates(replace(system, fabric=_without(fabric, always)), state)


def _without(fabric: Fabric, names: Sequence[str]) -> Fabric:
    nothing: dict[str, Any] = dict.fromkeys(names)
    return replace(fabric, **nothing)


def least_damping(fabric: Fabric, omega: float) -> float:
    """Return the damping rate [1/s] that a mode of tension of frequency omega [1/s] has at least, from the element
    least damped for its stiffness.
    """
    shares = [np.inf]
    if (springs := fabric.springs) is not None and springs.number:
        firm = springs.stiffest()
        k, c = firm.per_spring(firm.k), firm.per_spring(firm.c)
        shares.append(float((c[k > 0.0] / k[k > 0.0]).min(initial=np.inf)))
    if (membrane := fabric.membrane) is not None and membrane.number:
        k = membrane.moduli[[0, 1, 3]]
        shares.append(float((membrane.damping[k > 0.0] / k[k > 0.0]).min(initial=np.inf)))
    least = min(shares)
    return least * omega * omega if math.isfinite(least) else 0.0
