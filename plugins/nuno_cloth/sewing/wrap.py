"""Panels that start bent round the body: tubes wrapped round a limb, and more than half of a ring in waves."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from nuno_cloth.sewing.sew import Sewn
from nuno_geometry.closest_point import closest_points
from nuno_geometry.sections import Loop, cut_mesh
from nuno_geometry.tree import build_tree
from nuno_schemas.fabric import Float, Int

# Panels that are more than half of a ring, as those of a circle skirt, start as a cone in waves.
#
# Laid flat before the wearer, such a panel is sewn to the next one along edges that run up from its waist, and the seam
# midway between both would run through trunk and arms. So each point is placed as far out and down from the waist as it
# is from there in the cloth, and at the same share of half a turn round the trunk as of the panel's turn. Cloth wider
# than the cone goes into waves.

WIDE, LESS = np.pi, 1.0
"""A panel is a ring if its free edge turns by more than this [rad]; LESS makes flared panels rings, too."""
NARROWEST = 1e-3
"""Smallest inner radius of a ring [m]: a panel whose sides meet in a corner has no waist."""
SLOPES = np.radians([30.0, 45.0, 60.0, 75.0])
"""Slopes of the cone below level, tried until it is out of the body. Waves of a steeper cone are deeper."""
SMALLER = 0.5
"""Parts of a section with a smaller share than this of the largest area are arms."""
WAVES = 8.0
"""Number of waves of each panel."""
STEEP = np.linspace(0.0, 12.0, 121)
"""Steepest slopes of a wave, and the wave's length over its straight length for each."""
LONGER = np.array([np.sqrt(1.0 + (a * np.cos(np.linspace(0.0, 2.0 * np.pi, 256, False))) ** 2).mean() for a in STEEP])


@dataclass(frozen=True)
class Ring:
    """A ring-shaped panel: its centre (2,) [m] and the direction of its middle (2,) in `flat`, its angle [rad], and its
    inner radius [m].
    """

    centre: Float
    middle: Float
    turn: float
    inner: float


def flare(sewn: Sewn, placed: Float, body: Float, faces: Int, clearance: float, wide: float = WIDE) -> Float:
    """Return where cut vertices (m, 3) start [m] beside a body (v, 3), faces (f, 3): as `placed` (m, 3), but for rings,
    whose free edges turn by more than `wide` [rad].
    """
    rings = {panel: ring for panel in range(len(sewn.names)) if (ring := find_ring(sewn, panel, wide)) is not None}
    if not rings:
        return placed
    placed, tree = placed.copy(), build_tree(body, faces)
    vertices = {panel: np.unique(sewn.faces[sewn.panel == panel]) for panel in rings}
    of_rings = np.concatenate(list(vertices.values()))
    for slope in SLOPES:
        for panel, indices in vertices.items():
            placed[indices] = _cone(sewn, indices, rings[panel], slope, body, faces, clearance)
        if np.asarray(closest_points(tree, placed[of_rings]).distance).min() > clearance:
            break
    return placed


def find_ring(sewn: Sewn, panel: int, wide: float = WIDE) -> Ring | None:
    """Return a panel as a ring, or None: free edges in a row, between two that are sewn to other panels and point away
    from one centre, round which the free ones turn by more than `wide` [rad].
    """
    edges, name = sewn.edges[panel], sewn.names[panel]
    joined = [pair for one in sewn.seams for pair in permutations((one.seam.one, one.seam.other))]
    sewn_to = {place[1]: other[0] for place, other in joined if place[0] == name}
    for first in range(len(edges)):
        row: list[int] = []
        while (first + len(row)) % len(edges) not in sewn_to and len(row) < len(edges) - 2:
            row.append((first + len(row)) % len(edges))
        before, after = (first - 1) % len(edges), (first + len(row)) % len(edges)
        if row and {sewn_to.get(before, name), sewn_to.get(after, name)}.isdisjoint({name}):
            hem = np.concatenate([sewn.flat[edges[k]] for k in row])
            if (ring := _ring(sewn.flat[edges[before][0]], hem, sewn.flat[edges[after][-1]], wide)) is not None:
                return ring
    return None


def _ring(left: Float, hem: Float, right: Float, wide: float) -> Ring | None:
    """Return the ring of points (k, 2) along the hem, and the inner ends of its sides at the first and last one."""
    ways = np.stack([hem[0] - left, hem[-1] - right], axis=1)
    if abs(np.linalg.det(ways)) < 1e-9 * np.linalg.norm(ways) ** 2:
        return None
    centre = left + np.linalg.solve(ways * [1.0, -1.0], right - left)[0] * ways[:, 0]
    hem = hem - centre
    turn, inner = float(_angle(hem[:-1], hem[1:]).sum()), float(np.linalg.norm(left - centre))
    if abs(turn) <= wide or not NARROWEST < inner < float(np.linalg.norm(hem[0])):
        return None
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    middle = np.array([[c, -s], [s, c]]) @ hem[0]
    return Ring(centre, middle / np.linalg.norm(middle), abs(turn), inner)


def _angle(a: Float, b: Float) -> Float:
    """Return angles (k,) from vectors (k, 2) to others, counter-clockwise [rad]."""
    return np.asarray(np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1)))


def _trunk(section: list[Loop], otherwise: Float) -> tuple[Float, float]:
    """Return the middle (3,) of the trunk, or of both thighs, in a section of the body, without arms, whose areas are
    far smaller, and the largest distance of its points from there [m].
    """
    if not section:
        return otherwise, 0.0
    areas = [np.linalg.norm(np.cross(one.points, np.roll(one.points, -1, axis=0)).sum(axis=0)) for one in section]
    large = [one for one, area in zip(section, areas, strict=True) if area > SMALLER * max(areas)]
    axis = np.asarray(np.mean([one.centroid() for one in large], axis=0))
    return axis, max(float(np.linalg.norm(one.points - axis, axis=1).max()) for one in large)


def _cone(sewn: Sewn, vertices: Int, ring: Ring, slope: float, body: Float, faces: Int, clearance: float) -> Float:
    """Return where the vertices (k,) of a panel start (k, 3) [m]."""
    flat, place = sewn.flat[vertices] - ring.centre, sewn.placed[vertices]
    radius, angle = np.linalg.norm(flat, axis=1), _angle(np.broadcast_to(ring.middle, flat.shape), flat)
    plane, *_ = np.linalg.lstsq(flat - flat.mean(axis=0), place - place.mean(axis=0), rcond=None)
    waist = place[radius < 1.1 * ring.inner].mean(axis=0)
    axis, reach = _trunk(cut_mesh(body, faces, body[:, 1] - waist[1]), waist)
    ahead, sideways = (waist - axis) * [1.0, 0.0, 1.0], np.array([-ring.middle[1], ring.middle[0]]) @ plane
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 0.0 else np.cross(sideways, [0.0, 1.0, 0.0])
    sideways = np.cross([0.0, 1.0, 0.0], ahead) * np.sign(np.cross([0.0, 1.0, 0.0], ahead) @ sideways)
    share, outwards = 2.0 * angle / ring.turn, radius - ring.inner
    wide = reach + clearance + outwards * np.cos(slope)
    steep = np.interp(ring.turn * radius / (np.pi * wide), LONGER, STEEP)
    wave = steep * wide / (2.0 * WAVES) * np.sin(WAVES * np.pi * (share + 1.0))
    wide, down = wide + wave * np.sin(slope), outwards * np.sin(slope) - wave * np.cos(slope)
    turn = 0.5 * np.pi * share
    return np.asarray(
        axis + (wide * np.cos(turn))[:, None] * ahead + (wide * np.sin(turn))[:, None] * sideways
        + (waist[1] - axis[1] - down)[:, None] * np.array([0.0, 1.0, 0.0])
    )  # fmt: skip


# Wrapping of panels that are sewn into a tube, such as a sleeve of one piece, round the limb next to them.
#
# Such a panel lies flat before the limb, and both edges of its seam would be joined there, before it. So it is bent
# round an axis instead, its seam on the far side: at each height to a circle as long as the panel is wide there, or
# round the limb if that is wider.

LEVELS = 24
"""Sections of the body, over the height of a panel, in which a limb is searched."""


@dataclass(frozen=True)
class Frame:
    """The frame of a placed panel: its middle in `flat` (2,) and in space (3,) [m], the directions across and along the
    tube in the panel's plane (2, 2), and those and the normal in space (3, 3).
    """

    flat: Float
    middle: Float
    turn: Float
    axes: Float

    def across(self, flat: Float) -> Float:
        return np.asarray((flat - self.flat) @ self.turn[0])

    def along(self, flat: Float) -> Float:
        return np.asarray((flat - self.flat) @ self.turn[1])


def wrap(sewn: Sewn, body: Float, faces: Int, clearance: float) -> Float:
    """Return where cut vertices (m, 3) start [m] by a body (v, 3), faces (f, 3): as placed, but for tubes."""
    placed = sewn.placed.copy()
    for panel in range(len(sewn.names)):
        for pairs in tubes(sewn, panel):
            vertices = np.unique(sewn.faces[sewn.panel == panel])
            frame = _frame(sewn, vertices, pairs)
            placed[vertices] = _bend(sewn, vertices, pairs, frame, body, faces, clearance)
    return placed


def tubes(sewn: Sewn, panel: int) -> list[Int]:
    """Return pairs (k, 2) of cut vertices of each line along which a panel is sewn to itself from side to side. Darts,
    whose two edges meet in a tip, are left out.
    """
    name, lines = sewn.names[panel], list[Int]()
    for seam in sewn.seams:
        if seam.seam.one[0] == seam.seam.other[0] == name:
            ends = {frozenset(pair) for pair in seam.pairs[[0, -1]].tolist()}
            joined = [line for line in lines if ends & {frozenset(pair) for pair in line.tolist()}]
            lines = [line for line in lines if not any(line is one for one in joined)]
            lines.append(np.concatenate([seam.pairs, *joined]))
    return [line for line in lines if (line[:, 0] != line[:, 1]).all()]


def _frame(sewn: Sewn, vertices: Int, pairs: Int) -> Frame:
    flat, middle = sewn.flat[vertices].mean(axis=0), sewn.placed[vertices].mean(axis=0)
    across_seam = sewn.flat[pairs[:, 1]] - sewn.flat[pairs[:, 0]]
    across_seam *= np.where(across_seam @ across_seam[0] < 0.0, -1.0, 1.0)[:, None]
    across = across_seam.sum(axis=0) / np.linalg.norm(across_seam.sum(axis=0))
    turn = np.array([across, [-across[1], across[0]]])
    plane, *_ = np.linalg.lstsq((sewn.flat[vertices] - flat) @ turn.T, sewn.placed[vertices] - middle, rcond=None)
    return Frame(flat, middle, turn, np.concatenate([plane, np.cross(*plane)[None]]))


def _bend(sewn: Sewn, vertices: Int, pairs: Int, frame: Frame, body: Float, faces: Int, clearance: float) -> Float:
    """Return the places (k, 3) of a panel's vertices (k,) bent round its limb [m]."""
    heights, ends = frame.along(sewn.flat[pairs].mean(axis=1)), frame.across(sewn.flat[pairs])
    order = heights.argsort()
    height, left, right = heights[order], ends.min(axis=1)[order], ends.max(axis=1)[order]
    along, across = frame.along(sewn.flat[vertices]), frame.across(sewn.flat[vertices])
    low, high = np.interp(along, height, left), np.interp(along, height, right)
    angle = np.pi * (2.0 * across - low - high) / (high - low)
    levels = np.linspace(along.min(), along.max(), LEVELS)
    narrowest = int(np.interp(levels, height, right - left).argmin())
    axis, reach = _limb(frame, levels, narrowest, body, faces)
    radius = np.maximum((high - low) / (2.0 * np.pi), np.interp(along, levels, reach) + clearance)
    side, up, out = frame.axes
    return np.asarray(
        axis + along[:, None] * up + (radius * np.sin(angle))[:, None] * side + (radius * np.cos(angle))[:, None] * out
    )


def _limb(frame: Frame, levels: Float, first: int, body: Float, faces: Int) -> tuple[Float, Float]:
    """Return a point (3,) of the axis of a panel's limb, at height 0, and the limb's largest radius at each level (l,)
    [m].

    At its narrowest, the `first` level, it goes round the nearest part of the body; from there up and down round parts
    that begin within the previous one: a skirt round both legs, and no arm.
    """
    up = frame.axes[1]
    heights = (body - frame.middle) @ up
    sections = [cut_mesh(body, faces, heights - level) for level in levels]
    reach = np.zeros(len(levels))
    nearby = sorted(range(len(levels)), key=lambda k: abs(k - first))
    first = next((k for k in nearby if sections[k]), -1)
    if first < 0:
        return frame.middle, reach
    middle = frame.middle + levels[first] * up
    nearest = min(sections[first], key=lambda loop: float(np.linalg.norm(loop.points - middle, axis=1).min()))
    centre = nearest.centroid()
    axis = centre - levels[first] * up

    def farthest(loops: list[Loop]) -> float:
        points = np.concatenate([loop.points for loop in loops]) - axis
        return float(np.linalg.norm(points - (points @ up)[:, None] * up, axis=1).max())

    def off(loop: Loop) -> float:
        way = loop.centroid() - axis
        return float(np.linalg.norm(way - (way @ up) * up))

    reach[first] = farthest([nearest])
    for step in (-1, 1):
        bound = reach[first]
        for k in range(first + step, len(levels) if step > 0 else -1, step):
            inner = [loop for loop in sections[k] if off(loop) < bound]
            reach[k] = bound = farthest(inner) if inner else bound
    return axis, reach
