"""What a user should know about what the viewer shows: a page, and the scale of the colours of tension."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nuno.cloth.tension import SPAN
from nuno.exports.paint import INSET
from nuno.viewer.layout import BACKGROUND
from nuno.words import duration
from nuno_schemas.colour import colours, to_srgb

WIDTH, HEIGHT = 1200, 110
"""Of the picture [pixels]."""
SIDE, TOP, BOTTOM = 90, 12, 56
"""The bar's distance from either side, and its first row and the one below it."""
FONT, INK = 30, (40, 44, 52)


def about(scene: str, vertices: int, faces: int, speed: float | None = None) -> str:
    """What a user should know about the picture, as Markdown; `speed` is that of the dye, where there is any."""
    dyed = f"\n**Dye**: a second here is {duration(speed)} of dyeing.\n" if speed is not None else ""
    return f"""# {scene}
{vertices:,} vertices, {faces:,} triangles.

**Colour**: cloth has its texture, its colour, or one by its place in the scene. Links of nets, and all cloth of a scene
with `view: {{colour: stretch}}`, show the stretch of the most stretched thread, on a logarithmic scale:

| colour | stretch |
| --- | --- |
| violet | 0.1 % and less |
| blue | 1 % |
| green | 10 % |
| yellow | 100 % and more |
| grey | not a number |

Nets of yarns show the yarn that each link is of, or its tension, where the scene's view has `links: yarn` or
`links: tension`.
Bodies are drawn {1000 * INSET:g} mm thinner than they are, so that cloth resting on them shows.
{dyed}"""


def about_tension(most: list[float]) -> str:
    """The colours of tension, as Markdown; `most` are the strongest [N] of the pieces of cloth that have them."""
    if not most:
        return ""
    return f"""
**Links of yarns**: their tension along the yarn, by the scale below the scene. Its end, {most[0]:.3g} N, is that of the
stiffest link as long again as at rest.
"""


def tension_legend(most: float) -> NDArray[np.uint8]:
    """(HEIGHT, WIDTH, 3) sRGB: a logarithmic bar from the strongest tension `most` [N] down to a SPANth of it, and
    what each tenfold of it is.
    """
    from PIL import Image, ImageDraw, ImageFont

    picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    picture[:] = BACKGROUND
    bar = colours(np.linspace(0.0, 1.0, WIDTH - 2 * SIDE), 0.0, 1.0)
    picture[TOP:BOTTOM, SIDE:-SIDE] = np.round(255.0 * to_srgb(bar))
    image = Image.fromarray(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(FONT)
    unit, name = (1.0, "N") if most >= 1.0 else (1e-3, "mN")
    for share, tension in ticks(most):
        x = SIDE + round(share * (WIDTH - 2 * SIDE - 1))
        draw.line((x, BOTTOM, x, BOTTOM + 10), INK, 3)
        draw.text((x, BOTTOM + 14), f"{tension / unit:.3g} {name}", INK, font, anchor="mt")
    return np.asarray(image)


def ticks(most: float) -> list[tuple[float, float]]:
    """(share of the bar's length, tension [N]) of each tenth, hundredth, ... of the strongest, from the weakest on."""
    count = round(math.log10(SPAN))
    return [(i / count, most * SPAN ** (i / count - 1.0)) for i in range(count + 1)]
