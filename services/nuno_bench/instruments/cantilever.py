"""The cantilever of ASTM D1388: how far a strip can be pushed over an edge before it bends down to 41.5 degrees."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno_bench.instruments.rig import mount
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float

SLOPE = math.radians(41.5)
ENOUGH = 1e-4
"""Length is found to this share of it."""
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
    """Length [m] of the strip whose end is SLOPE below its clamp, looked for from a guess of it by secants: the slope's
    tangent grows about with the third power of the length. Raises RunFailed where it is not found.
    """

    def off(log: float) -> float:
        return math.log(steepness(*hang(fabric, math.exp(log), edges, angle, **model)) / math.tan(SLOPE))

    log = math.log(guess)
    found = off(log)
    before, log = (log, found), log - found / 2.5
    for _ in range(8):
        found = off(log)
        step = -found * (log - before[0]) / (found - before[1])
        before, log = (log, found), log + float(np.clip(step, -0.5, 0.5))
        if abs(step) < ENOUGH:
            return math.exp(log)
    raise RunFailed(f"cantilever: no length is found at which its end hangs {math.degrees(SLOPE):g} degrees below")


def bending_length(overhang: float) -> float:
    """Peirce's length [m] of a strip of this overhang: half of it, which is the elastica's to 1e-4."""
    return 0.5 * overhang
