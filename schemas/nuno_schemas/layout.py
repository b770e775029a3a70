"""Annotations for the layout of data from plugins: `Annotated[Float, "n", 3, Bounds(low=0.0)]`.

The lengths of an array follow its type. Each is a number, a name that stands for one length in all fields of a class,
or a tuple of alternative names, of which one may be a property of the class. A tuple has at most one length.
Bounds come last, if any. The names of lengths of a class also hold in the classes of its fields.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Bounds(NamedTuple):
    """Bounds of a number, or of each entry of an array: low <= value <= high, above < value, value < below.

    below is the name of a length, for indices. With `strided` an array need not be C-contiguous.
    """

    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    below: str = ""
    finite: bool = True
    strided: bool = False
