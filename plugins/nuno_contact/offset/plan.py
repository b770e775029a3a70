"""The expected ways of vertices, their duration and accuracy, for which lists of pairs are made.

There are two plans. That of the list is looked for in the tree, which is dear, and lasts up to an interval or more;
that of what is near is chosen from the list, often, so that each step looks at few pairs. Each holds until its time is
over or a vertex has strayed from it. Vertices go on as they go in the step that is to come. How far each may stray
follows from how far it did stray before, as the square of the time: what is thrown about gets wide room, what hangs
quietly nearly none. That cloth goes on as fast, not faster and faster: accelerations, which change within a frame,
foretell less for half a frame ahead than none (measured on a skirt that swings).
"""

from __future__ import annotations

from nuno_contact.offset.candidate_pairs import choose_near, renew_list
from nuno_contact.offset.contact_state import ContactState
from nuno_contact.offset.places import (
    CLOSE,
    LACKING,
    LEFT_OUT,
    LIST_BEGUN,
    LIST_ROOM,
    LIST_WINDOW,
    LISTED,
    NEAR,
    NEAR_BEGUN,
    NEAR_WINDOW,
    NOW,
)
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.lanes.simd import (
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
from nuno_schemas.fabric import Float

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
    way = minus(read_triple(x, 0, i, count), read_triple(m.reference, 3 * which, i, count))
    return minus(way, times(splat(share), read_triple(m.motion, 3 * which, i, count)))


@block_kernel
def strays(m: ContactState, which: int, x: Float, share: float) -> bool:
    """Whether a vertex of x (3, n) is farther from its place in a plan after a share of that than allowed."""
    for i in range(0, x.shape[1], WIDTH):
        count = min(WIDTH, x.shape[1] - i)
        off, room = off_plan(m, which, x, share, i, count), read(m.spread, which, i, count)
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
    """Update m.unrest by how much each vertex of x (3, n) has strayed from a plan that was made `gone` of the interval
    ago; `share` of the plan's window has passed.
    """
    for i in range(0, x.shape[1], WIDTH):
        count = min(WIDTH, x.shape[1] - i)
        off = off_plan(m, which, x, share, i, count)
        # In this order: before the first plan the reference is NaN, which must not enter.
        before = 0.7 * read(m.unrest, which, i, count)
        write(m.unrest, which, i, count, higher(root(dot(off, off)) / (gone * gone), before))


@block_kernel
def allow(m: ContactState, spread: Float, unrest: Float, window: float, least: float, most: float) -> None:
    """Set spread (n,), how far each vertex may stray in a plan for a window, between `least` and `most` thicknesses."""
    h = m.law[0]
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
    dear = (m.number[NEAR] - m.number[CLOSE]) * gone > CHOICE * m.number[LISTED] * way
    window = clock[NEAR_WINDOW] * (1.0 / GROWTH if dear or used < 0.5 else GROWTH if used > 1.0 else 1.0)
    window = max(way + 1.5 * ahead, min(LONGEST, max(SHORTEST, window)))
    if gone > 0.0:
        learn(m, 1, m.last, gone, share)
    allow(m, m.spread[1], m.unrest[1], window, LEAST[1], MOST[1])
    set_out(m, u, way, window, renew, threads)


@block_kernel
def set_out(m: ContactState, u: Float, way: float, window: float, renew: bool, threads: int | None) -> None:
    """Choose near pairs for a window, in which vertices may stray as far as m.spread[1], from a list made anew if
    `renew`.
    """
    clock, last, reference, motion, spread = m.clock, m.last, m.reference, m.motion, m.spread
    s, near, scale, pinched, explicit = clock[NOW], motion[3:], window / way, m.share, m.step[0] == 0.0
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
        scale, pairs = clock[LIST_ROOM], m.number[LISTED] / (last.shape[1] - m.local.shape[0])
        if pairs > CROWDED[0] and begun > EARLY:
            scale *= 0.7
        elif pairs < 0.5 * CROWDED[0] or (pairs < CROWDED[1] and begun < EARLY):
            scale = min(1.0, 1.2 * scale)
        whole, clock[LIST_ROOM] = max(2.0 * window, LISTS), scale
        longer = min(LONGEST, GROWTH * clock[LIST_WINDOW])
        if begun > EARLY and longer > whole and is_quiet(m.unrest[0], longer, LEAST[0] * m.law[0]):
            whole = longer
        allow(m, spread[0], m.unrest[0], whole, LEAST[0], MOST[0])
        for i in range(last.shape[1]):
            spread[0, i] = scale * spread[0, i] + spread[1, i]
            for row in range(3):
                reference[row, i], motion[row, i] = last[row, i], whole / window * near[row, i]
        clock[LIST_BEGUN], clock[LIST_WINDOW] = s, whole
        renew_list(m, threads)
        while m.number[LACKING] > 0 and whole > window and m.leave[0] == 0:
            # Vertices that will be pushed back are expected to go through: over a shorter time by less.
            shorter = max(0.5, window / whole)
            whole *= shorter
            clock[LIST_WINDOW] = whole
            for row in range(3):
                for i in range(last.shape[1]):
                    motion[row, i] *= shorter
            renew_list(m, threads)
        while m.number[LACKING] > 0 and m.leave[0] == 0 and tighter(spread):
            clock[LIST_ROOM] *= 0.5
            renew_list(m, threads)
        m.so_far[LEFT_OUT] += m.number[LACKING]
    choose_near(m, threads)
