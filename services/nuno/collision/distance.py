"""How deep points lie inside bodies, to measure what the contact force achieved.

Written apart from the kernel that computes the force, in another way (all points against one
primitive at a time, in the primitive's own frame), so that a mistake there shows up here.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from nuno.collision.mesh import Columns, are_inside, columns_of, distances, make_columns
from nuno_schemas.bodies import BOX, CAPSULE, OF_TRIANGLES, PLANE, SKIN, Geometry, Poses, rotation_matrices
from nuno_schemas.fabric import Float
from nuno_schemas.field import DistanceField
from nuno_schemas.operation import Beside


def signed_distance(points: Float, geometry: Geometry, poses: Poses) -> Float:
    """(n,) distance [m] of (n, 3) points to the union of all bodies, negative inside.

    Points that are not finite, as in the last frame of a diverged run, are outside of everything.
    """
    return _lowest(points, geometry, poses, range(len(geometry.kind)))


def beside(points: Float, geometry: Geometry, poses: Poses, name: str) -> Beside:
    """A body, by its name, beside (n, 3) points."""
    number = geometry.bodies.index(name)
    own = [i for i, frame in enumerate(geometry.frames) if frame.split("/", 1)[0] == name]
    carried = [np.flatnonzero((geometry.frame == frame) & (geometry.body == number)).tolist() for frame in own]
    return Beside(
        tuple(geometry.frames[frame].split("/", 1)[1] for frame in own),
        poses.rotation[own],
        poses.translation[own],
        np.array([_lowest(points, geometry, poses, chosen) for chosen in carried]),
    )


def penetration(points: Float, geometry: Geometry, poses: Poses) -> Float:
    """(n,) how deep [m] points lie inside bodies, 0 outside.

    Primitives whose bounding sphere does not reach the points' bounding box are passed over: nothing can lie inside of
    them. Not so skins, which bend.
    """
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return np.zeros(len(points))
    low, high = finite.min(axis=0), finite.max(axis=0)
    centre = 0.5 * (geometry.a + geometry.b)
    reach = 0.5 * np.linalg.norm(geometry.b - geometry.a, axis=1) + geometry.radius
    boxes = geometry.kind == BOX
    centre[boxes], reach[boxes] = geometry.a[boxes], np.linalg.norm(geometry.b[boxes], axis=1)
    turns, skins = rotation_matrices(poses.rotation)[geometry.frame], geometry.kind == SKIN
    centre = np.einsum("pij,pj->pi", turns, centre) + poses.translation[geometry.frame]
    away = np.linalg.norm(np.maximum(np.maximum(low - centre, centre - high), 0.0), axis=1)
    near = np.flatnonzero((away <= reach) | (geometry.kind == PLANE) | skins)
    return np.maximum(-_lowest(points, geometry, poses, near, True), 0.0)


def _lowest(points: Float, geometry: Geometry, poses: Poses, chosen: Iterable[int], inside_only: bool = False) -> Float:
    """(n,) signed distance to the nearest of the chosen primitives, inf for points not finite, and, where only
    points inside count, for points outside of a mesh.
    """
    nearest = np.full(len(points), np.inf)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    points = np.where(finite[:, None], points, 0.0)
    turns = rotation_matrices(poses.rotation)
    for i in chosen:
        if geometry.kind[i] == SKIN:
            nearest = np.minimum(nearest, _bent(points, geometry, i, poses, inside_only))
            continue
        frame = geometry.frame[i]
        local = (points - poses.translation[frame]) @ turns[frame]
        kind, a, b = int(geometry.kind[i]), geometry.a[i], geometry.b[i]
        if kind in OF_TRIANGLES:
            distance = _mesh(local, geometry, i, inside_only)
        else:
            distance = _primitive(local, kind, a, b, float(geometry.radius[i]))
        nearest = np.minimum(nearest, distance)
    return np.where(finite, nearest, np.inf)


def _mesh(p: Float, geometry: Geometry, i: int, inside_only: bool) -> Float:
    """To a mesh; of a field that contact is with what it says, exact to its tolerance: cloth that rests on it lies
    inside by the depth of penalty contact, and the distance of so many vertices to every triangle would take longer
    than the run.
    """
    if (field := geometry.distance_field(i)) is not None:
        return field_distance(p, field)
    return _to_mesh(p, columns_of(geometry, i), inside_only)


def _bent(p: Float, geometry: Geometry, i: int, poses: Poses, inside_only: bool) -> Float:
    """To a skin, of points in the world."""
    vertices, faces = geometry.placed(i, poses)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    near = ((p >= low) & (p <= high)).all(axis=1) if inside_only else np.ones(len(p), bool)
    distance = np.full(len(p), np.inf)
    if near.any():
        distance[near] = _to_mesh(p[near], make_columns(vertices, faces), inside_only)
    return distance


def _to_mesh(p: Float, columns: Columns, inside_only: bool) -> Float:
    inside = are_inside(p, columns)
    if not inside_only:
        return np.where(inside, -1.0, 1.0) * distances(p, columns)
    distance = np.full(len(p), np.inf)
    if inside.any():
        distance[inside] = -distances(p[inside], columns)
    return distance


def _primitive(p: Float, kind: int, a: Float, b: Float, radius: float) -> Float:
    if kind == CAPSULE:
        axis = b - a
        length = float(axis @ axis)
        along = np.clip((p - a) @ axis / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(p))
        return np.asarray(np.linalg.norm(p - a - along[:, None] * axis, axis=1) - radius)
    if kind == PLANE:
        return np.asarray((p - a) @ b)
    if kind == BOX:
        q = np.abs(p - a) - b
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=1)
        return np.asarray(outside + np.minimum(q.max(axis=1), 0.0))
    raise ValueError(f"primitive kind {kind}")


def field_distance(p: Float, field: DistanceField) -> Float:
    """(n,) distance [m] of points (n, 3) in the field's frame; outside of its box that of the box's nearest point,
    and so much longer as that is away.
    """
    place = np.clip((p - field.low) / field.size, 0.0, field.shape)
    away = np.linalg.norm(p - field.low - field.size * place, axis=1)
    cell = np.minimum(np.floor(place).astype(np.int64), field.shape - 1)
    place = place - cell
    at = field.child[(cell[:, 0] * field.shape[1] + cell[:, 1]) * field.shape[2] + cell[:, 2]].astype(np.int64)
    while (inner := at >= 0).any():
        place = np.where(inner[:, None], 2.0 * place, place)
        part = inner[:, None] & (place >= 1.0)
        place = place - part
        at = np.where(inner, field.child[np.where(inner, at + part @ np.array([4, 2, 1]), 0)], at)
    values = field.corners[-1 - at, ::4].astype(np.float64).reshape(-1, 2, 2, 2)
    for axis in range(3):
        share = place[:, axis].reshape(-1, *(1,) * (2 - axis))
        values = values[:, 0] * (1.0 - share) + values[:, 1] * share
    return np.asarray(values + away)
