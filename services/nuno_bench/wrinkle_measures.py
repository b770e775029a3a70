"""How high and how wide drawn wrinkles stand over the cloth as it lay before."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_schemas.fabric import Float, Int

NEAR = 0.06
"""What lies so near to a line when it is drawn belongs to its wrinkle [m]."""


class Ridge(NamedTuple):
    """Mean height of a line's vertices [m], and area of cloth that stands at half of that or more, over the line's
    length [m].
    """

    height: float
    width: float


class Drawn:
    """Cloth before lines are drawn on it, and which of its vertices are whose.

    before (n, 3) [m] and faces (f, 3) of the cloth as it lay; x (m, 3) [m] and faces_drawn (g, 3) just drawn, new
    vertices behind the old ones; lines (k, 3) [m] near it.
    """

    def __init__(self, before: Float, faces: Int, x: Float, faces_drawn: Int, lines: list[Float]) -> None:
        old = len(before)
        normals = vertex_normals(before, faces)
        self._faces = faces_drawn
        new = x[old:]
        nearest = np.array([int(np.argmin(((before - place) ** 2).sum(axis=1))) for place in new], int)
        self._base = np.concatenate([before, before[nearest]])
        self._normal = np.concatenate([normals, normals[nearest]])
        away = np.stack([distance_to(self._base, line) for line in lines], axis=1)
        self._own = [(away.argmin(axis=1) == i) & (away[:, i] < NEAR) for i in range(len(lines))]
        self._new = np.arange(len(x)) >= old
        self._long = [float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines]

    def measure(self, x: Float) -> list[Ridge]:
        """Of every line, with the cloth at x (m, 3) [m]. NaN where no vertex of a line is near it."""
        rise = ((x - self._base) * self._normal).sum(axis=1)
        area = vertex_areas(x, self._faces)
        found = []
        for own, long in zip(self._own, self._long, strict=True):
            mine = own & self._new
            height = float(rise[mine].mean()) if mine.any() else float("nan")
            high = own & (rise * np.sign(height) >= 0.5 * abs(height))
            found.append(Ridge(height, float(area[high].sum()) / long))
        return found


def vertex_normals(x: Float, faces: Int) -> Float:
    """(n, 3) unit normals, weighted by area."""
    normal = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
    total = np.zeros_like(x)
    for k in range(3):
        np.add.at(total, faces[:, k], normal)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30))


def vertex_areas(x: Float, faces: Int) -> Float:
    """(n,) a third of the triangles at each vertex [m^2]."""
    normal = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
    share = np.repeat(np.linalg.norm(normal, axis=1) / 6.0, 3)
    return np.asarray(np.bincount(faces.reshape(-1), share, len(x)), np.float64)


def distance_to(places: Float, line: Float) -> Float:
    """(n,) distance of places (n, 3) to a polyline (k, 3) [m]."""
    start, side = line[:-1], np.diff(line, axis=0)
    way = places[:, None] - start
    share = np.clip((way * side).sum(axis=2) / np.maximum((side * side).sum(axis=1), 1e-30), 0.0, 1.0)
    return np.asarray(np.linalg.norm(way - share[..., None] * side, axis=2).min(axis=1))
