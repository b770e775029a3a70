"""Depth of points inside bodies, to measure the result of the contact force.

This is independent of the kernel that computes the force (all points against one primitive at a
time, in the primitive's own frame), so that a mistake there shows here.
"""

from __future__ import annotations

import functools
from collections.abc import Container, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno.collision.crossings import Mesh
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
# A point is inside where a ray from it along x crosses the mesh an odd number of times. Triangles are listed by the
# cells of a grid over y and z, so that a ray tests those of its own cell. Which side of an edge a ray passes is
# computed from the edge's ends in the order of their numbers, and so with the same bits for both of its triangles: a
# ray that hits an edge or a vertex crosses exactly one. The distance is computed only for points inside, to the
# triangles that may be nearer than the nearest centre.

AT_ONCE = 2_000_000
"""Pairs of points and triangles whose distances are computed together."""
ROUNDING = 1e-9
"""Relative margin for rounding of a triangle's box, in cells, and of the bound of a distance."""


@dataclass(frozen=True)
class Columns:
    """A mesh whose triangles are listed by the cells (y, z) that they overlap.

    low (2,) [m], size [m] and shape (2,) of the cells; triangles of cell k are listed[start[k]:start[k + 1]].
    Rays that cross a triangle start in its box of `reached`, which is unbounded towards -x.
    """

    vertices: Float
    faces: Int
    low: Float
    size: float
    shape: tuple[int, int]
    start: NDArray[np.int64]
    listed: NDArray[np.int64]
    reached: Boxes

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


def make_columns(vertices: Float, faces: Int) -> Columns:
    """List triangles by cells about as wide as they are, so that a cell has few."""
    lowest, highest = _boxes_of(np.ascontiguousarray(vertices.T), faces)
    least, most = lowest[1:].T, highest[1:].T
    low, high = least.min(axis=0), most.max(axis=0)
    size = max(float((most - least).mean()), float((high - low).max()) / 2048) or 1.0
    shape = (int((high - low)[0] / size) + 1, int((high - low)[1] / size) + 1)
    first = ((least - low) / size).astype(np.int64)
    last = np.minimum(((most - low) / size).astype(np.int64), np.array(shape) - 1)
    wide = last - first + 1
    count = wide.prod(axis=1)
    face = np.repeat(np.arange(len(faces)), count)
    step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    row, column = first[face, 0] + step // wide[face, 1], first[face, 1] + step % wide[face, 1]
    cell = row * shape[1] + column
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(shape[0] * shape[1] + 1))
    lowest[0] = -np.inf
    reached = lowest - ROUNDING * size, highest + ROUNDING * size
    return Columns(vertices, faces, low, size, shape, start.astype(np.int64), face[order], reached)


def are_inside(points: Float, columns: Columns) -> Bool:
    """Return whether points (n, 3) lie inside, shape (n,)."""
    place = (points[:, 1:] - columns.low) / columns.size
    within = ((place >= 0.0) & (place < np.array(columns.shape))).all(axis=1)
    which = np.flatnonzero(within)
    cell = place[which].astype(np.int64) @ np.array([columns.shape[1], 1])
    count = columns.start[cell + 1] - columns.start[cell]
    point = np.repeat(which, count)
    step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    along = np.ascontiguousarray(points.T)
    face = columns.listed[np.repeat(columns.start[cell], count) + step]
    point, face = _overlap(point, (along, along), face, columns.reached)
    crossed = np.bincount(point[_cross(points[point], columns, face)], minlength=len(points))
    return np.asarray(crossed % 2 == 1)


def _cross(p: Float, columns: Columns, face: NDArray[np.int64]) -> Bool:
    """Return whether the rays from p (m, 3) towards +x cross the triangles `face` (m,), shape (m,)."""
    corner = columns.faces[face]
    sides = []
    for k in range(3):
        a, b = corner[:, k], corner[:, (k + 1) % 3]
        first, second = np.minimum(a, b), np.maximum(a, b)
        start, along = columns.vertices[first, 1:], columns.vertices[second, 1:] - columns.vertices[first, 1:]
        off = p[:, 1:] - start
        left = along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0] >= 0.0
        sides.append(left == (a < b))
    same_side = (sides[0] == sides[1]) & (sides[1] == sides[2])
    start, second_corner, third = (columns.vertices[corner[:, k]] for k in range(3))
    normal = np.cross(second_corner - start, third - start)
    height = ((p - start) * normal).sum(axis=1)
    return np.asarray(same_side & (height * normal[:, 0] < 0.0))


def distances(points: Float, columns: Columns) -> Float:
    """Return the distance (n,) [m] of points (n, 3) to the nearest triangle."""
    (near, groups), corners = columns.trees, columns.vertices[columns.faces]
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


FEW = 32
"""Triangles of about a size, as large ones of a box, whose distances are computed, not bounded by their centres'."""
PARTS = np.array([(2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (0, 1, 1), (1, 0, 1), (2 / 3, 2 / 3, 2 / 3)]) / 2.0
"""Barycentric coordinates (7, 3) of the corners of the six parts into which a triangle's medians cut it."""
WEIGHTS = np.array([1, 1, 1, 1, 1, 1, 3]) / 9.0
"""Share (7,) of the triangle's area at each of them: a third of each part that has it as a corner."""
_COLUMNS: dict[int, tuple[Geometry, Columns]] = {}
"""Columns of the last few meshes, by the identity of their geometry."""


def columns_of(geometry: Geometry, primitive: int) -> Columns:
    """Return the columns of a primitive with a mesh, made once."""
    key = hash((id(geometry), primitive))
    cached = _COLUMNS.get(key)
    if cached is None or cached[0] is not geometry:
        while len(_COLUMNS) >= 16:
            del _COLUMNS[next(iter(_COLUMNS))]
        cached = _COLUMNS[key] = (geometry, make_columns(*geometry.mesh(primitive)))
    return cached[1]


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
        least = _least(x, geometry, poses, i)
        entered = np.flatnonzero(finite & (least < 0.0))
        depth[entered] = np.maximum(depth[entered], -_lowest(x[entered], geometry, poses, [i], True))
        radius = {CAPSULE: float(geometry.radius[i]), PLANE: np.inf}.get(int(geometry.kind[i]), 0.0)
        margin = np.sqrt(radius**2 + spread) - radius if radius < np.inf else 0.0 * spread
        near = np.flatnonzero(np.minimum(np.minimum(least[one], least[two]), least[three]) < margin)
        if len(near):
            points = (PARTS @ corners[near]).reshape(-1, 3)
            distance = _lowest(points, geometry, poses, [i], True).reshape(len(near), -1)
            inside[near] |= distance < 0.0
            deepest = max(deepest, -float(distance.min()))
    return Inside(depth, float(face_areas(corners) @ (inside @ WEIGHTS)), deepest)


def _are_finite(points: Float) -> NDArray[np.bool_]:
    """Return whether points (n, 3) are finite, shape (n,). Axis by axis: numpy reduces short rows ten times as long."""
    return np.asarray(np.isfinite(points[:, 0]) & np.isfinite(points[:, 1]) & np.isfinite(points[:, 2]))


def _least(x: Float, geometry: Geometry, poses: Poses, i: int) -> Float:
    """Return lower bounds (n,) [m] of the distances of points x (n, 3) to a primitive, negative inside."""
    if geometry.kind[i] not in OF_TRIANGLES or geometry.distance_field(i) is not None:
        return _lowest(x, geometry, poses, [i])
    vertices, faces = geometry.placed(i, poses)
    if geometry.kind[i] == SKIN:
        columns = make_columns(vertices, faces)
    else:
        frame = geometry.frame[i]
        columns, x = columns_of(geometry, i), (x - poses.translation[frame]) @ rotation_matrices(poses.rotation)[frame]
    x, corners = np.where(np.isfinite(x), x, 0.0), columns.vertices[columns.faces]
    least = np.where(are_inside(x, columns), -np.inf, np.inf)
    for tree, size, which in columns.trees[1]:
        if len(which) > FEW:
            least = np.minimum(least, tree.query(x)[0] - size)
        else:
            every = (to_triangles(x, np.broadcast_to(face, (len(x), 3, 3))) for face in corners[which])
            least = functools.reduce(np.minimum, every, least)
    return least


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
    """Return the distance to a mesh; if contact uses a distance field, that of the field, exact to its tolerance: cloth
    at rest lies inside by the depth of penalty contact, and distances of all its vertices to all triangles would take
    longer than the run.
    """
    if (field := geometry.distance_field(i)) is not None:
        return field_distance(p, field) if isinstance(field, DistanceField) else np.asarray(field.distance(*p.T))
    return _to_mesh(p, columns_of(geometry, i), inside_only)


def _bent(p: Float, geometry: Geometry, i: int, poses: Poses, inside_only: bool) -> Float:
    """Return the distance of points in the world to a skin."""
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
