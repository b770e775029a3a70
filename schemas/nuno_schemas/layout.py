"""How annotations say the layout of what plugins hand over: `Annotated[Float, "n", 3, Bounds(low=0.0)]`.

What follows the type of an array are its lengths: a number, a name that stands for one length in all fields of a class,
or a tuple of names of which any will do, where one may also be a property of the class. A tuple has one length at most.
Last come bounds, if there are any. Where a class is a part of another, the names of lengths of the other hold in it.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Bounds(NamedTuple):
    """What a number, or each entry of an array, is held to: low <= value <= high, above < value, value < below.

    below is the name of a length: so an index is bounded. An array that may be strided need not be C-contiguous.
    """

    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    below: str = ""
    finite: bool = True
    strided: bool = False
