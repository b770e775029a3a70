"""The cantilever of ASTM D1388: how far a strip can be pushed over an edge before it bends down to 41.5 degrees."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from scipy.optimize import brentq

from nuno_bench.instruments.rig import mount
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float

SLOPE = math.radians(41.5)
ENOUGH = 1e-4
"""Length is found to this share of it. Friction scatters the slope, that of limp cloth by 0.5 %."""
FIRST = 0.01
"""Share of the guess by which another length is tried at least."""
STILL = 1e-5
HELD = 4
"""Edges of the strip that the clamp holds."""
WIDE = 4
"""Edges across it. ASTM's strip is 2.5 cm wide; narrow ones spare time, and bend the same where no Poisson's ratio
makes them curl.
"""


def hang(fabric: object, length: float, edges: int, angle: float = 0.0, **model: Any) -> tuple[Float, Float]:
    """(n, 3) a strip of so many edges along its free length [m] at its start and at rest [m]; `angle` of its warp."""
    edge = length / edges
    size = [length + HELD * edge, WIDE * edge]
    rig = mount("cantilever", fabric, size=size, hold=HELD * edge, edge=edge, angle=angle, **model)
    return rig.fabric.position, rig.rest(STILL)


def steepness(start: Float, x: Float) -> float:
    """Height over width of a strip at x (n, 3) [m], from its clamp to the middle of its end."""
    end = start[:, 0] > start[:, 0].max() - 1e-9
    return float(-x[end, 1].mean() / x[end, 0].mean())


def overhang(fabric: object, guess: float, edges: int, angle: float = 0.0, **model: Any) -> float:
    """Length [m] of the strip whose end is SLOPE below its clamp, looked for from a guess of it: the slope's tangent
    grows about with the third power of the length. It is found between a longer and a shorter one, so that slopes that
    friction scatters have one, too. Raises RunFailed where there is none.
    """

    @cache
    def off(log: float) -> float:
        return math.log(steepness(*hang(fabric, math.exp(log), edges, angle, **model)) / math.tan(SLOPE))

    start = math.log(guess)
    reach = math.copysign(max(abs(off(start)) / 2.0, FIRST), -off(start))
    for _ in range(4):
        if off(start) * off(start + reach) <= 0.0:
            return math.exp(brentq(off, start, start + reach, xtol=ENOUGH))
        reach *= 2.0
    raise RunFailed(f"cantilever: no length is found at which its end hangs {math.degrees(SLOPE):g} degrees below")


def bending_length(overhang: float) -> float:
    """Peirce's length [m] of a strip of this overhang: half of it, which is the elastica's to 1e-4."""
    return 0.5 * overhang
