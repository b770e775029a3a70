"""A skirt on a body: held round its waist, and clear of the body below.

A row must go round the convex hull of the sections of trunk and legs from the waist down to the lowest place where the
row can hang, which is its distance along the cloth: wherever it hangs, it is outside. The hull of length h, offset by
d, is h + 2 pi d long (J. Steiner), so that the waist is as long as a tape round the body there and the ease. Cloth
beyond that length goes into folds outwards of the hull.

Rejected: an ellipse of the waist's width and depth. No trunk is one: with a centimetre of ease it cuts into flanks or
back.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from nuno_cloth.models.delaunay import is_inside
from nuno_cloth.models.placement import Over
from nuno_cloth.models.skirt_rows import SAMPLES, UNFOLDED, Curve
from nuno_cloth.models.wearer import STEP, find_wearer, trunk_at
from nuno_cloth.quantities import Length, Metres
from nuno_geometry.centreline import lengths as lengths_along
from nuno_geometry.limb import convex_hull, spread_hull
from nuno_geometry.section import cut_mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

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
