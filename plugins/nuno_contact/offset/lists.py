"""The list of pairs made from what the tree finds, and those of it that are near: what forces and steps look at."""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.offset.meeting import EDGES, Meeting, tree_of
from nuno_contact.offset.proximity import closest, point, spread_between, unit, weigh
from nuno_contact.offset.search import find_leaves, find_near
from nuno_contact.offset.tree import Tree, fit_tree, less
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.bodies.poses import Index, Vector
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_schemas.fabric import Float, Int

MIDDLES = (0.5, 0.5, -0.5, -0.5), (1.0, -1.0 / 3.0, -1.0 / 3.0, -1.0 / 3.0)
"""Weights of the way between the middles of two edges, and of a vertex and a triangle."""


@forced_inline
def share_of(m: Meeting, i: int, l: int, of_edges: bool) -> float:  # noqa: E741
    """The share of the stiffness that a pair of cloth and a body has, by the first of each primitive's vertices: a
    piece of cloth has as many of a fine body's vertices below it, and edges as many across it, as that is finer.
    """
    first = m.size.shape[0] - m.local.shape[0]
    cloth, body = (m.size[i], m.size[l]) if i < first else (m.size[l], m.size[i])
    finer: float = less(1.0, body / cloth)
    return finer if of_edges else 1.0 if i < first else finer * finer


@block_kernel
def measure(m: Meeting, p: int) -> None:
    """From where on a listed pair pushes, how stiffly, how damped and how rough; not at all where all of it is held."""
    s, i, j, k, l = m.start, m.pair[p, 0], m.pair[p, 1], m.pair[p, 2], m.pair[p, 3]  # noqa: E741
    begun = (point(s, i), point(s, j), point(s, k), point(s, l))
    _, before = unit(weigh(closest(m.of[p] < 0, begun).weights, begun))
    least, mass = np.inf, np.inf
    for v in (i, j, k, l):
        if m.mass[v] > 0.0:
            least, mass = less(least, m.stiffness[v]), less(mass, m.mass[v])
    stiffness = 0.0 if mass == np.inf else 0.5 * least * (EDGES if m.of[p] < 0 else 1.0)
    mu, damping = m.law[1], m.law[2]
    body = max(m.piece[i], m.piece[l]) - (m.meets.shape[0] - m.body_law.shape[0])
    if body >= 0:
        mu, damping = m.body_law[body, 0], m.body_law[body, 1]
        stiffness *= share_of(m, i, l, m.of[p] < 0)
    m.reach[p], m.pair_stiffness[p], m.pair_friction[p] = less(m.law[0], before), stiffness, mu
    m.pair_damping[p] = 0.0 if mass == np.inf else 2.0 * damping * math.sqrt(0.5 * stiffness * mass)


@block_kernel
def lay_out(x: Float, u: Float, spread: Float, ways: Float) -> None:
    """Into ways (n, 8), for each vertex in one line of the cache: where it is, where it goes, and its spread."""
    for i in range(x.shape[1]):
        for row in range(3):
            ways[i, row], ways[i, 3 + row] = x[row, i], x[row, i] + u[row, i]
        ways[i, 6] = spread[i]


@forced_inline
def begin_of(ways: Float, i: Index) -> Vector:
    """Where vertex i is."""
    return ways[i, 0], ways[i, 1], ways[i, 2]


@forced_inline
def end_of(ways: Float, i: Index) -> Vector:
    """Where it goes."""
    return ways[i, 3], ways[i, 4], ways[i, 5]


@forced_inline
def gap_along(of_edges: bool, n: Vector, ways: Float, i: Index, j: Index, k: Index, l: Index) -> float:  # noqa: E741
    """How far apart a plane across n keeps a pair all along its way, strays included."""
    r = (ways[i, 6], ways[j, 6], ways[k, 6], ways[l, 6])
    begin = (begin_of(ways, i), begin_of(ways, j), begin_of(ways, k), begin_of(ways, l))
    end = (end_of(ways, i), end_of(ways, j), end_of(ways, k), end_of(ways, l))
    return less(spread_between(of_edges, n, begin, r), spread_between(of_edges, n, end, r))


@forced_inline
def vertices_of(m: Meeting, e: int, f: int) -> tuple[int, int, int, int]:
    """Of a vertex e and a triangle f, or of edges -1 - e and f."""
    if e < 0:
        return m.edges[-1 - e, 0], m.edges[-1 - e, 1], m.edges[f, 0], m.edges[f, 1]
    return e, m.faces[f, 0], m.faces[f, 1], m.faces[f, 2]


@block_kernel
def enlist(m: Meeting, ways: Float, found: Long, count: int) -> None:
    """List those of `count` primitives found that do not stay apart."""
    pair, of, key, normal, thickness, edges = m.pair, m.of, m.key, m.normal, m.law[0], m.edges.shape[0]
    kept, at = 0, 0
    # Neighbours in the cloth, most of what is found, are kept apart across the line between their middles. All are
    # looked at without asking, since to guess wrongly takes longer.
    for c in range(count):
        of_edges = found[c, 0] < 0
        i, j, k, l = vertices_of(m, found[c, 0], found[c, 1])  # noqa: E741
        here = (begin_of(ways, i), begin_of(ways, j), begin_of(ways, k), begin_of(ways, l))
        n, _ = unit(weigh(MIDDLES[0] if of_edges else MIDDLES[1], here))
        apart = gap_along(of_edges, n, ways, i, j, k, l) > thickness
        found[kept, 0], found[kept, 1] = found[c, 0], found[c, 1]
        kept += 0 if apart or not m.meets[m.piece[i], m.piece[l]] else 1
    for c in range(kept):
        e, f = found[c, 0], found[c, 1]
        i, j, k, l = vertices_of(m, e, f)  # noqa: E741
        here = (begin_of(ways, i), begin_of(ways, j), begin_of(ways, k), begin_of(ways, l))
        n, _ = unit(weigh(closest(e < 0, here).weights, here))
        if gap_along(e < 0, n, ways, i, j, k, l) > thickness:
            continue
        if at < pair.shape[0]:
            pair[at, 0], pair[at, 1], pair[at, 2], pair[at, 3] = i, j, k, l
            of[at], m.reach[at] = -1 if e < 0 else f, -1.0
            key[at] = (1 + e) * edges - 1 - f if e < 0 else e * m.faces.shape[0] + f
            normal[at, 0], normal[at, 1], normal[at, 2] = n
        at += 1
    m.number[0], m.number[2] = min(at, pair.shape[0]), max(0, at - pair.shape[0])


@block_kernel
def search(m: Meeting, tree: Tree) -> None:
    """List the pairs by the tree, which is fitted already, as m.ways are."""
    radius = m.law[0]
    bodies, leaves = m.local.shape[0] > 0, np.empty((8 * m.faces.shape[0], 2), np.int64)
    count = find_leaves(tree.boxes, radius, bodies, leaves)
    if count > leaves.shape[0]:
        leaves = np.empty((count, 2), np.int64)
        find_leaves(tree.boxes, radius, bodies, leaves)
    found = np.empty((8 * m.faces.shape[0], 2), np.int64)
    number = find_near(tree, radius, leaves, count, found)
    if number > found.shape[0]:
        found = np.empty((number, 2), np.int64)
        find_near(tree, radius, leaves, count, found)
    enlist(m, m.ways, found, number)


@block_kernel
def choose_near(m: Meeting) -> None:
    """Choose the listed pairs that may come near in the near plan; the others touch nothing, and lose their anchors."""
    pair, of, normal, anchored, near, thickness, ways = m.pair, m.of, m.normal, m.anchored, m.near, m.law[0], m.ways
    lay_out(m.reference[3:], m.motion[3:], m.spread[1], ways)
    kept, number = 0, 0
    # Without asking for each, since to guess wrongly takes longer than to look.
    for p in range(m.number[0]):
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        apart = gap_along(of[p] < 0, (normal[p, 0], normal[p, 1], normal[p, 2]), ways, i, j, k, l) > thickness
        anchored[p] &= not apart
        near[kept] = p
        kept += 0 if apart else 1
    for q in range(kept):
        p = near[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        here = (begin_of(ways, i), begin_of(ways, j), begin_of(ways, k), begin_of(ways, l))
        n, _ = unit(weigh(closest(of[p] < 0, here).weights, here))
        if gap_along(of[p] < 0, n, ways, i, j, k, l) > thickness:
            anchored[p] = False
            continue
        normal[p, 0], normal[p, 1], normal[p, 2] = n
        if m.reach[p] < 0.0:
            measure(m, p)
        near[number] = p
        number += 1
    m.number[1], m.number[4] = number, m.number[4] + 1
    note(m, 1)


@block_kernel
def share_out(pair: Int, chosen: Int, number: int, start: Int, shared: Int) -> None:
    """Which of `number` chosen pairs each block of vertices has a part in, in their order: bounds of each block's, and
    the pairs.
    """
    blocks = start.shape[0] - 1
    start[:] = 0
    for fill in range(2):
        for q in range(number):
            p = chosen[q]
            for corner in range(4):
                block = pair[p, corner] // BLOCK
                seen = False
                for other in range(corner):
                    seen = seen or pair[p, other] // BLOCK == block
                if not seen:
                    if fill == 1:
                        shared[start[block]] = p
                    start[block] += 1
        if fill == 0:
            total = 0
            for block in range(blocks):
                count = start[block]
                start[block] = total
                total += count
    for block in range(blocks, 0, -1):
        start[block] = start[block - 1]
    start[0] = 0


@block_kernel
def keep_anchors(m: Meeting, old: int, keys: Long, anchors: Float) -> None:
    """Give pairs the anchors that they had: keys (k,) and weights (k, 4) of those anchored in a list of `old` pairs."""
    order = np.argsort(keys)
    in_order, anchored, key = keys[order], m.anchored, m.key
    anchored[: max(old, m.number[0])] = False
    if keys.shape[0] == 0:
        return
    for p in range(m.number[0]):
        at = np.searchsorted(in_order, key[p])
        if at < keys.shape[0] and in_order[at] == key[p]:
            anchored[p] = True
            m.anchor[p] = anchors[order[at]]


@block_kernel
def note(m: Meeting, which: int) -> None:
    """Note in m.listed what a plan's list is made for."""
    listed, reference, motion, spread = m.listed, m.reference, m.motion, m.spread
    for i in range(spread.shape[1]):
        for row in range(3 * which, 3 * which + 3):
            listed[row, i], listed[6 + row, i] = reference[row, i], motion[row, i]
        listed[12 + which, i] = spread[which, i]


@block_kernel
def make_list(m: Meeting) -> None:
    """List the pairs for the present plan; anchors are left alone."""
    x, u, spread = m.reference[:3], m.motion[:3], m.spread[0]
    tree = tree_of(m)
    fit_tree(tree, x, u, spread)
    lay_out(x, u, spread, m.ways)
    note(m, 0)
    search(m, tree)
    m.number[3] += 1


@block_kernel
def renew_list(m: Meeting) -> None:
    """The same, anchors going with their pairs."""
    old = m.number[0]
    held = np.flatnonzero(m.anchored[:old])
    keys, anchors = m.key[held], m.anchor[held]
    make_list(m)
    keep_anchors(m, old, keys, anchors)
