"""Yarns in simple places: straight, round a hoop, on a plane."""

from __future__ import annotations

import numpy as np

from nuno_render.config import YarnsConfig
from nuno_render.rays.yarns import radiance
from nuno_schemas.operation import YarnCurves
from nuno_schemas.pictures import Camera, Mesh, Worn

BARE = {"ground": "none", "shadows": False, "occlusion": False}


def curves(yarns, radius):
    """Yarns along polylines, all of one radius."""
    ptr = np.cumsum([0, *(len(points) for points in yarns)])
    points = np.concatenate(yarns).astype(float)
    count = len(yarns)
    zero = np.zeros_like(points)
    return YarnCurves(points, ptr, np.full(count, float(radius)), np.zeros(count, np.int32), ("yarn",), zero)


def worn(yarns, *bodies):
    """Yarns on bodies, whose links are the pieces of the curves."""
    first = yarns.segments()
    links = np.stack([first, first + 1], axis=1).astype(np.int32)
    return Worn(bodies, yarns.points, links, yarns)


def parallel(spacing, radius, half=2.0, height=0.0, axis=1, pieces=7):
    """Yarns along x (axis 0) or y (axis 1), cut into pieces."""
    across = np.arange(-half, half, spacing)
    along = np.linspace(-half, half, pieces + 1)
    lines = []
    for place in across:
        line = np.full((len(along), 3), height)
        line[:, axis], line[:, 1 - axis] = along, place
        lines.append(line)
    return curves(lines, radius)


def joined(a, b):
    """Both."""
    lines = [x.points[i:j] for x in (a, b) for i, j in zip(x.ptr[:-1], x.ptr[1:], strict=True)]
    return curves(lines, a.radius[0])


def plane(half=2.0, height=0.0):
    """A square of white skin, seen from above."""
    x = half * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + [0, 0, height]
    return Mesh(x, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.ones((4, 3)))


def above(half=1.0, size=(16, 16), distance=1e4):
    """A camera so far above that its rays are parallel to a part in ten thousand, on [-half, half]^2."""
    fov = 2 * np.arctan(half / distance)
    return Camera(np.array([0.0, 0.0, distance]), np.zeros(3), np.array([0.0, 1.0, 0.0]), fov, size)


def shares(yarns, camera, *bodies, **config):
    """(h, w) share of each pixel that is yarn."""
    return radiance(YarnsConfig(**{**BARE, "translucency": 0.0, **config}), worn(yarns, *bodies), camera)[..., 3]


def everywhere(tree):
    """A tree whose boxes hold all of space: every item is looked at."""
    boxes = tree.boxes.copy().reshape(-1, 6, 8)
    known = np.isfinite(boxes).all(axis=1)
    for side in range(6):
        boxes[:, side][known] = -1e9 if side < 3 else 1e9
    return tree._replace(boxes=boxes.reshape(-1, 8))
