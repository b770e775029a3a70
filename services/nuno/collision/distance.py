"""Depth of points inside bodies, to measure the result of the contact force.

This is independent of the kernel that computes the force (all points against one primitive at a
time, in the primitive's own frame), so that a mistake there shows here.
"""

from __future__ import annotations

import functools
from collections.abc import Container, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno.collision.crossings import Mesh, compiled
from nuno_schemas.bodies import (
    BOX,
    CAPSULE,
    OF_TRIANGLES,
    PLANE,
    SKIN,
    DistanceField,
    Geometry,
    Poses,
    rotation_matrices,
)
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.operation import Beside
from nuno_schemas.vectors import face_areas

Long = NDArray[np.int64]
Boxes = tuple[Float, Float]
"""Lower and upper bounds along each of d axes (d, k) [m]."""


def _boxes_of(along: Float, vertices: Int) -> Boxes:
    """Return the boxes of k elements with vertices (k, w), from coordinates `along` (d, n) on d axes."""
    corners = [along.take(each, axis=1) for each in vertices.T]
    return functools.reduce(np.minimum, corners), functools.reduce(np.maximum, corners)


def _overlap(a: Long, one: Boxes, b: Long, two: Boxes) -> tuple[Long, Long]:
    """Return the pairs of a, b (k,) whose boxes, of two kinds, overlap."""
    for low, high, other_low, other_high in zip(*one, *two, strict=True):
        near = np.flatnonzero((low.take(a) <= other_high.take(b)) & (other_low.take(b) <= high.take(a)))
        a, b = a.take(near), b.take(near)
    return a, b


# Depth of points inside a closed mesh, independent of the search that contact uses.
#
# A point is inside where the mesh goes round it (nuno_contact/crossings.py). The distance is computed only for points
# inside, to the triangles that may be nearer than the nearest centre.

AT_ONCE = 2_000_000
"""Pairs of points and triangles whose distances are computed together."""
ROUNDING = 1e-9
"""Relative margin for rounding of the bound of a distance."""


@dataclass(frozen=True)
class Solid:
    """A mesh: vertices (v, 3) [m] and faces (f, 3); `closed` (g, 3) are the faces of parts that have an inside."""

    vertices: Float
    faces: Int
    closed: Int

    @cached_property
    def trees(self) -> tuple[Any, list[tuple[Any, float, NDArray[np.int64]]]]:
        """A tree of the triangles' centres, and for each group of similar size a tree, the largest distance of a corner
        from its centre [m], and the triangles' numbers.
        """
        corners = self.vertices[self.faces]
        middle = corners.mean(axis=1)
        size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        alike = [np.flatnonzero(np.frexp(size)[1] == like) for like in np.unique(np.frexp(size)[1])]
        return _tree(middle), [(_tree(middle[which]), float(size[which].max()), which) for which in alike]


def _tree(points: Float) -> Any:
    """Build an unbalanced tree: balancing takes longer than it saves, since skins need a new one in every frame."""
    from scipy.spatial import KDTree  # its import takes a second, and is not always needed

    return KDTree(points, compact_nodes=False, balanced_tree=False)


def are_inside(points: Float, solid: Solid) -> Bool:
    """Return whether points (n, 3) lie inside, shape (n,)."""
    return np.asarray(compiled().find_turns(points, solid.vertices, solid.closed) != 0)


def distances(points: Float, solid: Solid) -> Float:
    """Return the distance (n,) [m] of points (n, 3) to the nearest triangle."""
    (near, groups), corners = solid.trees, solid.vertices[solid.faces]
    bound = near.query(points)[0] * (1.0 + ROUNDING)
    least = np.full(len(points), np.inf)
    for tree, size, which in groups:
        reach = bound + size
        count = np.cumsum(tree.query_ball_point(points, reach, return_length=True))
        at = 0
        while at < len(points):
            end = max(at + 1, int(np.searchsorted(count, (count[at - 1] if at else 0) + AT_ONCE, side="right")))
            candidates = tree.query_ball_point(points[at:end], reach[at:end])
            point = np.repeat(np.arange(at, end), [len(faces) for faces in candidates])
            face = which[np.concatenate([*candidates, []]).astype(np.int64)]
            np.minimum.at(least, point, to_triangles(points[point], corners[face]))
            at = end
    return least


PARTS = np.array([(2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (0, 1, 1), (1, 0, 1), (2 / 3, 2 / 3, 2 / 3)]) / 2.0
"""Barycentric coordinates (7, 3) of the corners of the six parts into which a triangle's medians cut it."""
WEIGHTS = np.array([1, 1, 1, 1, 1, 1, 3]) / 9.0
"""Share (7,) of the triangle's area at each of them: a third of each part that has it as a corner."""
_SOLIDS: dict[int, tuple[Geometry, Solid]] = {}
"""Meshes of the last few geometries, by their identity."""


def solid_of(geometry: Geometry, primitive: int, poses: Poses) -> Solid:
    """Return the mesh of a primitive, made once: in its frame, or where a skin is at `poses`."""
    key = hash((id(geometry), primitive))
    cached = _SOLIDS.get(key)
    if cached is None or cached[0] is not geometry:
        while len(_SOLIDS) >= 16:
            del _SOLIDS[next(iter(_SOLIDS))]
        x, faces = geometry.mesh(primitive)
        cached = _SOLIDS[key] = (geometry, Solid(x, faces, faces[compiled().closed_parts(faces)]))
    solid, skin = cached[1], geometry.skin(primitive)
    if skin is None:
        return solid
    frame = int(geometry.frame[primitive])
    return replace(solid, vertices=poses.bend(skin, frame, solid.vertices, compiled().bend_skin))


def signed_distance(points: Float, geometry: Geometry, poses: Poses) -> Float:
    """Return the distance (n,) [m] of points (n, 3) to the union of all bodies, negative inside.

    Points that are not finite, as in the last frame of a diverged run, are outside all bodies.
    """
    return _lowest(points, geometry, poses, range(len(geometry.kind)))


def body_distances(points: Float, geometry: Geometry, poses: Poses, name: str) -> Beside:
    """Return a body by name, with the distances of points (n, 3) from each of its frames."""
    number = geometry.bodies.index(name)
    frames = [i for i, frame in enumerate(geometry.frames) if frame.split("/", 1)[0] == name]
    primitives = [np.flatnonzero((geometry.frame == frame) & (geometry.body == number)).tolist() for frame in frames]
    return Beside(
        tuple(geometry.frames[frame].split("/", 1)[1] for frame in frames),
        poses.rotation[frames],
        poses.translation[frames],
        np.array([_lowest(points, geometry, poses, chosen) for chosen in primitives]),
    )


def penetration(points: Float, geometry: Geometry, poses: Poses) -> Float:
    """Return the depth (n,) [m] of points inside bodies, 0 outside."""
    return np.maximum(-_lowest(points, geometry, poses, _reached(points, geometry, poses), True), 0.0)


def _reached(points: Float, geometry: Geometry, poses: Poses) -> list[int]:
    """Return the primitives whose bounding sphere reaches the points' bounding box: no point can lie inside others.
    Skins are always among them, since they bend.
    """
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return []
    low, high = finite.min(axis=0), finite.max(axis=0)
    centre = 0.5 * (geometry.a + geometry.b)
    reach = 0.5 * np.linalg.norm(geometry.b - geometry.a, axis=1) + geometry.radius
    boxes = geometry.kind == BOX
    centre[boxes], reach[boxes] = geometry.a[boxes], np.linalg.norm(geometry.b[boxes], axis=1)
    turns, skins = rotation_matrices(poses.rotation)[geometry.frame], geometry.kind == SKIN
    centre = np.einsum("pij,pj->pi", turns, centre) + poses.translation[geometry.frame]
    away = np.linalg.norm(np.maximum(np.maximum(low - centre, centre - high), 0.0), axis=1)
    return np.flatnonzero((away <= reach) | (geometry.kind == PLANE) | skins).tolist()


class Inside(NamedTuple):
    """Depth of vertices (n,) [m] inside bodies, area [m^2] of triangles inside of them, and its largest depth [m]."""

    depth: Float
    area: float
    area_depth: float


def measure_inside(x: Float, faces: Int, geometry: Geometry, poses: Poses, met: Container[int] = ()) -> Inside:
    """Return how far cloth x (n, 3), faces (f, 3) lies inside bodies: its vertices, and, but for the bodies `met`, its
    triangles, from seven points each: one whose vertices are outside of a limb may cut through it.

    A point q = sum_i b_i x_i of a triangle, and the point a of a capsule's axis that is nearest to it, have
    |q - a|^2 = sum_i b_i |x_i - a|^2 - sum_i b_i |x_i - q|^2, and the last sum is at most L^2 / 3 for sides up to L. So
    no triangle enters a capsule whose corners are all at least sqrt(r^2 + L^2 / 3) from its axis.
    """
    finite = _are_finite(x)
    faces = faces[finite[faces].all(axis=1)]
    corners, (one, two, three) = x[faces], np.ascontiguousarray(faces.T)
    spread = np.square(corners - np.roll(corners, 1, axis=1)).sum(axis=2).max(axis=1, initial=0.0) / 3.0
    depth, inside, deepest = np.zeros(len(x)), np.zeros((len(faces), len(PARTS)), bool), 0.0
    for i in _reached(x, geometry, poses):
        if not len(faces) or geometry.body[i] in met:
            depth = np.maximum(depth, -_lowest(x, geometry, poses, [i], True))
            continue
        if geometry.kind[i] in OF_TRIANGLES and geometry.distance_field(i) is None:
            least = np.full(len(x), -np.inf)  # that of all points takes less than a bound
        else:
            least = _lowest(x, geometry, poses, [i])
        entered = np.flatnonzero(finite & (least < 0.0))
        radius = {CAPSULE: float(geometry.radius[i]), PLANE: np.inf}.get(int(geometry.kind[i]), 0.0)
        margin = np.sqrt(radius**2 + spread) - radius if radius < np.inf else 0.0 * spread
        near = np.flatnonzero(np.minimum(np.minimum(least[one], least[two]), least[three]) < margin)
        between = (PARTS[3:] @ corners[near]).reshape(-1, 3)
        found, own = _lowest(np.concatenate([x[entered], between]), geometry, poses, [i], True), np.full(len(x), np.inf)
        own[entered] = found[: len(entered)]
        depth = np.maximum(depth, -own)
        if len(near):
            distance = np.concatenate([own[faces[near]], found[len(entered) :].reshape(len(near), -1)], axis=1)
            inside[near] |= distance < 0.0
            deepest = max(deepest, -float(distance.min()))
    return Inside(depth, float(face_areas(corners) @ (inside @ WEIGHTS)), deepest)


def _are_finite(points: Float) -> NDArray[np.bool_]:
    """Return whether points (n, 3) are finite, shape (n,). Axis by axis: numpy reduces short rows ten times as long."""
    return np.asarray(np.isfinite(points[:, 0]) & np.isfinite(points[:, 1]) & np.isfinite(points[:, 2]))


def _lowest(points: Float, geometry: Geometry, poses: Poses, chosen: Iterable[int], inside_only: bool = False) -> Float:
    """Return the signed distance (n,) to the nearest of the chosen primitives; inf for points that are not finite, and
    with `inside_only` for points outside a mesh.
    """
    nearest = np.full(len(points), np.inf)
    finite = _are_finite(points)
    points = np.where(finite[:, None], points, 0.0)
    turns = rotation_matrices(poses.rotation)
    for i in chosen:
        if geometry.kind[i] == SKIN:
            nearest = np.minimum(nearest, _to_mesh(points, solid_of(geometry, i, poses), inside_only))
            continue
        frame = geometry.frame[i]
        local = (points - poses.translation[frame]) @ turns[frame]
        kind, a, b = int(geometry.kind[i]), geometry.a[i], geometry.b[i]
        if kind in OF_TRIANGLES:
            distance = _mesh(local, geometry, i, poses, inside_only)
        else:
            distance = _primitive(local, kind, a, b, float(geometry.radius[i]))
        nearest = np.minimum(nearest, distance)
    return np.where(finite, nearest, np.inf)


def _mesh(p: Float, geometry: Geometry, i: int, poses: Poses, inside_only: bool) -> Float:
    """Return the distance to a mesh; if contact uses a distance field, that of the field, exact to its tolerance: cloth
    at rest lies inside by the depth of penalty contact, and distances of all its vertices to all triangles would take
    longer than the run.
    """
    if (field := geometry.distance_field(i)) is not None:
        return field_distance(p, field) if isinstance(field, DistanceField) else np.asarray(field.distance(*p.T))
    return _to_mesh(p, solid_of(geometry, i, poses), inside_only)


def _to_mesh(p: Float, solid: Solid, inside_only: bool) -> Float:
    inside = are_inside(p, solid)
    if not inside_only:
        return np.where(inside, -1.0, 1.0) * distances(p, solid)
    distance = np.full(len(p), np.inf)
    if inside.any():
        distance[inside] = -distances(p[inside], solid)
    return distance


def _primitive(p: Float, kind: int, a: Float, b: Float, radius: float) -> Float:
    if kind == CAPSULE:
        axis = b - a
        length = float(axis @ axis)
        along = np.clip((p - a) @ axis / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(p))
        away = p - a - along[:, None] * axis
        return np.asarray(np.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + away[:, 2] ** 2) - radius)
    if kind == PLANE:
        return np.asarray((p - a) @ b)
    if kind == BOX:
        q = np.abs(p - a) - b
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=1)
        return np.asarray(outside + np.minimum(q.max(axis=1), 0.0))
    raise ValueError(f"primitive kind {kind}")


def field_distance(p: Float, field: DistanceField) -> Float:
    """Return the distance (n,) [m] of points (n, 3) in the field's frame; outside its box that of the box's nearest
    point, plus the distance to that.
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


# Distances of cloth from cloth.


def vertex_distances(x: Float, mesh: Mesh, pairs: tuple[Int, Int], within: float) -> Float:
    """Return the distance (n,) [m] of each vertex of a mesh x (n, 3) from triangles of edges and triangles in pairs by
    number that share no vertex, and of each triangle's corners from these vertices; at most `within`.
    """
    along = np.ascontiguousarray(x.T)
    low, high = _boxes_of(along, mesh.faces)
    vertex, below = mesh.edges[pairs[0]].ravel().astype(np.int64), pairs[1].repeat(2).astype(np.int64)
    vertex, below = _overlap(vertex, (along, along), below, (low - within, high + within))
    vertex, below = np.divmod(np.unique(vertex * len(mesh.faces) + below), len(mesh.faces))
    distance, found = to_triangles(x[vertex], x[mesh.faces[below]]), np.full(len(x), within)
    np.minimum.at(found, vertex, distance)
    np.minimum.at(found, mesh.faces[below], distance[:, None])
    return found


def to_triangles(p: Float, triangle: Float) -> Float:
    """Return distances (k,) of points p (k, 3) from triangles (k, 3, 3)."""
    a, b, c = (triangle[:, i] for i in range(3))
    return functools.reduce(np.minimum, (_to_edge(p, a, b), _to_edge(p, b, c), _to_edge(p, c, a)), _above(p, triangle))


def _above(p: Float, triangle: Float) -> Float:
    """Return distances (k,) of points p (k, 3) above the inside of triangles (k, 3, 3); inf from others."""
    a, b, c = (triangle[:, i] for i in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    inside = size > 0.0
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= _dot(np.cross(end - start, p - start), normal) >= 0.0
    return np.asarray(np.divide(np.abs(_dot(p - a, normal)), size, out=np.full(len(p), np.inf), where=inside))


def _to_edge(p: Float, a: Float, b: Float) -> Float:
    """Return distances (k,) of points p (k, 3) from edges a b."""
    along = b - a
    size = _dot(along, along)
    share = np.divide(_dot(p - a, along), size, out=np.zeros(len(p)), where=size > 0.0).clip(0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - share[:, None] * along, axis=1))


def _dot(a: Float, b: Float) -> Float:
    return np.asarray(np.einsum("ki,ki->k", a, b))
