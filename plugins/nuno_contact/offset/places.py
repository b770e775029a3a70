"""Indices of the arrays of ContactState that hold single numbers."""

from __future__ import annotations

LISTED, NEAR, LACKING, LISTS_MADE, CHOICES, SHARED, CLOSE, TOUCHING = range(8)
"""Indices of ContactState.number: listed pairs; near ones; pairs without room in the list; the number of lists made,
and of choices of near pairs; the choice that is assigned to blocks; close pairs; touching pairs."""
CUT, HELD_CUT, STEPS, LEFT_OUT, STILL = range(5)
"""Indices of ContactState.so_far: shortened steps of vertices, and of held ones; steps; pairs that had no room in a
list; steps in which nothing moved for that reason."""
NOW, LIST_BEGUN, LIST_WINDOW, NEAR_BEGUN, NEAR_WINDOW, LIST_ROOM, LAST_STEP = range(7)
"""Indices of ContactState.clock, in fractions of the interval: the end of the last step; the time of the list, and its
window; the same of near pairs; the share of the list plan's spread that is allowed at most; the duration of the last
step of an explicit method [s]."""
