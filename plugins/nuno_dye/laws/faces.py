"""What passes between two cells: D = D0 P T, T = tau 1 tau 2 tau 3, on every face (dye paper, equations 3 and 4).

Face values are symmetric, so that dye is kept: P is the harmonic mean of the two cells' (0 where either is 0),
tau 1 their arithmetic mean. A yarn runs on along its own direction; between the layers only tau 3 I counts,
whatever the two cells are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_schemas.dye import Cells
from nuno_schemas.fabric import Float


class Faces(NamedTuple):
    """P T of all faces; times D0 dt / size^2 these are the weights of an explicit step.

    along   (2, ny, nx)  to the next column, 0 in the last
    down    (2, ny, nx)  to the next row, 0 in the last
    across  (ny, nx)     to the other layer
    """

    along: Float
    down: Float
    across: Float


def face_values(cells: Cells) -> Faces:
    """P T of a cloth's faces."""
    along, down = np.zeros((2, *cells.fibre.shape))
    along[:, :, :-1] = _in_layer(cells, axis=2)
    down[:, :-1] = _in_layer(cells, axis=1)
    porosity = _harmonic(cells.porosity[0], cells.porosity[1])
    across = porosity * 0.5 * (cells.twist[0] + cells.twist[1]) * cells.tortuosity.layers
    return Faces(along, down, across)


def face_sums(faces: Faces) -> Float:
    """(2, ny, nx) sum of P T over each cell's faces."""
    total = faces.along + faces.down + faces.across
    total[:, :, 1:] += faces.along[:, :, :-1]
    total[:, 1:] += faces.down[:, :-1]
    return total


def largest_sum(faces: Faces) -> float:
    """Largest sum of P T over a cell's faces: an explicit step is stable up to D0 dt / size^2 times this of 1."""
    return float(face_sums(faces).max(initial=0.0))


def _in_layer(cells: Cells, axis: int) -> Float:
    """P T between neighbours along an axis of (2, ny, nx)."""
    t = cells.tortuosity
    near = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
    far = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
    both, none = cells.fibre[near] & cells.fibre[far], ~cells.fibre[near] & ~cells.fibre[far]
    # The weft's yarns lie along the last axis, the warp's along the one before it.
    along_yarn = np.array([axis == 2, axis == 1])[:, None, None]
    tau3 = np.where(both, np.where(along_yarn, t.yarn, t.beside), np.where(none, t.gap, t.rim))
    tau2 = np.where(both & (cells.up[near] != cells.up[far]), t.weave, 1.0)
    tau1 = 0.5 * (cells.twist[near] + cells.twist[far])
    values: Float = _harmonic(cells.porosity[near], cells.porosity[far]) * tau1 * tau2 * tau3
    return values


def _harmonic(a: Float, b: Float) -> Float:
    """Harmonic mean, 0 where either is."""
    total = a + b
    mean: Float = np.divide(2.0 * a * b, total, out=np.zeros(np.shape(total)), where=total > 0.0)
    return mean
