"""Knits put on bodies by projection, and how deep their yarns lie, found in another way than the repair's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from closed_meshes import brute_distance, winding_number

from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_knit.knit import Knit, KnitConfig
from nuno_schemas.fabric import Fabric, Float, Int


class NoFiles:
    """A knit needs none."""

    def resolve(self, name: str) -> Path:
        raise AssertionError(name)


def knit(form: str, wales: int, courses: int, spacing: float = 1e-3, yarns: tuple[Any, ...] = ("nylon",)) -> Fabric:
    """A knit, of nylon unless said otherwise."""
    fields = {"form": form, "wales": wales, "courses": courses, "spacing": (spacing, spacing), "yarns": yarns}
    return Knit().build(KnitConfig.model_validate(fields), NoFiles(), 0)


def wrapped(
    x: Float, faces: Int, rows: int, columns: int, low: float, high: float, radius: float, limb: Float | None = None
) -> Float:
    """(rows columns, 3) points of a tube about a limb along y, each on the mesh at the place closest to it.

    `limb` (m, 3) are the vertices that the tube is drawn about, all of them unless given.
    """
    limb = x if limb is None else limb
    height = np.linspace(low, high, rows)
    about = np.linspace(low, high, 9)
    width = 0.6 * (high - low) / 8.0
    middle = np.array([limb[np.abs(limb[:, 1] - y) < width].mean(axis=0) for y in about])
    angle = 2.0 * np.pi * np.arange(columns) / columns
    points = np.empty((rows, columns, 3))
    points[..., 0] = np.interp(height, about, middle[:, 0])[:, None] + radius * np.sin(angle)
    points[..., 1] = height[:, None]
    points[..., 2] = np.interp(height, about, middle[:, 2])[:, None] + radius * np.cos(angle)
    return closest_points(build_tree(x, faces), points.reshape(-1, 3)).point


def samples(points: Float, ptr: Int, number: int) -> Float:
    """(m, 3) points at equal distances on every piece of polylines, both its ends included."""
    inside = np.ones(len(points), bool)
    inside[ptr[1:] - 1] = False
    first = np.flatnonzero(inside)
    share = np.linspace(0.0, 1.0, number)[:, None]
    a, b = points[first][:, None], points[first + 1][:, None]
    return np.asarray((a + share * (b - a)).reshape(-1, 3))


def brute_depths(points: Float, x: Float, faces: Int) -> Float:
    """(n,) how deep points lie in a closed mesh [m], negative outside: distances to every triangle, and winding."""
    found = np.empty(len(points))
    for at in range(0, len(points), 256):
        part = points[at : at + 256]
        distance = brute_distance(part, x, faces).min(axis=1)
        found[at : at + 256] = np.where(winding_number(part, x, faces) > 0.5, distance, -distance)
    return found
