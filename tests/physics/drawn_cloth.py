"""A woven cloth and its picture in one dye."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nuno.scene.files import SceneFiles
from nuno_dye.cloths.woven_cloth import WovenConfig, YarnConfig, build_cells
from nuno_dye.picture import TextureConfig, YarnsPicture, YarnsPictureConfig
from nuno_schemas.dye import Cells, Tortuosity
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import Picture, Window

INK = DyeColour(light="#ffffff", mid="#808080", dark="#000000", full=1.0)
BYTE = 0.5 + 0.5 / 65535 * 12.92 * 255
"""Half a byte, and half a step of the table of linear light where sRGB is steepest."""
FLAT = TextureConfig(depth=0, fibres=0, relief=0, bend=0, shadow=1, hole=1)
TAU = Tortuosity(1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def cloth(drawdown: np.ndarray, width: int = 8, gap: int = 2, nx: int = 60, ny: int = 40) -> Cells:
    yarn = YarnConfig(width=width, gap=gap)
    return build_cells(drawdown, WovenConfig(cells=(nx, ny), weft=yarn, warp=yarn), TAU, 0)


def whole(cells: Cells) -> Window:
    return Window(0, cells.fibre.shape[1], 0, cells.fibre.shape[2])


def draw_cloth(
    cells: Cells, amounts: Float, scale: int = 1, texture: TextureConfig | None = None, window: Window | None = None
) -> Picture:
    """A picture of one dye, black on white."""
    config, plugin = YarnsPictureConfig(texture=texture or TextureConfig()), YarnsPicture()
    return plugin.draw(plugin.prepare(config, SceneFiles(Path()), cells, [INK], window or whole(cells), scale), amounts)


def by_layer(cells: Cells) -> Float:
    """(1, 2, ny, nx) black weft, white warp."""
    amounts = np.zeros((1, *cells.fibre.shape))
    amounts[0, 0] = 1.0
    return amounts


def spots(cells: Cells) -> Float:
    """(1, 2, ny, nx) amounts at random."""
    return np.random.default_rng(1).random((1, *cells.fibre.shape))
