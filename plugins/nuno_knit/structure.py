"""Plain knit as a net: a point wherever yarns cross; and the start of a tube of it on a limb."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from nuno_geometry.centreline import find_axis
from nuno_geometry.closest_point import closest_points
from nuno_geometry.limb import Rows, find_limb, lay_rows
from nuno_geometry.tree import build_tree
from nuno_knit.quantities import Length, Point, Ratio, Share
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.plugin import Config

# Plain knit as a net: a point wherever yarns cross, two columns of points per wale.
#
# Points (r, q) have number r Q + q, rows r = 0 .. R from the bottom, columns q = 0 .. Q - 1 to the right; R courses
# have R + 1 rows. The vertical link (r, q)-(r + 1, q) is a leg of course r. The horizontal link (r, q)-(r, q + 1) is
# the head of course r - 1 where q is even and the sinker of course r where q is odd:
#
#     r + 1   o===o   o===o    heads of course r       course r (its yarn) goes
#             |   |   |   |    legs of course r        up a leg, along a head, down a leg, along a sinker, up ...
#     r       o   o===o   o    sinkers of course r
#             0   1   2   3
#
# On the bottom row heads have no course, on the top row sinkers have none: such a borrowed link has its neighbour's
# kind of yarn, but is a separate yarn, since tension does not pass through it. On a tube a course is a closed ring.


@dataclass(frozen=True)
class Knit:
    """A net of `courses` and `columns` (two per wale), joined to a tube if `periodic`."""

    courses: int
    columns: int
    periodic: bool

    @property
    def points(self) -> int:
        return (self.courses + 1) * self.columns

    @property
    def legs(self) -> int:
        """Vertical links; they come before the arcs, row by row."""
        return self.courses * self.columns

    @property
    def across(self) -> int:
        """Arcs in a row."""
        return self.columns if self.periodic else self.columns - 1

    @property
    def links(self) -> int:
        return self.legs + (self.courses + 1) * self.across

    def pairs(self) -> Int:
        """Return the points (s, 2) of every link, legs first."""
        number = np.arange(self.points, dtype=np.int32).reshape(-1, self.columns)
        legs = np.stack([number[:-1], number[1:]], axis=-1).reshape(-1, 2)
        right = np.roll(number, -1, axis=1)
        arcs = np.stack([number, right], axis=-1)[:, : self.across].reshape(-1, 2)
        return np.ascontiguousarray(np.concatenate([legs, arcs]), np.int32)

    def spread(self, legs: Float, arcs: Float) -> Float:
        """Return values (s,) of every link from those of each course's legs (courses,) and each row's arcs (rows,)."""
        return np.concatenate([np.repeat(legs, self.columns), np.repeat(arcs, self.across)])

    def cells(self) -> Int:
        """Return the points (c, 4) of every quad between two rows, counter-clockwise seen from outside."""
        number = np.arange(self.points, dtype=np.int32).reshape(-1, self.columns)
        right = np.roll(number, -1, axis=1)
        corners = (number[:-1], right[:-1], right[1:], number[1:])
        return np.ascontiguousarray(np.stack(corners, axis=-1)[:, : self.across].reshape(-1, 4), np.int32)

    def course(self) -> tuple[Int, Bool]:
        """Return the course (s,) of every link, and which are borrowed: heads at the bottom, sinkers at the top."""
        rows, columns = np.divmod(np.arange((self.courses + 1) * self.across), self.across)
        row_course = rows - (columns % 2 == 0)
        borrowed = (row_course < 0) | (row_course >= self.courses)
        legs = np.repeat(np.arange(self.courses), self.columns)
        course = np.concatenate([legs, np.clip(row_course, 0, self.courses - 1)])
        return course.astype(np.int32), np.concatenate([np.zeros(self.legs, bool), borrowed])

    def threads(self) -> list[Int]:
        """Return the links of every yarn in order: course by course, then each borrowed one."""
        threads = [self._thread(course) for course in range(self.courses)]
        _, borrowed = self.course()
        return threads + [np.array([link], np.int32) for link in np.flatnonzero(borrowed)]

    def _thread(self, course: int) -> Int:
        """Return links up a leg, along a head, down a leg, along a sinker; a ring ends with its first leg."""
        q = np.arange(0, self.columns, 2)
        legs, arcs = course * self.columns, self.legs + self.across * np.array([course + 1, course])
        wale = np.stack([legs + q, arcs[0] + q, legs + q + 1, arcs[1] + q + 1], axis=1).reshape(-1)
        end = wale[:1] if self.periodic else wale[:0]
        return np.concatenate([wale if self.periodic else wale[:-1], end]).astype(np.int32)


# A tube of knit drawn over a limb: the start of its rows, and the rest lengths of its links.

LINE = 65
"""Points of the part of an axis under a knit."""
SKIN = 5e-5
"""Distance of the end rows from the surface [m]: the default gap of sliding contact at rest."""
NARROW = 0.9
"""Largest share of the limb's girth for a row's girth at rest: rows narrow towards a toe."""
ROOM = 4e-5
"""Least distance from the surface at which points start [m]."""
ROUNDS = 8
"""The most rounds that move points off the surface."""


class Over(Config):
    """The body that a tube is drawn over, and the tube's size at rest as ratios of the limb's."""

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
    """A fitted knit: positions (n, 3) [m] of its points, and rest lengths of arcs by row and of legs by course [m]."""

    position: Float
    arcs: Float
    legs: Float


def draw_over(over: Over, net: Knit, spacing: tuple[float, float] | None, x: Float, faces: Int) -> Fitted:
    """Fit a tube over the mesh x (v, 3) [m], faces (f, 3). `spacing` [m], if any, is the rest length of arcs and legs.

    Raises BadInput for ends that lie outside of the mesh, for a limb that has no room for it, and for a knit that is
    too wide for the limb or starts too far from it.
    """
    try:
        rows = lay_rows(x, faces, _axis_line(over, x, faces), net.courses + 1, net.columns, over.toe == "closed")
    except BadInput as error:
        # The functions that find axes and rows do not know the scene's field of the ends.
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
    return Fitted(_lift_off(over, rows, x, faces), girth / net.columns, np.full(net.courses, leg))


def _check_clearance(over: Over, rows: Rows) -> None:
    """Raise BadInput for a start farther off than the limb's radius, where rows of a bent limb would cross."""
    radius = float(rows.girth.mean() / (2.0 * np.pi))
    if over.clearance > radius:
        raise BadInput(
            "the knit starts too far from the limb", field="over.clearance", value=f"{over.clearance:g} m",
            limit=f"at most {radius:.2g} m, the limb's mean radius", remedy="a few millimetres are enough",
        )  # fmt: skip


def _check_girth(over: Over, girth: Float, limb: Float, spaced: bool) -> None:
    """Raise BadInput if a knit of rows' girths (r,) [m] is on average too wide for those of the limb (r,) [m]; single
    rows, as at an ankle, are narrowed.
    """
    share = float(girth.mean() / limb.mean())
    if share > NARROW:
        raise BadInput(
            f"the knit is too wide to hold on the limb: at rest {share:.2f} of its girth on average",
            field="spacing" if spaced else "over.girth",
            limit=f"at most {NARROW:g}",
            remedy="fewer wales or shorter arcs" if spaced else "0.5 to 0.8 fit well",
        )


def _axis_line(over: Over, x: Float, faces: Int) -> Float:
    """Return the part (k, 3) of the limb's axis between the two places [m]."""
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


def _lift_off(over: Over, rows: Rows, x: Float, faces: Int) -> Float:
    """Return points (n, 3) off the surface: the end rows nearly on it, the others by the clearance, or less where the
    limb is near to itself. Raises BadInput if there is no room.
    """
    tree = build_tree(x, faces)
    offset = np.full(rows.points.shape[:2], over.clearance)
    offset[[0, -1]] = SKIN
    position, normal = (rows.points + offset[..., None] * rows.normal).reshape(-1, 3), rows.normal.reshape(-1, 3)
    for _ in range(ROUNDS):
        nearest = closest_points(tree, position)
        near = nearest.distance < ROOM
        if not near.any():
            return np.ascontiguousarray(position)
        # Where an oblique row cuts through a swelling, move out by the shortest way, or on the surface itself by the
        # row's normal.
        distance = nearest.distance[near, None]
        out = np.divide(position[near] - nearest.point[near], distance, out=normal[near], where=distance != 0.0)
        position[near] = nearest.point[near] + 2.0 * ROOM * out
    row = int(np.argmax(near)) // rows.points.shape[1]
    raise BadInput(
        "the limb leaves no room for the knit", field="over", value=f"row {row} of {len(offset)}",
        limit=f"{ROOM:g} m beside the surface", remedy="take the mesh apart where it nearly touches itself",
    )  # fmt: skip
