"""A weaver's draft as a picture, as a plugin of `nuno.dye_cloths` with a method `draw_draft(path)` returns it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from nuno_schemas.dye_picture import Picture


@dataclass(frozen=True)
class DrawnDraft:
    """A draft with its drawdown.

    picture  (h, w, 3) sRGB
    pixel    side of a pixel of the drawdown [m], None if the file has no spacing
    facts    properties that the file states, as text by name
    """

    picture: Picture
    pixel: float | None
    facts: Mapping[str, str]
