"""Colours: their notation, the colour map for scalars on cloth, and the sRGB transfer, for every picture."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nuno_schemas.errors import nearest

CONTROL = ("#f6f1e6", "#fdcc91", "#fca55d", "#f67949", "#e64f35", "#cb2527", "#a50026")
"""Equally spaced points of the colour map: the way of ColorBrewer's OrRd, in equal steps of lightness. Small values are
pale: shading, and with it folds, is seen there, which on viridis' dark end it is not.
"""

MISSING = "#9a9a9a"
"""Colour of a value that is not a number."""


def upright(image: Any) -> Any:
    """Return an image that Pillow has opened as viewers show it: turned by its EXIF tag, 16 bits rounded to 8."""
    from PIL import Image, ImageOps

    image = ImageOps.exif_transpose(image)
    if not image.mode.startswith("I"):
        return image
    return Image.fromarray(np.round(np.clip(np.asarray(image, np.float64) / 257.0, 0.0, 255.0)).astype(np.uint8))


def as_rgb(image: Any) -> NDArray[np.uint8]:
    """Return (h, w, 3) sRGB of an image that Pillow has opened, upright, on white. Raises ValueError for floats."""
    from PIL import Image

    if image.mode == "F":
        raise ValueError("its pixels are floats; save it in 8 or 16 bits")
    image = upright(image)
    if image.has_transparency_data:
        image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image.convert("RGBA"))
    return np.asarray(image.convert("RGB"))


def read_rgb(source: Path | BinaryIO) -> NDArray[np.uint8]:
    """Return (h, w, 3) sRGB of an image file. Raises OSError or ValueError for an unreadable file."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            # Pillow only warns of an image that would unpack to gigabytes.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(source) as image:
                return as_rgb(image)
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise ValueError(str(error)) from None


def to_linear(srgb: ArrayLike) -> NDArray[np.float64]:
    """Convert sRGB values in [0, 1] to linear light in [0, 1] (IEC 61966-2-1), any shape."""
    value = np.asarray(srgb, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((np.maximum(value, 0.0) + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: ArrayLike) -> NDArray[np.float64]:
    """Convert linear light, clipped to [0, 1], to sRGB values in [0, 1] (IEC 61966-2-1), any shape."""
    value = np.clip(np.asarray(linear, np.float64), 0.0, 1.0)
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1.0 / 2.4) - 0.055)


HEX = "#[0-9a-fA-F]{6}"
"""Regular expression of an sRGB colour in numbers."""


def names() -> dict[str, str]:
    """Return the 148 named colours of CSS (CSS Color 4, section 6.1), each as "#rrggbb"."""
    from PIL import ImageColor  # takes longer to load than a small scene to read

    # Not the values of colormap: Pillow puts what it has parsed in their place.
    rgb = {name: ImageColor.getrgb(name)[:3] for name in ImageColor.colormap}
    return {name: f"#{red:02x}{green:02x}{blue:02x}" for name, (red, green, blue) in rgb.items()}


def as_hex(text: str) -> str:
    """Return a colour as "#rrggbb", from that notation or a CSS name in any case. Raises ValueError for other text."""
    if re.fullmatch(HEX, text):
        return text
    css = names()
    if text.lower() in css:
        return css[text.lower()]
    near, separator, _ = nearest(text.lower(), css).partition("? ")
    hint = f"{near}? Or " if separator and not text.startswith("#") else ""
    advice = "write red, green and blue as #rrggbb, for example #c04030, or one of CSS's names, for example indianred"
    raise ValueError(f"not a colour; {hint}{advice}")


def parse_hex(text: str) -> NDArray[np.float64]:
    """Return the linear light (3,) of an sRGB colour "#rrggbb". Raises ValueError for other text."""
    if not re.fullmatch(HEX, text):
        raise ValueError(f"{text!r} is not a colour such as '#f2efe9'")
    return to_linear(np.frombuffer(bytes.fromhex(text[1:]), np.uint8) / 255.0)


def colours(values: ArrayLike, low: float, high: float) -> NDArray[np.float64]:
    """Map n values to linear light (n, 3): `low` is the map's pale end, `high` its dark end.

    Values outside are clipped; with low = high everything is pale; NaN is grey. The control points are interpolated in
    sRGB.
    """
    value = np.asarray(values, np.float64).reshape(-1)
    span = high - low
    position = np.clip((value - low) / span, 0.0, 1.0) if span > 0.0 else np.zeros_like(value)
    table = np.array([list(bytes.fromhex(text[1:])) for text in CONTROL], np.float64) / 255.0
    knots = np.linspace(0.0, 1.0, len(CONTROL))
    result = to_linear(np.stack([np.interp(position, knots, table[:, channel]) for channel in range(3)], axis=1))
    result[np.isnan(value)] = parse_hex(MISSING)
    return result
