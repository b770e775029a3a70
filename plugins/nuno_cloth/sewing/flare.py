"""Panels that are more than half of a ring, as those of a circle skirt, start as a cone in waves.

Laid flat before the wearer, such a panel is sewn to the next one along edges that run up from its waist, and the seam
midway between both would run through trunk and arms. So each point is placed as far out and down from the waist as it
is from there in the cloth, and at the same share of half a turn round the trunk as of the panel's turn. Cloth wider
than the cone goes into waves.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from nuno_cloth.sewing.sew import Sewn
from nuno_geometry.closest_point import closest_points
from nuno_geometry.section import Loop, cut_mesh
from nuno_geometry.tree import build_tree
from nuno_schemas.fabric import Float, Int

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
