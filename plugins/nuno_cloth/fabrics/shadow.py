"""The shadow of a draped specimen, read from a photograph, and its nodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.colour import as_rgb
from nuno_schemas.errors import BadInput

FORMATS = ("PNG", "JPEG")
CONTRAST = 0.1
"""Least difference between a shadow's mean and that of its surroundings, as a share of white."""
RAYS, SMOOTH, PEAK = 720, 24, 1e-3
"""Directions in which the outline is read, harmonics kept of it, and least height of a node over the rest [m]."""


def read_shadow(path: Path, field: str) -> NDArray[np.bool_]:
    """Return the pixels (h, w) of the shadow: the largest area of a photograph that is dark by Otsu's threshold (1979),
    without holes. Raises BadInput, of this field, for a picture that cannot be read, has no contrast, or cuts the
    shadow off.
    """
    from scipy import ndimage

    values = _read_grey(path, field)
    counts, edges = np.histogram(values, 256)
    middles = 0.5 * (edges[1:] + edges[:-1])
    below, sums = np.cumsum(counts)[:-1], np.cumsum(counts * middles)
    above = values.size - below
    darker, lighter = sums[:-1] / np.maximum(below, 1), (sums[-1] - sums[:-1]) / np.maximum(above, 1)
    best = int(np.argmax(below * above * (lighter - darker) ** 2.0))
    if not (below[best] and above[best] and lighter[best] - darker[best] > 255.0 * CONTRAST):
        raise BadInput(
            "no shadow stands out: the picture is as dark, or as light, everywhere", field=field, value=str(path),
            limit=f"a shadow darker than the rest by {CONTRAST:.0%} of white", remedy="photograph it dark on light",
        )  # fmt: skip
    areas, _ = ndimage.label(values < edges[best + 1])
    largest = areas == np.argmax(np.bincount(areas.ravel())[1:]) + 1
    if largest[[0, -1]].any() or largest[:, [0, -1]].any():
        raise BadInput(
            "the shadow reaches the picture's edge", field=field, value=str(path), limit="light all around the shadow",
            remedy="take the whole shadow into the picture, dark on light",
        )  # fmt: skip
    return np.asarray(ndimage.binary_fill_holes(largest))


def _read_grey(path: Path, field: str) -> NDArray[np.uint8]:
    """Read the grey values (h, w)."""
    from PIL import Image

    try:
        with path.open("rb") as stream, Image.open(stream, formats=FORMATS) as image:
            return np.asarray(Image.fromarray(as_rgb(image)).convert("L"))
    except Exception as error:  # a decoder may raise anything on a broken file
        reason = getattr(error, "strerror", None) or "it is none, or damaged"
        raise BadInput(
            f"the picture cannot be read: {reason}", field=field, value=str(path), limit=" or ".join(FORMATS),
            remedy="name a picture beside the sheet",
        ) from None  # fmt: skip


def count_nodes(shadow: NDArray[np.bool_], dot: float, middle: tuple[float, float]) -> int:
    """Return the number of folds in the outline of a shadow (h, w), with pixels of side `dot` [m], seen from its
    `middle` (row, column).
    """
    angles, steps = 2.0 * np.pi * np.arange(RAYS) / RAYS, np.arange(max(shadow.shape))
    rows, columns = (
        np.clip(np.rint(start + np.outer(turn, steps)).astype(int), 0, most - 1)
        for start, turn, most in zip(middle, (np.sin(angles), np.cos(angles)), shadow.shape, strict=True)
    )
    reach = dot * (shadow[rows, columns] * steps).max(axis=1)
    waves = np.fft.rfft(reach)
    waves[SMOOTH + 1 :] = 0.0
    outline = np.fft.irfft(waves, RAYS)
    high = np.flatnonzero((outline > np.roll(outline, 1)) & (outline >= np.roll(outline, -1)))
    if len(high) < 2:
        return len(high)
    low = [
        outline[np.arange(a, b if b > a else b + RAYS) % RAYS].min()
        for a, b in zip(high, np.roll(high, -1), strict=True)
    ]
    before = np.roll(low, 1)
    return int((outline[high] - np.maximum(low, before) > PEAK).sum())
