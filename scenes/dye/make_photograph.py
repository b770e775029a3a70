"""Make photograph.jpg, a photograph of cloth that never was: python scenes/dye/make_photograph.py

Unbleached warp and white weft in plain weave, of yarns that are not all as wide, under a lamp from the upper left,
through a lens that is not quite sharp onto a sensor with noise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from nuno_dye.cloths.woven_cloth import Layout, WovenConfig, build_cells, lay_measured
from nuno_dye.picture import TextureConfig, shade_window
from nuno_dye.weaving_drafts.weaves import draw_plain
from nuno_schemas.colour import parse_hex, to_srgb
from nuno_schemas.dye import Tortuosity
from nuno_schemas.pictures import Window

PATH = Path(__file__).with_name("photograph.jpg")
WIDTH, HEIGHT = 640, 480
WARP, WEFT = "#c9a878", "#efece6"
PITCH, UNEVEN = 13.0, 0.12
"""Of yarns, in pixels; and the standard deviation of their widths, as a share."""
NOISE = 0.012
TEXTURE = TextureConfig(depth=0.2, fibres=0.3, shadow=0.5, hole=0.25)


def lay(length: int, stream: np.random.Generator) -> Layout:
    """Yarns side by side over `length` pixels, which touch."""
    widths = PITCH * (1.0 + UNEVEN * np.clip(stream.standard_normal(length // 8), -2.5, 2.5))
    return lay_measured(widths, 0.93 * widths, 1.0, length)


def weave() -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Which layer shows at a pixel, and how bright it is: (480, 640)."""
    stream = np.random.default_rng(14)
    lays = lay(HEIGHT, stream), lay(WIDTH, stream)
    one = Tortuosity(1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    cells = build_cells(draw_plain(), WovenConfig(cells=(WIDTH, HEIGHT)), one, 0, lays)
    return shade_window(cells, Window(0, HEIGHT, 0, WIDTH), 1, TEXTURE)


def make_photograph() -> Image.Image:
    """The picture, 640 x 480."""
    stream = np.random.default_rng(15)
    layer, shade = weave()
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] / WIDTH
    lamp = 1.0 - 0.45 * np.hypot(x - 0.25, y - 0.15) ** 1.5
    light = np.where(layer[..., None] == 1, parse_hex(WARP), parse_hex(WEFT)) * (shade * lamp)[..., None]
    light += NOISE * stream.standard_normal(light.shape) * np.sqrt(light)
    image = Image.fromarray(np.rint(255.0 * to_srgb(light)).astype(np.uint8))
    return image.filter(ImageFilter.GaussianBlur(0.7))


if __name__ == "__main__":
    make_photograph().save(PATH, quality=88)
