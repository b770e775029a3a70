"""Repair: yarns are led round the skin where their straight links would cut through it (the knit paper, section 6.3).

Links between points on different faces can enter the body. Such a link gains points on the edges of the skin, at which
it bends, so that it follows the skin where it would be inside and is straight where it is outside or over a hollow. No
point moves.

If no plane leads from one end to the other (ends on opposite sides of an edge, or below an overhang) the middle of the
link moves to the closest place on the skin, and the halves are repaired separately.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from nuno_geometry.sections import STEPS, Joined, edge_share, find_start, follow_section, make_chord
from nuno_kernels import kernel
from nuno_knit.paths import Paths, find_paths, mean_length
from nuno_knit.quantities import Length, Reach
from nuno_knit.skin import Skin
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int, State
from nuno_schemas.operation import Outcome, Surface, YarnCurves
from nuno_schemas.plugin import Config

# Chords between points on a triangle mesh as strings: the shortest path in one plane that stays outside.
#
# The path is the upper hull of the line in which the plane cuts the mesh (nuno_geometry.sections) and of both
# ends: it bends round ridges and is straight over hollows. All its inner points are on edges of the mesh.
#
# Rejected: the knit paper's path, which projects the rest of the chord onto every triangle again, so that the plane
# turns a little at each edge. It may not arrive, but turn round near the second point. In one plane it arrives if the
# plane's line joins both points.


@kernel
def upper_hull(count: int, length: float, tolerance: float, u: Float, w: Float, order: NDArray[np.int64]) -> int:
    """Return the number of `count` points (u, w) on the upper hull of these, (0, 0) and (length, 0); order[:..] are
    their indices. Points at most `tolerance` [m] above the path without them are left out.
    """
    for k in range(count):
        place = k
        while place > 0 and u[order[place - 1]] > u[k]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = k
    kept = 0
    for k in range(count + 1):
        point = order[k] if k < count else -1
        x, y = (u[point], w[point]) if point >= 0 else (length, 0.0)
        while kept > 0:
            bx, by = u[order[kept - 1]], w[order[kept - 1]]
            ax, ay = (u[order[kept - 2]], w[order[kept - 2]]) if kept > 1 else (0.0, 0.0)
            if (bx - ax) * (y - ay) < (by - ay) * (x - ax):
                break
            kept -= 1
        if point >= 0:
            order[kept] = point
            kept += 1
    return thin_hull(kept, length, tolerance, u, w, order)


@kernel
def thin_hull(count: int, length: float, tolerance: float, u: Float, w: Float, order: NDArray[np.int64]) -> int:
    """Leave points of a hull out while all of these stay within `tolerance` of the path. Return the number kept."""
    kept, x0, y0, last = 0, 0.0, 0.0, 0
    for k in range(1, count + 1):
        x, y = (u[order[k]], w[order[k]]) if k < count else (length, 0.0)
        for m in range(last, k):
            a, b = u[order[m]] - x0, w[order[m]] - y0
            if b * (x - x0) - a * (y - y0) > tolerance * (x - x0):
                last = k
                break
        if last == k:
            order[kept] = order[k - 1]
            x0, y0 = u[order[kept]], w[order[kept]]
            kept += 1
    return kept


LIES, CLEAR, LOST = 1, 0, -1
"""Status of a chord: laid over the mesh, straight and outside, or without a path."""


class NearPoints(NamedTuple):
    """Points (n, 3) [m] near a mesh, with normals (n, 3), distance (n,) [m] and triangle (n,) of the closest point."""

    points: Float
    normals: Float
    distance: Float
    foot: Int


class Laid(NamedTuple):
    """Chords over a mesh: status (s,) LIES, CLEAR or LOST; chord k gains points[ptr[k]:ptr[k + 1]] on faces `face`."""

    status: NDArray[np.int8]
    ptr: NDArray[np.int64]
    points: Float
    face: Int


@kernel
def lay_chords(
    begin: int, near: NearPoints, pairs: NDArray[np.int64], tolerance: float, mesh: Joined, laid: Laid
) -> int:
    """Lay chords from `begin` over the mesh. Return the first one without space in laid.points."""
    points, distance, status, ends, added = near.points, near.distance, laid.status, laid.ptr, laid.points
    vertices, faces = mesh.vertices, mesh.faces
    u, w = np.empty(STEPS), np.empty(STEPS)
    met, order = np.empty((STEPS, 2), np.int64), np.empty(STEPS, np.int64)
    for k in range(begin, pairs.shape[0]):
        i, j, at = pairs[k, 0], pairs[k, 1], ends[k]
        if at + STEPS > added.shape[0]:
            return k
        ends[k + 1], status[k] = at, CLEAR
        dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
        # A point of a chord is at least as far from the mesh as an end, less its distance from that end.
        if max(distance[i], 0.0) + max(distance[j], 0.0) >= math.sqrt(dx * dx + dy * dy + dz * dz):
            continue
        chord = make_chord(points, near.normals, i, j)
        start = find_start(chord, near.foot[i], vertices, faces, mesh.ptr, mesh.around) if chord.length > 0.0 else -1
        count = -1
        if start >= 0:
            below = 2.0 * max(-distance[i], -distance[j], 0.0)
            count = follow_section(chord, start, below, vertices, faces, mesh.across, u, w, met)
        if count < 0:
            status[k] = LOST
            continue
        kept = upper_hull(count, chord.length, tolerance, u, w, order)
        for m in range(kept):
            face, edge = met[order[m], 0], met[order[m], 1]
            first, second = faces[face, edge], faces[face, (edge + 1) % 3]
            t = edge_share(chord, first, second, vertices)
            for c in range(3):
                added[at + m, c] = vertices[first, c] + t * (vertices[second, c] - vertices[first, c])
            laid.face[at + m] = face
        if kept > 0:
            status[k], ends[k + 1] = LIES, at + kept
    return int(pairs.shape[0])


def lay_over(mesh: Joined, near: NearPoints, pairs: Int, tolerance: float) -> Laid:
    """Lay chords between points, pairs (s, 2) of them, as strings over a closed mesh. A chord at most `tolerance` [m]
    deep stays straight.
    """
    every = np.ascontiguousarray(pairs, np.int64)
    status, ends = np.zeros(len(every), np.int8), np.zeros(len(every) + 1, np.int64)
    added, face = np.empty((len(every) + 2 * STEPS, 3)), np.empty(len(every) + 2 * STEPS, np.int32)
    next_chord = 0
    while next_chord < len(every):
        next_chord = lay_chords(next_chord, near, every, tolerance, mesh, Laid(status, ends, added, face))
        if next_chord < len(every):
            added, face = np.concatenate([added, np.empty_like(added)]), np.concatenate([face, np.empty_like(face)])
    return Laid(status, ends, added[: ends[-1]].copy(), face[: ends[-1]].copy())


HALVINGS = 8
"""The most times that a link without a plane is halved."""
CHECKED = 20
"""Samples of every piece, with its ends, in the check of the result."""
RADIUS = 0.04
"""Default radius of a yarn as a share of the mean link: links are 25 radii long."""


class YarnConfig(Config):
    """The fields of every operation that makes curves of yarns."""

    radius: Reach | tuple[Reach, ...] | None = Field(
        default=None,
        description="of the yarns, or of each kind in their order [m]; left out: as the roots of their linear "
        f"densities, {RADIUS:g} of the mean link's length for the mean one",
    )
    tolerance: Length = Field(default=1e-6, description="how deep a yarn may lie in the skin unchanged [m]")


@dataclass(frozen=True)
class Repaired:
    """Yarns with the points that repair inserted.

    points (n, 3)     [m]; ptr (y + 1,) first point of each yarn
    vertex (n,) int32 the fabric's point, -1 for an inserted one
    face   (n,) int32 face of the skin at the point, -1 without skin
    normal (n, 3)     of the skin there, 0 without
    first  (s + 1,)   place of each link's first point, and one past the last
    status (s,)       of each link: LIES, CLEAR or LOST
    """

    points: Float
    ptr: NDArray[np.int64]
    vertex: Int
    face: Int
    normal: Float
    first: NDArray[np.int64]
    status: NDArray[np.int8]


class Repair:
    """Draws yarns as straight links, repaired where they cut through the skin."""

    name: ClassVar[str] = "repair"
    Config: ClassVar[type[BaseModel]] = YarnConfig

    def apply(self, config: YarnConfig, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Return the repaired yarns. Raises BadInput for a fabric without yarns."""
        paths = find_paths(fabric)
        below = to_skin(skin)
        repaired = repair(paths, state.x, below, config.tolerance)
        radius = radius_of(config, paths, state.x)
        curves = YarnCurves(repaired.points, repaired.ptr, radius, paths.kind, paths.names, repaired.normal)
        facts = count_links(repaired, curves) | measure(curves, below, 0.0, repaired.face)
        return Outcome(facts, curves, {"vertex": repaired.vertex, "face": repaired.face})


def to_skin(surface: Surface | None) -> Skin | None:
    """Return the skin for look-ups of closest points, None without faces."""
    return None if surface is None or not len(surface.faces) else Skin(surface.vertices, surface.faces)


def radius_of(config: YarnConfig, paths: Paths, x: Float) -> Float:
    """Return the radii (y,) of the yarns [m]. Raises BadInput for radii of another number of kinds."""
    if config.radius is None:
        return np.asarray(RADIUS * mean_length(paths, x) * paths.thickness)
    if not isinstance(config.radius, tuple):
        return np.full(paths.number, config.radius)
    if len(config.radius) != len(paths.names):
        kinds = f"{len(paths.names)}: {', '.join(paths.names)}"
        raise BadInput(
            "one radius for each kind of yarn, or one for all", field="radius", value=len(config.radius), limit=kinds
        )
    return np.array(config.radius)[paths.kind]


def count_links(repaired: Repaired, curves: YarnCurves) -> dict[str, float]:
    """Return the numbers of links, of repaired ones and of those without a way, of inserted and of all points."""
    return {
        "links": float(len(repaired.status)),
        "repaired": float((repaired.status == LIES).sum()),
        "lost": float((repaired.status == LOST).sum()),
        "inserted": float((repaired.vertex < 0).sum()),
        "points": float(len(curves.points)),
    }


def measure(curves: YarnCurves, skin: Skin | None, off: float, face: Int, samples: int = CHECKED) -> dict[str, float]:
    """Return the number of checked places, `samples` a piece, and the depth of the deepest below a height `off` [m]."""
    if skin is None:
        return {}
    number, depth = skin.deepest(curves.points, curves.ptr, samples, face)
    return {"samples": float(number), "deepest": max(0.0, depth + off)}


def repair(paths: Paths, x: Float, skin: Skin | None, tolerance: float) -> Repaired:
    """Return yarns of points x (n, 3) [m] with inserted points where a link is deeper than `tolerance` [m].

    Raises BadInput for points that are not finite.
    """
    pairs = paths.pairs
    if skin is None:
        at = np.concatenate([paths.steps, [len(paths.vertex)]])
        none = np.full(len(paths.vertex), -1, np.int32)
        flat = x[paths.vertex]
        return Repaired(flat, paths.ptr, paths.vertex, none, np.zeros_like(flat), at, np.zeros(len(pairs), np.int8))
    if not np.isfinite(x[paths.vertex]).all():
        raise BadInput("yarns that are not finite cannot be laid over a body", field="x")
    foot, normals = skin.look(x)
    laid = lay_over(skin.joined, NearPoints(x, skin.facing[foot.face], foot.distance, foot.face), pairs, tolerance)
    status, count = laid.status.copy(), np.diff(laid.ptr)
    gained, face = laid.points, laid.face
    halves: dict[int, tuple[Float, Int]] = {}
    for link in np.flatnonzero(status == LOST):
        points, on, complete = halve(skin, x[pairs[link]], tolerance, HALVINGS)
        halves[int(link)], count[link] = (points, on), len(points)
        status[link] = LIES if complete else LOST
    if halves:
        parts = [halves.get(k) for k in range(len(pairs))]
        split = np.split(np.arange(len(gained)), laid.ptr[1:-1])
        gained = np.concatenate([p[0] if p else laid.points[s] for p, s in zip(parts, split, strict=True)])
        face = np.concatenate([p[1] if p else laid.face[s] for p, s in zip(parts, split, strict=True)])
    return _thread(paths, x, skin, (gained, face, count), foot.face, normals, status)


def halve(skin: Skin, ends: Float, tolerance: float, times: int) -> tuple[Float, Int, bool]:
    """Return points (m, 3) between two ends (2, 3) on the skin, their faces (m,), and whether a way was found."""
    middle = ends.mean(axis=0)[None]
    nearest, _ = skin.look(middle)
    middle = np.where(nearest.distance[:, None] < 0.0, nearest.point, middle)
    points = np.concatenate([ends[:1], middle, ends[1:]])
    at, _ = skin.look(points)
    pairs = np.array([[0, 1], [1, 2]], np.int32)
    laid = lay_over(skin.joined, NearPoints(points, skin.facing[at.face], at.distance, at.face), pairs, tolerance)
    parts: list[Float] = []
    faces: list[Int] = []
    complete = True
    for half in (0, 1):
        gained = slice(laid.ptr[half], laid.ptr[half + 1])
        inner, on, done = laid.points[gained], laid.face[gained], laid.status[half] != LOST
        if not done and times > 1:
            inner, on, done = halve(skin, points[half : half + 2], tolerance, times - 1)
        parts += [inner, middle] if half == 0 else [inner]
        faces += [on, at.face[1:2]] if half == 0 else [on]
        complete = complete and done
    return np.concatenate(parts), np.concatenate(faces), complete


def _thread(
    paths: Paths, x: Float, skin: Skin, gained: tuple[Float, Int, NDArray[np.int64]], foot: Int, normals: Float,
    status: NDArray[np.int8],
) -> Repaired:  # fmt: skip
    """Return points and inserted points along their yarns; `gained` are places, faces, and the number on each link."""
    new, face, count = gained
    steps = paths.steps
    shift = np.zeros(len(paths.vertex) + 1, np.int64)
    shift[steps + 1] = count
    place = np.arange(len(paths.vertex) + 1) + np.cumsum(shift)
    kept = place[:-1]
    total = int(place[-1])
    added = np.ones(total, bool)
    added[kept] = False
    points, vertex = np.empty((total, 3)), np.full(total, -1, np.int32)
    faces, normal = np.empty(total, np.int32), np.empty((total, 3))
    points[kept], vertex[kept], faces[kept], normal[kept] = (
        x[paths.vertex], paths.vertex, foot[paths.vertex], normals[paths.vertex],
    )  # fmt: skip
    points[added], faces[added] = new, face
    if len(new):
        normal[added] = skin.look(new, face)[1]
    ptr = np.concatenate([kept[paths.ptr[:-1]], [total]])
    return Repaired(points, ptr, vertex, faces, normal, np.concatenate([kept[steps], [total]]), status)
