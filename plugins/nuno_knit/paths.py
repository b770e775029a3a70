"""Yarns as rows of points, from one end to the other, and the course of their loops in plain knit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.operation import first_of_pieces
from nuno_schemas.vectors import unit_rows

# Yarns as rows of points, from one end to the other.


@dataclass(frozen=True)
class Paths:
    """Points along yarns.

    vertex (p,)     int32 points of the fabric, yarn by yarn; a ring ends with its first point
    ptr    (y + 1,) int64 yarn y is vertex[ptr[y]:ptr[y + 1]]
    kind   (y,)     int32 index into `names`
    thickness (y,)  as a ratio of the mean yarn's
    """

    vertex: Int
    ptr: NDArray[np.int64]
    kind: Int
    names: tuple[str, ...]
    thickness: Float

    @property
    def number(self) -> int:
        return len(self.kind)

    @property
    def steps(self) -> NDArray[np.int64]:
        """Places (s,) in `vertex` from which a link leads to the next."""
        return first_of_pieces(self.ptr)

    @property
    def pairs(self) -> Int:
        """Points (s, 2) of every link, in the direction of its yarn."""
        return np.stack([self.vertex[self.steps], self.vertex[self.steps + 1]], axis=1)

    @property
    def order(self) -> NDArray[np.int64]:
        """Number (s,) of each link in its yarn, from 0."""
        return self.steps - np.repeat(self.ptr[:-1], np.diff(self.ptr) - 1)

    @property
    def rings(self) -> Bool:
        """Whether yarns (y,) close on themselves."""
        return np.asarray(
            (np.diff(self.ptr) > 2) & (self.vertex[self.ptr[:-1]] == self.vertex[self.ptr[1:] - 1]), np.bool_
        )


def find_paths(fabric: Fabric) -> Paths:
    """Return the points along a fabric's yarns, in order. Raises BadInput for a fabric without yarns."""
    springs, yarns = fabric.springs, fabric.yarns
    if springs is None or yarns is None or not yarns.number:
        raise BadInput("the cloth has no yarns", value=fabric.name, remedy="yarns are what the model knit makes")
    size = np.diff(yarns.ptr).astype(np.int64)
    first, last = yarns.ptr[:-1].astype(np.int64), yarns.ptr[1:].astype(np.int64) - 1
    ring = (size > 1) & (yarns.links[first] == yarns.links[last])
    counted = np.ones(len(yarns.links), bool)
    counted[last[ring]] = False
    links = springs.pairs()[yarns.links]
    # A link's end is the point that the next link shares; a yarn's last link starts where the previous one ends, and a
    # single link at its first point.
    following, previous = np.roll(links, -1, axis=0), np.roll(links, 1, axis=0)
    backward = (links[:, :1] == following).any(axis=1) & ~(links[:, 1:] == following).any(axis=1)
    backward[last] = (links[last, 1:] == previous[last]).any(axis=1) & (size > 1)
    directed = np.where(backward[:, None], links[:, ::-1], links)[counted]
    count = size - ring
    ptr = np.concatenate([[0], np.cumsum(count + 1)]).astype(np.int64)
    vertex = np.empty(ptr[-1], np.int32)
    ends = ptr[1:] - 1
    inner = np.ones(len(vertex), bool)
    inner[ends] = False
    vertex[inner] = directed[:, 0]
    vertex[ends] = directed[np.cumsum(count) - 1, 1]
    return Paths(vertex, ptr, yarns.kind.astype(np.int32), yarns.names, yarns.thickness())


def mean_length(paths: Paths, x: Float) -> float:
    """Return the mean length of all links [m] between points x (n, 3) [m]; 0 without links."""
    pairs = paths.pairs
    return float(np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1).mean()) if len(pairs) else 0.0


# Loops of plain knit: the course of yarns between and next to the points of the net.
#
# At a point of the net two loops hook into each other. There the yarn of the lower course turns from a leg into a head,
# or back, and that of the upper course from a sinker into a leg, or back. Each turns beyond the other, so that they
# cross twice (drawn for the left side of a loop, legs up and arcs to the right):
#
#           leg of the upper course          At distance delta from the point along both axes:
#               |                             x  turns, each displaced away from its own links
#       x-------+------ head of the lower      +  crossings, where a leg passes over an arc
#       |   o   |
#     --+-------x                             Legs lie in front of heads and sinkers, as on the face of plain knit,
#       |  sinker of the upper                a turn half way between; so heads reach beyond the legs that they
#     leg of the lower                        hold, sinkers likewise, and loops narrow at their feet, as do real ones.
#
# Each link gives four points: its turn, the crossing near its start, its middle and the crossing near its end. In its
# middle an arc is bowed outwards by `BOW` of its ends' displacement. This shape is prescribed, not a result of bending:
# the elastica of Leaf (1960) gives similar shapes for knit at rest, and this net is stretched far beyond that.
#
# The kind of a corner follows from a course's links, in the order of the model `knit`: up a leg, along a head, down a
# leg, along a sinker, and so on. Links without a course are arcs: heads below the first course, sinkers above the last.

ROUND, BOW = 0.75, 1.3
"""Displacements of turns and of an arc's middle as ratios of that of crossings, which make arcs round."""
WIDEST = 0.3
"""Largest displacement of a turn as a share of the shortest link at its point, which keeps a link's crossings apart."""


@dataclass(frozen=True)
class Net:
    """Links in the directions of their yarns.

    start, end (s,)   int32 points
    leg        (s,)   whether it is a leg, else an arc
    role       (s, 2) at start and end: 1 if the yarn is the lower one, whose head is there, else -1
    onward     (s - 1,) whether the yarn continues with the next link
    """

    start: Int
    end: Int
    leg: Bool
    role: Float
    onward: Bool

    @property
    def points(self) -> Int:
        """Points (2 s,) of all starts, then of all ends."""
        return np.concatenate([self.start, self.end])

    def sums(self, values: Float, count: int) -> Float:
        """Return sums (count, 3) by point of values (2 s, 3), those of starts first."""
        return np.stack([np.bincount(self.points, values[:, c], count) for c in range(3)], axis=1)


def find_net(paths: Paths, count: int) -> Net:
    """Return the links with their roles; `count` is the number of the fabric's points."""
    pairs, phase = paths.pairs, paths.order % 4
    alone = np.repeat(np.diff(paths.ptr) == 2, np.diff(paths.ptr) - 1)
    role = np.stack([np.where((phase == 1) | (phase == 2), 1.0, -1.0), np.where(phase < 2, 1.0, -1.0)], axis=1)
    role[alone] = 0.0
    balance = np.bincount(pairs.T.reshape(-1), role.T.reshape(-1), count)
    role[alone] = np.where(balance[pairs[alone]].sum(axis=1) > 0.0, -1.0, 1.0)[:, None]
    return Net(pairs[:, 0], pairs[:, 1], (phase % 2 == 0) & ~alone, role, paths.order[1:] > 0)


def face_of_knit(net: Net, x: Float) -> Float:
    """Return unit normals (n, 3) towards the knit's face, right-handed with its right and up; 0 at points without a
    turn.

    At a turn a yarn passes from one link to the next; at a head it turns clockwise, seen from the face.
    """
    along = unit_rows(x[net.end] - x[net.start])
    on = net.onward
    turn = np.zeros_like(along)
    turn[:-1][on] = -net.role[:-1, 1][on, None] * np.cross(along[:-1], along[1:])[on]
    return unit_rows(net.sums(np.concatenate([np.zeros_like(turn), turn]), len(x)))


def find_axes(net: Net, x: Float, normal: Float) -> tuple[Float, Float]:
    """Return unit directions (n, 3), normal to `normal`, in which the lower course's legs and arcs leave each point, as
    means with the opposite directions of the upper course's.
    """
    along = unit_rows(x[net.end] - x[net.start])
    away = np.concatenate([net.role[:, :1] * along, -net.role[:, 1:] * along])
    leg = np.concatenate([net.leg, net.leg])[:, None]
    axes = []
    for selected in (leg, ~leg):
        axis = net.sums(np.where(selected, away, 0.0), len(x))
        axes.append(unit_rows(axis - (axis * normal).sum(axis=1, keepdims=True) * normal))
    return axes[0], axes[1]


def find_widths(net: Net, x: Float, curl: float, radius: float) -> Float:
    """Return the displacement (n,) of turns along each axis [m]: a share `curl` of the shortest link, at least the
    yarn's radius, and at most WIDEST.
    """
    length = np.linalg.norm(x[net.end] - x[net.start], axis=1)
    shortest = np.full(len(x), np.inf)
    np.minimum.at(shortest, net.points, np.concatenate([length, length]))
    shortest = np.where(np.isfinite(shortest), shortest, 0.0)
    wanted = np.maximum(curl * shortest, radius if curl > 0.0 else 0.0)
    return np.asarray(np.minimum(wanted, WIDEST * shortest))


def lay_loops(
    paths: Paths, net: Net, x: Float, middle: Float, axes: tuple[Float, Float], width: Float
) -> tuple[Float, NDArray[np.int8], NDArray[np.int64]]:
    """Return points (c, 3) of curves, their levels (c,), and the first of each yarn, ptr (y + 1,). middle (s, 3) are
    the middles of the links [m], width (n,) is that of find_widths.
    """
    leg = net.leg[:, None]
    ends = []
    for k, point in enumerate((net.start, net.end)):
        along, beside_axis = (np.where(leg, axes[i][point], axes[1 - i][point]) for i in (0, 1))
        scale = (net.role[:, k] * width[point])[:, None]
        ends.append((x[point], scale * along, scale * beside_axis))
    (a, along_a, across_a), (b, along_b, across_b) = ends
    bowed = middle - 0.5 * BOW * (across_a + across_b)
    of_link = np.stack(
        [a - ROUND * (along_a + across_a), a + along_a - across_a, bowed, b + along_b - across_b], axis=1
    )
    level = np.where(leg, np.array([1, 2, 2, 2]), np.array([1, 0, 0, 0])).astype(np.int8)
    steps = paths.steps
    count = np.zeros(len(paths.vertex), np.int64)
    count[steps] = 4
    count[paths.ptr[1:] - 1] = 1
    place = np.concatenate([[0], np.cumsum(count)])
    points, levels = np.empty((place[-1], 3)), np.ones(place[-1], np.int8)
    at = place[steps][:, None] + np.arange(4)
    points[at], levels[at] = of_link, level
    final = np.flatnonzero(np.append(steps[1:] != steps[:-1] + 1, True))
    points[place[paths.ptr[1:] - 1]] = (b - ROUND * (along_b + across_b))[final]
    return points, levels, place[paths.ptr]
