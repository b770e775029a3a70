"""Which triangles of cloth meet bodies, by tests of triangles that have nothing of the product's own measure.

Limbs by the distance of a triangle from their axis, boxes by separating axes, meshes by edges through triangles.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from nuno_schemas.bodies import BOX, CAPSULE, PLANE, Geometry, Poses, rotation_matrices
from nuno_schemas.fabric import Bool, Float, Int

SIDES = ((0, 1), (1, 2), (2, 0))


def meeting(x: Float, faces: Int, geometry: Geometry, poses: Poses) -> Bool:
    """Whether each triangle has a part inside a body, shape (f,)."""
    found, turns = np.zeros(len(faces), bool), rotation_matrices(poses.rotation)
    for p, kind in enumerate(geometry.kind.tolist()):
        frame, a, b, radius = geometry.frame[p], geometry.a[p], geometry.b[p], geometry.radius[p]
        local = (x - poses.translation[frame]) @ turns[frame]
        if kind == PLANE:
            found |= (((local - a) @ b)[faces] < 0.0).any(axis=1)
        elif kind == CAPSULE:
            found |= _to_segment(local[faces], a, b) < radius
        elif kind == BOX:
            found |= _in_box(local[faces] - a, b)
        else:
            found |= _in_mesh(x, faces, *geometry.placed(p, poses))
    return found


def _dot(a: Float, b: Float) -> Float:
    return np.einsum("...i,...i->...", a, b)


def _to_segment(t: Float, a: Float, b: Float) -> Float:
    """Distance of triangles (f, 3, 3) from a segment: that of its ends, or of the sides, or none where it crosses."""
    ends = np.broadcast_to(np.stack([a, b]), (len(t), 2, 3))
    least = np.minimum(*(_to_triangle(ends[:, k], t) for k in (0, 1)))
    for i, j in SIDES:
        least = np.minimum(least, _between(t[:, i], t[:, j], ends[:, 0], ends[:, 1]))
    return np.where(_pass(ends, t), 0.0, least)


def _to_triangle(p: Float, t: Float) -> Float:
    """Distance of points (f, 3) from triangles: above them by height, else from the sides."""
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    above = np.all([_dot(np.cross(t[:, j] - t[:, i], p - t[:, i]), normal) >= 0.0 for i, j in SIDES], axis=0)
    height = np.abs(_dot(p - t[:, 0], normal)) / np.linalg.norm(normal, axis=1)
    sides = np.min([_between(t[:, i], t[:, j], p, p) for i, j in SIDES], axis=0)
    return np.where(above, height, sides)


def _between(a: Float, b: Float, c: Float, d: Float) -> Float:
    """Distance between segments a b and c d (f, 3), by turns along one and along the other: it is convex."""
    u, v = b - a, d - c
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    least = np.full(len(a), np.inf)
    inner = (uv * _dot(v, a - c) - vv * _dot(u, a - c)) / np.where(uu * vv - uv * uv > 0.0, uu * vv - uv * uv, np.inf)
    ends = [_dot(end - a, u) / np.where(uu > 0.0, uu, 1.0) for end in (c, d)]
    for s in (inner, 0.0 * uu, 0.0 * uu + 1.0, *ends):
        at = a + np.clip(s, 0.0, 1.0)[:, None] * u
        on = c + np.clip(_dot(at - c, v) / np.where(vv > 0.0, vv, 1.0), 0.0, 1.0)[:, None] * v
        least = np.minimum(least, np.linalg.norm(at - on, axis=1))
    return least


def _in_box(t: Float, half: Float) -> Bool:
    """Whether triangles (f, 3, 3) overlap a box about the origin, by separating axes."""
    sides = np.stack([t[:, j] - t[:, i] for i, j in SIDES], axis=1)
    across = [np.cross(sides[:, k], axis) for k in range(3) for axis in np.eye(3)]
    axes = [*(np.broadcast_to(axis, (len(t), 3)) for axis in np.eye(3)), np.cross(sides[:, 0], sides[:, 1]), *across]
    overlap = np.ones(len(t), bool)
    for axis in axes:
        along, reach = np.einsum("fki,fi->fk", t, axis), np.abs(axis) @ half
        overlap &= ((along.min(axis=1) < reach) & (along.max(axis=1) > -reach)) | (np.abs(axis).max(axis=1) < 1e-15)
    return overlap


def _pass(segment: Float, t: Float) -> Bool:
    """Whether segments (k, 2, 3) pass through triangles (k, 3, 3)."""
    p, q = segment[:, 0], segment[:, 1]
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    across = _dot(p - t[:, 0], normal) * _dot(q - t[:, 0], normal) < 0.0
    turns = np.array([_dot(np.cross(t[:, i] - p, t[:, j] - p), q - p) for i, j in SIDES])
    return across & ((turns >= 0.0).all(axis=0) | (turns <= 0.0).all(axis=0))


def _in_mesh(x: Float, faces: Int, body: Float, body_faces: Int) -> Bool:
    """Whether triangles cross a closed mesh, or are part of a piece of cloth that is inside without crossing it."""
    cloth, solid = x[faces], body[body_faces]
    middle, other = cloth.mean(axis=1), solid.mean(axis=1)
    size, reach = (np.linalg.norm(t - m[:, None], axis=2).max(axis=1) for t, m in ((cloth, middle), (solid, other)))
    found = np.zeros(len(faces), bool)
    tree = KDTree(middle)
    for low in range(0, len(solid), 2000):
        near = tree.query_ball_point(other[low : low + 2000], reach[low : low + 2000] + size.max())
        b = np.repeat(np.arange(low, low + len(near)), [len(one) for one in near])
        c = np.concatenate([*near, []]).astype(np.int64)
        low_high = [(t[k].min(axis=1), t[k].max(axis=1)) for t, k in ((cloth, c), (solid, b))]
        apart = (low_high[0][0] > low_high[1][1]) | (low_high[1][0] > low_high[0][1])
        b, c = b[~apart.any(axis=1)], c[~apart.any(axis=1)]
        through = np.zeros(len(c), bool)
        for i, j in SIDES:
            through |= _pass(cloth[c][:, [i, j]], solid[b]) | _pass(solid[b][:, [i, j]], cloth[c])
        found[c[through]] = True
    links = coo_array((np.ones(2 * len(faces)), faces[:, [0, 1, 0, 2]].reshape(-1, 2).T), shape=(len(x), len(x)))
    _, part = connected_components(links, directed=False)
    for one in np.unique(part[faces[:, 0]]).tolist():
        triangles = np.flatnonzero(part[faces[:, 0]] == one)
        if not found[triangles].any() and turns_about(x[faces[triangles[0], 0]], solid) > 0.5:
            found[triangles] = True
    return found


def turns_about(p: Float, t: Float) -> float:
    """How often a closed mesh of triangles (f, 3, 3) goes round a point, by solid angles."""
    a, b, c = (t[:, k] - p for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    below = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
    return float(np.arctan2(_dot(a, np.cross(b, c)), below).sum() / (2.0 * np.pi))
