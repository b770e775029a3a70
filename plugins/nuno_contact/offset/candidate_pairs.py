"""The list of candidate pairs, the near ones among them, and the expected ways of vertices for which both are made."""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.offset.contact_state import (
    CHOICES,
    CLOSE,
    EDGES,
    IN_TURN,
    LACKING,
    LEFT_OUT,
    LIST_BEGUN,
    LIST_ROOM,
    LIST_WINDOW,
    LISTED,
    LISTS_MADE,
    NEAR,
    NEAR_BEGUN,
    NEAR_WINDOW,
    NOW,
    PARTS,
    ContactState,
    close_up,
)
from nuno_contact.offset.proximity import closest, point, spread_between, unit, weigh
from nuno_contact.offset.tree import find_near, fit_tree, less, near_leaves
from nuno_geometry.poses import Index, Vector
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.lanes import (
    EVERY,
    WIDTH,
    Triple,
    dot,
    higher,
    lanes_up_to,
    minus,
    read,
    read_triple,
    root,
    splat,
    times,
    write,
)
from nuno_kernels.step.blocks import Long, copy_rows
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float

# The list of candidate pairs that the tree finds, and the near ones among them, which forces and steps examine.

MIDDLES = (0.5, 0.5, -0.5, -0.5), (1.0, -1.0 / 3.0, -1.0 / 3.0, -1.0 / 3.0)
"""weights of the way between the middles of two edges, and of a vertex and a triangle"""
SCATTER = 0x9E3779B97F4A7C15 - (1 << 64)
"""the golden ratio of 64 bits, as a signed number (Knuth, vol. 3, 6.4)"""
EMPTY = -(1 << 63)


@forced_inline
def share_of(m: ContactState, i: int, l: int, of_edges: bool) -> float:  # noqa: E741
    """Return the share of the stiffness of a pair of cloth and a body, by the first vertex of each primitive: a piece
    of cloth has as many of a fine body's vertices below it, and edges as many across it, as that is finer.
    """
    surface = m.surface
    first = surface.size.shape[0] - m.bodies.local.shape[0]
    cloth, body = (surface.size[i], surface.size[l]) if i < first else (surface.size[l], surface.size[i])
    finer: float = less(1.0, body / cloth)
    return finer if of_edges else 1.0 if i < first else finer * finer


@forced_inline
def begun_apart(m: ContactState, p: int) -> float:
    """Return how far apart a listed pair starts [m]."""
    pair, s = m.pairs.vertices, m.surface.start
    i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
    begun = (point(s, i), point(s, j), point(s, k), point(s, l))
    distance: float = unit(weigh(closest(m.pairs.face[p] < 0, begun).weights, begun))[1]
    return distance


@block_kernel
def measure(m: ContactState, p: int) -> None:
    """Set a listed pair's reach, stiffness, damping and friction; stiffness is 0 if the whole pair is held.

    Cloth that starts nearer to itself than the thickness, as beside the tip of a dart, is as thin as that there.
    """
    pairs, surface = m.pairs, m.surface
    i, j, k, l = pairs.vertices[p, 0], pairs.vertices[p, 1], pairs.vertices[p, 2], pairs.vertices[p, 3]  # noqa: E741
    least, mass = np.inf, np.inf
    for v in (i, j, k, l):
        if surface.mass[v] > 0.0:
            least, mass = less(least, surface.stiffness[v]), less(mass, surface.mass[v])
    stiffness = 0.0 if mass == np.inf else 0.5 * least * (EDGES if pairs.face[p] < 0 else 1.0)
    mu, damping = surface.law[1], surface.law[2]
    body = max(surface.piece[i], surface.piece[l]) - (surface.meets.shape[0] - m.bodies.law.shape[0])
    if body >= 0:
        mu, damping = m.bodies.law[body, 0], m.bodies.law[body, 1]
        stiffness *= share_of(m, i, l, pairs.face[p] < 0)
    pairs.reach[p] = less(surface.law[0], begun_apart(m, p)) if surface.piece[i] == surface.piece[l] else surface.law[0]
    pairs.stiffness[p], pairs.friction[p] = stiffness, mu
    pairs.damping[p] = 0.0 if mass == np.inf else 2.0 * damping * math.sqrt(0.5 * stiffness * mass)


@block_kernel
def lay_out(x: Float, u: Float, spread: Float, ways: Float) -> None:
    """Write into ways (n, 8), one cache line for each vertex: its position, its way, and its spread."""
    for i in range(x.shape[1]):
        for row in range(3):
            ways[i, row], ways[i, 3 + row] = x[row, i], x[row, i] + u[row, i]
        ways[i, 6] = spread[i]


@forced_inline
def begin_of(ways: Float, i: Index) -> Vector:
    """Return vertex i's position at the start of the way."""
    return ways[i, 0], ways[i, 1], ways[i, 2]


@forced_inline
def end_of(ways: Float, i: Index) -> Vector:
    """Return its position at the end."""
    return ways[i, 3], ways[i, 4], ways[i, 5]


@forced_inline
def gap_along(of_edges: bool, n: Vector, ways: Float, i: Index, j: Index, k: Index, l: Index) -> float:  # noqa: E741
    """Return how far apart a plane across n keeps a pair all along its way, strays included."""
    r = (ways[i, 6], ways[j, 6], ways[k, 6], ways[l, 6])
    begin = (begin_of(ways, i), begin_of(ways, j), begin_of(ways, k), begin_of(ways, l))
    end = (end_of(ways, i), end_of(ways, j), end_of(ways, k), end_of(ways, l))
    return less(spread_between(of_edges, n, begin, r), spread_between(of_edges, n, end, r))


@forced_inline
def apart_at_middles(of_edges: bool, ways: Float, i: Index, j: Index, k: Index, l: Index, thickness: float) -> bool:  # noqa: E741
    """Whether the plane across the line between their middles keeps a pair apart, as it does most neighbours in the
    cloth. Not the plane that the pair had last: a resumed run has only those across closest points.
    """
    here = (begin_of(ways, i), begin_of(ways, j), begin_of(ways, k), begin_of(ways, l))
    n, _ = unit(weigh(MIDDLES[0] if of_edges else MIDDLES[1], here))
    return gap_along(of_edges, n, ways, i, j, k, l) > thickness


@forced_inline
def vertices_of(m: ContactState, e: int, f: int) -> tuple[int, int, int, int]:
    """Return the vertices of a vertex e and a triangle f, or of edges -1 - e and f."""
    if e < 0:
        return m.tree.edges[-1 - e, 0], m.tree.edges[-1 - e, 1], m.tree.edges[f, 0], m.tree.edges[f, 1]
    return e, m.tree.faces[f, 0], m.tree.faces[f, 1], m.tree.faces[f, 2]


@block_kernel
def keep_near(m: ContactState, found: Long, normal: Float, count: int) -> int:
    """Keep those of `count` primitives found (c, 2) that do not stay apart, in place and in order, with the planes
    (c, 3) across their closest points; return their number.
    """
    surface = m.surface
    ways, thickness = m.plan.ways, surface.law[0]
    candidates, number = 0, 0
    # All are evaluated without a branch, since a wrong prediction takes longer.
    for c in range(count):
        of_edges = found[c, 0] < 0
        i, j, k, l = vertices_of(m, found[c, 0], found[c, 1])  # noqa: E741
        apart = apart_at_middles(of_edges, ways, i, j, k, l, thickness)
        found[candidates, 0], found[candidates, 1] = found[c, 0], found[c, 1]
        candidates += 0 if apart or not surface.meets[surface.piece[i], surface.piece[l]] else 1
    for c in range(candidates):
        e, f = found[c, 0], found[c, 1]
        i, j, k, l = vertices_of(m, e, f)  # noqa: E741
        here = (begin_of(ways, i), begin_of(ways, j), begin_of(ways, k), begin_of(ways, l))
        n, _ = unit(weigh(closest(e < 0, here).weights, here))
        if gap_along(e < 0, n, ways, i, j, k, l) > thickness:
            continue
        found[number, 0], found[number, 1] = e, f
        normal[number, 0], normal[number, 1], normal[number, 2] = n
        number += 1
    return number


@block_kernel
def search_part(part: int, m: ContactState, leaves: Long, found: Long, normal: Float, number: Long) -> None:
    """Find the pairs of a part of the pairs of leaves; found (PARTS r, 2), normal (PARTS r, 3) have room for r in each.

    Writes into number (PARTS, 2) their number, or, if negative, the number without room, and the number of pairs of a
    vertex and a triangle.
    """
    room, count = found.shape[0] // PARTS, leaves.shape[0]
    mine, across = found[part * room : (part + 1) * room], normal[part * room : (part + 1) * room]
    met = find_near(m.tree, m.surface.law[0], leaves[part * count // PARTS : (part + 1) * count // PARTS], mine)
    number[part, 0] = room - met if met > room else keep_near(m, mine, across, met)
    number[part, 1] = 0
    for c in range(number[part, 0]):
        number[part, 1] += 1 if mine[c, 0] >= 0 else 0


@block_kernel
def enlist_part(part: int, m: ContactState, found: Long, normal: Float, number: Long) -> None:
    """Write a part's pairs to the list, as far as there is room: all pairs of a vertex and a triangle, then all of
    edges, part by part. Pairs of a list then have the same order in the next one, wherever parts begin: forces are
    summed, and constraints solved, in that order, in which cloth at rest is to stay at rest.
    """
    pairs, pair = m.pairs, m.pairs.vertices
    room, edges, faces = found.shape[0] // PARTS, m.tree.edges.shape[0], m.tree.faces.shape[0]
    first, own_faces = [0, number[:, 1].sum()], number[part, 1]
    for before in range(part):
        first[0] += number[before, 1]
        first[1] += number[before, 0] - number[before, 1]
    for c in range(number[part, 0]):
        at, of = (first[0] + c if c < own_faces else first[1] + c - own_faces), part * room + c
        if at < pair.shape[0]:
            e, f = found[of, 0], found[of, 1]
            pair[at, 0], pair[at, 1], pair[at, 2], pair[at, 3] = vertices_of(m, e, f)
            pairs.face[at], pairs.reach[at] = -1 if e < 0 else f, -1.0
            pairs.key[at] = (1 + e) * edges - 1 - f if e < 0 else e * faces + f
            for row in range(3):
                pairs.normal[at, row] = normal[of, row]


search_parts = over_blocks(search_part, "m, leaves, found, normal, number", order=IN_TURN)
enlist_parts = over_blocks(enlist_part, "m, found, normal, number", order=IN_TURN)


@block_kernel
def search(m: ContactState, threads: int | None) -> None:
    """List the pairs by the tree, which is already fitted to m.plan.ways."""
    leaves = near_leaves(m.tree.boxes, m.surface.law[0], m.bodies.local.shape[0] > 0)
    number, room = np.empty((PARTS, 2), np.int64), 24 * m.tree.faces.shape[0] // PARTS
    lacking = 1
    while lacking > 0:
        if m.leave[0] != 0:
            m.counts[LISTED] = m.counts[LACKING] = 0
            return
        found, normal = np.empty((PARTS * room, 2), np.int64), np.empty((PARTS * room, 3))
        search_parts(m, leaves, found, normal, number, PARTS, threads)
        lacking, total = 0, 0
        for part in range(PARTS):
            lacking, total = max(lacking, -number[part, 0]), total + number[part, 0]
        room += lacking
    enlist_parts(m, found, normal, number, PARTS, threads)
    places = m.pairs.vertices.shape[0]
    m.counts[LISTED], m.counts[LACKING] = min(total, places), max(0, total - places)


@block_kernel
def choose_part(part: int, m: ContactState, number: Long) -> None:
    """Choose near pairs among a part of the listed ones; write them into `near` from the part's first place on."""
    pairs, anchored, thickness, ways = m.pairs, m.anchored, m.surface.law[0], m.plan.ways
    pair, of, normal, near = pairs.vertices, pairs.face, pairs.normal, pairs.near
    first, end = part * m.counts[LISTED] // PARTS, (part + 1) * m.counts[LISTED] // PARTS
    candidates_end = first
    # Without a branch for each, since a wrong prediction takes longer than the evaluation.
    for p in range(first, end):
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        apart = apart_at_middles(of[p] < 0, ways, i, j, k, l, thickness)
        anchored[p] &= not apart
        near[candidates_end] = p
        candidates_end += 0 if apart else 1
    chosen = first
    for q in range(first, candidates_end):
        p = near[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        here = (begin_of(ways, i), begin_of(ways, j), begin_of(ways, k), begin_of(ways, l))
        n, _ = unit(weigh(closest(of[p] < 0, here).weights, here))
        if gap_along(of[p] < 0, n, ways, i, j, k, l) > thickness:
            anchored[p] = False
            continue
        normal[p, 0], normal[p, 1], normal[p, 2] = n
        if pairs.reach[p] < 0.0:
            measure(m, p)
        near[chosen] = p
        chosen += 1
    number[part] = chosen - first


choose_parts = over_blocks(choose_part, "m, number", order=IN_TURN)


@block_kernel
def choose_near(m: ContactState, threads: int | None) -> None:
    """Choose the listed pairs that may come near in the near plan; the others do not touch, and lose their anchors."""
    plan = m.plan
    lay_out(plan.reference[3:], plan.motion[3:], plan.spread[1], plan.ways)
    number = np.empty(PARTS, np.int64)
    choose_parts(m, number, PARTS, threads)
    m.counts[NEAR], m.counts[CHOICES] = close_up(m.pairs.near, m.counts[LISTED], number), m.counts[CHOICES] + 1
    copy_rows(plan.reference[3:], plan.listed[3:6])
    copy_rows(plan.motion[3:], plan.listed[9:12])
    copy_rows(plan.spread[1:], plan.listed[13:])


@block_kernel
def make_list(m: ContactState, threads: int | None) -> None:
    """List the pairs for the present plan, without moving anchors."""
    plan = m.plan
    x, u, spread = plan.reference[:3], plan.motion[:3], plan.spread[0]
    fit_tree(m.tree, x, u, spread)
    lay_out(x, u, spread, plan.ways)
    copy_rows(x, plan.listed[:3])
    copy_rows(u, plan.listed[6:9])
    copy_rows(plan.spread[:1], plan.listed[12:13])
    search(m, threads)
    m.counts[LISTS_MADE] += 1


@forced_inline
def slot(key: int, table: Long) -> int:
    """Return a key's place in a table of keys, a power of two long (Knuth, vol. 3, 6.4: linear probing)."""
    at = (key * SCATTER >> 32) & (table.shape[0] - 1)
    while table[at] != EMPTY and table[at] != key:
        at = (at + 1) & (table.shape[0] - 1)
    return int(at)


@block_kernel
def renew_list(m: ContactState, threads: int | None) -> None:
    """List the pairs; anchors move with them, and so do the shares of friction of the present xpbd step."""
    pairs, anchor, anchored = m.pairs, m.anchor, m.anchored
    held, size = 0, 64
    for p in range(m.counts[LISTED]):
        held += 1 if anchored[p] else 0
    while size < 2 * held:
        size *= 2
    table, anchors, share = np.empty(size, np.int64), np.empty((size, 4)), np.empty(size)
    for at in range(size):
        table[at] = EMPTY
    for p in range(m.counts[LISTED]):
        if anchored[p]:
            at = slot(pairs.key[p], table)
            table[at], share[at] = pairs.key[p], m.solver.force[p, 3] if m.solver.kept[p] else -1.0
            for corner in range(4):
                anchors[at, corner] = anchor[p, corner]
            anchored[p] = False
    make_list(m, threads)
    for p in range(m.counts[LISTED] if held > 0 else 0):
        at = slot(pairs.key[p], table)
        anchored[p] = table[at] != EMPTY
        if anchored[p]:
            m.solver.kept[p], m.solver.force[p, 3] = share[at] >= 0.0, share[at]
            for corner in range(4):
                anchor[p, corner] = anchors[at, corner]


# The expected ways of vertices, their duration and accuracy, for which lists of pairs are made.
#
# There are two plans. That of the list is looked for in the tree, which is dear, and lasts up to an interval or more;
# that of what is near is chosen from the list, often, so that each step looks at few pairs. Each holds until its time
# is over or a vertex has strayed from it. Vertices go on as they go in the step that is to come. How far each may stray
# follows from how far it did stray before, as the square of the time: what is thrown about gets wide room, what hangs
# quietly nearly none. That cloth goes on as fast, not faster and faster: accelerations, which change within a frame,
# foretell less for half a frame ahead than none (measured on a skirt that swings).

LIST, CHOSEN = range(2)
"""the plan of the list, and that of near pairs"""
BEGUN, LASTS = (LIST_BEGUN, NEAR_BEGUN), (LIST_WINDOW, NEAR_WINDOW)
WINDOW, SHORTEST, LONGEST = 1.0 / 16.0, 1.0 / 96.0, 4.0
"""shares of an interval for which near pairs are chosen at first, at least and at most"""
CHOICE = 4.0
"""To examine a listed pair when near pairs are chosen takes as long as so many examinations of a near one."""
LISTS, RESTLESS = 1.0, 0.05
"""share of an interval for which the list is made at least; else it is made for two windows of near pairs, or for
longer and longer, up to LONGEST, while no more than the second share of the vertices need more room for it"""
CROWDED = 24.0, 36.0
"""Pairs in the list for each vertex from which on the next is made for less: layers that lie on each other are all near
to each other, if each may stray by more than they are apart. Up to the second it is made for more where vertices
strayed from it EARLY.
"""
EARLY = 0.25
"""a share of its window so small that the plan was exceeded early"""
LEAST, MOST = (2.0, 0.1), (3.0, 1.0)
"""least and greatest stray of vertices over the thickness, in the list's plan and in that of near pairs"""
GROWTH = 1.25
"""factor by which the window of near pairs gets longer or shorter"""
AHEAD = 3.0
"""factor on the expected stray that is allowed"""


@forced_inline
def off_plan(m: ContactState, which: int, x: Float, share: float, i: int, count: int) -> Triple:
    """Return how far `count` vertices of x (3, n) from number i on are off a plan after a share of it."""
    way = minus(read_triple(x, 0, i, count), read_triple(m.plan.reference, 3 * which, i, count))
    return minus(way, times(splat(share), read_triple(m.plan.motion, 3 * which, i, count)))


@block_kernel
def strays(m: ContactState, which: int, x: Float, share: float) -> bool:
    """Whether a vertex of x (3, n) is farther from its place in a plan after a share of that than allowed."""
    for i in range(0, x.shape[1], WIDTH):
        count = min(WIDTH, x.shape[1] - i)
        off, room = off_plan(m, which, x, share, i, count), read(m.plan.spread, which, i, count)
        if lanes_up_to(dot(off, off) - room * room, 0.0) != EVERY:
            return True
    return False


@block_kernel
def holds(m: ContactState, which: int, x: Float, s: float, ahead: float) -> bool:
    """Whether a plan holds for vertices x (3, n) at fraction s of the interval, and until `ahead` after that."""
    begun, window = m.clock[BEGUN[which]], m.clock[LASTS[which]]
    return s + ahead <= begun + window and not strays(m, which, x, (s - begun) / window)


@block_kernel
def learn(m: ContactState, which: int, x: Float, gone: float, share: float) -> None:
    """Update `unrest` by how much each vertex of x (3, n) has strayed from a plan that was made `gone` of the interval
    ago; `share` of the plan's window has passed.
    """
    for i in range(0, x.shape[1], WIDTH):
        count = min(WIDTH, x.shape[1] - i)
        off = off_plan(m, which, x, share, i, count)
        # In this order: before the first plan the reference is NaN, which must not enter.
        before = 0.7 * read(m.plan.unrest, which, i, count)
        write(m.plan.unrest, which, i, count, higher(root(dot(off, off)) / (gone * gone), before))


@block_kernel
def allow(m: ContactState, spread: Float, unrest: Float, window: float, least: float, most: float) -> None:
    """Set spread (n,), how far each vertex may stray in a plan for a window, between `least` and `most` thicknesses."""
    h = m.surface.law[0]
    for i in range(spread.shape[0]):
        spread[i] = min(max(AHEAD * window * window * unrest[i], least * h), most * h)


@block_kernel
def tighter(spread: Float) -> bool:
    """Halve the room that the list's plan has beyond that of near pairs; return False if there was hardly any."""
    roomy = False
    for i in range(spread.shape[1]):
        room = spread[0, i] - spread[1, i]
        roomy = roomy or room > 0.1 * spread[1, i]
        spread[0, i] = spread[1, i] + 0.5 * room
    return roomy


@block_kernel
def is_quiet(unrest: Float, window: float, least: float) -> bool:
    """Whether nearly all vertices are expected to stray by less than `least` [m] in a window: a plan that long has
    hardly more pairs.
    """
    restless = 0
    for i in range(unrest.shape[0]):
        restless += 1 if AHEAD * window * window * unrest[i] > least else 0
    return bool(restless < RESTLESS * unrest.shape[0])


@block_kernel
def plan(m: ContactState, u: Float, way: float, ahead: float, renew: bool, threads: int | None) -> None:
    """Plan from `last` on, for vertices that go u (3, n) in a step of `way`: for a shorter time than before if
    examining near pairs that do not touch is dearer than choosing them, or if the last plan ended before half of its
    time; for a longer time if that was used up. A plan that is to hold for a step `ahead` is used up where another goes
    beyond its end. The list is made anew if `renew`.
    """
    clock = m.clock
    gone = clock[NOW] - clock[NEAR_BEGUN]
    share, used = gone / clock[NEAR_WINDOW], (gone + way + ahead) / clock[NEAR_WINDOW]
    dear = (m.counts[NEAR] - m.counts[CLOSE]) * gone > CHOICE * m.counts[LISTED] * way
    window = clock[NEAR_WINDOW] * (1.0 / GROWTH if dear or used < 0.5 else GROWTH if used > 1.0 else 1.0)
    window = max(way + 1.5 * ahead, min(LONGEST, max(SHORTEST, window)))
    if gone > 0.0:
        learn(m, 1, m.last, gone, share)
    allow(m, m.plan.spread[1], m.plan.unrest[1], window, LEAST[1], MOST[1])
    set_out(m, u, way, window, renew, threads)


@block_kernel
def set_out(m: ContactState, u: Float, way: float, window: float, renew: bool, threads: int | None) -> None:
    """Choose near pairs for a window, in which vertices may stray as far as m.plan.spread[1], from a list made anew if
    `renew`.
    """
    plan = m.plan
    clock, last, reference, motion, spread = m.clock, m.last, plan.reference, plan.motion, plan.spread
    s, near, scale, pinched, explicit = clock[NOW], motion[3:], window / way, m.share, m.solver.step[0] == 0.0
    for row in range(3):
        for i in range(last.shape[1]):
            # A shortened vertex is pinched, and comes no farther in the steps to come.
            near[row, i] = scale * u[row, i] * (pinched[i] if explicit else 1.0)
            reference[3 + row, i] = last[row, i]
    clock[NEAR_BEGUN], clock[NEAR_WINDOW] = s, window
    if renew:
        begun = (s - clock[LIST_BEGUN]) / clock[LIST_WINDOW]
        if s > clock[LIST_BEGUN]:
            learn(m, 0, last, s - clock[LIST_BEGUN], begun)
        scale, pairs = clock[LIST_ROOM], m.counts[LISTED] / (last.shape[1] - m.bodies.local.shape[0])
        if pairs > CROWDED[0] and begun > EARLY:
            scale *= 0.7
        elif pairs < 0.5 * CROWDED[0] or (pairs < CROWDED[1] and begun < EARLY):
            scale = min(1.0, 1.2 * scale)
        whole, clock[LIST_ROOM] = max(2.0 * window, LISTS), scale
        longer = min(LONGEST, GROWTH * clock[LIST_WINDOW])
        if begun > EARLY and longer > whole and is_quiet(plan.unrest[0], longer, LEAST[0] * m.surface.law[0]):
            whole = longer
        allow(m, spread[0], plan.unrest[0], whole, LEAST[0], MOST[0])
        for i in range(last.shape[1]):
            spread[0, i] = scale * spread[0, i] + spread[1, i]
            for row in range(3):
                reference[row, i], motion[row, i] = last[row, i], whole / window * near[row, i]
        clock[LIST_BEGUN], clock[LIST_WINDOW] = s, whole
        renew_list(m, threads)
        while m.counts[LACKING] > 0 and whole > window and m.leave[0] == 0:
            # Vertices that will be pushed back are expected to go through: over a shorter time by less.
            shorter = max(0.5, window / whole)
            whole *= shorter
            clock[LIST_WINDOW] = whole
            for row in range(3):
                for i in range(last.shape[1]):
                    motion[row, i] *= shorter
            renew_list(m, threads)
        while m.counts[LACKING] > 0 and m.leave[0] == 0 and tighter(spread):
            clock[LIST_ROOM] *= 0.5
            renew_list(m, threads)
        m.so_far[LEFT_OUT] += m.counts[LACKING]
    choose_near(m, threads)
