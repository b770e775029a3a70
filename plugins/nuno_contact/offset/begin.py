"""The start of an interval: contact continues with its lists, or makes new ones if cloth was moved meanwhile."""

from __future__ import annotations

from nuno_contact.offset.bodies import STANDS, copy_part, find_behind, pose_solids
from nuno_contact.offset.candidate_pairs import choose_near, make_list
from nuno_contact.offset.ccd import all_close
from nuno_contact.offset.contact_state import ContactState
from nuno_contact.offset.force import corners_of
from nuno_contact.offset.places import (
    LAST_STEP,
    LIST_BEGUN,
    LIST_ROOM,
    LIST_WINDOW,
    LISTED,
    NEAR,
    NEAR_BEGUN,
    NOW,
)
from nuno_contact.offset.plan import LEAST, LISTS, MOST, WINDOW, allow, set_out
from nuno_contact.offset.proximity import closest, unit, weigh
from nuno_contact.offset.touching import find_touching
from nuno_kernels import block_kernel, kernel
from nuno_kernels.step.rows import all_finite, copy_rows, same_rows
from nuno_schemas.fabric import Float


@kernel
def begin_interval(m: ContactState, x: Float, span: float, threads: int | None) -> None:
    """Before an interval's first step from x (3, n), keep the lists, or begin anew if x is another state."""
    n, goal = x.shape[1], x
    if m.local.shape[0] > 0:
        goal, m.still[0] = m.goal, min(m.still[0], STANDS)
        pose_solids(m, 0.0)
        copy_part(x, goal, 0, n)
    begin_whole(m, goal, same_rows(x, m.last), span, threads)
    if m.local.shape[0] > 0:
        find_behind(m, n)


@block_kernel
def begin_whole(m: ContactState, x: Float, goes_on: bool, span: float, threads: int | None) -> None:
    """Do so for cloth and bodies together; `goes_on`: the cloth is where it was left."""
    clock, m.span[0] = m.clock, span
    m.share[:] = 1.0  # a resumed run lacks it
    clock[LIST_BEGUN] -= clock[NOW]
    clock[NEAR_BEGUN] -= clock[NOW]
    clock[NOW] = 0.0
    if not (goes_on and all_finite(m.reference)):
        if not all_finite(x):
            return
        copy_rows(x, m.last)
        clock[LIST_BEGUN], clock[LIST_WINDOW], clock[LIST_ROOM], clock[LAST_STEP] = 0.0, LISTS, 1.0, 0.0
        m.unrest[:] = 0.0
        m.anchored[:] = False
        m.number[LISTED] = 0
        allow(m, m.spread[1], m.unrest[1], WINDOW, LEAST[1], MOST[1])
        set_out(m, m.nothing, 1.0, WINDOW, True, threads)
    elif not (
        same_rows(m.listed[:6], m.reference)
        and same_rows(m.listed[6:12], m.motion)
        and same_rows(m.listed[12:], m.spread)
    ):
        make_list(m, threads)
        choose_near(m, threads)
    renew_planes(m)
    all_close(m)
    find_touching(m, threads)


@block_kernel
def renew_planes(m: ContactState) -> None:
    """Give each near pair the plane across its closest points at `last`."""
    for q in range(m.number[NEAR]):
        p = m.near[q]
        corners = corners_of(m.last, m.pair[p, 0], m.pair[p, 1], m.pair[p, 2], m.pair[p, 3])
        n, _ = unit(weigh(closest(m.of[p] < 0, corners).weights, corners))
        m.normal[p, 0], m.normal[p, 1], m.normal[p, 2] = n
