"""A weaver's draft as a picture, of a plugin of `nuno.dye_cloths` that draws some by `draw_draft(path)`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from nuno_schemas.dye_picture import Picture


@dataclass(frozen=True)
class DrawnDraft:
    """A draft with its drawdown.

    picture  (h, w, 3) sRGB
    pixel    side of a pixel of the drawdown [m], None where the file has no spacing
    facts    what it says of itself, in words, by name
    """

    picture: Picture
    pixel: float | None
    facts: Mapping[str, str]
