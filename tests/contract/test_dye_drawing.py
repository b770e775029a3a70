"""What every installed plugin that draws dyed cloth promises."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nuno.scene.files import SceneFiles
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.pictures import Layers, Photograph, Window

PLUGINS = sorted(entry_points(group="nuno.dye_pictures"), key=lambda entry: entry.name)
NY, NX = 24, 30


@pytest.fixture(params=PLUGINS, ids=lambda entry: entry.name)
def plugin(request: pytest.FixtureRequest) -> Any:
    found = request.param.load()()
    return found


def cloth() -> Layers:
    """Fibre and gaps, above and below, at random, and a photograph: any arrays are a cloth."""
    rng = np.random.default_rng(5)
    up = rng.random((NY, NX)) > 0.5
    photograph = Photograph(
        rng.integers(90, 255, (2 * NY, 2 * NX, 3), np.uint8), np.repeat(np.repeat(up, 2, axis=0), 2, axis=1)
    )
    return Layers(rng.random((2, NY, NX)) > 0.2, np.stack([~up, up]), photograph=photograph)


def amounts(dyes: int) -> np.ndarray:
    return np.random.default_rng(6).random((dyes, 2, NY, NX)).astype(np.float32) * 0.2


def colours(dyes: int) -> list[DyeColour]:
    return [DyeColour(), DyeColour(light="#f7eeee", mid="#d0605a", dark="#7a1518")][:dyes]


@pytest.mark.parametrize("scale", [1, 3, 8])
@pytest.mark.parametrize("dyes", [1, 2])
def test_a_picture_has_its_window_s_size_and_the_same_bytes_every_time(plugin: Any, scale: int, dyes: int) -> None:
    window, seen = Window(3, 20, 1, 30), amounts(dyes)
    prepared = plugin.prepare(plugin.Config(), SceneFiles(Path()), cloth(), colours(dyes), window, scale)
    first = plugin.draw(prepared, seen)
    assert first.shape == (17 * scale, 29 * scale, 3) and first.dtype == np.uint8
    plugin.draw(prepared, 0.0 * seen)
    assert np.array_equal(plugin.draw(prepared, seen), first)
    assert np.array_equal(seen, amounts(dyes))


def test_dye_shows_where_it_is_and_nowhere_else(plugin: Any) -> None:
    seen, window = np.zeros((1, 2, NY, NX)), Window(0, NY, 0, NX)
    prepared = plugin.prepare(plugin.Config(), SceneFiles(Path()), cloth(), colours(1), window, 4)
    bare = plugin.draw(prepared, seen).astype(int)
    seen[:, :, 8:16, 8:16] = 0.2
    changed = np.abs(plugin.draw(prepared, seen) - bare).max(axis=2) > 0
    near = np.zeros((NY * 4, NX * 4), bool)
    near[28:68, 28:68] = True
    assert not changed[~near].any()
    assert changed[32:64, 32:64].mean() > 0.9
