"""Diffusivity of the faces between cells: D = D0 P T, T = tau 1 tau 2 tau 3 (dye paper, equations 3 and 4).

Face values are symmetric, so that dye is conserved: P is the harmonic mean of the two cells' (0 if either is 0), tau 1
their arithmetic mean. A yarn continues along its own direction; between the layers only tau 3 I counts, whatever the
two cells are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_schemas.dye import Cells
from nuno_schemas.fabric import Float


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
    values: Float = _harmonic(cells.porosity[near], cells.porosity[far]) * tau1 * tau2 * tau3
    return values


def _harmonic(a: Float, b: Float) -> Float:
    """Return the harmonic mean, 0 if either is 0."""
    total = a + b
    mean: Float = np.divide(2.0 * a * b, total, out=np.zeros(np.shape(total)), where=total > 0.0)
    return mean
