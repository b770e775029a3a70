"""Rows round a limb: loops on a closed mesh from one end to the other that follow it round any bend.

They are levels of a harmonic field (nuno_kernels.harmonic) between plane sections across the limb's axis at both
ends, or the limb's tip, where the rows draw together. So neighbouring rows never cross, not at a heel either, where
planes across the axis do; and every row lies on the surface to begin with. Rows are the same height apart: between
neighbouring levels lies an area dA, and dA / girth is their distance, taken round the limb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_kernels.centreline import Centreline, find_axis, way_from
from nuno_kernels.closest_point import closest_points
from nuno_kernels.harmonic import solve_harmonic
from nuno_kernels.mesh_sections import Loop, cut_mesh, section_about
from nuno_kernels.surface_normals import edge_numbers, vertex_normals
from nuno_kernels.surface_tree import Tree, build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int

SAMPLES = 240
"""Levels from whose girths heights are found."""
ENDS = (0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.3)
"""Shares of the limb's length over the surface at which the automatic axis may begin and end."""
DEEP = 0.4
"""It does so where the limb is round: its middle so many radii, girth / (2 pi), below the surface at least."""
TIP = 0.15
"""The row at the tip is so many rows' heights away from it."""


@dataclass(frozen=True)
class Rows:
    """r rows of q points on a limb's surface, from its start to its end, in equal steps round it.

    points (r, q, 3) [m], to the right seen from outside with the end up; normal (r, q, 3) unit, outwards;
    girth (r,) [m]; height [m] from the first row to the last, over the surface
    """

    points: Float
    normal: Float
    girth: Float
    height: float


def find_limb(x: Float, faces: Int) -> Centreline:
    """The axis of a mesh that is one limb, from its thinner end to the other, found from the mesh alone.

    Its ends are the two vertices farthest apart over the surface, about.
    """
    tree = build_tree(x, faces)
    far = _farthest(x, faces, 0)
    ends = [_round_place(x, faces, end, tree) for end in (far, _farthest(x, faces, far))]
    ends.sort(key=lambda loop: loop.girth)
    return find_axis(x, faces, ends[0].centroid(), ends[1].centroid())


def _round_place(x: Float, faces: Int, end: int, tree: Tree) -> Loop:
    """The first level of the way from vertex `end` round a middle that lies deep enough."""
    way = way_from(x, faces, x[end])
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
    """Rows over a limb from the first to the last point of the line (k, 3) [m] inside of it; `to_tip`: from the tip
    of the limb beyond the first point.

    Raises BadInput where the surface between the two ends is not one tube.
    """
    field = _find_field(x, faces, line, to_tip)
    levels, height = _find_levels(x, faces, field, line_length(line), rows, to_tip)
    normals = vertex_normals(x, faces)
    loops = [_one_loop(x, faces, field - level) for level in levels]
    centres = np.array([loop.centroid() for loop in loops])
    points, normal = np.empty((rows, columns, 3)), np.empty((rows, columns, 3))
    for row, (seam, tangent) in enumerate(_carry_seam(centres)):
        loop = loops[row]
        outward = (1.0 - loop.share[:, None]) * normals[loop.edges[:, 0]] + loop.share[:, None] * normals[
            loop.edges[:, 1]
        ]
        both = np.concatenate([loop.points, outward / np.linalg.norm(outward, axis=1, keepdims=True)], axis=1)
        spread = _spread(both, centres[row], seam, tangent, columns)
        points[row], normal[row] = spread[:, :3], spread[:, 3:]
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return Rows(points, normal, np.array([loop.girth for loop in loops]), height)


def line_length(line: Float) -> float:
    """Length of a line of points (k, 3) [m]."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _find_field(x: Float, faces: Int, line: Float, to_tip: bool) -> Float:
    """The field (n,): 0 at the plane through the line's first point, or at the tip, and the line's length at that
    through its last.

    Vertices beyond the ends get values beyond those.
    """
    length = line_length(line)
    few = max(1, len(line) // 16)
    ways = [line[few] - line[0], line[-1] - line[-1 - few]]
    across = [(point, way / np.linalg.norm(way)) for point, way in zip(line[[0, -1]], ways, strict=True)]
    planes = [(x - point) @ way for point, way in across]
    loops = [section_about(x, faces, point, way) for point, way in across]
    if loops[0] is None or loops[1] is None:
        raise BadInput("the axis does not lie in the limb", field="between", remedy="give places inside of the mesh")
    start, end = _split(x, faces, [loops[0], loops[1]], planes)
    given, value = end.copy(), np.where(end, 2.0 * length, 0.0)
    _give(given, value, loops[1], length + planes[1])
    if to_tip:
        tip = int(np.flatnonzero(start)[np.argmin(planes[0][start])])
        given[tip] = True
    else:
        given |= start
        value = np.where(start, -length, value)
        _give(given, value, loops[0], planes[0])
    return solve_harmonic(x, faces, given, value)


def _give(given: Bool, value: Float, loop: Loop, own: Float) -> None:
    """Give the ends of the edges that a section cuts the values `own` (n,), in place."""
    ends = np.unique(loop.edges)
    given[ends], value[ends] = True, own[ends]


def _split(x: Float, faces: Int, loops: list[Loop], planes: list[Float]) -> tuple[Bool, Bool]:
    """Which vertices (n,) lie beyond the first section, and which beyond the second.

    Raises BadInput where the sections do not part the mesh so.
    """
    _, pairs = edge_numbers(faces)
    key = pairs[:, 0].astype(np.int64) * len(x) + pairs[:, 1]
    cut = np.isin(key, np.concatenate([loop.edges[:, 0] * len(x) + loop.edges[:, 1] for loop in loops]))
    part = _components(len(x), pairs[~cut])
    sides = []
    for loop, plane in zip(loops, planes, strict=True):
        ends = loop.edges.reshape(-1)
        sides.append((np.unique(part[ends[plane[ends] >= 0.0]]), np.unique(part[ends[plane[ends] < 0.0]])))
    (inner, before), (beyond, same) = sides
    if not (len(inner) == len(same) == 1 and inner[0] == same[0]) or inner[0] in before or inner[0] in beyond:
        raise BadInput(
            "the two ends of the axis do not take one tube out of the mesh", field="between",
            remedy="give places on one limb, before it joins the rest or meets itself",
        )  # fmt: skip
    return np.isin(part, before), np.isin(part, beyond)


def _components(n: int, pairs: Int) -> Int:
    """(n,) the lowest number of the vertices that edges (e, 2) join each to."""
    part = np.arange(n)
    while True:
        before = part.copy()
        low = np.minimum(part[pairs[:, 0]], part[pairs[:, 1]])
        np.minimum.at(part, pairs[:, 0], low)
        np.minimum.at(part, pairs[:, 1], low)
        part = part[part]
        if np.array_equal(before, part):
            return np.asarray(part)


def _find_levels(x: Float, faces: Int, field: Float, high: float, rows: int, to_tip: bool) -> tuple[Float, float]:
    """(rows,) levels in equal steps of height, and the height from the first to the last [m]."""
    within = np.sort(field[(field > 0.0) & (field < high)])
    sample = np.quantile(np.concatenate([[0.0], within, [high]]), np.linspace(0.0, 1.0, SAMPLES + 1))
    area = _areas_below(x, faces, field, sample)
    girth = np.array([_one_loop(x, faces, field - level).girth for level in (sample[1:] if to_tip else sample)])
    steps = np.diff(area)
    if to_tip:
        # Round the tip the rows are circles of girth 2 pi r about an area of pi r^2: r = 2 A / girth.
        steps *= np.concatenate([2.0 / girth[:1], 0.5 * (1.0 / girth[1:] + 1.0 / girth[:-1])])
    else:
        steps *= 0.5 * (1.0 / girth[1:] + 1.0 / girth[:-1])
    height = np.concatenate([[0.0], np.cumsum(steps)])
    first = TIP * height[-1] / (rows - 1) if to_tip else 0.0
    levels = np.interp(np.linspace(first, height[-1], rows), height, sample)
    return levels, float(height[-1] - first)


def _areas_below(x: Float, faces: Int, field: Float, levels: Float) -> Float:
    """(k,) area of the surface on which a linear field lies between levels[0] and each of levels (k,) [m^2].

    With a <= b <= c at a triangle's corners the share below t is (t - a)^2 / ((b - a)(c - a)) up to b, and 1 less
    (c - t)^2 / ((c - a)(c - b)) from there.
    """
    a, b, c = np.sort(field[faces], axis=1).T
    met = (c > levels[0]) & (a < levels[-1])
    corner, a, b, c = x[faces[met]], a[met], b[met], c[met]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    found = np.empty(len(levels))
    with np.errstate(divide="ignore", invalid="ignore"):
        for k, t in enumerate(levels):
            low, top = (t - a) ** 2 / ((b - a) * (c - a)), 1.0 - (c - t) ** 2 / ((c - a) * (c - b))
            share = np.where(t <= a, 0.0, np.where(t >= c, 1.0, np.where(t < b, low, top)))
            found[k] = (area * share).sum()
    return np.asarray(found - found[0])


def _one_loop(x: Float, faces: Int, value: Float) -> Loop:
    loops = cut_mesh(x, faces, value)
    if not loops:
        raise BadInput("no row goes round the limb there", field="between", remedy="move the ends of the axis inwards")
    return max(loops, key=lambda loop: loop.girth)


def _carry_seam(centres: Float) -> list[tuple[Float, Float]]:
    """(seam, tangent) of every row: directions in which columns begin, turned along from the last row to the first
    as little as the axis turns. At the last row the seam points to -z, or to -y where the limb does so itself.
    """
    few = max(1, len(centres) // 24)
    ahead = np.minimum(np.arange(len(centres)) + few, len(centres) - 1)
    behind = np.maximum(np.arange(len(centres)) - few, 0)
    tangent = centres[ahead] - centres[behind]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    seam = np.array([0.0, 0.0, -1.0]) if abs(tangent[-1, 2]) < 0.7 else np.array([0.0, -1.0, 0.0])
    found = []
    for t in tangent[::-1]:
        seam = seam - (seam @ t) * t
        seam = seam / np.linalg.norm(seam)
        found.append((seam, t))
    return found[::-1]


def _spread(corners: Float, centre: Float, seam: Float, tangent: Float, columns: int) -> Float:
    """(columns, c) points in equal steps round a loop of corners (k, c), whose first three values are places, from
    where it meets the seam, to the right.
    """
    away = corners[:, :3] - centre
    side = np.cross(tangent, seam)
    if float((np.cross(away, np.roll(away, -1, axis=0)) @ tangent).sum()) < 0.0:
        corners, away = corners[::-1], away[::-1]
    u, v = away @ seam, away @ side
    after_u, after_v = np.roll(u, -1), np.roll(v, -1)
    meets = (v < 0.0) != (after_v < 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(meets, v / (v - after_v), 0.0)
    reach = np.where(meets, u + share * (after_u - u), -np.inf)
    k = int(np.argmax(reach))
    first = corners[k] + share[k] * (np.roll(corners, -1, axis=0)[k] - corners[k])
    line = np.concatenate([first[None], np.roll(corners, -(k + 1), axis=0), first[None]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :3], axis=0), axis=1))])
    at = along[-1] * np.arange(columns) / columns
    return np.stack([np.interp(at, along, line[:, c]) for c in range(line.shape[1])], axis=1)
