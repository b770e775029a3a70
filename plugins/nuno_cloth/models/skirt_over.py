"""A skirt on a body: held round its waist, and clear of the body below.

A row must go round the convex hull of the sections of trunk and legs from the waist down to the lowest place where the
row can hang, which is its distance along the cloth: wherever it hangs, it is outside. The hull of length h, offset by
d, is h + 2 pi d long (J. Steiner), so that the waist is as long as a tape round the body there and the ease. Cloth
beyond that length goes into folds outwards of the hull.

Rejected: an ellipse of the waist's width and depth. No trunk is one: with a centimetre of ease it cuts into flanks or
back.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from nuno_cloth.models.delaunay import is_inside
from nuno_cloth.models.placement import Over
from nuno_cloth.models.wearer import STEP, find_wearer, trunk_at
from nuno_cloth.quantities import Length, Metres
from nuno_geometry.centreline import lengths as lengths_along
from nuno_geometry.limb import convex_hull, spread_hull
from nuno_geometry.sections import cut_mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

# The start of a skirt: rows of cloth, each on its own closed curve, one below the other.

SAMPLES = 2048
"""Points at which a row's curve is sampled."""

ROUNDS = 4
UNFOLDED = 1e-9
"""Cloth that exceeds its circle by a smaller share than this has no folds."""

Curve = Callable[[int, float], Float]
"""Returns for a row's number and a length [m] a closed curve (p, 2) [m] about as long, its last point the first."""


def drape(columns: int, step: float, circle: Float, curve: Curve) -> Float:
    """Return starting positions (rows, columns, 3) [m] about the middle of the waist, of rows that are `circle` (rows,)
    long and `step` apart [m]. Columns start at +x and run towards -z.

    Waves, heights and steps around depend on each other: chords are shorter than the curve they
    span, and rise and fall along a row add to its length. A few rounds make the steps of
    each row equal and as long together as its cloth.
    """
    rows = len(circle)
    steps = np.tile(np.arange(columns + 1) / columns, (rows, 1))
    even = steps[0].copy()
    aim = circle.copy()
    position = np.empty((rows, columns, 3))
    for _ in range(ROUNDS):
        for row in range(rows):
            ring = curve(row, float(aim[row]))
            arc_lengths = lengths_along(ring)
            arc = steps[row, :-1] * arc_lengths[-1]
            position[row, :, 0] = np.interp(arc, arc_lengths, ring[:, 0])
            position[row, :, 2] = -np.interp(arc, arc_lengths, ring[:, 1])
        position[0, :, 1] = 0.0
        position[1:, :, 1] = -np.cumsum(_fall(position[..., [0, 2]], step), axis=0)
        for row in range(rows):
            arc_lengths = lengths_along(np.concatenate([position[row], position[row, :1]]))
            steps[row] = np.interp(even, arc_lengths / arc_lengths[-1], steps[row])
            aim[row] *= circle[row] / arc_lengths[-1]
    return position


def ellipses(radius: Float, ratio: float, circle: Float, pleats: int) -> Curve:
    """Return ellipses, as long as circles of `radius` (rows,) [m], with waves where the cloth, `circle` (rows,), is
    longer. `ratio` is an ellipse's depth over its width. Raises BadInput for waves that would reach the axis.
    """
    around = np.linspace(0, 2 * np.pi, SAMPLES + 1)
    outline = np.stack([np.cos(around), ratio * np.sin(around)], -1)
    outline *= 2 * np.pi / lengths_along(outline)[-1]
    phase = lengths_along(outline) * pleats
    depths, lengths = _wave_depths(outline, phase)
    fullness = circle[-1] / radius[-1]
    if fullness > lengths[-1]:
        raise BadInput("the folds would reach the axis", field="fullness", remedy="more pleats, or less fullness")
    folded = fullness > 2 * np.pi * (1 + UNFOLDED)

    def curve(row: int, length: float) -> Float:
        depth = np.interp(length / radius[row], lengths, depths) if folded else 0.0
        return np.asarray(radius[row] * outline * (1 + depth * np.cos(phase))[:, None])

    return curve


def _wave_depths(outline: Float, phase: Float) -> tuple[Float, Float]:
    """Return depths of waves on a ring over its radius, and the lengths that they give it, over its radius. The length
    grows with the square of small depths, and so do the table's steps.
    """
    depths = 0.95 * np.linspace(0, 1, 256) ** 2
    return depths, np.array([lengths_along(outline * (1 + depth * np.cos(phase))[:, None])[-1] for depth in depths])


def _fall(flat: Float, step: float) -> Float:
    """Return the drop (rows - 1, columns) of each warp edge [m] that keeps the edge's length."""
    outwards = np.square(np.diff(flat, axis=0)).sum(axis=-1)
    return np.asarray(np.sqrt(np.maximum(step**2 - outwards, (0.1 * step) ** 2)))


END = 0.03
"""Distance from its lower end within which a body that is cut off at the hips is rounded [m]."""
OPENS = 0.3
"""The clearance grows below the waist by this share of the way down, up to its full value."""
AMPLITUDES = 96
"""Depths of folds for which a row's length is tabulated."""


class AtWaist(Over):
    """The body that wears a skirt, and where the waist is held."""

    at: Literal["waist", "hips"] | Metres = Field(
        default="waist",
        description="where it is held: where a tape is shortest, or longest below that; or a height [m]",
    )
    ease: Length = Field(default=0.01, description="how much longer it is there than a tape round the body [m]")


class Wearing(NamedTuple):
    """The hulls that a skirt's rows go round.

    centre (3,) middle of the body's section where the skirt is held, tape: its girth [m]; places, out (rows, p, 2)
    points and normals of the hull that each row must go round, about the centre, along the body's left and back; round
    (rows,) the hull's length; clear (rows,) a row's least distance from it [m]
    """

    centre: Float
    tape: float
    places: Float
    out: Float
    round: Float
    clear: Float

    @property
    def least(self) -> Float:
        """Least lengths (rows,) of rows [m]."""
        return self.round + 2.0 * np.pi * self.clear


def find_height(at: str | float, x: Float, faces: Int) -> float:
    """Return the height of a body's waist or hips [m], or `at` itself. Raises BadInput if no waist is found."""
    if not isinstance(at, str):
        return float(at)
    wearer = find_wearer(x, faces)
    levels = np.arange(wearer.armpit - STEP, x[:, 1].min() + END, -STEP)
    tapes = []
    for level in levels:
        loop = wearer.trunk(float(level))
        if loop is None:
            break
        tapes.append(_girth(loop.points[:, [0, 2]]))
    if not tapes:
        raise BadInput(
            "no waist is found on this body", field="over.at", value=at, remedy="give its height: at: 1.05 m"
        )
    waist = int(np.argmin(tapes))
    return float(levels[waist if at == "waist" else waist + int(np.argmax(tapes[waist:]))])


def measure(over: AtWaist, x: Float, faces: Int, falls: Float) -> Wearing:
    """Return the hulls of a body's mesh x (v, 3) [m], faces (f, 3), for a skirt with rows `falls` (rows,) below its
    waist along the cloth [m]. Raises BadInput where the body has no trunk at that height.
    """
    height = find_height(over.at, x, faces)
    section = trunk_at(x, faces, 0.5 * float(x[:, 0].min() + x[:, 0].max()), height)
    if section is None:
        limit = f"from crotch to armpits; it stands from {x[:, 1].min():.3g} to {x[:, 1].max():.3g} m"
        raise BadInput("the body has no trunk at this height", field="over.at", value=f"{height:.3g} m", limit=limit)
    centre = section.centroid()
    depths = np.arange(0.0, falls[-1] + 2.0 * STEP, STEP)
    hulls = [corners := _hull(section.points[:, [0, 2]])]
    for depth in depths[1:]:
        loops = [loop.points[:, [0, 2]] for loop in cut_mesh(x, faces, x[:, 1] - (height - depth))
                 if is_inside(loop.centroid()[None, [0, 2]], corners)[0]]  # fmt: skip
        corners = _hull(np.concatenate([corners, *loops]))
        hulls.append(corners)
    spread = [_spread(hulls[int(np.ceil(fall / STEP - 1e-9))], centre) for fall in falls]
    ease = over.ease / (2.0 * np.pi)
    return Wearing(
        centre,
        _girth(section.points[:, [0, 2]]),
        np.stack([places for places, _, _ in spread]),
        np.stack([out for _, out, _ in spread]),
        np.array([length for _, _, length in spread]),
        np.where(
            falls == 0.0, ease, np.maximum(np.minimum(ease + OPENS * falls, over.clearance), min(ease, over.clearance))
        ),
    )


def rings(wearing: Wearing, base: Float, circle: Float, pleats: int) -> Curve:
    """Return hulls offset to be `base` (rows,) long [m], with folds outwards where the cloth, `circle` (rows,), is
    longer. Raises BadInput for folds that would be deeper than the body is wide.
    """
    off = (base - wearing.round) / (2.0 * np.pi)
    phase = 2.0 * np.pi * pleats * np.arange(SAMPLES + 1) / SAMPLES
    inner = wearing.places + off[:, None, None] * wearing.out
    tables = {}
    for row in np.flatnonzero(circle > base * (1.0 + UNFOLDED)).tolist():
        depths = base[row] / np.pi * np.linspace(0.0, 1.0, AMPLITUDES) ** 2
        lengths = [lengths_along(_folded(inner[row], wearing.out[row], depth, phase))[-1] for depth in depths]
        tables[row] = np.array(lengths), depths
        if circle[row] > lengths[-1]:
            limit = f"{circle[row]:.3g} m of cloth round {base[row]:.3g} m"
            problem = "the folds would be deeper than the body is wide"
            raise BadInput(problem, field="pleats", value=pleats, limit=limit, remedy="more pleats")

    def curve(row: int, length: float) -> Float:
        if row in tables:
            return _folded(inner[row], wearing.out[row], float(np.interp(length, *tables[row])), phase)
        return np.asarray(wearing.places[row] + (length - wearing.round[row]) / (2.0 * np.pi) * wearing.out[row])

    return curve


def _folded(inner: Float, out: Float, depth: float, phase: Float) -> Float:
    return np.asarray(inner + 0.5 * depth * (1.0 + np.cos(phase))[:, None] * out)


def _hull(points: Float) -> Float:
    """Return the corners (k, 2) of the convex hull of points (m, 2), counter-clockwise."""
    return np.asarray(points[convex_hull(points)])


def _girth(points: Float) -> float:
    hull = _hull(points)
    return float(np.linalg.norm(hull - np.roll(hull, 1, axis=0), axis=1).sum())


def _spread(corners: Float, centre: Float) -> tuple[Float, Float, float]:
    """Return points (SAMPLES + 1, 2) in equal steps round a hull of corners (k, 2) in x and z, its normals there, and
    its length: about the centre, from +x towards -z; the last point is the first.
    """
    around = np.column_stack([corners[:, 0], np.full(len(corners), centre[1]), corners[:, 1]])
    left, back = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
    places, normal, length = spread_hull(around, centre, left, back, SAMPLES)
    flat = [np.stack([one[:, 0], -one[:, 2]], axis=1) for one in (places - centre, normal)]
    points, out = (np.concatenate([one, one[:1]]) for one in flat)
    return points, out, length
