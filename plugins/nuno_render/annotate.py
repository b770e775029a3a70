"""A caption and a colour bar, drawn over a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nuno_render.config import Legend
from nuno_schemas.colour import colours, to_srgb

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

INK, HALO = (58, 58, 62), (250, 249, 246)


def annotate(picture: NDArray[np.uint8], caption: str, legend: Legend | None) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3) with a caption at the lower left and a bar at the lower right.

    Sizes follow the picture's height. Text is in Pillow's font, so that it looks the same on every machine; Pillow is
    imported only to draw text.
    """
    if not caption and legend is None:
        return picture
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    height, width = picture.shape[:2]
    font = ImageFont.load_default(max(round(height / 42), 9))
    margin = round(height / 30)
    if caption:
        _text(draw, (margin, height - margin), caption, font, "ls")
    if legend is not None:
        _bar(image, draw, legend, font, (width - margin, height - margin), (width // 4, max(height // 60, 4)))
    return np.asarray(image)


def _bar(
    image: object, draw: ImageDraw, legend: Legend, font: FreeTypeFont | ImageFont, corner: tuple[int, int],
    size: tuple[int, int],
) -> None:  # fmt: skip
    """Draw a bar with its label above and its limits below, right-aligned with `corner`."""
    from PIL import Image

    assert isinstance(image, Image.Image)
    (right, bottom), (width, height) = corner, size
    left, line = right - width, int(draw.textbbox((0, 0), "0g", font)[3])
    top = bottom - line - height
    row = np.rint(to_srgb(colours(np.linspace(0.0, 1.0, width), 0.0, 1.0)) * 255.0).astype(np.uint8)
    image.paste(Image.fromarray(np.tile(row, (height, 1, 1))), (left, top))
    draw.rectangle((left - 1, top - 1, right, top + height), outline=INK)
    # A label longer than the bar is right-aligned with it.
    wide = draw.textlength(legend.label, font) > width
    _text(draw, (right if wide else left, top - line // 3), legend.label, font, "rs" if wide else "ls")
    _text(draw, (left, bottom), _number(legend.low, legend.format), font, "ls")
    _text(draw, (right, bottom), _number(legend.high, legend.format), font, "rs")


def _text(draw: ImageDraw, place: tuple[int, int], text: str, font: FreeTypeFont | ImageFont, anchor: str) -> None:
    draw.text(place, text, INK, font, anchor=anchor, stroke_width=1, stroke_fill=HALO)


def _number(value: float, style: str) -> str:
    if style == "percent":
        return f"{value * 100:.3g} %"
    # Three digits, but thousands without a power of ten.
    return f"{float(f'{value:.3g}'):,.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"
