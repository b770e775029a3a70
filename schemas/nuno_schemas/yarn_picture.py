"""What pictures of knits on bodies are drawn from, and plugins that draw them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

from nuno_schemas.curves import YarnCurves
from nuno_schemas.drawing import Camera, Mesh
from nuno_schemas.dye_picture import Picture
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Plugin

Progress = Callable[[int, int], None]
"""Called with the rows drawn and all rows."""


@dataclass(frozen=True)
class SurfaceValues:
    """Numbers to be shown as colours on bodies.

    values (n,)  of the points that are worn, of the vertices, or of the faces of all bodies in their order; NaN: none
    label        what they are, with their unit
    """

    on: Literal["points", "vertices", "faces"]
    values: Float
    label: str


@dataclass(frozen=True)
class Worn:
    """Knits and the bodies that wear them, z up.

    bodies          closed where they are one-sided; one that brings no colours is skin
    points (n, 3)   where yarns cross, the paper's mass points [m]
    links  (l, 2)   int32, points that a piece of yarn joins
    yarns           as curves; None for a plugin that draws none
    values          None for a plugin that shows none
    """

    bodies: tuple[Mesh, ...]
    points: Float
    links: Int
    yarns: YarnCurves | None = None
    values: SurfaceValues | None = None


class YarnPicture(Plugin, Protocol):
    """Draws knits on bodies."""

    curves: ClassVar[bool]
    """Whether it draws yarns as curves; to make them takes time."""
    shows: ClassVar[bool]
    """Whether it shows values that its caller brings: of knits in recordings, their pressure."""

    def draw(self, config: Any, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """(height, width, 3) uint8 sRGB picture, the same bytes however many threads draw it.

        Raises BadInput for what cannot be drawn: an eye inside a body, yarns without thickness, nothing to draw.
        """
        ...
