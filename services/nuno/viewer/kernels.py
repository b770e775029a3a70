"""Compiled loops of the viewer: normals, stretch and colours of a frame.

With numpy alone (cross products, `bincount`, look-ups) a frame takes several times as long, and
holds the interpreter's lock meanwhile: time that a simulation in the same process loses. With
their types written out they compile, once, where the module is imported, not in a run's first frame.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])
Float32 = NDArray[np.float32]
FLAGS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


def compiled(signature: str) -> Callable[[F], F]:
    """Compile a function here and now, or read it from numba's cache."""

    def decorate(function: F) -> F:
        try:
            return cast(F, njit(signature, cache=True, **FLAGS)(function))
        except Exception:  # a damaged file, which may say anything when it is read, or nowhere to write
            return cast(F, njit(signature, **FLAGS)(function))

    return decorate


@compiled("void(float32[:, ::1], int32[:, ::1], float32[:, ::1])")
def vertex_normals(x: Float32, faces: NDArray[np.int32], out: Float32) -> None:
    """Unit normals (n, 3) of a mesh: the mean of the faces' normals, weighted by area.

    The cross product of two edges is twice the area times the unit normal, so the plain sum is
    that weighted mean. A vertex without area gets the zero vector.
    """
    out[:] = 0.0
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        bx, by, bz = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for v in (i, j, k):
            out[v, 0] += nx
            out[v, 1] += ny
            out[v, 2] += nz
    for v in range(out.shape[0]):
        length = np.sqrt(out[v, 0] ** 2 + out[v, 1] ** 2 + out[v, 2] ** 2)
        if length > 0.0:
            out[v] /= length


@compiled("void(float32[:, ::1], int32[:, ::1], float32[::1], float32[::1])")
def edge_stretch(x: Float32, edges: NDArray[np.int32], rest: Float32, out: Float32) -> None:
    """|d| / rest - 1 of each edge (e,)."""
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        out[e] = np.sqrt(dx * dx + dy * dy + dz * dz) / rest[e] - 1.0


@compiled("void(float32[::1], int32[:, ::1], float32[::1])")
def vertex_stretch(stretch: Float32, edges: NDArray[np.int32], out: Float32) -> None:
    """The largest stretch among each vertex's edges (n,); NaN where an edge's is NaN."""
    out[:] = -1.0
    for e in range(edges.shape[0]):
        for v in (edges[e, 0], edges[e, 1]):
            if not (stretch[e] <= out[v]):
                out[v] = stretch[e]


@compiled("void(float32[::1], uint32[::1], float64, float64, uint32, uint32[::1])")
def paint(
    stretch: Float32, table: NDArray[np.uint32], low: float, high: float, missing: int, out: NDArray[np.uint32]
) -> None:
    """Packed colours: `table` spread evenly over log10(stretch) in [low, high]."""
    last = table.shape[0] - 1
    for i in range(stretch.shape[0]):
        if np.isnan(stretch[i]):
            out[i] = missing
        elif stretch[i] <= 0.0:
            out[i] = table[0]
        else:
            place = (np.log10(stretch[i]) - low) / (high - low)
            out[i] = table[int(min(max(place, 0.0), 1.0) * last + 0.5)]
