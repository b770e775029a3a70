"""A panel in triangles: the division of its edges into sides, and triangles spread evenly inside of its outline."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from nuno_cloth.models.delaunay import distances, is_inside, lay_grid, triangulate
from nuno_cloth.sewing.curves import area_under, draw, turning_of
from nuno_cloth.sewing.pattern import Panel, Pattern, Side, ends_of, join_corners
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import CERTAIN, dot, norm, sides

# Division of a pattern's edges into sides, equally many in both edges of a seam, by the longer of the two.

ACCURATE = 1e-3
"""Largest error of the total area of a panel's triangles, as a share of the panel's."""
AIMED = 0.9 * ACCURATE
TURNS = np.pi / 3.0
"""Largest turn of a curve along one side [rad]."""
BENT = 0.15
"""Edges that turn more than this [rad] have a point between their ends: one side alone would be 0.1 % too short."""


@dataclass
class EdgePolygon:
    """An edge's polygon (n + 1, 2) [m], and the area between it and the curve [m^2], positive on the right of it."""

    points: Float
    excess: float


def draw_edges(pattern: Pattern, spacing: float) -> dict[Side, EdgePolygon]:
    """Return each edge as a polygon of about `spacing` [m] a side, as long as the edge, with equally many sides in a
    seam. Curves of a panel whose polygons enclose another area than its curves are divided more finely.
    """
    number, partner = _numbers(pattern, spacing), pattern.partner
    drawn = {side: _draw(pattern, side, n) for side, n in number.items()}
    # A finer division of a curve for one panel changes the panel that it is sewn to, which may have been right before.
    while inaccurate := _find_inaccurate(pattern, drawn):
        for side in inaccurate:
            for one in (side, partner[side][0]) if side in partner else (side,):
                number[one] += 1 + number[one] // 4
                drawn[one] = _draw(pattern, one, number[one])
    return drawn


def _find_inaccurate(pattern: Pattern, drawn: dict[Side, EdgePolygon]) -> list[Side]:
    """Return, for each panel whose polygons enclose another area, the edge with the largest error."""
    inaccurate = []
    for name, panel in pattern.panels.items():
        sides = [(name, k) for k in range(len(panel.edges))]
        excess = sum(drawn[side].excess for side in sides)
        if abs(excess) > AIMED * abs(panel.area):
            inaccurate.append(max(sides, key=lambda side: float(np.sign(excess)) * drawn[side].excess))
    return inaccurate


def _draw(pattern: Pattern, side: Side, n: int) -> EdgePolygon:
    edge = pattern.edge(side)
    points = draw(edge.curve, n)
    (x, y), (dx, dy) = points[:-1].T, np.diff(points, axis=0).T
    return EdgePolygon(points, float(0.5 * (x * dy - y * dx).sum()) - area_under(edge.curve))


def _numbers(pattern: Pattern, spacing: float) -> dict[Side, int]:
    """Return each edge's number of sides, by its length and turn; no two sides may connect the same sewn corners."""
    number = {}
    for name, panel in pattern.panels.items():
        for k, edge in enumerate(panel.edges):
            turning = turning_of(edge.curve)
            least = max(1 if turning < BENT else 2, int(np.ceil(turning / TURNS)))
            number[name, k] = max(least, round(edge.length / spacing))
    corner = join_corners(pattern)
    ends = {side: tuple(sorted(corner[end] for end in ends_of(pattern, side))) for side in number}
    for seam in pattern.seams:
        number[seam.one] = number[seam.other] = max(number[seam.one], number[seam.other])
    second = {seam.other for seam in pattern.seams}
    shared = Counter(ends[side] for side in number if side not in second)
    for side in number:
        low, high = ends[side]
        number[side] = max(number[side], 3 if low == high else 2 if shared[ends[side]] > 1 else 1)
    return number


# Triangles of a panel, evenly spread inside of an outline with fixed points.
#
# Points begin as a triangular grid of the wanted density where the outline's points are no denser; the rest is filled
# by Delaunay refinement (Ruppert 1995, J. Algorithms 18, 548-585): triangles that are too large or too thin get a point
# in the middle of their circumcircle, unless it would be too close to the outline, whose sides must stay whole. Then
# inner points repeatedly move to the mean of the triangles round them, and the Delaunay triangulation is renewed.

# Constrained Delaunay triangles of points in an outline: every side of it is a side of a triangle. The Delaunay
# triangulation of the points has most of the outline's sides. It lacks those close to another part of the outline, as
# at the tip of a dart. Flips of the sides that cross these recover them (Sloan 1993, Adv. Eng. Software 17, 49-55).
# Triangles outside of the outline are left out.

Edge = tuple[int, int]
FAR, CORNERS = 3.0, np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def triangulate_inside(points: Float, outline: int) -> Int:
    """Return triangles (f, 3), counter-clockwise, of points (n, 2). The first `outline` points are the outline.

    The outline is counter-clockwise. Raises ValueError if a side of it runs through a point, or cannot be recovered.
    """
    # With four distant points no side of the outline is on the convex hull, where rounding decides which of several
    # collinear points belong to it.
    low, high = points.min(axis=0), points.max(axis=0)
    middle, wide = 0.5 * (low + high), FAR * float((high - low).max())
    points = np.concatenate([points, middle + wide * CORNERS])
    faces = triangulate(points)
    start = np.arange(outline, dtype=np.int64)
    end = np.roll(start, -1)
    keys = _directed(faces, len(points)).reshape(-1)
    present = np.isin(start * len(points) + end, keys)
    if not present.all():
        faces = _recover(points, faces, [(int(a), int(b)) for a, b in zip(start[~present], end[~present], strict=True)])
    return _inside(faces, len(points), start * len(points) + end)


def _directed(faces: Int, n: int) -> Int:
    """Return the key (f, 3) of the directed side from each corner to the next."""
    return np.asarray(faces.astype(np.int64) * n + np.roll(faces, -1, axis=1))


def _inside(faces: Int, n: int, border: Int) -> Int:
    """Return the triangles that are connected, without crossing the outline, to one on the left of a side of it."""
    keys = _directed(faces, n)
    low, high = np.divmod(keys, n)
    back = high * n + low
    order = np.argsort(keys.reshape(-1))
    at = order[np.minimum(np.searchsorted(keys.reshape(-1), back.reshape(-1), sorter=order), keys.size - 1)]
    joined = (keys.reshape(-1)[at] == back.reshape(-1)) & ~np.isin(keys, border).reshape(-1)
    joined &= ~np.isin(back, border).reshape(-1)
    face = np.repeat(np.arange(len(faces)), 3)
    links = coo_array((np.ones(int(joined.sum())), (face[joined], at[joined] // 3)), shape=(len(faces),) * 2)
    part = connected_components(links, directed=False)[1]
    return np.ascontiguousarray(faces[np.isin(part, part[np.isin(keys, border).any(axis=1)])])


def _recover(points: Float, faces: Int, missing: list[Edge]) -> Int:
    """Return triangles that have the missing sides, by flips."""
    third: dict[Edge, int] = {}
    for a, b, c in faces.tolist():
        third[a, b], third[b, c], third[c, a] = c, a, b
    place = [(float(x), float(y)) for x, y in points]

    def side(a: int, b: int, c: int) -> float:
        """Return more than 0 if c is to the left of the line from a to b, less if to the right, 0 if on it."""
        (ax, ay), (bx, by), (cx, cy) = place[a], place[b], place[c]
        one, other = (bx - ax) * (cy - ay), (by - ay) * (cx - ax)
        certain = abs(one - other) > CERTAIN * (abs(one) + abs(other))
        return one - other if certain else float(sides(points[[a]], points[[b]], points[[c]])[0])

    def cross(a: int, b: int, c: int, d: int) -> bool:
        return (side(a, b, c) > 0.0) != (side(a, b, d) > 0.0) and (side(c, d, a) > 0.0) != (side(c, d, b) > 0.0)

    for a, b in missing:
        others = [(c, d) for c, d in third if c < d and (d, c) in third and not {a, b} & {c, d}]
        crossing = [(c, d) for c, d in others if cross(a, b, c, d)]
        for _ in range(50 * (len(crossing) + 1) ** 2):
            if not crossing:
                break
            c, d = crossing.pop(0)
            left, right = third[c, d], third[d, c]
            # The two triangles can be flipped where the four corners are convex.
            if side(right, left, c) <= 0.0 or side(left, right, d) <= 0.0:
                crossing.append((c, d))
                continue
            del third[c, d], third[d, c]
            for one, two, three in ((right, left, c), (left, right, d)):
                third[one, two], third[two, three], third[three, one] = three, one, two
            if left not in (a, b) and right not in (a, b) and cross(a, b, left, right):
                crossing.append((left, right))
        if (a, b) not in third and (b, a) not in third:
            raise ValueError(f"{a} {b}")
    triangles = {min(((a, b, c), (b, c, a), (c, a, b))) for (a, b), c in third.items()}
    return np.array(sorted(triangles), np.int32)


GRADE = 0.4
"""Growth of triangles' sides with the distance from a shorter side of the outline."""
LEAST = 0.4
"""Sides shorter than this many spacings make only the triangles that touch them smaller."""
INSET = 0.65
"""Least distance of the grid's points from the outline, in spacings."""
APART = 0.75
"""Least distance between points that are inserted at once, over the wanted side of triangles there."""
LARGE = 1.3
"""A circumcircle larger than that of the wanted triangle by this factor is too large."""
THIN, SMALL = 1.25, 0.7
"""Triangles with circumradii of THIN shortest sides are too thin: their least angle is 23.6 degrees. Those with
circumcircles below SMALL of the wanted one have no room for another point."""
REFINED, ROUNDS = 12, 12
AT_ONCE = 4096


def fill(outline: Float, spacing: float) -> tuple[Float, Int]:
    """Return points (n, 2), the outline's (m, 2) first, and triangles (f, 3), counter-clockwise, of side `spacing` [m].

    The outline is simple and counter-clockwise. Raises ValueError if a side of it cannot be recovered.
    """
    sizes = SizeField(outline, spacing)
    points = np.concatenate([outline, _grid(sizes)])
    for _ in range(REFINED):
        new = _refine(points, triangulate_inside(points, len(outline)), sizes)
        if not len(new):
            break
        points = _smooth(np.concatenate([points, new]), sizes, 2)
    points = _smooth(points, sizes, ROUNDS)
    return points, triangulate_inside(points, len(outline))


class SizeField:
    """The wanted size of triangles within an outline (m, 2), which follows from its sides."""

    def __init__(self, outline: Float, spacing: float) -> None:
        self.outline, self.spacing = outline, spacing
        self.sides = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
        length = np.clip(norm(self.sides[:, 1] - self.sides[:, 0]), LEAST * spacing, spacing)
        short = length < 0.95 * spacing
        self.short, self.length = self.sides[short], length[short]

    def size(self, points: Float) -> Float:
        """Return the wanted sides (n,) of triangles at points (n, 2) [m]."""
        sizes = np.full(len(points), self.spacing)
        if len(self.length):
            for at in range(0, len(points), AT_ONCE):
                far = distances(points[at : at + AT_ONCE], self.short)
                sizes[at : at + AT_ONCE] = np.minimum((self.length + GRADE * far).min(axis=1), self.spacing)
        return sizes

    def inside(self, points: Float, far: Float) -> Bool:
        """Return which points (n, 2) are inside, and farther from the outline than `far` (n,) [m]."""
        mask = np.zeros(len(points), np.bool_)
        for at in range(0, len(points), AT_ONCE):
            some = points[at : at + AT_ONCE]
            near = distances(some, self.sides).min(axis=1)
            mask[at : at + AT_ONCE] = is_inside(some, self.outline) & (near > far[at : at + AT_ONCE])
        return mask


def _grid(sizes: SizeField) -> Float:
    spacing, grid = sizes.spacing, lay_grid(sizes.outline, sizes.spacing)
    grid = grid[sizes.inside(grid, np.full(len(grid), INSET * spacing))]
    return grid[sizes.size(grid) >= 0.9 * spacing]


def _refine(points: Float, faces: Int, sizes: SizeField) -> Float:
    """Return spread-out circumcentres of triangles that are too large or too thin, the worst first."""
    centre, radius, shortest = _circles(points, faces)
    large = radius * np.sqrt(3.0) / sizes.size(points[faces].mean(axis=1))
    bad = np.flatnonzero((large > LARGE) | ((radius > THIN * shortest) & (large > SMALL)))
    centre = centre[bad[np.argsort(-large[bad], kind="stable")]]
    size = sizes.size(centre)
    free = sizes.inside(centre, 0.5 * size)
    if free.any():
        near, _ = cKDTree(points).query(centre[free])
        free[free] = near > 0.6 * size[free]
    centre, size = centre[free], size[free]
    chosen, available = [], np.ones(len(centre), np.bool_)
    tree = cKDTree(centre) if len(centre) else None
    for i in range(len(centre)):
        if available[i] and tree is not None:
            chosen.append(i)
            available[tree.query_ball_point(centre[i], APART * size[i])] = False
    return centre[chosen]


def _circles(points: Float, faces: Int) -> tuple[Float, Float, Float]:
    """Return centres (f, 2) and radii (f,) of circumcircles, and the shortest sides (f,)."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    one, two = b - a, c - a
    double = 2.0 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    p, q = dot(one, one), dot(two, two)
    x = (two[:, 1] * p - one[:, 1] * q) / double
    y = (one[:, 0] * q - two[:, 0] * p) / double
    shortest = np.minimum(np.minimum(np.sqrt(p), np.sqrt(q)), norm(c - b))
    return a + np.stack([x, y], axis=1), np.hypot(x, y), shortest


def _smooth(points: Float, sizes: SizeField, rounds: int) -> Float:
    """Move each point to the mean of its triangles' centroids, weighted by their areas over the wanted ones."""
    points, fixed, size = points.copy(), len(sizes.outline), sizes.size(points)
    for k in range(rounds):
        if k % 2 == 0:
            faces = triangulate_inside(points, fixed)
            corner = faces.reshape(-1)
            density = size[faces].mean(axis=1) ** -3
        one, two = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
        weight = (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) * density
        middle = points[faces].mean(axis=1)
        total = np.bincount(corner, np.repeat(weight, 3), len(points))
        moved = [np.bincount(corner, np.repeat(weight * middle[:, d], 3), len(points)) for d in (0, 1)]
        points[fixed:] = (np.stack(moved, axis=1) / total[:, None])[fixed:]
    return points


# A panel in triangles.


@dataclass
class Piece:
    """A panel in triangles, its right side up.

    flat (n, 2) [m], the outline's points first; faces (f, 3) counter-clockwise; edges: the points along each edge, from
    start to end; mirror: factor of x to the panel as it is drawn
    """

    panel: Panel
    flat: Float
    faces: Int
    edges: list[Int]
    mirror: float

    def place(self) -> Float:
        """Return the starting places (n, 3) of its points [m]."""
        return self.panel.place(self.flat * [self.mirror, 1.0])


def cut_panel(panel: Panel, polygons: list[EdgePolygon], spacing: float) -> Piece:
    """Return the triangles of a panel with these polygons of its edges. Raises BadInput if they are too coarse."""
    mirror = 1.0 if panel.area > 0.0 else -1.0
    outline = np.concatenate([edge.points[:-1] for edge in polygons]) * [mirror, 1.0]
    try:
        flat, faces = fill(outline, spacing)
    except ValueError:
        raise too_coarse(panel.name, spacing) from None
    first = np.concatenate([[0], np.cumsum([len(edge.points) - 1 for edge in polygons])])
    runs = [np.arange(a, b + 1) % first[-1] for a, b in pairwise(first)]
    return Piece(panel, flat, faces, [run.astype(np.int32) for run in runs], mirror)


def too_coarse(where: str, spacing: float) -> BadInput:
    return BadInput(
        f"triangles are too large for {where}", field="edge", value=f"{100 * spacing:.4g} cm",
        remedy="make them smaller: half as large, for a start",
    )  # fmt: skip


def split(piece: Piece, sides: Int) -> None:
    """Insert a point in the middle of sides (k, 2) that two of the piece's triangles share."""
    for a, b in sides.tolist():
        adjacent = np.flatnonzero(((piece.faces == a) | (piece.faces == b)).sum(axis=1) == 2)
        new = len(piece.flat)
        piece.flat = np.concatenate([piece.flat, piece.flat[[a, b]].mean(axis=0)[None]])
        faces = [np.where(piece.faces[adjacent] == end, new, piece.faces[adjacent]) for end in (a, b)]
        kept = np.delete(piece.faces, adjacent, axis=0)
        piece.faces = np.ascontiguousarray(np.concatenate([kept, *faces]).astype(np.int32))
