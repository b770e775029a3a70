"""Plain knit as a net: a point wherever yarns cross, two columns of points a wale.

Points (r, q) have number r Q + q, rows r = 0 .. R from the bottom, columns q = 0 .. Q - 1 to the right; R courses
have R + 1 rows. The vertical link (r, q)-(r + 1, q) is a leg of course r. The horizontal link (r, q)-(r, q + 1) is
the head of course r - 1 where q is even and the sinker of course r where q is odd:

    r + 1   o===o   o===o    heads of course r       course r (its yarn) goes
            |   |   |   |    legs of course r        up a leg, along a head, down a leg, along a sinker, up ...
    r       o   o===o   o    sinkers of course r
            0   1   2   3

On the bottom row heads have no course, on the top row sinkers: such a borrowed link is of its neighbour's yarn, and a
yarn by itself, for tension does not pass through it. On a tube a course closes on itself and is a ring.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_schemas.fabric import Bool, Float, Int


@dataclass(frozen=True)
class Knit:
    """`courses` of `columns` (two a wale), joined to a tube where `periodic`."""

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
        """(s, 2) points of every link, legs first."""
        number = np.arange(self.points, dtype=np.int32).reshape(-1, self.columns)
        legs = np.stack([number[:-1], number[1:]], axis=-1).reshape(-1, 2)
        right = np.roll(number, -1, axis=1)
        arcs = np.stack([number, right], axis=-1)[:, : self.across].reshape(-1, 2)
        return np.ascontiguousarray(np.concatenate([legs, arcs]), np.int32)

    def spread(self, legs: Float, arcs: Float) -> Float:
        """(s,) values of every link from those of each course's legs (courses,) and of each row's arcs (rows,)."""
        return np.concatenate([np.repeat(legs, self.columns), np.repeat(arcs, self.across)])

    def cells(self) -> Int:
        """(c, 4) points of every quad between two rows, counter-clockwise seen from outside."""
        number = np.arange(self.points, dtype=np.int32).reshape(-1, self.columns)
        right = np.roll(number, -1, axis=1)
        corners = (number[:-1], right[:-1], right[1:], number[1:])
        return np.ascontiguousarray(np.stack(corners, axis=-1)[:, : self.across].reshape(-1, 4), np.int32)

    def course(self) -> tuple[Int, Bool]:
        """(s,) course of every link, and which are borrowed from it: the first's heads below, the last's above."""
        rows, columns = np.divmod(np.arange((self.courses + 1) * self.across), self.across)
        own = rows - (columns % 2 == 0)
        borrowed = (own < 0) | (own >= self.courses)
        legs = np.repeat(np.arange(self.courses), self.columns)
        course = np.concatenate([legs, np.clip(own, 0, self.courses - 1)])
        return course.astype(np.int32), np.concatenate([np.zeros(self.legs, bool), borrowed])

    def threads(self) -> list[Int]:
        """Links of every yarn in their order: course by course, then the borrowed ones, each by itself."""
        found = [self._thread(course) for course in range(self.courses)]
        _, borrowed = self.course()
        return found + [np.array([link], np.int32) for link in np.flatnonzero(borrowed)]

    def _thread(self, course: int) -> Int:
        """Up a leg, along a head, down a leg, along a sinker; a ring ends with the leg it began with."""
        q = np.arange(0, self.columns, 2)
        legs, arcs = course * self.columns, self.legs + self.across * np.array([course + 1, course])
        wale = np.stack([legs + q, arcs[0] + q, legs + q + 1, arcs[1] + q + 1], axis=1).reshape(-1)
        end = wale[:1] if self.periodic else wale[:0]
        return np.concatenate([wale if self.periodic else wale[:-1], end]).astype(np.int32)
