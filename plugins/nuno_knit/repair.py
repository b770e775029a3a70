"""Repair: yarns are led round the skin where their straight links would cut through it (the knit paper, section 6.3).

Links between points on different faces can enter the body. Such a link gains points on the edges of the skin, at which
it bends, so that it follows the skin where it would be inside and is straight where it is outside or over a hollow. No
point moves. nuno_knit.strings finds the points.

If no plane leads from one end to the other (ends on opposite sides of an edge, or below an overhang) the middle of the
link moves to the closest place on the skin, and the halves are repaired separately.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from nuno_knit.paths import Paths, find_paths, mean_length
from nuno_knit.quantities import Length, Reach
from nuno_knit.skin import Skin
from nuno_knit.strings import LIES, LOST, NearPoints, lay_over
from nuno_schemas.curves import YarnCurves
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int, State
from nuno_schemas.operation import Outcome, Surface
from nuno_schemas.plugin import Config

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
