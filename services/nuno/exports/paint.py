"""Colours of cloth and bodies in pictures and mesh files, and nets as tubes for renderers of triangles."""

from __future__ import annotations

import io
import math

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.colour import colours, parse_hex
from nuno_schemas.fabric import Float, Int

STRETCH = (0.001, 1.0)
"""Ends of the colour map for stretch, logarithmic as in the viewer: wool under its own weight
stretches by a thousandth, the skirt paper's springs by half."""
SIDES = 6
THICKNESS = 0.004
"""Radius of a tube, as part of the net's extent."""
INSET = 0.002
"""Bodies are drawn thinner by this much [m]: cloth at rest on them sinks in by about as much."""
CLOTHS = ("#5f84ad", "#c4795c", "#84a06c", "#cfa75b", "#95749f", "#5a9590")
"""Colours of objects without one of their own, in their order: soft dye colours that are easy to distinguish."""
PLAIN, BODY = "#d8d3cb", "#b9c0c9"
YARNS = ("#c98b6b", "#3b5b8c", "#5d8a4f", "#b5523b", "#7d5ba6", "#c9a227")
"""Colours of kinds of yarn in the order of their names, repeated if there are more kinds."""


def colour_of(index: int) -> str:
    """Return the colour of an object without one of its own, by its index in the scene."""
    return CLOTHS[index % len(CLOTHS)]


def as_png(picture: NDArray[np.uint8]) -> bytes:
    """Encode a picture (h, w, 3) as PNG, fast rather than small."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(picture).save(out, "PNG", compress_level=1)
    return out.getvalue()


def paint_yarns(kinds: NDArray[np.int8]) -> NDArray[np.float64]:
    """Return the linear light (e, 3) of links by their kind of yarn; -1, no yarn, is plain."""
    table = np.stack([parse_hex(colour) for colour in (*YARNS, PLAIN)])
    return np.asarray(table[np.where(kinds < 0, len(YARNS), kinds % len(YARNS))])


def paint_pressure(pressure: Float, high: float) -> NDArray[np.float64]:
    """Return the linear light (n, 3) of n pressures [Pa] from 0 to `high`; below 0 as 0, NaN grey."""
    return colours(np.maximum(pressure, 0.0), 0.0, high)


def paint_stretch(stretch: Float) -> NDArray[np.float64]:
    """Return the linear light (n, 3) of n stretches; NaN is grey."""
    low, high = (math.log10(end) for end in STRETCH)
    with np.errstate(invalid="ignore"):
        return colours(np.log10(np.maximum(stretch, STRETCH[0])), low, high)


def tubes(x: Float, edges: Int) -> tuple[Float, Int, NDArray[np.int64]]:
    """Make open tubes along edges (e, 2) between points x (n, 3) [m].

    Returns vertices (12 e, 3), faces (12 e, 3) counter-clockwise seen from outside, and the
    point (12 e,) that gives each vertex its colour.
    """
    finite = x[np.isfinite(x).all(axis=1)]
    extent = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
    start, end = x[edges[:, 0]], x[edges[:, 1]]
    axis = end - start
    helper = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    u = _unit(np.cross(helper, axis))
    v = _unit(np.cross(axis, u))
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None]
    ring *= THICKNESS * (extent or 1.0)
    vertices = np.stack([start[:, None] + ring, end[:, None] + ring], axis=1).reshape(-1, 3)
    side = np.arange(SIDES)
    after = (side + 1) % SIDES
    pattern = np.concatenate(
        [np.stack([side, after, side + SIDES], axis=1), np.stack([after, after + SIDES, side + SIDES], axis=1)]
    )
    faces = (pattern[None] + 2 * SIDES * np.arange(len(edges))[:, None, None]).reshape(-1, 3).astype(np.int32)
    return vertices, faces, np.repeat(edges, SIDES, axis=1).reshape(-1).astype(np.int64)


def _unit(vectors: Float) -> Float:
    length = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0))
