"""A tube of knit drawn over a limb: where its rows start, and how long its links are at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from nuno_kernels.meshes.centreline import find_axis
from nuno_kernels.meshes.closest_point import closest_points
from nuno_kernels.meshes.limb import Rows, find_limb, lay_rows
from nuno_kernels.meshes.tree import build_tree
from nuno_knit.quantities import Length, Point, Ratio, Share
from nuno_knit.structure import Knit as Structure
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Config

LINE = 65
"""Points of the part of an axis that a knit is drawn over."""
SKIN = 5e-5
"""The end rows are held so far off the surface [m]: the gap at which sliding contact rests unless told otherwise."""
NARROW = 0.9
"""A row's girth at rest is this share of the limb's there at most: rows narrow towards a toe."""
ROOM = 4e-5
"""Least distance from the surface at which points start [m]."""
ROUNDS = 8
"""Times that points too near to the surface are moved off it."""


class Over(Config):
    """What a tube is drawn over, and its size at rest as ratios of the limb's."""

    body: str = Field(min_length=1, description="name of the body, which has a mesh as collider")
    between: tuple[Share, Share] | tuple[Point, Point] = Field(
        default=(0.05, 0.95),
        description="where the first row and the last row lie: as shares of the limb's axis from its thinner end, "
        "or as two places inside of the mesh [m]",
    )
    toe: Literal["open", "closed"] = Field(
        default="open", description="closed: the first rows narrow over the limb's tip, and the first draws together"
    )
    girth: Ratio | tuple[Ratio, Ratio] = Field(
        default=0.55, description="girth at rest as a ratio of the limb's, or of the first row and of the last"
    )
    of: Literal["mean", "own"] = Field(
        default="mean", description="the girth that it is a ratio of: the limb's mean, or its own of each row"
    )
    height: Ratio = Field(default=0.8, description="height at rest as a ratio of that over the limb")
    clearance: Length = Field(default=5e-3, description="how far from the surface points start [m]")


@dataclass(frozen=True)
class Fitted:
    """Positions (n, 3) [m] of a knit's points, and rest lengths of arcs by row and of legs by course [m]."""

    position: Float
    arcs: Float
    legs: Float


def draw_over(over: Over, net: Structure, spacing: tuple[float, float] | None, x: Float, faces: Int) -> Fitted:
    """A tube over the mesh x (v, 3) [m], faces (f, 3). `spacing` [m], where given, is the rest length of arcs and legs.

    Raises BadInput for ends that lie outside of the mesh, for a limb that has no room for it, and for a knit that is
    too wide for the limb or starts too far from it.
    """
    try:
        rows = lay_rows(x, faces, _line(over, x, faces), net.courses + 1, net.columns, over.toe == "closed")
    except BadInput as error:
        # Who finds axes and rows does not know where a scene says between what.
        if error.field is not None and error.field.startswith(("axis", "between")):
            error.field = "over.between"
        raise
    _check_clearance(over, rows)
    ratio = np.linspace(*(over.girth if isinstance(over.girth, tuple) else (over.girth, over.girth)), len(rows.girth))
    if spacing is None:
        girth = ratio * (rows.girth.mean() if over.of == "mean" else rows.girth)
        leg = over.height * rows.height / net.courses
    else:
        girth, leg = np.full(len(rows.girth), spacing[0] * net.columns), spacing[1]
    _check_girth(over, girth, rows.girth, spacing is not None)
    girth = np.minimum(girth, NARROW * rows.girth)
    return Fitted(_clear(over, rows, x, faces), girth / net.columns, np.full(net.courses, leg))


def _check_clearance(over: Over, rows: Rows) -> None:
    """Raises BadInput for a start farther off than the limb is thick, where rows of a bent limb would cross."""
    radius = float(rows.girth.mean() / (2.0 * np.pi))
    if over.clearance > radius:
        raise BadInput(
            "the knit starts too far from the limb", field="over.clearance", value=f"{over.clearance:g} m",
            limit=f"at most {radius:.2g} m, the limb's mean radius", remedy="a few millimetres are enough",
        )  # fmt: skip


def _check_girth(over: Over, girth: Float, limb: Float, spaced: bool) -> None:
    """Raises BadInput for a knit of rows' girths (r,) [m] that is too wide on the whole for those of the limb (r,) [m];
    single rows that are, at an ankle, are narrowed.
    """
    share = float(girth.mean() / limb.mean())
    if share > NARROW:
        raise BadInput(
            f"the knit is too wide to hold on the limb: at rest {share:.2f} of its girth on average",
            field="spacing" if spaced else "over.girth",
            limit=f"at most {NARROW:g}",
            remedy="fewer wales or shorter arcs" if spaced else "0.5 to 0.8 fit well",
        )


def _line(over: Over, x: Float, faces: Int) -> Float:
    """(k, 3) the part of the limb's axis between the two places [m]."""
    first, last = over.between
    if isinstance(first, tuple) and isinstance(last, tuple):
        return find_axis(x, faces, np.array(first), np.array(last)).points
    start, end = float(first), float(last)  # type: ignore[arg-type]
    if not 0.0 <= start < end <= 1.0:
        raise BadInput(
            "the first row lies before the last one", field="over.between", value=[start, end],
            limit="0 to 1, ascending", remedy="0 is the limb's thinner end",
        )  # fmt: skip
    return find_limb(x, faces).at(np.linspace(start, end, LINE))


def _clear(over: Over, rows: Rows, x: Float, faces: Int) -> Float:
    """(n, 3) points off the surface: the end rows about on it, the others by the clearance, or less where the limb is
    nearer to itself. Raises BadInput where there is no room at all.
    """
    tree = build_tree(x, faces)
    away = np.full(rows.points.shape[:2], over.clearance)
    away[[0, -1]] = SKIN
    position, normal = (rows.points + away[..., None] * rows.normal).reshape(-1, 3), rows.normal.reshape(-1, 3)
    for _ in range(ROUNDS):
        found = closest_points(tree, position)
        near = found.distance < ROOM
        if not near.any():
            return np.ascontiguousarray(position)
        # Where a row that is not level cuts through a swelling: out by the shortest way, from the surface itself by
        # the row's own.
        distance = found.distance[near, None]
        out = np.divide(position[near] - found.point[near], distance, out=normal[near], where=distance != 0.0)
        position[near] = found.point[near] + 2.0 * ROOM * out
    row = int(np.argmax(near)) // rows.points.shape[1]
    raise BadInput(
        "the limb leaves no room for the knit", field="over", value=f"row {row} of {len(away)}",
        limit=f"{ROOM:g} m beside the surface", remedy="take the mesh apart where it nearly touches itself",
    )  # fmt: skip
