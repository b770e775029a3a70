"""Plain knit as a net: a point wherever yarns cross, two columns of points per wale.

Points (r, q) have number r Q + q, rows r = 0 .. R from the bottom, columns q = 0 .. Q - 1 to the right; R courses
have R + 1 rows. The vertical link (r, q)-(r + 1, q) is a leg of course r. The horizontal link (r, q)-(r, q + 1) is
the head of course r - 1 where q is even and the sinker of course r where q is odd:

    r + 1   o===o   o===o    heads of course r       course r (its yarn) goes
            |   |   |   |    legs of course r        up a leg, along a head, down a leg, along a sinker, up ...
    r       o   o===o   o    sinkers of course r
            0   1   2   3

On the bottom row heads have no course, on the top row sinkers have none: such a borrowed link has its neighbour's kind
of yarn, but is a separate yarn, since tension does not pass through it. On a tube a course is a closed ring.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_schemas.fabric import Bool, Float, Int


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
