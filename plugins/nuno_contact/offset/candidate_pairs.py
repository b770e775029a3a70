"""The list of candidate pairs, the near ones among them, and the expected ways of vertices for which both are made."""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.offset.bodies import activate
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
    WITH_FACES,
    ContactState,
    close_up,
)
from nuno_contact.offset.proximity import closest, point, unit, weigh
from nuno_contact.offset.tree import PER_TWO, find_pairs, fit_tree, lay_out, less, more, near_leaves, vertices_of
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.lanes import (
    EVERY,
    WIDTH,
    Lanes,
    Seven,
    Triple,
    dot,
    gather_rows,
    higher,
    lane,
    lanes_above,
    lanes_up_to,
    lower,
    magnitude,
    minus,
    plus,
    read,
    read_triple,
    root,
    splat,
    store,
    times,
    where_greater,
    where_not_negative,
    write,
)
from nuno_kernels.step.blocks import Long, copy_rows
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float, Int

# The list of candidate pairs that the tree finds, and the near ones among them, which forces and steps examine.

SCATTER = 0x9E3779B97F4A7C15 - (1 << 64)
"""the golden ratio of 64 bits, as a signed number (Knuth, vol. 3, 6.4)"""
EMPTY = -(1 << 63)
TINY = 1e-150
"""Shortest way that a direction is taken from: the squares of shorter ones are no longer exact."""


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


Pair = tuple[Seven, Seven, Seven, Seven]
"""positions, ends and spreads of the four vertices of eight pairs, as nuno_contact.offset.tree.lay_out has them"""


@forced_inline
def begin_of(w: Seven) -> Triple:
    """Return a vertex' position at the start of the way."""
    return w[0], w[1], w[2]


@forced_inline
def end_of(w: Seven) -> Triple:
    """Return its position at the end."""
    return w[3], w[4], w[5]


@forced_inline
def gap_at(of_edges: bool, n: Triple, p: tuple[Triple, Triple, Triple, Triple], w: Pair) -> Lanes:
    """Return how far apart a plane across n keeps pairs with vertices p, strays included."""
    a, b, c, d = dot(n, p[0]), dot(n, p[1]), dot(n, p[2]), dot(n, p[3])
    second = higher(c + w[2][6], d + w[3][6])
    if of_edges:
        return lower(a - w[0][6], b - w[1][6]) - second
    return a - w[0][6] - higher(b + w[1][6], second)


@forced_inline
def begins_of(w: Pair) -> tuple[Triple, Triple, Triple, Triple]:
    """Return the positions of eight pairs' vertices at the start of their way."""
    return begin_of(w[0]), begin_of(w[1]), begin_of(w[2]), begin_of(w[3])


@forced_inline
def ends_of(w: Pair) -> tuple[Triple, Triple, Triple, Triple]:
    """Return their positions at the end."""
    return end_of(w[0]), end_of(w[1]), end_of(w[2]), end_of(w[3])


@forced_inline
def gap_along(of_edges: bool, n: Triple, w: Pair) -> Lanes:
    """Return how far apart a plane across n keeps eight pairs all along their way."""
    return lower(gap_at(of_edges, n, begins_of(w), w), gap_at(of_edges, n, ends_of(w), w))


@forced_inline
def bare_gap(of_edges: bool, n: Triple, p: tuple[Triple, Triple, Triple, Triple]) -> Lanes:
    """Return how far apart a plane across n keeps eight pairs with vertices p, without strays."""
    a, b, c, d = dot(n, p[0]), dot(n, p[1]), dot(n, p[2]), dot(n, p[3])
    return lower(a, b) - higher(c, d) if of_edges else a - higher(b, higher(c, d))


@forced_inline
def between_middles(of_edges: bool, w: Pair) -> Triple:
    """Return the way between the middles of eight pairs, of any length."""
    a, b, c, d = begin_of(w[0]), begin_of(w[1]), begin_of(w[2]), begin_of(w[3])
    if of_edges:
        return minus(plus(a, b), plus(c, d))
    return minus(times(splat(3.0), a), plus(b, plus(c, d)))


@forced_inline
def clamped_lanes(a: Lanes) -> Lanes:
    """Clamp numbers to [0, 1]; NaN becomes 0."""
    return lower(higher(a, splat(0.0)), splat(1.0))


@forced_inline
def between_edges(w: Pair) -> Triple:
    """Return the way between the closest points of eight pairs of edges: see nuno_contact.offset.proximity.to_edge."""
    p, a = begin_of(w[0]), begin_of(w[2])
    d1, d2, r = minus(begin_of(w[1]), p), minus(begin_of(w[3]), a), minus(p, a)
    aa, ee, f, c, bb = dot(d1, d1), dot(d2, d2), dot(d2, r), dot(d1, r), dot(d1, d2)
    det = aa * ee - bb * bb
    s = where_greater(det, 1e-14 * aa * ee, clamped_lanes((bb * f - c * ee) / det))
    along = (bb * s + f) / ee
    t = clamped_lanes(along)
    s = where_not_negative(splat(0.0) - magnitude(t - along), s, clamped_lanes((bb * t - c) / aa))
    return minus(plus(r, times(s, d1)), times(t, d2))


@forced_inline
def choose(test: Lanes, a: Triple, b: Triple) -> Triple:
    """Return `a` where `test` is not negative, `b` elsewhere."""
    x, y, z = (
        where_not_negative(test, a[0], b[0]),
        where_not_negative(test, a[1], b[1]),
        where_not_negative(test, a[2], b[2]),
    )
    return x, y, z


@forced_inline
def between_faces(w: Pair) -> Triple:
    """Return the way from the closest points of triangles to vertices: across the triangle where that leads into it,
    else the shortest from its edges.
    """
    p, a, b, c = begin_of(w[0]), begin_of(w[1]), begin_of(w[2]), begin_of(w[3])
    ab, ac, bc, ap, bp = minus(b, a), minus(c, a), minus(c, b), minus(p, a), minus(p, b)
    bb, bc_, cc, pb, pc = dot(ab, ab), dot(ab, ac), dot(ac, ac), dot(ap, ab), dot(ap, ac)
    nearest = minus(ap, times(clamped_lanes(pb / bb), ab))
    for other in (
        minus(ap, times(clamped_lanes(pc / cc), ac)), minus(bp, times(clamped_lanes(dot(bp, bc) / dot(bc, bc)), bc)),
    ):  # fmt: skip
        nearest = choose(dot(other, other) - dot(nearest, nearest), nearest, other)
    square, t, s = bb * cc - bc_ * bc_, bb * pc - bc_ * pb, cc * pb - bc_ * pc
    across = minus(ap, times(1.0 / square, plus(times(s, ab), times(t, ac))))
    return choose(splat(0.0) - lower(lower(s, t), square - s - t), nearest, across)


@forced_inline
def unit_lanes(v: Triple) -> Triple:
    """Return eight vectors at length 1, those shorter than TINY at less: a plane across them keeps apart no more."""
    return times(1.0 / higher(root(dot(v, v)), splat(TINY)), v)


@forced_inline
def plane_between(of_edges: bool, by_middles: bool, w: Pair) -> Triple:
    """Return the directions of planes that may keep eight pairs apart: across the line between their middles, which
    keeps apart most neighbours in the cloth, or between their closest points.
    """
    if by_middles:
        way = between_middles(of_edges, w)
    elif of_edges:
        way = between_edges(w)
    else:
        way = between_faces(w)
    return unit_lanes(way)


@block_kernel
def keep_near(m: ContactState, of_edges: bool, pair: Int, kept: Int, normal: Float | None, gaps: Float | None) -> int:
    """Keep those of pairs (c,) of vertices pair (p, 4) that do not stay apart, in place and in order; return their
    number. Their normal (p, 3) becomes that of a plane across their closest points, and their gaps (2, p) [m] how far
    apart this keeps them at the start and at the end of their way, without strays.

    All are evaluated without a branch, since a wrong prediction takes longer.
    """
    ways, thickness, count = m.plan.ways, m.surface.law[0], kept.shape[0]
    four, across, between = np.zeros((WIDTH, 4), np.int32), np.empty((3, WIDTH)), np.empty((2, WIDTH))
    for by_middles in (True, False):
        number = 0
        for c in range(0, count, WIDTH):
            eight = min(WIDTH, count - c)
            for k in range(eight):
                p = kept[c + k]
                four[k, 0], four[k, 1], four[k, 2], four[k, 3] = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]
            first, second = gather_rows(ways, four, 0), gather_rows(ways, four, 1)
            w = first, second, gather_rows(ways, four, 2), gather_rows(ways, four, 3)
            n = plane_between(of_edges, by_middles, w)
            apart = lanes_above(gap_along(of_edges, n, w), thickness)
            for row in range(3):
                store(across, row, 0, n[row])
            if gaps is not None:
                store(between, 0, 0, bare_gap(of_edges, n, begins_of(w)))
                store(between, 1, 0, bare_gap(of_edges, n, ends_of(w)))
            for k in range(eight):
                p = kept[c + k]
                if normal is not None:
                    normal[p, 0], normal[p, 1], normal[p, 2] = across[0, k], across[1, k], across[2, k]
                if gaps is not None:
                    gaps[0, p], gaps[1, p] = between[0, k], between[1, k]
                kept[number] = p
                number += 1 - ((apart >> k) & 1)
        count = number
    return int(count)


@block_kernel
def search_part(part: int, m: ContactState, leaves: Long, found: Int, gaps: Float, number: Long) -> None:
    """Find the pairs of a part of the pairs of leaves, and their gaps; found and gaps (PARTS, 2, r) have room for r in
    each.

    Writes into number (PARTS, 2) their number, or, if negative, the number without room, and the number of pairs of a
    vertex and a triangle.
    """
    surface, room, size, listed = m.surface, found.shape[2], 4 * PER_TWO, 0
    mine = leaves[part * leaves.shape[0] // PARTS : (part + 1) * leaves.shape[0] // PARTS]
    some, four, kept = np.empty((2, size), np.int32), np.empty((size, 4), np.int32), np.empty(size, np.int32)
    between = np.empty((2, size))
    for of_edges in (False, True):
        first = 0
        while first < mine.shape[0] and m.leave[0] == 0:
            first, met = find_pairs(m.tree, of_edges, mine, first, some, four)
            for c in range(met):
                kept[c] = c
            for q in range(keep_near(m, of_edges, four, kept[:met], None, between)):
                c = kept[q]
                if surface.meets[surface.piece[four[c, 0]], surface.piece[four[c, 3]]]:
                    if listed < room:
                        found[part, 0, listed], found[part, 1, listed] = some[0, c], some[1, c]
                        gaps[part, 0, listed], gaps[part, 1, listed] = between[0, c], between[1, c]
                    listed += 1
        if not of_edges:
            number[part, 1] = listed
    number[part, 0] = room - listed if listed > room else listed


@block_kernel
def enlist_part(part: int, m: ContactState, found: Int, gaps: Float, number: Long) -> None:
    """Write a part's pairs to the list, as far as there is room: all pairs of a vertex and a triangle, then all of
    edges, part by part. Pairs of a list then have the same order in the next one, wherever parts begin: forces are
    summed, and constraints solved, in that order, in which cloth at rest is to stay at rest.
    """
    pairs, pair = m.pairs, m.pairs.vertices
    edges, faces = m.tree.edges.shape[0], m.tree.faces.shape[0]
    first, own_faces = [0, number[:, 1].sum()], number[part, 1]
    for before in range(part):
        first[0] += number[before, 1]
        first[1] += number[before, 0] - number[before, 1]
    for c in range(number[part, 0]):
        of_edges = c >= own_faces
        at = first[1] + c - own_faces if of_edges else first[0] + c
        if at < pair.shape[0]:
            e, f = int(found[part, 0, c]), int(found[part, 1, c])
            pair[at, 0], pair[at, 1], pair[at, 2], pair[at, 3] = vertices_of(m.tree, of_edges, e, f)
            pairs.face[at], pairs.reach[at] = -1 if of_edges else f, -1.0
            pairs.gaps[0, at], pairs.gaps[1, at] = gaps[part, 0, c], gaps[part, 1, c]
            pairs.key[at] = -e * edges - 1 - f if of_edges else e * faces + f


search_parts = over_blocks(search_part, "m, leaves, found, gaps, number", order=IN_TURN)
enlist_parts = over_blocks(enlist_part, "m, found, gaps, number", order=IN_TURN)


@block_kernel
def search(m: ContactState, threads: int | None) -> None:
    """List the pairs by the tree, which is already fitted to m.plan.ways."""
    leaves = near_leaves(m.tree, m.bodies.local.shape[0] > 0)
    number, room = np.empty((PARTS, 2), np.int64), 24 * m.tree.faces.shape[0] // PARTS
    lacking = 1
    while lacking > 0:
        found, gaps = np.empty((PARTS, 2, room), np.int32), np.empty((PARTS, 2, room))
        search_parts(m, leaves, found, gaps, number, PARTS, threads)
        if m.leave[0] != 0:
            m.counts[LISTED] = m.counts[LACKING] = m.counts[WITH_FACES] = 0
            return
        lacking, total, of_faces = 0, 0, 0
        for part in range(PARTS):
            lacking = max(lacking, -number[part, 0])
            total, of_faces = total + number[part, 0], of_faces + number[part, 1]
        room += lacking
    enlist_parts(m, found, gaps, number, PARTS, threads)
    places = m.pairs.vertices.shape[0]
    m.counts[LISTED], m.counts[LACKING] = min(total, places), max(0, total - places)
    m.counts[WITH_FACES] = min(of_faces, places)


@block_kernel
def foretell(m: ContactState, off: Float) -> tuple[float, float]:
    """Write into off (1, n) how far each vertex may be from where the list's plan has it while the near plan holds [m];
    return the shares of the list's window at which that begins and ends, 1 at most: there, a new list begins.
    """
    plan, clock = m.plan, m.clock
    window = clock[LIST_WINDOW]
    begin = less(1.0, (clock[NEAR_BEGUN] - clock[LIST_BEGUN]) / window)
    end = less(1.0, begin + clock[NEAR_WINDOW] / window)
    share = (end - begin) * window / clock[NEAR_WINDOW]
    for i in range(0, off.shape[1], WIDTH):
        count = min(WIDTH, off.shape[1] - i)
        there, go = read_triple(plan.reference, 0, i, count), read_triple(plan.motion, 0, i, count)
        first = minus(read_triple(plan.reference, 3, i, count), plus(there, times(splat(begin), go)))
        way = minus(times(splat(share), read_triple(plan.motion, 3, i, count)), times(splat(end - begin), go))
        last = plus(first, way)
        write(off, 0, i, count, root(higher(dot(first, first), dot(last, last))) + read(plan.spread, 1, i, count))
    return begin, end


@block_kernel
def keep_strayed(m: ContactState, of_edges: bool, kept: Int, first: int, off: Float, begin: float, end: float) -> int:
    """Write into kept (c,) those of as many listed pairs from the first on that the list's plan does not keep apart,
    off which vertices are up to off (1, n) [m]; return their number. Between the shares of its window a pair's gap is
    concave in time: not below the line between those at its start and end.
    """
    pair, gaps, thickness, number = m.pairs.vertices, m.pairs.gaps, m.surface.law[0], 0
    for c in range(kept.shape[0]):
        p = np.uint64(first + c)
        a, b = off[0, np.uint64(pair[p, 0])], off[0, np.uint64(pair[p, 1])]
        k, l = off[0, np.uint64(pair[p, 2])], off[0, np.uint64(pair[p, 3])]  # noqa: E741
        strays = more(a, b) + more(k, l) if of_edges else a + more(b, more(k, l))
        gap, change = gaps[0, p], gaps[1, p] - gaps[0, p]
        kept[number] = p
        number += 1 - int(less(gap + begin * change, gap + end * change) - strays > thickness)
    return number


@block_kernel
def choose_part(part: int, m: ContactState, off: Float, begin: float, end: float, number: Long) -> None:
    """Choose near pairs among a part of the listed ones; write them into `near` from the part's first place on."""
    pairs, anchored, near, listed = m.pairs, m.anchored, m.pairs.near, m.counts[LISTED]
    first, last = part * listed // PARTS, (part + 1) * listed // PARTS
    middle = max(first, min(last, m.counts[WITH_FACES]))
    chosen = first
    for of_edges, start, stop in ((False, first, middle), (True, middle, last)):
        strayed = start + keep_strayed(m, of_edges, near[start:stop], start, off, begin, end)
        kept = keep_near(m, of_edges, pairs.vertices, near[start:strayed], pairs.normal, None)
        for q in range(start, start + kept):
            near[chosen] = near[q]
            chosen += 1
    is_near = np.zeros(last - first, np.bool_)
    for q in range(first, chosen):
        is_near[near[q] - first] = True
    for p in range(last - first):
        anchored[first + p] &= is_near[p]
    for q in range(first, chosen):
        if pairs.reach[near[q]] < 0.0:
            measure(m, near[q])
    number[part] = chosen - first


choose_parts = over_blocks(choose_part, "m, off, begin, end, number", order=IN_TURN)


@block_kernel
def choose_near(m: ContactState, threads: int | None) -> None:
    """Choose the listed pairs that may come near in the near plan; the others do not touch, and lose their anchors."""
    plan = m.plan
    lay_out(plan.reference[3:], plan.motion[3:], plan.spread[1], plan.ways)
    number, off = np.empty(PARTS, np.int64), np.empty((1, plan.ways.shape[0]))
    begin, end = foretell(m, off)
    choose_parts(m, off, begin, end, number, PARTS, threads)
    m.counts[NEAR], m.counts[CHOICES] = close_up(m.pairs.near, m.counts[LISTED], number), m.counts[CHOICES] + 1
    copy_rows(plan.reference[3:], plan.listed[3:6])
    copy_rows(plan.motion[3:], plan.listed[9:12])
    copy_rows(plan.spread[1:], plan.listed[13:])


@block_kernel
def make_list(m: ContactState, threads: int | None) -> None:
    """List the pairs for the present plan, without moving anchors."""
    plan = m.plan
    x, u, spread = plan.reference[:3], plan.motion[:3], plan.spread[0]
    lay_out(x, u, spread, plan.ways)
    fit_tree(m.tree, plan.ways, m.surface.law[0])
    copy_rows(x, plan.listed[:3])
    copy_rows(u, plan.listed[6:9])
    copy_rows(plan.spread[:1], plan.listed[12:13])
    search(m, threads)
    m.counts[LISTS_MADE] += 1
    activate(m, bool(m.bodies.always[0]))


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
CHOICE = 1.0
"""To examine a listed pair when near pairs are chosen takes at most as long as so many examinations of a near one."""
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
    """Whether a vertex of x (3, n), of cloth or active, is farther from its place in a plan after a share of that than
    allowed.
    """
    bodies, all_active = m.bodies.local.shape[0], m.bodies.number[0] == m.bodies.local.shape[0]
    first, row, motion = x.shape[1] - bodies, 3 * which, m.plan.motion
    end = x.shape[1] if all_active else first
    for i in range(0, end, WIDTH):
        count = min(WIDTH, end - i)
        off, room = off_plan(m, which, x, share, i, count), read(m.plan.spread, which, i, count)
        if lanes_up_to(dot(off, off) - room * room, 0.0) != EVERY:
            return True
    for q in range(0 if all_active else m.bodies.number[0]):
        i = first + m.bodies.active[q]
        way = minus(point(x, i), (m.plan.reference[row, i], m.plan.reference[row + 1, i], m.plan.reference[row + 2, i]))
        away = minus(way, (share * motion[row, i], share * motion[row + 1, i], share * motion[row + 2, i]))
        if not dot(away, away) <= m.plan.spread[which, i] ** 2:
            return True
    return False


@block_kernel
def holds(m: ContactState, which: int, x: Float, s: float, ahead: float) -> bool:
    """Whether a plan holds for vertices x (3, n) at fraction s of the interval, and until `ahead` after that."""
    begun, window = m.clock[BEGUN[which]], m.clock[LASTS[which]]
    if s + ahead > begun + window or (which == LIST and s > m.bodies.until[0]):
        return False
    return not strays(m, which, x, (s - begun) / window)


@block_kernel
def learn(m: ContactState, which: int, x: Float, gone: float, share: float) -> None:
    """Update `unrest` by how much each vertex of x (3, n) has strayed from a plan that was made `gone` of the interval
    ago; `share` of the plan's window has passed.
    """
    unrest, first = m.plan.unrest, x.shape[1] - m.bodies.local.shape[0]
    for i in range(0, x.shape[1], WIDTH):
        count = min(WIDTH, x.shape[1] - i)
        off = off_plan(m, which, x, share, i, count)
        # In this order: before the first plan the reference is NaN, which must not enter.
        before = 0.7 * read(unrest, which, i, count)
        found = higher(root(dot(off, off)) / (gone * gone), before)
        for k in range(count):
            # Others were not followed since near pairs were chosen.
            if which == LIST or i + k < first or m.bodies.is_active[i + k - first]:
                unrest[which, i + k] = lane(found, k)


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
        if s > clock[LIST_BEGUN] and m.bodies.local.shape[0] > 0:
            # What a list has for a time that it does not last is found in vain.
            lived, before = s - clock[LIST_BEGUN], clock[LIST_WINDOW]
            shorter = max(1.5 * lived, 0.5 * before) if begun < 0.9 else GROWTH * before
            whole = max(2.0 * window, min(LISTS, shorter))
        longer = min(LONGEST, GROWTH * clock[LIST_WINDOW])
        if begun > EARLY and longer > whole and is_quiet(plan.unrest[0], longer, LEAST[0] * m.surface.law[0]):
            whole = longer
        allow(m, spread[0], plan.unrest[0], whole, LEAST[0], MOST[0])
        caught = False
        for i in range(last.shape[1]):
            caught = caught or pinched[i] < 1.0
        for i in range(last.shape[1]):
            spread[0, i] = scale * spread[0, i] + spread[1, i]
            if caught:
                # What is pinched will be again, and whatever stays behind then is to need no other list.
                spread[0, i] += math.sqrt(u[0, i] * u[0, i] + u[1, i] * u[1, i] + u[2, i] * u[2, i])
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
