"""Panels cut as more than half of a ring, as those of a circle skirt, start as a cone in waves.

Laid flat before the wearer, such a panel is sewn to the next one along edges that run up from its waist, and the seam
midway between both would run through trunk and arms. So each point goes as far out and down from the waist as it is
from there in the cloth, and as large a share of half a turn round the trunk as it has of the panel's. What the cone is
too narrow for goes in waves.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from nuno_cloth.sewing.sew import Sewn
from nuno_kernels.meshes.closest_point import closest_points
from nuno_kernels.meshes.loops import Loop, cut_mesh
from nuno_kernels.meshes.tree import build_tree
from nuno_schemas.fabric import Float, Int

WIDE, LESS = np.pi, 1.0
"""A panel is a ring if its free edge goes round farther than this [rad]; less makes rings of panels that are flared."""
SLOPES = np.radians([30.0, 45.0, 60.0, 75.0])
"""Of the cone below level: the first at which it is out of the body. Where it is steeper, waves are deeper."""
SMALLER = 0.5
"""Of the largest part of a section: what has less area is an arm."""
WAVES = 8.0
"""Of each panel."""
STEEP = np.linspace(0.0, 12.0, 121)
"""Slopes of a wave where it is steepest, and how much longer than straight it is then."""
LONGER = np.array([np.sqrt(1.0 + (a * np.cos(np.linspace(0.0, 2.0 * np.pi, 256, False))) ** 2).mean() for a in STEEP])


@dataclass(frozen=True)
class Ring:
    """A panel's centre in `flat` (2,) [m], the direction of its middle there (2,), the angle that it fills [rad], and
    its inner radius [m].
    """

    centre: Float
    middle: Float
    turn: float
    inner: float


def flare(sewn: Sewn, placed: Float, body: Float, faces: Int, clearance: float, wide: float = WIDE) -> Float:
    """(m, 3) where cut vertices start [m] beside a body (v, 3), faces (f, 3): as `placed` (m, 3), but for rings, whose
    free edges go round farther than `wide` [rad].
    """
    rings = {panel: ring for panel in range(len(sewn.names)) if (ring := find_ring(sewn, panel, wide)) is not None}
    if not rings:
        return placed
    placed, tree = placed.copy(), build_tree(body, faces)
    each = {panel: np.unique(sewn.faces[sewn.panel == panel]) for panel in rings}
    every = np.concatenate(list(each.values()))
    for slope in SLOPES:
        for panel, own in each.items():
            placed[own] = _cone(sewn, own, rings[panel], slope, body, faces, clearance)
        if np.asarray(closest_points(tree, placed[every]).distance).min() > clearance:
            break
    return placed


def find_ring(sewn: Sewn, panel: int, wide: float = WIDE) -> Ring | None:
    """A panel as a ring: free edges in a row, between two that are sewn to other panels and point away from one centre,
    round which the free ones go farther than `wide` [rad].
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
    """Of points (k, 2) along the hem, and the other ends of the sides that begin at its first and last one."""
    ways = np.stack([hem[0] - left, hem[-1] - right], axis=1)
    if abs(np.linalg.det(ways)) < 1e-9 * np.linalg.norm(ways) ** 2:
        return None
    centre = left + np.linalg.solve(ways * [1.0, -1.0], right - left)[0] * ways[:, 0]
    hem = hem - centre
    turn, inner = float(_angle(hem[:-1], hem[1:]).sum()), float(np.linalg.norm(left - centre))
    if abs(turn) <= wide or inner >= float(np.linalg.norm(hem[0])):
        return None
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    middle = np.array([[c, -s], [s, c]]) @ hem[0]
    return Ring(centre, middle / np.linalg.norm(middle), abs(turn), inner)


def _angle(a: Float, b: Float) -> Float:
    """(k,) angles from vectors (k, 2) to others, counter-clockwise [rad]."""
    return np.asarray(np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1)))


def _trunk(section: list[Loop], otherwise: Float) -> tuple[Float, float]:
    """The middle (3,) of the trunk in a section of the body, or of both thighs, and how far they reach from there [m].

    Not of arms, whose area is smaller by far.
    """
    if not section:
        return otherwise, 0.0
    areas = [np.linalg.norm(np.cross(one.points, np.roll(one.points, -1, axis=0)).sum(axis=0)) for one in section]
    large = [one for one, area in zip(section, areas, strict=True) if area > SMALLER * max(areas)]
    axis = np.asarray(np.mean([one.centroid() for one in large], axis=0))
    return axis, max(float(np.linalg.norm(one.points - axis, axis=1).max()) for one in large)


def _cone(sewn: Sewn, own: Int, ring: Ring, slope: float, body: Float, faces: Int, clearance: float) -> Float:
    """(k, 3) where the panel's own vertices (k,) start [m]."""
    flat, place = sewn.flat[own] - ring.centre, sewn.placed[own]
    radius, angle = np.linalg.norm(flat, axis=1), _angle(np.broadcast_to(ring.middle, flat.shape), flat)
    plane, *_ = np.linalg.lstsq(flat - flat.mean(axis=0), place - place.mean(axis=0), rcond=None)
    waist = place[radius < 1.1 * ring.inner].mean(axis=0)
    axis, reach = _trunk(cut_mesh(body, faces, body[:, 1] - waist[1]), waist)
    out, over = (waist - axis) * [1.0, 0.0, 1.0], np.array([-ring.middle[1], ring.middle[0]]) @ plane
    out = out / np.linalg.norm(out) if np.linalg.norm(out) > 0.0 else np.cross(over, [0.0, 1.0, 0.0])
    over = np.cross([0.0, 1.0, 0.0], out) * np.sign(np.cross([0.0, 1.0, 0.0], out) @ over)
    share, far = 2.0 * angle / ring.turn, radius - ring.inner
    wide = reach + clearance + far * np.cos(slope)
    steep = np.interp(ring.turn * radius / (np.pi * wide), LONGER, STEEP)
    wave = steep * wide / (2.0 * WAVES) * np.sin(WAVES * np.pi * (share + 1.0))
    wide, down = wide + wave * np.sin(slope), far * np.sin(slope) - wave * np.cos(slope)
    turn = 0.5 * np.pi * share
    return np.asarray(
        axis + (wide * np.cos(turn))[:, None] * out + (wide * np.sin(turn))[:, None] * over
        + (waist[1] - axis[1] - down)[:, None] * np.array([0.0, 1.0, 0.0])
    )  # fmt: skip
