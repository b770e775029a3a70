"""The direction in which cloth has to move: the part on the wrong side of a contour, and the right side.

A contour that cuts a sheet in two has the smaller part on the wrong side (Baraff, Witkin, Kass 2003). Cut are edges
that the contour crosses an odd number of times; where a contour ends within a triangle at the sheet's border, what
little is left of it counts as cut. Both sheets go where the contour is closed and neither part is much larger than the
other, otherwise only the one that has the smaller part. A part that is held counts as large.

A contour that cuts neither sheet, as where two borders have slid into each other, is made shorter (Volino, Magnenat-
Thalmann: Resolving surface collisions through intersection contour minimization, SIGGRAPH 2006). With unit vectors r
from a node along its segments, the edge's direction e and the triangle's normal n, a displacement a of the edge and b
of the triangle there moves the node by a + e ((b - a) . n) / (e . n), and the contour gets shorter by that times the
sum of r: steepest for a - b along r - 2 n (r . e) / (n . e). What moves is a sheet, so that all of a contour's nodes go
the mean way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_contact.untangle.cloth import Cloth, Long
from nuno_contact.untangle.contours import Contours, Nodes, units
from nuno_kernels import block_kernel
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.vectors import dot, norm

ALIKE = 4.0
"""Both sheets of a closed contour move if neither's part is larger than this factor on the other's."""
HALF = 0.5
"""A sheet is cut if at least this share of the nodes on its edges have their ends in different parts."""
GRAZING = 0.1
"""least cosine between an edge and a normal for the change of a contour"""
ONE_WAY = 0.1
"""share of the sum of their lengths that a contour's vectors' sum has at least; otherwise they point all ways"""


class Sides(NamedTuple):
    """Directions of nodes: way (k, 3) that each edge has to go in relation to its triangle; wrong (k,) the vertex of
    the edge that is on the wrong side, -1 if that is unknown. And tangled (n,), vertices that are on the wrong side or
    at a node.
    """

    way: Float
    wrong: Long
    tangled: Bool


@block_kernel
def flood(start: Long, ring: Long, ring_edge: Long, cut: Bool, seeds: Long, label: Long, weight: Float) -> Long:
    """Return the numbers (s,) of the parts that uncut edges join seeds to; label (n,) gets them as well, -1 elsewhere.
    The weight of each part goes into the beginning of weight (n,).
    """
    waiting, count, own = np.empty(label.shape[0], np.int64), 0, weight.copy()
    found = np.empty(seeds.shape[0], np.int64)
    for s in range(seeds.shape[0]):
        if label[seeds[s]] < 0:
            top, total = 1, 0.0
            waiting[0] = seeds[s]
            label[seeds[s]] = count
            while top > 0:
                top -= 1
                v = waiting[top]
                total += own[v]
                for q in range(start[v], start[v + 1]):
                    if not cut[ring_edge[q]] and label[ring[q]] < 0:
                        label[ring[q]] = count
                        waiting[top] = ring[q]
                        top += 1
            weight[count] = total
            count += 1
        found[s] = label[seeds[s]]
    return found


def find_sides(cloth: Cloth, x: Float, nodes: Nodes, contours: Contours, shorten: bool) -> Sides:
    """Return the sides at vertices x (n, 3); with `shorten`, contours are made shorter also where they cut."""
    k, sign = len(nodes.edge), np.where(contours.sheet == 0, 1.0, -1.0)
    way, wrong, known = np.zeros((k, 3)), np.full(k, -1), np.zeros(k, bool)
    tangled = np.zeros(len(x), bool)
    tangled[nodes.ends] = tangled[nodes.corners] = True
    order = np.argsort(contours.contour, kind="stable")
    for own in np.split(order, np.cumsum(np.bincount(contours.contour))[:-1]):
        parted, ends, inside = part(cloth, nodes, contours, own)
        tangled |= inside
        if not parted.any() or shorten:
            way[own], known[own] = sign[own][:, None] * shortening(x, nodes, contours, own, sign[own]), True
            continue
        chosen, at = own[parted], np.arange(len(own))[parted]
        wrong[chosen] = nodes.ends[chosen, ends[at]]
        below = np.where(nodes.heights[chosen, ends[at]] > 0.0, -1.0, 1.0)
        way[chosen], known[chosen] = below[:, None] * nodes.normals[chosen], True
    spread(contours, sign, way, known)
    return Sides(way, wrong, tangled)


def part(cloth: Cloth, nodes: Nodes, contours: Contours, own: Long) -> tuple[Bool, Long, Bool]:
    """Return, for one contour's nodes (m,): which of them have a direction, and which end of the edge is on the wrong
    side; and (n,) the vertices on the wrong side.
    """
    n, edges = len(cloth.weight), cloth.tree.edges
    ends, sheet = nodes.ends[own], contours.sheet[own]
    crossed, times = np.unique(nodes.edge[own], return_counts=True)
    cut = np.zeros(len(edges), bool)
    cut[crossed[times % 2 == 1]] = True
    odd = cut[nodes.edge[own]]
    # If the contour ends inside of a triangle at the border, the triangle's part of the border is cut as well.
    last = nodes.corners[own[contours.ends[own]]]
    bare = np.zeros(n, bool)
    bare[last[cloth.border[last]]] = True
    for vertex in np.flatnonzero(bare):
        cut[cloth.ring_edge[cloth.ring_start[vertex] : cloth.ring_start[vertex + 1]]] = True
    label, weight = np.full(n, -1), cloth.weight.copy()
    label_of = flood(cloth.ring_start, cloth.ring, cloth.ring_edge, cut, ends.ravel(), label, weight).reshape(-1, 2)
    split = odd & (label_of[:, 0] != label_of[:, 1]) & ~bare[ends].any(axis=1)
    lighter = (weight[label_of[:, 0]] > weight[label_of[:, 1]]).astype(np.int64)
    lost = label_of[np.arange(len(own)), lighter]
    cost = [np.inf, np.inf]
    for side in (0, 1):
        mine = sheet == side
        if (here := split & mine).any() and here.sum() >= HALF * mine.sum():
            cost[side] = float(np.cumsum(weight[np.unique(lost[here])])[-1])
    goes = np.zeros(2, bool)
    if min(cost) < np.inf:
        goes[best := int(cost[1] < cost[0])] = True
        goes[1 - best] = not contours.ends[own].any() and cost[1 - best] <= ALIKE * cost[best]
    parted = split & goes[sheet]
    return parted, lighter, np.isin(label, lost[parted]) & (label >= 0)


def shortening(x: Float, nodes: Nodes, contours: Contours, own: Long, sign: Float) -> Float:
    """Return the way (m, 3) that the contour's first sheet has to go in relation to its second to make it shorter."""
    e, n, r = units(x[nodes.ends[own, 1]] - x[nodes.ends[own, 0]]), nodes.normals[own], contours.pull[own]
    cosine = dot(e, n)
    cosine = np.where(np.abs(cosine) < GRAZING, np.copysign(GRAZING, cosine), cosine)
    steepest = sign[:, None] * (r - 2.0 * (dot(r, e) / cosine)[:, None] * n)
    total, length = np.cumsum(steepest, axis=0)[-1:], norm(steepest)
    if float(norm(total)[0]) > ONE_WAY * float(np.cumsum(length)[-1]):
        return np.repeat(units(total), len(own), axis=0)
    longest = float(length.max())
    return steepest / longest if longest > 0.0 else steepest


def spread(contours: Contours, sign: Float, way: Float, known: Bool) -> None:
    """Give the nodes without a way that of those next to them on the contour, in place."""
    while True:
        total, count = np.zeros_like(way), np.zeros(len(way))
        for one, two in ((contours.one, contours.two), (contours.two, contours.one)):
            np.add.at(total, one, (sign * known)[two][:, None] * way[two])
            np.add.at(count, one, known[two])
        new = ~known & (count > 0)
        if not new.any():
            return
        way[new] = sign[new][:, None] * units(total[new])
        known |= new
