"""The list of pairs made from what the tree finds, and those of it that are near: what forces and steps look at."""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.offset.meeting import EDGES, Meeting, tree_of
from nuno_contact.offset.proximity import Corners, closest, moved, point, spread_between, unit, weigh
from nuno_contact.offset.search import find_leaves, find_near
from nuno_contact.offset.tree import Tree, fit_tree, less
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.bodies.poses import Vector
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_schemas.fabric import Float, Int


@kernel
def strength(m: Meeting, i: int, j: int, k: int, l: int, of_edges: bool) -> tuple[float, float]:  # noqa: E741
    """Stiffness [N/m] and damping [N s/m] of a pair; none of one that is held altogether."""
    least, mass = np.inf, np.inf
    for v in (i, j, k, l):
        if m.mass[v] > 0.0:
            least, mass = less(least, m.stiffness[v]), less(mass, m.mass[v])
    if mass == np.inf:
        return 0.0, 0.0
    stiffness = 0.5 * least * (EDGES if of_edges else 1.0)
    return stiffness, 2.0 * m.law[2] * math.sqrt(0.5 * stiffness * mass)


@forced_inline
def stay_apart(
    of_edges: bool, n: Vector, x: Corners, u: Float, spread: Float, i: int, j: int, k: int, l: int,  # noqa: E741
    radius: float,
) -> bool:  # fmt: skip
    """Whether a plane across n keeps a pair at x farther apart than `radius` all the way along u, strays included."""
    r = (spread[i], spread[j], spread[k], spread[l])
    if spread_between(of_edges, n, x, r) <= radius:
        return False
    end = (moved(x[0], u, i), moved(x[1], u, j), moved(x[2], u, k), moved(x[3], u, l))
    return spread_between(of_edges, n, end, r) > radius


@block_kernel
def enlist(m: Meeting, x: Float, u: Float, spread: Float, found: Long, count: int) -> None:
    """List those of `count` primitives found that do not stay apart."""
    s, faces, edges, piece, meets = m.start, m.faces, m.edges, m.piece, m.meets
    pair, of, key, reach, normal, thickness = m.pair, m.of, m.key, m.reach, m.normal, m.law[0]
    at = 0
    for c in range(count):
        e, f = found[c, 0], found[c, 1]
        of_edges = e < 0
        if of_edges:
            e = -1 - e
            i, j, k, l = edges[e, 0], edges[e, 1], edges[f, 0], edges[f, 1]  # noqa: E741
        else:
            i, j, k, l = np.int32(e), faces[f, 0], faces[f, 1], faces[f, 2]  # noqa: E741
        if not meets[piece[i], piece[l]]:
            continue
        here = (point(x, i), point(x, j), point(x, k), point(x, l))
        n, _ = unit(weigh(closest(of_edges, here).weights, here))
        if stay_apart(of_edges, n, here, u, spread, i, j, k, l, thickness):
            continue
        if at < pair.shape[0]:
            begun = (point(s, i), point(s, j), point(s, k), point(s, l))
            _, before = unit(weigh(closest(of_edges, begun).weights, begun))
            pair[at, 0], pair[at, 1], pair[at, 2], pair[at, 3] = i, j, k, l
            of[at], reach[at] = -1 if of_edges else f, less(thickness, before)
            key[at] = -1 - (e * edges.shape[0] + f) if of_edges else e * faces.shape[0] + f
            normal[at, 0], normal[at, 1], normal[at, 2] = n
            m.pair_stiffness[at], m.pair_damping[at] = strength(m, i, j, k, l, of_edges)
        at += 1
    m.number[0], m.number[2] = min(at, pair.shape[0]), max(0, at - pair.shape[0])


@block_kernel
def search(m: Meeting, tree: Tree, x: Float, u: Float, spread: Float) -> None:
    """List the pairs by the tree, which is fitted already."""
    radius = m.law[0]
    leaves, count = np.empty((8 * m.face.shape[0], 2), np.int64), 0
    count = find_leaves(tree.boxes, radius, leaves)
    if count > leaves.shape[0]:
        leaves = np.empty((count, 2), np.int64)
        find_leaves(tree.boxes, radius, leaves)
    found = np.empty((8 * m.face.shape[0], 2), np.int64)
    number = find_near(x, u, spread, tree, radius, leaves, count, found)
    if number > found.shape[0]:
        found = np.empty((number, 2), np.int64)
        find_near(x, u, spread, tree, radius, leaves, count, found)
    enlist(m, x, u, spread, found, number)


@block_kernel
def choose_near(m: Meeting) -> None:
    """Choose the listed pairs that may come near in the near plan, and share them out to blocks; the others touch
    nothing, and lose their anchors.
    """
    pair, of, normal, anchored, near, thickness = m.pair, m.of, m.normal, m.anchored, m.near, m.law[0]
    x, u, spread, number = m.reference[3:], m.motion[3:], m.spread[1], 0
    for p in range(m.number[0]):
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        n = (normal[p, 0], normal[p, 1], normal[p, 2])
        here = (point(x, i), point(x, j), point(x, k), point(x, l))
        if stay_apart(of[p] < 0, n, here, u, spread, i, j, k, l, thickness):
            anchored[p] = False
            continue
        n, _ = unit(weigh(closest(of[p] < 0, here).weights, here))
        if stay_apart(of[p] < 0, n, here, u, spread, i, j, k, l, thickness):
            anchored[p] = False
            continue
        normal[p, 0], normal[p, 1], normal[p, 2] = n
        near[number] = p
        number += 1
    m.number[1], m.number[4] = number, m.number[4] + 1
    note(m, 1)
    share_out(m.pair, near, number, m.block_start, m.block_pair)


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
    note(m, 0)
    search(m, tree, x, u, spread)
    m.number[3] += 1


@block_kernel
def renew_list(m: Meeting) -> None:
    """The same, anchors going with their pairs."""
    old = m.number[0]
    held = np.flatnonzero(m.anchored[:old])
    keys, anchors = m.key[held], m.anchor[held]
    make_list(m)
    keep_anchors(m, old, keys, anchors)
