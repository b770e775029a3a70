"""The shipped scenes of dye that are no figures of the dye paper run, keep their dye, and can be drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nuno import scene_file
from nuno.arrays import encode_arrays
from nuno.dye.run import DyeRun
from nuno.export.dyed import painter_of
from nuno_schemas.dye_picture import Layers

SCENES = [Path(__file__).parents[2] / "scenes" / "dye" / f"{name}.yaml" for name in ("drops", "photograph")]


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_scene_of_dye_runs_and_shows_its_dye(path: Path) -> None:
    loaded = scene_file.read(path)
    dyeing, painter = DyeRun(loaded, 0), painter_of(loaded)
    cells = dyeing.cells
    painter.prepare(Layers(cells.fibre, cells.up, cells.v_max, cells.yarns, cells.photograph), cells.size)
    frame = dyeing.advance()
    assert frame.report.status == "ok" and dyeing.balance(frame.report) < 1e-12
    state = dyeing.state
    assert state.phi.min() >= 0.0 and (state.phi.sum(axis=(1, 2, 3)) > 0.0).all()
    dyed, bare = (
        painter.draw(encode_arrays({name: np.float32(share * getattr(state, name)) for name in ("phi", "fixed")}))
        for share in (1.0, 0.0)
    )
    assert 0.01 < (dyed != bare).any(axis=2).mean() <= 1.0
