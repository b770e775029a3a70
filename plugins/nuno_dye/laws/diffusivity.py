"""Diffusivity of the faces between cells, D = D0 P T g: tortuosities, and slower diffusion where there is more dye."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nuno_dye.laws.power import log
from nuno_kernels import kernel
from nuno_kernels.lanes import higher, lower, splat
from nuno_schemas.dye import Cells, Dye
from nuno_schemas.fabric import Float

# Diffusivity of the faces between cells: D = D0 P T, T = tau 1 tau 2 tau 3 (dye paper, equations 3 and 4).
#
# Face values are symmetric, so that dye is conserved: P is the harmonic mean of the two cells' (0 if either is 0), tau
# 1 their arithmetic mean. A yarn continues along its own direction; between the layers only tau 3 I counts, whatever
# the two cells are.


class Faces(NamedTuple):
    """P T of all faces. Times D0 dt / size^2 these are the weights of an explicit step.

    along   (2, ny, nx)  to the next column, 0 in the last
    down    (2, ny, nx)  to the next row, 0 in the last
    across  (ny, nx)     to the other layer
    """

    along: Float
    down: Float
    across: Float


def face_values(cells: Cells) -> Faces:
    """Return P T of a cloth's faces."""
    along, down = np.zeros((2, *cells.fibre.shape))
    along[:, :, :-1] = _in_layer(cells, axis=2)
    down[:, :-1] = _in_layer(cells, axis=1)
    porosity = _harmonic(cells.porosity[0], cells.porosity[1])
    across = porosity * 0.5 * (cells.twist[0] + cells.twist[1]) * cells.tortuosity.layers
    return Faces(along, down, across)


def face_sums(faces: Faces) -> Float:
    """Return sums (2, ny, nx) of P T over each cell's faces."""
    total = faces.along + faces.down + faces.across
    total[:, :, 1:] += faces.along[:, :, :-1]
    total[:, 1:] += faces.down[:, :-1]
    return total


def largest_sum(faces: Faces) -> float:
    """Return the largest sum of P T over a cell's faces: explicit steps are stable if D0 dt / size^2 times it <= 1."""
    return float(face_sums(faces).max(initial=0.0))


def _in_layer(cells: Cells, axis: int) -> Float:
    """Return P T between neighbours along an axis of (2, ny, nx)."""
    t = cells.tortuosity
    near = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
    far = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
    both_fibre, both_gap = cells.fibre[near] & cells.fibre[far], ~cells.fibre[near] & ~cells.fibre[far]
    # The weft's yarns run along the last axis, the warp's along the one before it.
    along_yarn = np.array([axis == 2, axis == 1])[:, None, None]
    tau3 = np.where(both_fibre, np.where(along_yarn, t.yarn, t.beside), np.where(both_gap, t.gap, t.rim))
    tau2 = np.where(both_fibre & (cells.up[near] != cells.up[far]), t.weave, 1.0)
    tau1 = 0.5 * (cells.twist[near] + cells.twist[far])
    return np.asarray(_harmonic(cells.porosity[near], cells.porosity[far]) * tau1 * tau2 * tau3)


def _harmonic(a: Float, b: Float) -> Float:
    """Return the harmonic mean, 0 if either is 0."""
    total = a + b
    return np.asarray(np.divide(2.0 * a * b, total, out=np.zeros(np.shape(total)), where=total > 0.0))


# Diffusion that slows down with the amount of dye: D = D0 P T g, g = min(cap, phi0 / phi) (dye paper, equation 4).
#
# The Weisz-Zollinger factor phi0 / phi is unbounded without dye, so it is capped. The flux over a face is the integral
# of D between its two amounts (Kirchhoff's transformation),
#
#     w (G(phi_j) - G(phi_i)),   G(phi) = cap phi                          up to phi0 / cap
#                                         phi0 (1 + ln(cap phi / phi0))    beyond,
#
# which is the flux in a steady state. It is the same from both sides, grows with phi_j and falls with phi_i, so that
# amounts stay between their neighbours', and it is linear in G. Rejected: g at the mean of the two amounts, with which
# 2 phi0 would pass from any cell into an empty one, whatever its amount.


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
