"""Renderers: plugins that draw meshes as a camera sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Plugin


@dataclass(frozen=True)
class Mesh:
    """Something to draw: vertices (n, 3) [m], faces (f, 3), colours (n, 3) float in [0, 1]
    linear or None, uv (n, 2) and image (h, w, 3) uint8 or None.
    """

    vertices: Float
    faces: NDArray[np.int32]
    colours: NDArray[np.float64] | None = None
    uv: NDArray[np.float32] | None = None
    image: NDArray[np.uint8] | None = None
    two_sided: bool = True


@dataclass(frozen=True)
class Camera:
    """eye, target, up (3,) [m]; vertical field of view [rad]; size (width, height) [pixels]."""

    eye: Float
    target: Float
    up: Float
    fov: float
    size: tuple[int, int]


class Renderer(Plugin, Protocol):
    """Draws meshes."""

    def render(self, config: Any, meshes: list[Mesh], camera: Camera) -> NDArray[np.uint8]:
        """Return a picture (height, width, 3) uint8 sRGB."""
        ...
