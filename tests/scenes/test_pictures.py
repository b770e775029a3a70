"""Pictures of shipped scenes, which the studio shows: all are there, small, and what their script makes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nuno.scene import shipped

FOLDER = shipped.folder() / "pictures"
SIZE, MOST, MOST_IN_ALL = (288, 216), 12_000, 600_000
"""Pixels, and bytes of each and of all."""
REFUSED = {"extreme/degenerate-triangles", "extreme/step-too-long"}
"""Scenes that are there to be refused, which no run has a picture of."""


def test_every_scene_that_runs_has_a_small_picture() -> None:
    paths = {path.relative_to(FOLDER).with_suffix("").as_posix(): path for path in FOLDER.rglob("*.webp")}
    assert paths.keys() == shipped.scenes().keys() - REFUSED
    sizes = {name: path.stat().st_size for name, path in paths.items()}
    assert max(sizes.values()) <= MOST and sum(sizes.values()) <= MOST_IN_ALL
    for path in paths.values():
        with Image.open(path) as picture:
            assert picture.size == SIZE and picture.format == "WEBP"


@pytest.mark.full
def test_a_picture_is_what_its_script_makes(tmp_path: Path) -> None:
    script = tmp_path / "make_pictures.py"
    script.write_text((shipped.folder() / "make_pictures.py").read_text())
    subprocess.run([sys.executable, str(script), "net"], check=True, cwd=tmp_path, capture_output=True)
    made, kept = (np.asarray(Image.open(folder / "net.webp"), np.float64) for folder in (tmp_path / "pictures", FOLDER))
    # Encoders of other versions, and other machines' last bits, may differ; another picture would by far more.
    assert np.abs(made - kept).mean() < 1.0
