"""What a user should know about what the viewer shows."""

from __future__ import annotations

import numpy as np

from nuno.cloth.tension import SPAN
from nuno.export.paint import INSET
from nuno.words import duration


def about(scene: str, vertices: int, faces: int, speed: float | None = None) -> str:
    """What a user should know about the picture, as Markdown; `speed` is that of the dye, where there is any."""
    dyed = f"\n**Dye**: a second here is {duration(speed)} of dyeing.\n" if speed is not None else ""
    return f"""# {scene}
{vertices:,} vertices, {faces:,} triangles.

**Colour**: stretch of the most stretched thread at each vertex, on a logarithmic scale:

| colour | stretch |
| --- | --- |
| violet | 0.1 % and less |
| blue | 1 % |
| green | 10 % |
| yellow | 100 % and more |
| grey | not a number |

Pieces with a texture or a colour of their own show that instead, and nets of yarns, where the scene's view has
`links: yarn` or `links: tension`, the yarn that each link is of or its tension.
Bodies are drawn {1000 * INSET:g} mm thinner than they are, so that cloth resting on them shows.
{dyed}"""


def about_tension(most: list[float]) -> str:
    """The colours of tension, as Markdown; `most` are the strongest [N] of the pieces of cloth that have them."""
    if not most:
        return ""
    values = most[0] * np.power(SPAN, [0.0, -1 / 3, -2 / 3, -1.0])
    names = zip(("yellow", "green", "blue", "violet"), values, strict=True)
    rows = "\n".join(f"| {colour} | {tension:.3g} N |" for colour, tension in names)
    return f"""
**Links of yarns**: their tension along the yarn, on a logarithmic scale; the strongest is that of the stiffest link
as long again as at rest.

| colour | tension |
| --- | --- |
{rows}
"""
