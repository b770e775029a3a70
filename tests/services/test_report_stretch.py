"""The report's stretch: the largest since the frame in which it first ceased to fall; that of the start apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import write_scene

import nuno


@pytest.mark.parametrize(("name", "drawn", "fields"), [
    ("relaxes", 1.3, {"gravity": [0, 0, 0], "damping": 200.0}),
    ("relaxes, then falls and is drawn out", 1.3, {"damping": {"first": 200.0, "over": "0.2 s", "last": 0.0}}),
    ("is drawn out from the start", 1.0, {}),
])  # fmt: skip
def test_frames_in_which_cloth_relaxes_are_left_out(
    name: str, drawn: float, fields: dict[str, Any], tmp_path: Path
) -> None:
    scene = write_scene(tmp_path, **fields)
    with np.load(tmp_path / "chain.npz") as chain:
        np.savez(tmp_path / "chain.npz", **dict(chain) | {"x": drawn * chain["x"]})
    result = nuno.run(scene, record=tmp_path / "run.mcap")
    with result.recording as recording:
        every = recording.series()["stretch"]
    rises = np.flatnonzero(~(np.diff(every) <= 0.0)) + 1
    counted = every[rises[0] :] if len(rises) else every[-1:]
    assert result.report["start_stretch"] == every[0] == pytest.approx(drawn - 1.0)
    assert result.report["stretch"] == counted.max()
    assert (name == "relaxes") == (len(rises) == 0) and (drawn == 1.0) == (counted.max() == every.max())
