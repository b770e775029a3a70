"""Pictures of knits on bodies: the data that they show, and the plugins that draw them."""

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
"""Called with the number of drawn rows and of all rows."""


@dataclass(frozen=True)
class SurfaceValues:
    """Numbers shown as colours on bodies.

    values (n,)  values of the worn points, or of the vertices or faces of all bodies in their order; NaN: no value
    label        name of the quantity, with its unit
    """

    on: Literal["points", "vertices", "faces"]
    values: Float
    label: str


@dataclass(frozen=True)
class Worn:
    """Knits and the bodies that wear them, z up.

    bodies          meshes, closed if they are one-sided; a body without colours has the colour of skin
    points (n, 3)   crossings of yarns, the paper's mass points [m]
    links  (l, 2)   int32, end points of each link of yarn
    yarns           yarns as curves; None for a plugin that draws none
    values          values to show; None for a plugin that shows none
    """

    bodies: tuple[Mesh, ...]
    points: Float
    links: Int
    yarns: YarnCurves | None = None
    values: SurfaceValues | None = None


class YarnPicture(Plugin, Protocol):
    """Draws knits on bodies."""

    curves: ClassVar[bool]
    """Whether it draws yarns as curves, which are slow to make."""
    shows: ClassVar[bool]
    """Whether it shows values from the caller: for knits in recordings, their pressure."""

    def draw(self, config: Any, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """Return a picture (height, width, 3) uint8 sRGB, the same bytes for any number of threads.

        Raises BadInput if the eye is inside a body, yarns have no thickness, or there is nothing to draw.
        """
        ...
