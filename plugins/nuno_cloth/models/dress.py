"""The start of a shirt on a body: clear of it, with as little strain as that takes.

Below the underarms the shirt is rings about the trunk, and beyond them rings about the arms: each is the convex hull of
the body's section, offset outwards so that the ring has its length at rest and is clear of the body. The yoke between
them is harmonic, and then everything is drawn together (nuno_cloth.sewing.draw).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_cloth.models.outside import not_outside, require_outside
from nuno_cloth.models.shirt_pattern import Cut, Sewn
from nuno_cloth.models.triangles import Edges
from nuno_cloth.models.wearer import Arm, Wearer
from nuno_cloth.sewing.draw import draw_together
from nuno_geometry.harmonic import solve_harmonic
from nuno_geometry.limb import spread_hull
from nuno_geometry.section import Loop
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.vectors import dot, norm

RINGS, AROUND = 24, 96
"""Rings about a trunk and about an arm, and points of each."""
UPPER = 0.2
"""Share of the cloth round an arm that lies over it, from the overarm, where the underarm is not closed yet."""
WIDER = "more ease, or longer"
MARGIN = 0.02
"""Rings of a shirt that is longer than the body are those about the body this far above its lower end [m]."""


@dataclass(frozen=True)
class Fit:
    """The fit of a cut to its wearer.

    shoulder: along the overarm, from N to the arm's root [m]; height: of N; deep: half the chest's depth, which makes
    the cloth from N to the underarms' ring longer than the drop [m]
    """

    shoulder: float
    height: float
    deep: float

    def drop(self, depth: float) -> float:
        """Height of N above the ring that is `depth` [m] below it along the cloth."""
        return float(np.sqrt(depth**2 - self.deep**2))


def dress(wearer: Wearer, cut: Cut, fit: Fit, sewn: Sewn, edges: Edges, clearance: float) -> Float:
    """Return the start (n, 3) of a sewn shirt with springs on its `edges`, no point nearer to the body than `clearance`
    [m]. Raises BadInput, with place and depth, for a shirt that would start inside of the body.
    """
    pairs = edges.pairs
    x, placed = _place_on_rings(wearer, cut, fit, sewn, clearance)
    for k in range(3):
        x[:, k] = solve_harmonic(sewn.flat + 1e-3 * sewn.front[:, None] * [0.0, 0.0, 1.0], sewn.faces, placed, x[:, k])
    tree = build_tree(wearer.x, wearer.faces)
    rest = np.linalg.norm(sewn.flat[pairs[:, 1]] - sewn.flat[pairs[:, 0]], axis=1)
    x = draw_together(x, edges, rest, tree, clearance, worn=True)
    require_outside(x, np.full(len(x), 0.5 * clearance), tree, "shirt", WIDER)
    return np.ascontiguousarray(x)


def _place_on_rings(wearer: Wearer, cut: Cut, fit: Fit, sewn: Sewn, clearance: float) -> tuple[Float, Bool]:
    """Return the places (n, 3) of points on rings, overarms and round the neck, and which points these are (n,)."""
    u, v = np.abs(sewn.flat[:, 0]), sewn.flat[:, 1]
    x = np.zeros_like(sewn.flat)
    # Round the arms from the overarm, by the front and the underarm, from where the underarm is straight; over their
    # upper side from the root.
    away = np.stack([u, v], axis=1) - [cut.neck, 0.0]
    along, across = dot(away, cut.along), dot(away, cut.across)
    inner, outer = (point - [cut.neck, 0.0] for point in (cut.curve()[1], cut.corners()["B"]))
    ends, widths = ([float(dot(p, way)) for p in (inner, outer)] for way in (cut.along, cut.across))
    part = across / np.interp(along, ends, widths)
    on_sleeve = np.where(along >= ends[0], part <= 1.0 + 1e-6, (along >= fit.shoulder) & (part <= UPPER))
    on_seam = (across < 1e-9) & ~on_sleeve
    share = np.where(sewn.front < 0, 1.0 - 0.5 * part, 0.5 * part)
    levels = np.linspace(fit.shoulder, ends[1], RINGS)
    for side, arm in zip((1, -1), wearer.arms, strict=True):
        selected = on_sleeve & (sewn.side == side)
        girths = np.where(levels < ends[0], -1.0, 1.0) * 2.0 * np.interp(levels, ends, widths)
        rings = _round_arm(wearer, arm, levels - fit.shoulder, girths, clearance)
        x[selected] = _on_rings(rings, levels, along[selected], share[selected])
        # The overarm before that, from the neck to the arm's root.
        selected = on_seam & (sewn.side == side)
        start = np.array([wearer.middle + side * cut.neck, fit.height, wearer.neck[2]])
        x[selected] = start + (along[selected] / fit.shoulder)[:, None] * (rings[0, 0] - start)
    # Round the trunk from the middle of the front, by the left side and the middle of the back.
    down, long = -v - cut.depth, cut.length - cut.depth
    quarter = 0.25 * u / np.interp(down, [0.0, long], [cut.width, cut.hem])
    half = np.where(sewn.front < 0, 0.5 - quarter, quarter)
    levels = np.linspace(0.0, long, RINGS)
    girths = 4.0 * np.interp(levels, [0.0, long], [cut.width, cut.hem])
    top = fit.height - fit.drop(cut.depth)
    rings = np.stack([_round_trunk(wearer, top - s, girth, clearance) for s, girth in zip(levels, girths, strict=True)])
    selected = (down >= 0.0) & ~on_sleeve
    x[selected] = _on_rings(rings, levels, down[selected], np.where(sewn.side < 0, 1.0 - half, half)[selected])
    placed = on_sleeve | on_seam | selected
    selected = sewn.neck
    depth = np.where(sewn.front > 0, cut.front, cut.back)
    turn = np.arctan2(sewn.flat[:, 0] / cut.neck, -v / depth)
    x[selected] = np.stack(
        [
            wearer.middle + cut.neck * np.sin(turn),
            fit.height - depth * np.cos(turn),
            wearer.neck[2] + np.where(sewn.front < 0, -1.0, 1.0) * cut.neck * np.cos(turn),
        ],
        axis=1,
    )[selected]
    return x, placed | selected


def _round_trunk(wearer: Wearer, level: float, girth: float, clearance: float) -> Float:
    """Return a ring (AROUND, 3) about the trunk at a height [m]."""
    loop = wearer.trunk(max(level, float(wearer.x[:, 1].min()) + MARGIN))
    if loop is None:
        raise BadInput(
            "the shirt is longer than the trunk", field="length", value=f"down to a height of {level:.3g} m",
            limit="where the body has one level section", remedy="make it shorter",
        )  # fmt: skip
    places = _ring(loop, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), girth, clearance)
    places[:, 1] = level
    return places


def _round_arm(wearer: Wearer, arm: Arm, places: Float, girths: Float, clearance: float) -> Float:
    """Return rings (r, AROUND, 3) round an arm at places (r,) from its root [m], past its end copies of the last."""
    up, ahead = (axis - dot(axis, arm.way) * arm.way for axis in (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])))
    seam = up / norm(up)
    side = ahead - dot(ahead, seam) * seam
    rings: list[Float] = []
    for i, girth in enumerate(girths):
        loop = wearer.across(arm, float(places[i]))
        if loop is not None:
            rings.append(_ring(loop, seam, side / norm(side), float(girth), clearance))
        elif rings:
            rings.append(rings[-1] + (places[i] - places[i - 1]) * arm.way)
        else:
            raise BadInput("the body has no arm where a sleeve begins", field="over.body", remedy="arms off its sides")
    return np.stack(rings)


def _ring(loop: Loop, seam: Float, side: Float, girth: float, clearance: float) -> Float:
    """Return points (AROUND, 3) in equal steps on a loop's hull, offset to this girth [m], or, below 0, by the
    clearance.

    The hull of length l offset by d is l + 2 pi d long (J. Steiner).
    """
    places, normals, length = spread_hull(loop.points, loop.centroid(), seam, side, AROUND)
    off = (girth - length) / (2.0 * np.pi)
    if girth >= 0.0 and off < clearance:
        raise not_outside(off, places[0], clearance, "shirt", WIDER)
    return places + max(off, clearance) * normals


def _on_rings(rings: Float, levels: Float, level: Float, share: Float) -> Float:
    """Return places (n, 3) at a level (n,) and share (n,) of the way round, between rings (r, AROUND, 3) at levels
    (r,).
    """
    row = np.clip((level - levels[0]) / (levels[-1] - levels[0]) * (len(levels) - 1), 0.0, len(levels) - 1.0)
    column = np.mod(share, 1.0) * AROUND
    i, j = np.minimum(row.astype(int), len(levels) - 2), column.astype(int) % AROUND
    a, b, k = (row - i)[:, None], (column - column.astype(int))[:, None], (j + 1) % AROUND
    first = (1.0 - b) * rings[i, j] + b * rings[i, k]
    return np.asarray((1.0 - a) * first + a * ((1.0 - b) * rings[i + 1, j] + b * rings[i + 1, k]))
