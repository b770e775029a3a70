"""The cloth of a photograph as a plugin, and the picture of it with the photograph's light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, field_validator, model_validator

from nuno_dye.cloths.cloth import Cloth, ClothConfig, FibreConfig, Tau
from nuno_dye.picture import Drawing, begin_drawing, draw
from nuno_dye.quantities import Share
from nuno_dye.supplies.resist import read_image
from nuno_schemas.colour import as_rgb, parse_hex, to_linear
from nuno_schemas.dye import Cells, DyeState, Tortuosity
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.parts import Colour
from nuno_schemas.pictures import Layers, Photograph, Picture, Window
from nuno_schemas.plugin import Config, Files
from nuno_schemas.vectors import turn

# A cloth from a photograph of woven cloth, by where warp and weft show (dye paper, section 4.3.1, b).
#
# Masks give the yarn that each pixel shows; or colours do, and a median filter removes single wrong pixels. Both layers
# are all fibre, without gaps. A cell is up in the layer that most of its pixels show.

MOST_PIXELS = 2**25
FORMATS = ["PNG", "JPEG"]
CLEAN_MOST = 31
NEAR = 0.02
"""Only noise distinguishes colours nearer than this."""


class Masks(Config):
    """Two grey PNGs of the photograph's size."""

    warp: str = Field(description="a PNG beside the scene, white where the photograph shows warp")
    weft: str = Field(
        description="a PNG beside the scene, white where it shows weft; pixels in neither join the nearer one"
    )


class Colours(Config):
    """Colours of warp and weft: a pixel shows the yarn with the nearer colour.

    Light of s times a colour has s^(1/3) times its L, a and b in OKLab, so a / L and b / L do not change with shade;
    they are compared, and L in the proportion `lightness`.
    """

    warp: Colour = Field(description="of the warp in the photograph, #rrggbb or a CSS name")
    weft: Colour = Field(description="of the weft in the photograph, #rrggbb or a CSS name")
    lightness: Share = Field(
        default=0.0, description="how much lightness counts, which shade changes too; yarns of one hue need some"
    )
    clean: Annotated[int, Field(ge=1, le=CLEAN_MOST)] = Field(
        default=5, description="side of the median filter that takes away specks, in pixels, odd; 1: none"
    )

    @field_validator("clean")
    @classmethod
    def _has_a_middle(cls, clean: int) -> int:
        if clean % 2 == 0:
            raise ValueError(f"a square of an even side has no middle pixel; write {clean - 1} or {clean + 1}")
        return clean


def read_photograph(path: Path) -> NDArray[np.uint8]:
    """Read a photograph (h, w, 3) sRGB, upright. Raises BadInput for other files, and for too many pixels."""
    with _open_photograph(path) as image:
        number = image.width * image.height
        if number <= MOST_PIXELS:
            return as_rgb(image)
    remedy = "scale the photograph"
    raise BadInput("too many pixels", file=str(path), value=number, limit=f"{MOST_PIXELS}", remedy=remedy)


@contextmanager
def _open_photograph(path: Path) -> Iterator[Any]:
    """Open a photograph. Raises BadInput for other files, and for any error of the decoder."""
    from PIL import Image

    try:
        with path.open("rb") as stream, Image.open(stream, formats=FORMATS) as image:
            yield image
    except Exception as error:  # a decoder may raise anything on a broken file
        raise BadInput(f"cannot be read as {' or '.join(FORMATS)}: {error}", file=str(path)) from None


def assign_rest(warp: Bool, weft: Bool, files: dict[str, str]) -> Bool:
    """Return the warp (h, w); pixels in neither mask join the nearer one. Raises BadInput for masks that overlap or are
    empty.
    """
    for name, mask in (("warp", warp), ("weft", weft)):
        if not mask.any():
            remedy = "paint white what shows this layer"
            raise BadInput("the mask is empty", file=files[name], field=name, remedy=remedy)
    both = np.argwhere(warp & weft)
    if len(both):
        y, x = both[0]
        raise BadInput(
            f"the masks overlap in {len(both)} pixels", file=files["weft"], field="weft",
            value=f"first at {x} to the right, {y} down", limit=f"none of {files['warp']}",
            remedy="paint a pixel white in one of them",
        )  # fmt: skip
    return _grow(warp, weft)


def _grow(warp: Bool, weft: Bool) -> Bool:
    """Grow both masks by a pixel at a time until they meet. Pixels that both reach at once are warp."""
    from PIL import Image, ImageFilter

    def wider(mask: Bool) -> Bool:
        return np.asarray(Image.fromarray(mask.astype(np.uint8)).filter(ImageFilter.MaxFilter(3))) > 0

    while not (warp | weft).all():
        unassigned = ~(warp | weft)
        warp, weft = warp | (unassigned & wider(warp)), weft | (unassigned & wider(weft) & ~wider(warp))
    return warp


def split_by_colour(colours: Colours, photograph: NDArray[np.uint8]) -> Bool:
    """Return where (h, w) warp's colour is nearer than weft's. Raises BadInput if one of them is nowhere."""
    from PIL import Image, ImageFilter

    features = _features(to_linear(photograph / 255.0), colours.lightness)
    targets = [_features(parse_hex(text), colours.lightness) for text in (colours.warp, colours.weft)]
    if np.linalg.norm(targets[0] - targets[1]) < NEAR:
        raise BadInput(
            "warp and weft have one colour", field="weft", value=colours.weft, limit=f"{colours.warp} is the warp's",
            remedy="add lightness: 0.3 where one is brighter, or give masks",
        )  # fmt: skip
    warp, weft = (np.square(features - target).sum(axis=-1) for target in targets)
    is_warp = np.asarray(warp < weft)
    if colours.clean > 1:
        image = Image.fromarray(is_warp.astype(np.uint8) * 255)
        is_warp = np.asarray(image.filter(ImageFilter.MedianFilter(colours.clean))) > 127
    if is_warp.all() or not is_warp.any():
        name = "weft" if is_warp.all() else "warp"
        remedy = "take the colours of both from the photograph itself"
        raise BadInput(f"the photograph shows no {name}", field=name, value=getattr(colours, name), remedy=remedy)
    return is_warp


def _features(linear: Float, lightness: float) -> Float:
    """Return the features (..., 3) of linear light that do not change with shade, and scaled lightness."""
    lab = to_oklab(linear)
    level = np.maximum(lab[..., :1], 1e-3)
    return np.concatenate([lightness * level, lab[..., 1:] / level], axis=-1)


LMS = np.array(
    [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
     [0.0883024619, 0.2817188376, 0.6299787005]]
)  # fmt: skip
LAB = np.array(
    [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099],
     [0.0259040371, 0.7827717662, -0.8086757660]]
)  # fmt: skip


def to_oklab(linear: Float) -> Float:
    """Return OKLab (..., 3) of linear light: lightness, green to red, blue to yellow (Ottosson 2020)."""
    return np.asarray(turn(LAB, np.cbrt(turn(LMS, linear))))


def find_up(warp: Bool, pixels: int) -> Bool:
    """Return which layer (2, ny, nx) is up in cells of `pixels` x `pixels`: warp if at least half of these show it.
    Pixels at the right and below that fill no cell are left out.
    """
    ny, nx = warp.shape[0] // pixels, warp.shape[1] // pixels
    blocks: Any = warp[: ny * pixels, : nx * pixels].reshape(ny, pixels, nx, pixels)
    up = 2 * blocks.sum(axis=(1, 3)) >= pixels * pixels
    return np.stack([~up, up])


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
        with _open_photograph(files.resolve(config.file)) as image:  # reads its header alone
            return int(2 * (image.height // config.pixels) * (image.width // config.pixels))

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
            paths = {name: files.resolve(getattr(config.masks, name)) for name in ("warp", "weft")}
            of = ("photograph's", "pixels")
            shown = {name: read_image(path, light.shape[:2], of=of) >= 0.5 for name, path in paths.items()}
            return assign_rest(shown["warp"], shown["weft"], {name: str(path) for name, path in paths.items()})
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
