"""Pictures in the viewer: cloth in the middle, coloured, on a plain background; dyed cloth whole and upright."""

from __future__ import annotations

import io
import os
import time
from pathlib import Path

import numpy as np
import pytest
from dye_scene import arrays, write_scene
from numpy.typing import NDArray
from PIL import Image
from viewer_run import messages

import nuno
from nuno.bus.sessions import free_port
from nuno.cli import main
from nuno.viewer.fields import BACKGROUND
from nuno.viewer.file import RerunFile
from nuno.viewer.stream import Subject
from nuno_schemas.scene import View

DRIVERS = [Path(folder) for folder in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")]
pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(
        not any(list(folder.glob("*.json")) for folder in DRIVERS if folder.is_dir()),
        reason="needs a Vulkan driver, in software too (Debian: mesa-vulkan-drivers)",
    ),
]
SOON = 60.0


def write_sheet(path: Path, view: View) -> Path:
    """Write a file of a waving sheet, in which the tab that the view asks for is seen."""
    file = RerunFile(path, Subject(run="run", view=view))
    for message in messages(31):
        file.feed(*message)
    return file.finish()


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> NDArray[np.int64]:
    """The cloth's own look at half a second, (height, width, 3)."""
    return look(write_sheet(tmp_path_factory.mktemp("look") / "run.rrd", View()), 0.5, "Cloth")


def look(path: Path, t: float, view: str, timeline: str = "sim_time") -> NDArray[np.int64]:
    """A rerun file's view of a name at t [s] of a timeline, (height, width, 3)."""
    import rerun_cli
    from rerun.experimental import ViewerClient

    binary = os.path.join(rerun_cli.__path__[0], "rerun")
    with ViewerClient.spawn(headless=True, port=free_port(), executable_path=binary) as client:
        client.open(str(path))
        end = time.monotonic() + SOON
        while not (views := [v.view_id for v in client.get_state().views if v.name == view]):
            assert time.monotonic() < end
            time.sleep(0.1)
        client.set_time(timeline, duration=t, play_state="paused")
        previous = b""
        # The first pictures may come before all is loaded: two equal ones say that nothing moves.
        while True:
            png = client.take_screenshot(view_id=views[0])
            if png == previous and len(np.unique(pixels(png).reshape(-1, 3), axis=0)) > 100:
                break
            assert time.monotonic() < end
            previous = png
            time.sleep(0.3)
    return pixels(png)


def pixels(png: bytes) -> NDArray[np.int64]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.int64)


def test_the_corner_of_the_sky_has_the_background_colour(picture: NDArray[np.int64]) -> None:
    assert np.abs(picture[40, 40] - BACKGROUND).max() <= 2


def test_cloth_stands_whole_in_the_middle(picture: NDArray[np.int64]) -> None:
    """Cloth is the only thing with a saturated colour."""
    cloth = picture.max(axis=2) - picture.min(axis=2) > 40
    rows, columns = np.nonzero(cloth)
    height, width = cloth.shape
    assert cloth.mean() > 0.05
    assert rows.min() > 0.03 * height
    assert rows.max() < 0.97 * height
    assert columns.min() > 0.03 * width
    assert columns.max() < 0.97 * width
    assert abs(columns.mean() - 0.5 * width) < 0.2 * width


def test_the_view_of_stretch_shows_its_range(tmp_path: Path) -> None:
    """Pale where the sheet is not stretched, and red where it is: no colour of its own is mixed in."""
    shown = look(write_sheet(tmp_path / "run.rrd", View(colour="stretch")), 0.5, "Stretch")
    red, green, blue = np.moveaxis(shown, 2, 0)
    assert (red > blue + 120).sum() > 200
    assert ((red > blue + 8) & (red < blue + 60) & (red >= green) & (green >= blue)).sum() > 200
    assert ((blue > red + 40) & (blue > 100)).sum() == 0


def test_the_picture_is_whole_and_dye_is_where_it_was_given(tmp_path: Path) -> None:
    """A drop in the upper left corner, which blocked faces keep there."""
    data = arrays(60, 80)
    data["phi"], data["resist"] = np.zeros_like(data["phi"]), np.zeros_like(data["resist"])
    data["fibre"] = np.ones_like(data["fibre"])
    cloth = {
        "plugin": "cells", "file": "cells.npz", "cell_size": "0.05 mm",
        "tau3": {"I": 0, "II": 0, "III": 0, "IV": 0, "V": 0},
        "supply": [{"kind": "drop", "place": ["1 mm", "0.75 mm"], "diameter": "1 mm"}],
    }  # fmt: skip
    colour = {"light": "#ffffff", "mid": "#ff4040", "dark": "#e00000", "full": 0.1}
    dyes = [{"name": "red", "D0": "1.93 mm^2/h", "colour": colour}]
    scene = write_scene(tmp_path, data=data, cloth=cloth, dyes=dyes, picture={"texture": None})
    path = nuno.run(scene, record=tmp_path / "run.mcap").path
    assert main(["export", str(path), "--rrd", str(tmp_path / "run.rrd")]) == 0
    picture = look(tmp_path / "run.rrd", 18.0, "Cloth", "dye_time")
    height, width, _ = picture.shape
    red = picture[..., 0] - picture[..., 1:].max(axis=2) > 100
    white = picture.min(axis=2) > 250
    rows, columns = np.nonzero(white | red)
    shown = columns.max() + 1 - columns.min(), rows.max() + 1 - rows.min()
    assert shown[0] / shown[1] == pytest.approx(80 / 60, rel=0.02), "cut, or not in proportion"
    assert max(shown[0] / width, shown[1] / height) > 0.9
    y, x = (place.mean() for place in np.nonzero(red))
    assert (x - columns.min()) / shown[0] == pytest.approx(1 / 4, abs=0.02)
    assert (y - rows.min()) / shown[1] == pytest.approx(0.75 / 3, abs=0.02)
