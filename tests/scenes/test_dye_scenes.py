"""The shipped scenes of dye that are no figures of the dye paper run, keep their dye, and can be drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nuno.bus.encodings import encode_arrays
from nuno.dye.painter import DyePainter
from nuno.dye.run import DyeRun
from nuno.scene import scene_file

NAMES = ("drops", "folded", "halo", "ikat", "photograph")
SCENES = [Path(__file__).parents[2] / "scenes" / "dye" / f"{name}.yaml" for name in NAMES]


@pytest.mark.quick(path=[path for path in SCENES if path.stem in ("drops", "folded", "photograph")])
@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_scene_of_dye_runs_and_shows_its_dye(path: Path) -> None:
    loaded = scene_file.read(path)
    dyeing, painter = DyeRun(loaded, 0), DyePainter(loaded)
    cells = dyeing.cells
    painter.prepare(cells, cells.size)
    frame = dyeing.advance()
    assert frame.report.status == "ok" and dyeing.balance(frame.report) < 1e-12
    state = dyeing.state
    assert state.phi.min() >= 0.0 and (state.phi.sum(axis=(1, 2, 3)) > 0.0).all()
    dyed, bare = (
        painter.draw(encode_arrays({name: np.float32(share * getattr(state, name)) for name in ("phi", "fixed")}))
        for share in (1.0, 0.0)
    )
    assert 0.01 < (dyed != bare).any(axis=2).mean() <= 1.0


@pytest.mark.full
def test_what_diffuses_faster_where_it_is_thin_keeps_a_core_and_sends_a_halo() -> None:
    """Of as much dye as the even drop beside it: more at its darkest, and more of it farther than twice the drop."""
    dyeing = DyeRun(scene_file.read(SCENES[NAMES.index("halo")]), 0)
    while not dyeing.finished:
        assert dyeing.advance().report.status == "ok"
    even, thinning = dyeing.state.phi.sum(axis=1)
    assert thinning.sum() == pytest.approx(even.sum(), rel=1e-12)
    assert thinning.max() > 1.2 * even.max()
    y, x = np.mgrid[0:130, 0:260]
    far_even, far_thinning = (
        amount[np.hypot(x - middle, y - 64.5) > 40].sum() / amount.sum()
        for amount, middle in ((even, 64.5), (thinning, 194.5))
    )
    assert far_thinning > 1.2 * far_even
