"""Rows round a limb: rings about a closed mesh from one end to the other that follow it round any bend and cover it.

A row is what a band would be, drawn tight round a level of a field on the surface: the convex hull of the level, seen
along the limb, so that it spans hollows and gaps between toes. The field is harmonic (nuno_geometry.harmonic)
between plane sections across the limb's axis at both ends, so that its levels never cross, not at a heel either, where
planes across the axis do. Beyond the first section, towards the limb's tip, levels are planes: all toes come under the
same rows, where a harmonic field would go round one of them. Rows are the same mean distance apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_geometry.centreline import Centreline, axis_by_levels, axis_by_planes, follow_axis, way_from
from nuno_geometry.closest_point import closest_points
from nuno_geometry.harmonic import solve_harmonic
from nuno_geometry.normals import edge_numbers
from nuno_geometry.sections import Loop, cut_mesh, section_about
from nuno_geometry.tree import Tree, build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import dot, norm

SAMPLES, AROUND = 160, 32
"""rings, and points of each, from which heights are found"""
ENDS = (0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.3)
"""shares of the limb's length over the surface at which the automatic axis may begin and end"""
DEEP = 0.4
"""least depth of the axis's ends below the surface, in radii girth / (2 pi)"""
FINER = 3
"""most halvings of edges, if the mesh has none between the two ends"""
TIP, DRAWN = 0.02, 0.2
"""The first ring towards a tip is that of a level so near to it, as a share of the way to the first section, drawn
together to this share and moved beyond the tip, by as much as the tip lies beyond the level."""


@dataclass(frozen=True)
class Rows:
    """r rows of q points round a limb, from its start to its end, in equal steps round it.

    points (r, q, 3) [m], to the right seen from outside with the end up; normal (r, q, 3) unit, outwards in the row's
    plane; girth (r,) [m]; height [m] from the first row to the last
    """

    points: Float
    normal: Float
    girth: Float
    height: float


def find_limb(x: Float, faces: Int) -> Centreline:
    """Find the axis of a mesh that is one limb, from its thinner end to the other, from the mesh alone.

    Its ends are about the two vertices farthest apart over the surface. Where the limb ends in a flat cap, such a
    vertex is on its rim, and levels of the way from there stand askew; those of the way from the other end do not.
    """
    tree = build_tree(x, faces)
    far = _farthest(x, faces, 0)
    near = [way_from(x, faces, x[vertex]) for vertex in (far, _farthest(x, faces, far))]
    line = axis_by_planes(x, faces, _round_places(x, faces, near, tree), tree)
    if line is None:
        opposite = [np.max(way, initial=0.0, where=np.isfinite(way)) - way for way in near[::-1]]
        line = axis_by_levels(x, faces, _round_places(x, faces, opposite, tree))
    return follow_axis(x, faces, line, tree)


def _round_places(x: Float, faces: Int, ways: list[Float], tree: Tree) -> Float:
    """Return the axis's beginning, the thinner end, and its end (2, 3), by the way (n,) from each end [m]."""
    loops = sorted((_round_place(x, faces, way, tree) for way in ways), key=lambda loop: loop.girth)
    return np.array([loop.centroid() for loop in loops])


def _round_place(x: Float, faces: Int, way: Float, tree: Tree) -> Loop:
    """Return the first level of the way (n,) from an end round a middle that lies deep enough."""
    length = float(way[np.isfinite(way)].max())
    for share in ENDS:
        level = np.where(np.isfinite(way), way, 2.0 * length) - share * length
        loop = max(cut_mesh(x, faces, level), key=lambda one: one.girth)
        if closest_points(tree, loop.centroid()[None]).distance[0] < -DEEP * loop.girth / (2.0 * np.pi):
            return loop
    raise BadInput(
        "no axis is found for this mesh", field="between", remedy="give two places inside of the limb, [[x, y, z], ..]"
    )


def _farthest(x: Float, faces: Int, vertex: int) -> int:
    way = way_from(x, faces, x[vertex])
    return int(np.argmax(np.where(np.isfinite(way), way, -1.0)))


def lay_rows(x: Float, faces: Int, line: Float, rows: int, columns: int, to_tip: bool) -> Rows:
    """Lay rows over a limb from the first to the last point of the line (k, 3) [m] inside of it; `to_tip`: from the tip
    of the limb beyond the first point.

    Raises BadInput where the surface between the two ends is not one tube.
    """
    x, faces, field, lowest = _find_field(x, faces, line, to_tip)
    levels = np.linspace(lowest, line_length(line), SAMPLES)
    points, _, _ = _lay_rings(x, faces, field, levels, AROUND, lowest if to_tip else -np.inf)
    height = np.linalg.norm(np.diff(points, axis=0), axis=-1).mean(axis=1)
    along = np.concatenate([[0.0], np.cumsum(height)])
    chosen = np.interp(np.linspace(0.0, along[-1], rows), along, levels)
    points, normal, girth = _lay_rings(x, faces, field, chosen, columns, lowest if to_tip else -np.inf)
    return Rows(points, normal, girth, float(along[-1]))


def _lay_rings(
    x: Float, faces: Int, field: Float, levels: Float, columns: int, tip: float
) -> tuple[Float, Float, Float]:
    """Return points and outward normals (r, columns, 3) and girths (r,) of rings at levels (r,); at the level `tip` the
    ring is drawn together, and lies twice as far out as the surface reaches.
    """
    loops = [_loops_at(x, faces, field - level) for level in levels]
    centres = np.array([max(found, key=lambda loop: loop.girth).centroid() for found in loops])
    points, normal, girth = np.empty((len(levels), columns, 3)), np.empty((len(levels), columns, 3)), []
    for row, (seam, tangent) in enumerate(_carry_seam(centres)):
        around = np.concatenate([loop.points for loop in loops[row]])
        points[row], normal[row], length = spread_hull(around, centres[row], seam, np.cross(tangent, seam), columns)
        if levels[row] == tip:
            middle = points[row].mean(axis=0)
            reach = float(dot(x[field < tip] - middle, tangent).min(initial=0.0))
            points[row] = middle + DRAWN * (points[row] - middle) + 2.0 * reach * tangent
            length *= DRAWN
        girth.append(length)
    return points, normal, np.array(girth)


def line_length(line: Float) -> float:
    """Return the length of a line of points (k, 3) [m]."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _find_field(x: Float, faces: Int, line: Float, to_tip: bool) -> tuple[Float, Int, Float, float]:
    """Return the mesh, refined if the ends are close, the field (n,) on it, and its value at the first ring: 0 at the
    plane through the line's first point, and the line's length at that through its last; beyond the first plane the
    distance from it, towards the tip.

    Vertices beyond the ends get values beyond those.
    """
    length = line_length(line)
    few = max(1, len(line) // 16)
    ways = [line[few] - line[0], line[-1] - line[-1 - few]]
    across = [(point, way / norm(way)) for point, way in zip(line[[0, -1]], ways, strict=True)]
    x, faces, loops, (start, end) = _part(x, faces, across)
    planes = [dot(x - point, way) for point, way in across]
    given, value = start | end, np.where(end, 2.0 * length, np.where(start, -length, 0.0))
    _give(given, value, loops[1], length + planes[1])
    _give(given, value, loops[0], planes[0])
    field = solve_harmonic(x, faces, given, value)
    if not to_tip:
        return x, faces, field, 0.0
    return x, faces, np.where(start, planes[0], field), (1.0 - TIP) * float(planes[0][start].min())


def _part(x: Float, faces: Int, across: list[tuple[Float, Float]]) -> tuple[Float, Int, list[Loop], tuple[Bool, Bool]]:
    """Return the mesh, refined as needed, the sections by planes `across` it at both ends, and which vertices lie
    beyond each. Raises BadInput if they do not part the mesh so.
    """
    for _ in range(FINER + 1):
        found = [section_about(x, faces, point, way) for point, way in across]
        loops = [loop for loop in found if loop is not None]
        if len(loops) < 2:
            remedy = "give places inside of the mesh"
            raise BadInput("the axis does not lie in the limb", field="between", remedy=remedy)
        parts = _split(x, faces, loops, [dot(x - point, way) for point, way in across])
        if parts is not None:
            return x, faces, loops, parts
        if not _in_one_ring(loops[0], loops[1], across):
            break
        x, faces = _halve(x, faces)
    raise BadInput(
        "the two ends of the axis do not take one tube out of the mesh", field="between",
        remedy="give places on one limb, before it joins the rest or meets itself",
    )  # fmt: skip


def _in_one_ring(first: Loop, last: Loop, across: list[tuple[Float, Float]]) -> bool:
    """Whether two sections that do not cross have no row of edges between them, since the mesh is too coarse there."""
    sides = [dot(loop.points - point, way) for loop, (point, way) in zip((last, first), across, strict=True)]
    apart = any((side > 0.0).all() or (side < 0.0).all() for side in sides)
    return apart and bool(np.isin(first.edges, last.edges).any())


def _halve(x: Float, faces: Int) -> tuple[Float, Int]:
    """Halve all edges of a surface."""
    from trimesh.remesh import subdivide

    x, faces = subdivide(x, faces)
    return np.ascontiguousarray(x, np.float64), np.ascontiguousarray(faces, np.int32)


def _give(fixed: Bool, value: Float, loop: Loop, values: Float) -> None:
    """Set the ends of the edges that a section cuts to `values` (n,), in place."""
    ends = np.unique(loop.edges)
    fixed[ends], value[ends] = True, values[ends]


def _split(x: Float, faces: Int, loops: list[Loop], planes: list[Float]) -> tuple[Bool, Bool] | None:
    """Return which vertices (n,) lie beyond the first section, and which beyond the second; None if the sections do not
    part the mesh so.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components  # slow to import, for knits over limbs alone

    _, pairs = edge_numbers(faces)
    key = pairs[:, 0].astype(np.int64) * len(x) + pairs[:, 1]
    cut = np.isin(key, np.concatenate([loop.edges[:, 0] * len(x) + loop.edges[:, 1] for loop in loops]))
    kept = pairs[~cut]
    joined = coo_array((np.ones(len(kept)), kept.T), (len(x), len(x)))
    part = connected_components(joined, directed=False)[1]
    sides = []
    for loop, plane in zip(loops, planes, strict=True):
        ends = loop.edges.reshape(-1)
        sides.append((np.unique(part[ends[plane[ends] >= 0.0]]), np.unique(part[ends[plane[ends] < 0.0]])))
    (inner, before), (beyond, same) = sides
    if not (len(inner) == len(same) == 1 and inner[0] == same[0]) or inner[0] in before or inner[0] in beyond:
        return None
    return np.isin(part, before), np.isin(part, beyond)


def _loops_at(x: Float, faces: Int, value: Float) -> list[Loop]:
    loops = cut_mesh(x, faces, value)
    if not loops:
        raise BadInput("no row goes round the limb there", field="between", remedy="move the ends of the axis inwards")
    return loops


def _carry_seam(centres: Float) -> list[tuple[Float, Float]]:
    """Return (seam, tangent) of every row: directions in which columns begin, turned along from the last row to the
    first as little as the axis turns. At the last row the seam points to -z, or to -y if the limb does so itself.
    """
    few = max(1, len(centres) // 24)
    ahead = np.minimum(np.arange(len(centres)) + few, len(centres) - 1)
    behind = np.maximum(np.arange(len(centres)) - few, 0)
    tangent = centres[ahead] - centres[behind]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    seam = np.array([0.0, 0.0, -1.0]) if abs(tangent[-1, 2]) < 0.7 else np.array([0.0, -1.0, 0.0])
    found = []
    for t in tangent[::-1]:
        seam = seam - dot(seam, t) * t
        seam = seam / norm(seam)
        found.append((seam, t))
    return found[::-1]


def spread_hull(around: Float, centre: Float, seam: Float, side: Float, columns: int) -> tuple[Float, Float, float]:
    """Return points (columns, 3) in equal steps along the convex hull of places (k, 3), as seen across the unit
    directions `seam` and `side`, from the seam on towards the side; the hull's normals there, and its length.
    """
    flat = np.stack([dot(around - centre, way) for way in (seam, side)], axis=1)
    hull = convex_hull(flat)
    corners = np.concatenate([around[hull], flat[hull]], axis=1)
    edge = np.roll(corners[:, 3:], -1, axis=0) - corners[:, 3:]
    edge /= np.linalg.norm(edge, axis=1, keepdims=True)
    out = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    corners = np.concatenate([corners[:, :3], out + np.roll(out, 1, axis=0), corners[:, 3:]], axis=1)
    v, after = corners[:, 6], np.roll(corners[:, 6], -1)
    k = int(np.argmax((v < 0.0) & (after >= 0.0)))
    first = corners[k] + v[k] / (v[k] - after[k]) * (np.roll(corners, -1, axis=0)[k] - corners[k])
    line = np.concatenate([first[None], np.roll(corners, -(k + 1), axis=0), first[None]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :3], axis=0), axis=1))])
    at = along[-1] * np.arange(columns) / columns
    found = np.stack([np.interp(at, along, line[:, c]) for c in range(5)], axis=1)
    normal = found[:, 3:4] * seam + found[:, 4:] * side
    return found[:, :3], normal / np.linalg.norm(normal, axis=1, keepdims=True), float(along[-1])


def convex_hull(points: Float) -> list[int]:
    """Return the numbers of the corners of the convex hull of points (k, 2), counter-clockwise (A. M. Andrew,
    Information Processing Letters 9(5), 1979).
    """
    order = np.lexsort((points[:, 1], points[:, 0])).tolist()
    x, y = points.T.tolist()
    halves = []
    for way in (order, order[::-1]):
        chain: list[int] = []
        for i in way:
            while len(chain) > 1:
                a, b = chain[-2], chain[-1]
                if (x[b] - x[a]) * (y[i] - y[a]) - (y[b] - y[a]) * (x[i] - x[a]) > 0.0:
                    break
                chain.pop()
            chain.append(i)
        halves.append(chain[:-1])
    return halves[0] + halves[1]
