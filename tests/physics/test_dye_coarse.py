"""The same cloth in fewer, larger cells: what lies where, what passes in all, and how far amounts are off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_runs import run
from pattern_files import Folder

from nuno_dye.cloths.woven_cloth import WovenCloth, WovenClothConfig
from nuno_dye.laws.diffusivity import face_values
from nuno_dye.laws.isotherms import Langmuir
from nuno_schemas.dye import Cells, Dye, DyeSystem
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

SCENES = Path(__file__).parents[2] / "scenes" / "dye"
TAU3 = {"I": 0.05, "II": 0.02, "III": 0.03, "V": 0.5}
WIDE = {"weft": {"width": 16, "gap": 4}, "warp": {"width": 16, "gap": 4}}


def build(coarser: int, cells: int = 200, **fields: Any) -> Cells:
    given = {"cells": [cells, cells], "coarser": coarser, "tau2": 0.47, "tau3": TAU3} | fields
    return WovenCloth().build(WovenClothConfig.model_validate(given), Folder(SCENES), 3, ["dye"])[0]


def means(values: Float, side: int) -> Float:
    """Over squares of so many cells, whole ones only."""
    ny, nx = (n // side for n in values.shape[-2:])
    return values[..., : ny * side, : nx * side].reshape(*values.shape[:-2], ny, side, nx, side).mean(axis=(-3, -1))


@pytest.mark.parametrize("times", [2, 4])
def test_yarns_lie_where_they_lay_and_hinder_dye_as_much(times: int) -> None:
    """The way's resistance over whole pitches, across yarns and along them, and what passes between layers per area."""
    fine, coarse = build(1, **WIDE), build(times, **WIDE)
    assert coarse.size == times * fine.size and coarse.fibre.shape == (2, 200 // times, 200 // times)
    assert np.array_equal(coarse.fibre, fine.fibre[:, times // 2 :: times, times // 2 :: times])
    assert np.array_equal(coarse.up, fine.up[:, times // 2 :: times, times // 2 :: times])
    faces, large = face_values(fine), face_values(coarse)
    row = 5 * 20 + 8 + times // 2
    for layer in (0, 1):
        for one, other in ((faces.along[layer], large.along[layer]), (faces.down[layer].T, large.down[layer].T)):
            given, found = one[row, 20:180], other[row // times, 20 // times : 180 // times]
            assert times * (1.0 / found).sum() == pytest.approx((1.0 / given).sum(), rel=1e-12)
            assert len(np.unique(given)) > 1
    assert np.allclose(large.across, times**2 * faces.across[times // 2 :: times, times // 2 :: times], rtol=1e-15)


@pytest.mark.parametrize(
    ("fields", "pitch", "most"),
    [
        (WIDE, 20, 0.004),
        ({"weft": {"width": 6, "gap": 0}, "warp": {"width": 6, "gap": 0}}, 6, 0.01),
        # Gaps of two cells around a crossing become one beside it: it lies half a larger cell off the drop.
        ({"weave": {"plugin": "wif", "file": "draft.wif", "measured": True}}, 10, 0.07),
    ],
)
def test_amounts_over_crossings_are_near_those_of_the_cells_as_given(
    fields: dict[str, Any], pitch: int, most: float
) -> None:
    """A drop on yarns of different porosity that fix it, half an hour on, in cells twice as large: of the largest."""
    found = []
    for times in (1, 2):
        cells = build(times, vary={"of": ["P"], "low": 0.7, "high": 1}, **fields)
        y, x = np.indices((200, 200)) + 0.5
        drop = means(np.where(np.hypot(x - 100, y - 100) <= 50, 0.9, 0.0), times)
        dye = Dye("dye", 1.93e-6 / 3600.0, 0.01 * cells.coarser**2, Langmuir().prepare(Langmuir.Config(K=20)))
        phi = drop * cells.mobile_room
        state, _ = run("explicit", DyeSystem(cells, (dye,)), phi, np.zeros_like(phi), 1800.0, 880 // times**2)
        found.append([means(amounts[0], pitch // times) for amounts in (state.phi + state.fixed, state.fixed)])
    for fine, coarse in zip(*found, strict=True):
        off = np.abs(fine - coarse) / fine.max()
        assert off.max() < most and np.sqrt(np.mean(off**2)) < 0.2 * most


def test_fibre_takes_dye_as_fast(tmp_path: Path) -> None:
    """In a bath that is kept up nothing spreads: each cell fixes what those do that it stands for."""
    from nuno.dye.run import DyeRun
    from nuno.scene import scene_file

    text = (SCENES / "draft.yaml").read_text().replace("stencil.png", str(SCENES / "stencil.png"))
    (tmp_path / "scene.yaml").write_text(text)
    bath = "[{kind: bath, maintained: true, amount: 0.5}]"
    common = ["dye.cloth.resist=[]", f"dye.cloth.supply={bath}", "dye.cloth.weave={plugin: twill}"]
    common += ["dye.cloth.vary=null", "dye.solver={plugin: explicit, dt: 2 s}", "duration=0.2 h"]
    fixed = []
    for times in (1, 2):
        overrides = [*common, f"dye.cloth.coarser={times}"]
        dyeing = DyeRun(scene_file.read(tmp_path / "scene.yaml", overrides), 1)
        dyeing.advance()
        fixed.append(np.unique(np.round(dyeing.state.fixed, 12)))
    assert np.array_equal(*fixed) and fixed[0][0] == 0.0 and fixed[0][-1] > 1e-3


def test_what_would_be_lost_between_cells_is_refused() -> None:
    for fields, words in (
        ({"weft": {"width": 8, "gap": 1}}, "1 cells, the narrowest"),
        ({"coarser": 3}, "2 cells, the"),
    ):
        with pytest.raises(BadInput, match=rf"(?s)coarser: a yarn or a gap is narrower.*{words}"):
            build(**{"coarser": 2} | fields)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="no cell is left"):
        build(8, cells=7, weft={"width": 8, "gap": 8}, warp={"width": 8, "gap": 8})
