"""Places in the arrays of a Meeting that hold single numbers."""

from __future__ import annotations

LISTED, NEAR, LACKING, LISTS_MADE, CHOICES, SHARED, CLOSE, TOUCHING = range(8)
"""Of Meeting.number: pairs in the list; those near; those that found no place in it; how often the list was made so
far, and what is near was chosen; which of these choices is shared out to blocks; pairs that are close; those that
touch.
"""
CUT, HELD_CUT, STEPS, LEFT_OUT, STILL = range(5)
"""Of Meeting.so_far: steps of vertices that were cut short, and of held ones; steps; pairs that found no place in a
list; steps in which for want of that nothing moved.
"""
NOW, LIST_BEGUN, LIST_WINDOW, NEAR_BEGUN, NEAR_WINDOW, LIST_ROOM, LAST_STEP = range(7)
"""Of Meeting.clock, in fractions of the interval: when the last step ended; when the list was made, and its window; the
same of what is near; the share of what the list's plan allows at most; how long the last step of an explicit method was
[s].
"""
