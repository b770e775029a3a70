"""Diffusion that slows down with the amount of dye: D = D0 P T g, g = min(cap, phi0 / phi) (dye paper, equation 4).

The Weisz-Zollinger factor phi0 / phi is unbounded without dye, so it is capped. The flux over a face is the integral of
D between its two amounts (Kirchhoff's transformation),

    w (G(phi_j) - G(phi_i)),   G(phi) = cap phi                          up to phi0 / cap
                                        phi0 (1 + ln(cap phi / phi0))    beyond,

which is the flux in a steady state. It is the same from both sides, grows with phi_j and falls with phi_i, so that
amounts stay between their neighbours', and it is linear in G. Rejected: g at the mean of the two amounts, with which 2
phi0 would pass from any cell into an empty one, whatever its amount.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from nuno_dye.laws.power import log
from nuno_kernels import kernel
from nuno_kernels.lanes.simd import higher, lower, splat
from nuno_schemas.dye import Dye
from nuno_schemas.fabric import Float


class Curve(NamedTuple):
    """The parameters of G: phi0, cap, and the amount phi0 / cap where it bends. A constant D has None instead."""

    phi0: float
    cap: float
    knee: float


def curve_of(one: Dye) -> Curve | None:
    """Return G of a dye, None if its D is constant."""
    law = one.weisz_zollinger
    return None if law is None else Curve(law.phi0, law.cap, law.phi0 / law.cap)


@kernel
def potentials(phi: Any, curve: Curve | None) -> Any:
    """Return G of eight amounts."""
    if curve is None:
        return phi
    # `lower` keeps NaN.
    bent = log(higher(phi, splat(curve.knee)) / curve.knee)
    return lower(splat(curve.knee), phi) * curve.cap + bent * curve.phi0


@kernel
def potential(phi: float, curve: Curve | None) -> float:
    """Return G of one amount."""
    if curve is None:
        return phi
    level: float = curve.cap * phi if not phi > curve.knee else curve.phi0 * (1.0 + math.log(phi / curve.knee))
    return level


@kernel
def amount(level: float, curve: Curve | None) -> float:
    """Return the amount whose G is `level`."""
    if curve is None:
        return level
    phi: float = level / curve.cap if not level > curve.phi0 else curve.knee * math.exp(level / curve.phi0 - 1.0)
    return phi


@kernel
def raise_levels(values: Float, curve: Curve | None, out: Float) -> None:
    """Write G of all amounts (n, w) into `out`."""
    for i in range(values.shape[0]):
        for c in range(values.shape[1]):
            out[i, c] = potential(values[i, c], curve)
