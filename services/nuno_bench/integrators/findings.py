"""What was seen next to what the skirt paper says, in words that follow from the figures."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nuno_bench.integrators.experiment import RUNAWAY, Trace
from nuno_bench.report.result import number

FARTHER = 2.0
"""Cloth counts as thrown off the body from this multiple of symplectic Euler's distance on."""
DEEPER = 1.5
"""Penetration counts as another from this multiple of symplectic Euler's on."""
SLOWER = 1.1
"""Times within a tenth of each other count as the same."""


class Finding(NamedTuple):
    """A claim of the paper, what was seen here, and whether the two agree."""

    claim: str
    seen: str
    verdict: str


def compare(traces: Sequence[Trace]) -> list[Finding]:
    """Findings on the runs there are; a claim about a run that was left out is left out too."""
    split = {trace.integrator: trace for trace in traces if trace.split}
    base = split.get("symplectic_euler")
    if base is None:
        return []
    energies = "energy {} J at the start, at most {} J, {} J at the end".format(*map(number, base.energies))
    ratio = f"; its step is {base.dt / base.limit:.0%} of its limit" if 0.0 < base.limit < np.inf else ""
    claim = f"symplectic Euler is stable at a step of {number(base.dt * 1e3)} ms"
    found = [Finding(claim, f"{_ending(base)}, {energies}{ratio}", _verdict(base.ended is None))]
    if euler := split.get("euler"):
        farthest = FARTHER * base.peak("distance")
        off = euler.first(euler.series["distance"] > farthest)
        grown, far = ("stays below" if t is None else f"passes, at {t:.2f} s," for t in (euler.runaway, off))
        seen = (
            f"{_ending(euler)}; the energy's growth {grown} {RUNAWAY:g} times what lifts the garment by its own size; "
            f"mean distance from the body {far} {_length(farthest)}, {FARTHER:g} times symplectic Euler's largest"
        )
        claim = "explicit Euler moves violently and throws the cloth off the body"
        found.append(Finding(claim, seen, _verdict(off is not None)))
    if rk4 := split.get("rk4"):
        times = f"{number(rk4.microseconds)} us a step against {number(base.microseconds)} us"
        ratios = [a / b for a, b in zip(rk4.rounds, base.rounds, strict=True)]
        seen = f"{times}: {_spread(ratios)} symplectic Euler's"
        found.append(Finding("Runge-Kutta is slower", seen, _slower(ratios)))
    for name, claim in (
        ("rk4", "Runge-Kutta lets a leg through the skirt"),
        ("rk4_printed", "the same, by Runge-Kutta as its formulas are printed"),
    ):
        if trace := split.get(name):
            depth, other = trace.peak("penetration"), base.peak("penetration")
            deeper = depth / other if other > 0 else (np.inf if depth > 0 else 1.0)
            depths = f"{_length(depth)} deep against symplectic Euler's {_length(other)}"
            seen = f"{_ending(trace)}, at most {depths} ({deeper:.2f} times)"
            if trace.rest_depth is not None:
                seen += f"; a vertex at rest sinks m g / k = {_length(trace.rest_depth)} under any method"
            found.append(Finding(claim, seen, _verdict(deeper > DEEPER)))
    pairs = [(a, b) for a in traces for b in traces if a.split and not b.split and a.integrator == b.integrator]
    return [*found, _bones(pairs)] if pairs else found


def _bones(pairs: Sequence[tuple[Trace, Trace]]) -> Finding:
    rounds = zip(*([x / y for x, y in zip(a.rounds, b.rounds, strict=True)] for a, b in pairs), strict=True)
    ratios = [statistics.median(methods) for methods in rounds]
    depths = [
        f"{a.integrator} {_length(a.peak('penetration'))} against {_length(b.peak('penetration'))}"
        for a, b in pairs
        if a.runaway is None and b.runaway is None
    ]
    seen = (
        f"a step takes {_spread(ratios)} as long (median over the methods; {pairs[0][0].primitives} primitives against "
        f"{pairs[0][1].primitives}). Penetration, each into its own body: {', '.join(depths) or 'every run ran away'}"
    )
    return Finding("bones cut in pieces are slower than whole ones", seen, _slower(ratios))


def _verdict(agrees: bool) -> str:
    return "agrees" if agrees else "contradicts"


def _slower(ratios: Sequence[float]) -> str:
    """Whether one is slower than the other, by the ratios of their times in each round of repeats.

    Rounds go over all variants in turn, so a machine that slows down does not part the two of a
    round. Undecided where rounds disagree, and where there is only one: its spread is not known.
    """
    slower = {ratio > SLOWER for ratio in ratios}
    return _verdict(slower.pop()) if len(ratios) > 1 and len(slower) == 1 else "undecided"


def _spread(ratios: Sequence[float]) -> str:
    """Median and range of ratios."""
    rounds = f"{min(ratios):.2f} to {max(ratios):.2f} in {len(ratios)} rounds" if len(ratios) > 1 else "in one round"
    return f"{statistics.median(ratios):.2f} times ({rounds})"


def _ending(trace: Trace) -> str:
    return "runs to the end" if trace.ended is None else f"diverges: no longer finite at {trace.ended:.2f} s"


def _length(metres: float) -> str:
    return f"{metres * 1e3:.3g} mm" if metres < 1.0 else f"{number(metres)} m"
