"""Words, numbers and scales on the drawing of a flat pattern."""

from __future__ import annotations

from html import escape

import numpy as np

from nuno.exports.paint import STRETCH
from nuno_schemas.colour import colours, to_srgb
from nuno_schemas.fabric import Float

STRIPES = 50
"""Of the bar of strains."""
INK, SEAM = "#1d2430", "#b5523b"


def scale() -> list[str]:
    """10 cm to check a print by."""
    return [
        f'<path class="scale" d="M0,-3V3M0,0H100M100,-3V3" fill="none" stroke="{INK}" stroke-width="0.6"/>',
        text("10 cm", 50, -2.5, 6, INK, "middle"), text("1:1, in mm. Arrows run along the warp.", 0, 12, 5),
    ]  # fmt: skip


def legend(words: str) -> list[str]:
    """A bar of 100 mm, beside the scale, with the strains at decades."""
    # Of stripes: what makes a PDF of the drawing knows no gradients. Each reaches under the next, so that no gap shows.
    shades = to_srgb(colours(np.arange(STRIPES), 0.0, STRIPES - 1.0))
    inks = ["#" + bytes(np.rint(255.0 * shade).astype(np.uint8).tolist()).hex() for shade in shades]
    wide = 100.0 / STRIPES
    decades = np.arange(round(np.log10(STRETCH[0])), round(np.log10(STRETCH[1])) + 1).tolist()
    marks = np.linspace(130.0, 230.0, len(decades)).tolist()
    return [
        *(f'<rect x="{130 + k * wide:g}" y="-3" width="{100 - k * wide:g}" height="6" fill="{ink}"/>'
          for k, ink in enumerate(inks)),
        text(words, 130, -5.5, 5),
        *(text(f"{100.0 * 10.0**k:g} %", x, 9, 5, INK, "middle") for k, x in zip(decades, marks, strict=True)),
    ]  # fmt: skip


def points(rows: Float) -> str:
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in rows.tolist())


def text(text: str, x: float, y: float, size: float, ink: str = INK, anchor: str = "start") -> str:
    place = f'x="{x:.3f}" y="{y:.3f}" font-size="{size:.3g}" fill="{ink}" text-anchor="{anchor}"'
    # A white rim first: labels are to be read on any colour, and not all programs know paint-order.
    return f'<text {place} stroke="#ffffff" stroke-width="{0.2 * size:.3g}">{escape(text)}</text>' + (
        f"<text {place}>{escape(text)}</text>"
    )
