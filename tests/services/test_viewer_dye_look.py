"""The dyed cloth in the viewer: the whole picture, large, upright."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dye_scene import arrays, write_scene
from test_viewer_look import look, pytestmark  # noqa: F401

import nuno
from nuno.cli import main


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
    picture = look(tmp_path / "run.rrd", 18.0, "2D", "dye_time")
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
