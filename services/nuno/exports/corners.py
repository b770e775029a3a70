"""Texture coordinates of triangles' corners, and the panels that they are cut in, from a fabric message."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.recording.recorded import Arrays
from nuno_schemas.fabric import Corners, Int, Panels


def read_corners(arrays: Arrays, faces: Int, number: int, names: Sequence[str]) -> Corners | None:
    """Those of all objects, or None. Raises LookupError or ValueError for some that do not fit the faces."""
    if "corner_uv" not in arrays:
        return None
    points, vertex = np.asarray(arrays["corner_uv"], np.float32), arrays["corner_vertex"]
    vertex = read_indices("corner_vertex", vertex.reshape(-1, 1), 1, number)[:, 0]
    own = read_indices("corner_faces", arrays["corner_faces"], 3, len(vertex))
    if points.shape != (len(vertex), 2) or own.shape != faces.shape or (vertex[own] != faces).any():
        raise ValueError("texture coordinates of corners that are not those of the faces")
    return Corners(points, vertex, own, _panels(arrays, tuple(map(str, names)), len(faces), len(points)))


def _panels(arrays: Arrays, names: tuple[str, ...], faces: int, points: int) -> Panels | None:
    """Those of all objects, or None. Raises LookupError or ValueError for some that do not fit the corners."""
    if "panel_of" not in arrays:
        return None
    of, seam = arrays["panel_of"], arrays["panel_seam"]
    edge = arrays.get("panel_edge", np.full((faces, 3), -1, np.int32))  # earlier recordings have none
    unit = np.asarray(arrays["panel_unit"], np.float64)
    pairs = read_indices("panel_pairs", arrays["panel_pairs"], 2, points)
    if of.shape != (faces,) or not (-1 <= of.min(initial=-1) <= of.max(initial=-1) < len(names)):
        raise ValueError("triangles of panels that are not those of the names")
    if edge.shape != (faces, 3):
        raise ValueError("edges of panels that are not those of the triangles")
    if unit.shape != (len(names),) or not (unit > 0.0).all() or seam.shape != (len(pairs),):
        raise ValueError("panels without a size, or stitches without a seam")
    return Panels(names, np.asarray(of, np.int32), np.asarray(edge, np.int32), unit, pairs, np.asarray(seam, np.int32))


def cut_corners(corners: Corners, own: NDArray[np.bool_], start: int, stop: int) -> Corners:
    """Those of one object, by its triangles and vertices."""
    mine = (corners.vertex >= start) & (corners.vertex < stop)
    place = np.cumsum(mine, dtype=np.int32) - 1
    panels = None if corners.panels is None else _cut_panels(corners.panels, own, mine, place)
    faces = place[corners.faces[own]].astype(np.int32)
    return Corners(corners.points[mine], corners.vertex[mine] - start, faces, panels)


def _cut_panels(panels: Panels, own: NDArray[np.bool_], mine: NDArray[np.bool_], place: Int) -> Panels | None:
    """Those of one object, by its triangles and corners, whose places among its own are given; None of one without."""
    of, kept = panels.of[own], mine[panels.pairs].all(axis=1)
    used = np.unique(of[of >= 0])
    if not len(used):
        return None
    number = np.full(len(panels.names) + 1, -1, np.int32)  # the last is what -1 takes
    number[used] = np.arange(len(used))
    seam = np.unique(panels.seam[kept], return_inverse=True)[1].reshape(-1).astype(np.int32)
    names = tuple(panels.names[k] for k in used)
    pairs = place[panels.pairs[kept]].astype(np.int32)
    return Panels(names, number[of], panels.edge[own], panels.unit[used], pairs, seam)


def read_indices(name: str, values: NDArray[Any], width: int, number: int) -> Int:
    """Rows of so many numbers of vertices. Raises ValueError for others."""
    fits = values.ndim == 2 and values.shape[1] == width and values.dtype.kind in "iu"
    if not fits or (values.size and not 0 <= values.min() <= values.max() < number):
        raise ValueError(f"{name} of {values.dtype} and shape {values.shape} for {number} vertices")
    return np.asarray(values, np.int32)
