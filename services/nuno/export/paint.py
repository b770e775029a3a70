"""Colours of cloth and bodies in pictures and mesh files."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.colour import colours
from nuno_schemas.fabric import Float

STRETCH = (0.001, 1.0)
"""Ends of the colour map for stretch, logarithmic as in the viewer: wool under its own weight
stretches by a thousandth, the skirt paper's springs by half."""
PLAIN, BODY = "#d8d3cb", "#b9c0c9"


def paint_stretch(stretch: Float) -> NDArray[np.float64]:
    """(n, 3) linear light of n stretches; NaN is grey."""
    low, high = (math.log10(end) for end in STRETCH)
    with np.errstate(invalid="ignore"):
        return colours(np.log10(np.maximum(stretch, STRETCH[0])), low, high)
