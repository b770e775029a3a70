"""Yarns of a knit as smooth curves: loops that hook into each other, on the skin or without one.

Curves go through the points of nuno_knit.paths, each raised off the skin by its level: an arc's centre is a radius
above the skin (or as high as the net, if that is farther off), a turn one radius higher, a leg two. Samples of the
curve that are still too low are raised, and pieces that dip between their ends are divided. Of yarns of different
thickness, the thickest one's radius counts, so that thinner ones have a little more room. Without skin the net itself
is the middle level, and its face the way up.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nuno_knit.paths import WIDEST, Net, Paths, face_of_knit, find_axes, find_net, find_paths, find_widths, lay_loops
from nuno_knit.quantities import Share
from nuno_knit.repair import CHECKED, Repaired, YarnConfig, count_links, measure, radius_of, repair, to_skin
from nuno_knit.skin import Skin
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int, State
from nuno_schemas.operation import Outcome, Surface, YarnCurves, first_of_pieces
from nuno_schemas.vectors import unit_rows

# Centripetal Catmull-Rom curves through points.
#
# Between P1 and P2, with P0 before and P3 after, knots are t_(i+1) = t_i + |P_(i+1) - P_i|^(1/2), and the curve is
# Barry and Goldman's pyramid of linear interpolations. It passes through all points with a continuous direction, and
# with these knots, unlike uniform or chordal ones, makes neither cusps nor loops between two points (C. Yuksel, S.
# Schaefer, J. Keyser: Parameterization and applications of Catmull-Rom curves. Computer-Aided Design 43, 2011).
#
# Rejected: B-splines, which do not pass through their points, so that two yarns that cross would come too near.

CHUNK = 1 << 15
"""Pieces sampled at once."""


def sample_curves(points: Float, ptr: NDArray[np.int64], rings: Bool, number: int) -> tuple[Float, NDArray[np.int64]]:
    """Sample curves through points (n, 3), curve y through points[ptr[y]:ptr[y + 1]] (at least two), as polylines.

    Every piece between two points is divided into `number`, at equal knot intervals. A ring ends at its start; others
    have mirrored points beyond their ends. Returns points (m, 3) and ptr (y + 1,).
    """
    first, last = ptr[:-1], ptr[1:] - 1
    closed = rings[:, None]
    previous, following = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    previous[first] = np.where(closed, points[last - 1], 2.0 * points[first] - points[first + 1])
    following[last] = np.where(closed, points[first + 1], 2.0 * points[last] - points[last - 1])
    is_last = np.zeros(len(points), bool)
    is_last[last] = True
    pieces = np.flatnonzero(~is_last)
    yarn = np.repeat(np.arange(len(first)), np.diff(ptr))
    # Samples before each point: `number` a piece and one an end.
    place = number * np.arange(len(points)) - (number - 1) * yarn
    sampled = np.empty((number * len(pieces) + len(last), 3))
    share = np.arange(number) / number
    for at in range(0, len(pieces), CHUNK):
        k = pieces[at : at + CHUNK]
        inner = sample_piece(previous[k], points[k], points[k + 1], following[k + 1], share)
        sampled[place[k][:, None] + np.arange(number)] = inner
    sampled[place] = points
    return sampled, np.concatenate([place[first], [len(sampled)]])


def sample_piece(p0: Float, p1: Float, p2: Float, p3: Float, share: Float) -> Float:
    """Return places (m, k, 3) of m pieces from p1 to p2 (m, 3) at shares (k,) of their knots, 0 at p1 and 1 at p2."""
    a, b, c = _step(p0, p1), _step(p1, p2), _step(p2, p3)
    t = share[None, :, None] * b
    # Knots of the four points: -a, 0, b and b + c.
    first = (-t * p0[:, None] + (t + a) * p1[:, None]) / a
    second = ((b - t) * p1[:, None] + t * p2[:, None]) / b
    third = ((b + c - t) * p2[:, None] + (t - b) * p3[:, None]) / c
    left = ((b - t) * first + (t + a) * second) / (a + b)
    right = ((b + c - t) * second + t * third) / (b + c)
    return np.asarray(((b - t) * left + t * right) / b)


def _step(p: Float, q: Float) -> Float:
    """Return knot intervals (m, 1, 1) between points; 1 for points in the same place."""
    step = np.sqrt(np.linalg.norm(q - p, axis=1))[:, None, None]
    return np.where(step > 0.0, step, 1.0)


PIECES = 4
"""Pieces of a link: between its turn, its crossings, its middle and the next turn."""
DIVISIONS = 6
"""The most times that a piece that dips is divided."""
INNER = 4
"""Checked places between the ends of a piece."""


class SmoothConfig(YarnConfig):
    """The fields of smooth yarns."""

    samples: int = Field(default=8, ge=PIECES, le=256, description="points a link, rounded up to fours")
    curl: Share = Field(
        default=0.15, le=WIDEST, description="how far loops reach beyond each other, as a share of the shortest link"
    )


class Smooth:
    """Draws yarns as curves that bend like the loops of plain knit, outside of the skin."""

    name: ClassVar[str] = "smooth"
    Config: ClassVar[type[SmoothConfig]] = SmoothConfig

    def apply(self, config: SmoothConfig, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Return the curves. Raises BadInput for a fabric without yarns, and for points that are not finite."""
        paths, below = find_paths(fabric), to_skin(skin)
        laid = repair(paths, state.x, below, config.tolerance)
        radii = radius_of(config, paths, state.x)
        radius = float(radii.max(initial=0.0))
        number = -(-config.samples // PIECES)
        points, ptr, face = smooth(paths, laid, state.x, below, radius, config.curl, number)
        normal = np.zeros_like(points)
        if below is not None:
            points, ptr, face = keep_off(points, ptr, face, below, radius, config.tolerance)
            normal = below.look(points, face)[1]
        curves = YarnCurves(points, ptr, radii, paths.kind, paths.names, normal)
        checked = max(3, 1 + -(-CHECKED // (PIECES * number)))
        facts = count_links(laid, curves) | measure(curves, below, radius, face, checked)
        return Outcome(facts, curves, {"face": face})


def smooth(
    paths: Paths, laid: Repaired, x: Float, skin: Skin | None, radius: float, curl: float, number: int
) -> tuple[Float, NDArray[np.int64], Int]:
    """Return curves, points (m, 3) and ptr (y + 1,), every link in PIECES of `number` points, and faces near (m,)."""
    net = find_net(paths, len(x))
    normal = vertex_normals(net, x) if skin is None else skin.look(x)[1]
    width = find_widths(net, x, curl, radius)
    points, level, ptr = lay_loops(paths, net, x, middles(laid), find_axes(net, x, normal), width)
    near = spread(laid.face[laid.vertex >= 0], paths.ptr, PIECES)
    if skin is None:
        points = points + radius * (level - 1.0)[:, None] * _interpolate_normals(paths, ptr, normal)
    else:
        points, near = lift(points, level, near, skin, radius)
    sampled, first = sample_curves(points, ptr, paths.rings, number)
    return sampled, first, spread(near, ptr, number)


def spread(values: Int, ptr: NDArray[np.int64], number: int) -> Int:
    """Repeat every value of a yarn's points `number` times, except that of its last point."""
    count = np.full(len(values), number)
    count[ptr[1:] - 1] = 1
    return np.repeat(values, count)


def vertex_normals(net: Net, x: Float) -> Float:
    """Return unit normals (n, 3) of the knit's face; at a point without a turn those of its neighbours.

    Raises BadInput for a net that is not finite.
    """
    if not np.isfinite(x[net.points]).all():
        raise BadInput("yarns that are not finite have no curves", field="x")
    normal = face_of_knit(net, x)
    neighbours = net.sums(normal[np.concatenate([net.end, net.start])], len(x))
    return unit_rows(np.where(normal.any(axis=1, keepdims=True), normal, neighbours))


def middles(laid: Repaired) -> Float:
    """Return the places (s, 3) half way along every link [m]."""
    step = np.linalg.norm(np.diff(laid.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    first = laid.first[:-1]
    owner = np.flatnonzero(laid.vertex >= 0)
    end = owner[np.searchsorted(owner, first) + 1]
    half = 0.5 * (along[first] + along[end])
    piece = np.clip(np.searchsorted(along, half, side="right") - 1, first, end - 1)
    share = np.divide(half - along[piece], step[piece], out=np.zeros_like(half), where=step[piece] > 0.0)
    share = np.clip(share, 0.0, 1.0)[:, None]
    return np.asarray(laid.points[piece] + share * (laid.points[piece + 1] - laid.points[piece]))


def _interpolate_normals(paths: Paths, ptr: NDArray[np.int64], normal: Float) -> Float:
    """Return normals (c, 3) at the points of loops: at turns those of the net's points, interpolated in between."""
    point_normals = normal[paths.vertex]
    steps = paths.steps
    near, far = point_normals[steps], point_normals[steps + 1]
    normals = np.empty((int(ptr[-1]), 3))
    inside = np.ones(len(normals), bool)
    inside[ptr[1:] - 1] = False
    normals[inside] = np.stack([near, near, unit_rows(near + far), far], axis=1).reshape(-1, 3)
    normals[~inside] = point_normals[paths.ptr[1:] - 1]
    return normals


def lift(points: Float, level: NDArray[np.int8], near: Int, skin: Skin, radius: float) -> tuple[Float, Int]:
    """Return points of loops at their heights above the skin, and the faces below them; `near` are faces near them."""
    nearest, normal = skin.look(points, near)
    height = np.maximum(nearest.distance, radius) + radius * level
    raised = points + (height - nearest.distance)[:, None] * normal
    return skin.raise_to(raised, radius * (1.0 + level.astype(np.float64)), nearest.face)


def keep_off(
    points: Float, ptr: NDArray[np.int64], near: Int, skin: Skin, radius: float, tolerance: float
) -> tuple[Float, NDArray[np.int64], Int]:
    """Return polylines whose samples are at least `radius` [m] off the skin, to `tolerance` [m], and the faces below
    (m,). A piece whose ends are that high above the plane of one face cannot dip: the height is linear along it.
    """
    points, face = skin.raise_to(points, np.full(len(points), radius), near)
    first = first_of_pieces(ptr)
    low = np.einsum("ni,ni->n", points - skin.vertices[skin.faces[face, 0]], skin.facing[face]) < radius - tolerance
    doubtful = first[(face[first + 1] != face[first]) | low[first + 1] | low[first]]
    share = (np.arange(INNER) + 1.0) / (INNER + 1.0)
    for _ in range(DIVISIONS):
        a, b = points[doubtful][:, None], points[doubtful + 1][:, None]
        inner = a + share[:, None] * (b - a)
        height = skin.look(inner.reshape(-1, 3), np.repeat(face[doubtful], INNER))[0].distance.reshape(-1, INNER)
        low = height.min(axis=1) < radius - tolerance
        if not low.any():
            break
        at = doubtful[low]
        new = inner[low, height[low].argmin(axis=1)]
        new, below = skin.raise_to(new, np.full(len(new), radius), face[at])
        points, face = np.insert(points, at + 1, new, axis=0), np.insert(face, at + 1, below)
        ptr = ptr + np.searchsorted(at, ptr, side="left")
        grown = at + np.arange(len(at))
        doubtful = np.sort(np.concatenate([grown, grown + 1]))
    return points, ptr, face
