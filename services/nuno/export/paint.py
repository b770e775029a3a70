"""Colours of cloth and bodies in pictures and mesh files."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.colour import colours, parse_hex
from nuno_schemas.fabric import Float

STRETCH = (0.001, 1.0)
"""Ends of the colour map for stretch, logarithmic as in the viewer: wool under its own weight
stretches by a thousandth, the skirt paper's springs by half."""
INSET = 0.002
"""Bodies are drawn thinner by this much [m]: cloth at rest on them sinks in by about as much."""
PLAIN, BODY = "#d8d3cb", "#b9c0c9"
YARNS = ("#c98b6b", "#3b5b8c", "#5d8a4f", "#b5523b", "#7d5ba6", "#c9a227")
"""Of kinds of yarn in the order of their names, over again where there are more."""


def read_rgb(source: Path | BinaryIO) -> NDArray[np.uint8]:
    """(h, w, 3) sRGB of an image file. Raises OSError or ValueError for one that cannot be read."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            # Pillow only warns of an image that would unpack to gigabytes.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(source) as image:
                return np.asarray(image.convert("RGB"))
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise ValueError(str(error)) from None


def paint_yarns(kinds: NDArray[np.int8]) -> NDArray[np.float64]:
    """(e, 3) linear light of links by their kind of yarn; -1, no yarn, is plain."""
    table = np.stack([parse_hex(colour) for colour in (*YARNS, PLAIN)])
    return np.asarray(table[np.where(kinds < 0, len(YARNS), kinds % len(YARNS))])


def paint_pressure(pressure: Float, high: float) -> NDArray[np.float64]:
    """(n, 3) linear light of n pressures [Pa] from 0 to `high`; below 0 as 0, NaN grey."""
    return colours(np.maximum(pressure, 0.0), 0.0, high)


def paint_stretch(stretch: Float) -> NDArray[np.float64]:
    """(n, 3) linear light of n stretches; NaN is grey."""
    low, high = (math.log10(end) for end in STRETCH)
    with np.errstate(invalid="ignore"):
        return colours(np.log10(np.maximum(stretch, STRETCH[0])), low, high)
