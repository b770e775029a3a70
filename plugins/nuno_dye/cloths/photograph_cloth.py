"""The cloth of a photograph as a plugin, and the picture of it with the photograph's light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, model_validator

from nuno_dye.cloths.cloth import Cloth, ClothConfig, FibreConfig, Tau
from nuno_dye.cloths.photograph import Colours, Masks, find_up, read_masks, read_photograph, read_size, split_by_colour
from nuno_dye.pictures.picture import Drawing, begin_drawing, draw
from nuno_schemas.colour import parse_hex, to_linear
from nuno_schemas.dye import Cells, DyeState, Tortuosity
from nuno_schemas.dye_picture import Layers, Photograph, Picture, Window
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.look import DyeColour
from nuno_schemas.parts import Colour
from nuno_schemas.plugin import Config, Files


class WholeTau3Config(Config):
    """Tortuosity of the way from a cell to its neighbour, 0 to 1, in cloth without gaps."""

    I: Tau = Field(description="to the other layer")  # noqa: E741
    II: Tau = Field(description="in a layer, across the yarn")
    V: Tau = Field(default=1.0, description="in a layer, along the yarn")


class PhotographConfig(ClothConfig):
    """A photograph, and how to distinguish its warp from its weft."""

    file: str = Field(description="the photograph, PNG or JPEG, beside the scene; warp upright")
    masks: Masks | None = Field(default=None, description="where warp shows, and where weft does")
    colours: Colours | None = Field(default=None, description="instead of masks: the colours of warp and weft")
    pixels: Annotated[int, Field(ge=1, le=256)] = Field(default=1, description="of the photograph, across a cell")
    weft: FibreConfig = Field(default=FibreConfig(), description="yarns along x")
    warp: FibreConfig = Field(default=FibreConfig(), description="yarns along y")
    tau3: WholeTau3Config = Field(description="by kind of face, I, II and V")

    @model_validator(mode="after")
    def _require_one_way(self) -> PhotographConfig:
        if (self.masks is None) == (self.colours is None):
            raise ValueError("warp and weft are distinguished in one way; give either masks or colours")
        return self


class PhotographCloth(Cloth):
    """A cloth with cells from a photograph's pixels."""

    name: ClassVar[str] = "photograph"
    Config: ClassVar[type[BaseModel]] = PhotographConfig

    def count(self, config: PhotographConfig, files: Files) -> int:
        height, width = read_size(files.resolve(config.file))
        return 2 * (height // config.pixels) * (width // config.pixels)

    def build(self, config: PhotographConfig, files: Files, seed: int, dyes: Sequence[str]) -> tuple[Cells, DyeState]:
        """Build the cloth. Raises BadInput for a photograph, masks or colours that do not fit each other."""
        light = read_photograph(files.resolve(config.file))
        if min(light.shape[:2]) < config.pixels:
            limit = f"the photograph has {light.shape[1]} x {light.shape[0]} pixels"
            raise BadInput("a cell is larger than the photograph", field="pixels", value=config.pixels, limit=limit)
        warp = self.warp(config, light, files)
        up = find_up(warp, config.pixels)
        ny, nx = up.shape[1:]
        inside = slice(ny * config.pixels), slice(nx * config.pixels)
        t = config.tau3
        tortuosity = Tortuosity(layers=t.I, beside=t.II, rim=1.0, gap=1.0, yarn=t.V, weave=config.tau2)
        porosity, twist, resist = (
            np.stack([np.full((ny, nx), getattr(layer, name)) for layer in (config.weft, config.warp)])
            for name in ("porosity", "twist", "resist")
        )
        cells = Cells(
            np.ones((2, ny, nx), np.bool_), up, porosity, twist, resist, config.cell_size, tortuosity,
            v_max=config.v_max,
            photograph=Photograph(np.ascontiguousarray(light[inside]), np.ascontiguousarray(warp[inside])),
        )  # fmt: skip
        return self.undyed(config, cells, files, len(dyes))

    def warp(self, config: PhotographConfig, light: NDArray[np.uint8], files: Files) -> NDArray[np.bool_]:
        """Return where (h, w) the photograph shows warp."""
        if config.masks is not None:
            return read_masks(config.masks, light.shape[:2], files)
        assert config.colours is not None
        try:
            return split_by_colour(config.colours, light)
        except BadInput as error:
            raise error.at(f"colours.{error.field}") from None


class PhotographPictureConfig(Config):
    """The photograph, dyed."""

    ground: Colour | None = Field(
        default=None,
        description="colour of the undyed cloth, #rrggbb or a CSS name, lit as the photograph; its own unless given",
    )


class PhotographPicture:
    """Draws dye on the photograph of the cloth, by the share of the reflected light that dye transmits.

    The dye paper multiplies colours by the photograph's lightness, which `ground` does; without it, undyed cloth
    is the photograph itself.
    """

    name: ClassVar[str] = "photograph"
    Config: ClassVar[type[BaseModel]] = PhotographPictureConfig

    def prepare(
        self,
        config: PhotographPictureConfig,
        files: Files,
        layers: Layers,
        dyes: Sequence[DyeColour],
        window: Window,
        scale: int,
    ) -> Drawing:
        """Prepare the drawing. Raises BadInput for a cloth without a photograph."""
        photograph = layers.photograph
        if photograph is None:
            remedy = "picture: {plugin: yarns}; or a cloth of plugin: photograph"
            raise BadInput("the cloth has no photograph", field="plugin", value=self.name, remedy=remedy)
        light, warp = cut(photograph, layers.fibre.shape[1], window, scale)
        shade = np.asarray(to_linear(light / 255.0), np.float32)
        ground = np.ones(3)
        if config.ground is not None:
            ground = parse_hex(config.ground)
            bright = shade @ np.array(LUMINANCE, np.float32)
            shade = np.minimum(bright / max(float(np.quantile(bright, BRIGHT)), 1e-6), 1.0)[..., None]
        _, ny, nx = layers.fibre.shape
        yarns = np.zeros(ny, np.int32), np.zeros(nx, np.int32)
        return begin_drawing(layers, dyes, ground, window, scale, warp.astype(np.uint8), shade, yarns)

    def draw(self, prepared: Drawing, amounts: Float) -> Picture:
        return draw(prepared, amounts)


LUMINANCE = (0.2126, 0.7152, 0.0722)
BRIGHT = 0.98
"""Quantile of the pixels' luminance that counts as fully lit."""


def cut(photograph: Photograph, ny: int, window: Window, scale: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return light (h, w, 3) and warp (h, w) of a window at `scale` pixels a cell, for a cloth of ny rows of cells."""
    from PIL import Image

    pixels = photograph.light.shape[0] // ny
    size = scale * (window.right - window.left), scale * (window.bottom - window.top)
    box = tuple(pixels * side for side in (window.left, window.top, window.right, window.bottom))
    smooth = Image.Resampling.BOX if scale <= pixels else Image.Resampling.BICUBIC
    light = np.asarray(Image.fromarray(photograph.light).resize(size, smooth, box))
    mask = Image.fromarray(photograph.warp.astype(np.uint8) * 255)
    # Interpolated between pixels of both layers, the border is smooth and not a staircase.
    return light, np.asarray(mask.resize(size, Image.Resampling.BILINEAR, box)) > 127
