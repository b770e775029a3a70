"""The woven cloth as a scene gives it: weave, yarns, resist and what is on it at the start."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pattern_files import write_image
from pydantic import ValidationError

from nuno_dye.cloths.woven_cloth import WovenCloth, WovenClothConfig
from nuno_dye.drafts.weaves import draw_plain, draw_satin, draw_twill
from nuno_dye.laws.isotherms import Langmuir
from nuno_dye.pictures.picture import YarnsPicture, YarnsPictureConfig
from nuno_dye.solvers.explicit import Explicit
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem
from nuno_schemas.dye_picture import Window
from nuno_schemas.errors import BadInput
from nuno_schemas.look import DyeColour

DROP = {"kind": "drop", "place": ["1 mm", "1 mm"], "diameter": "0.6 mm"}
WIF = """[WIF]
[WEAVING]
Shafts=2
[WARP]
Threads=2
Units=Centimeters
Spacing=0.05
Thickness=0.04
[WEFT]
Threads=2
Units=Centimeters
Spacing=0.04
[THREADING]
1=1
2=2
[LIFTPLAN]
1=1
2=2
"""


class Folder:
    """Files of one folder."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def resolve(self, name: str) -> Path:
        return self.root / name


def build(root: Path, dyes: int = 1, **scene: Any) -> tuple[Cells, DyeState]:
    given = {"cells": [40, 40], "tau2": 0.47, "tau3": {"I": 0.01, "II": 0.01, "III": 0.01}} | scene
    config = WovenClothConfig.model_validate(given)
    cloth = WovenCloth()
    cells, state = cloth.build(config, Folder(root), 3, [f"dye{k}" for k in range(dyes)])
    assert cloth.count(config, Folder(root)) == cells.fibre.size
    assert state.phi.shape == state.fixed.shape == (dyes, *cells.fibre.shape)
    assert not state.phi.any() and not state.fixed.any()
    for one in cloth.supplies(config, cells, [f"dye{k}" for k in range(dyes)]):
        state.phi[one.dye][one.cells] = one.amount * cells.mobile_room[one.cells]
    return cells, state


def test_every_weave_is_chosen_by_name(tmp_path: Path) -> None:
    (tmp_path / "plain.wif").write_text(WIF)
    weaves = {
        "plain": ({}, draw_plain()),
        "twill": ({"over": 3, "under": 1, "direction": "left"}, draw_twill(3, 1, "left")),
        "satin": ({"ends": 8, "step": 3, "face": "weft"}, draw_satin(8, 3, "weft")),
        "matrix": ({"rows": ["10", [0, 1]]}, draw_plain()),
        "wif": ({"file": "plain.wif"}, draw_plain()),
    }
    for name, (settings, drawdown) in weaves.items():
        cells, _ = build(tmp_path, cells=[80, 80], weave={"plugin": name, **settings})
        n, m = drawdown.shape
        assert np.array_equal(cells.up[1][5 : 10 * n : 10, 5 : 10 * m : 10], drawdown), name


def test_the_documented_cloth_is_one(tmp_path: Path) -> None:
    page = Path(__file__).parents[2] / "docs" / "how-to" / "dye-cloth.md"
    cloth = yaml.safe_load(page.read_text().split("```yaml\n")[1].split("```")[0])["cloth"]
    assert cloth.pop("plugin") == WovenCloth.name
    write_image(tmp_path / "stencil.png", np.eye(200))
    cells, state = build(tmp_path, **cloth)
    assert np.array_equal(cells.resist[0], np.eye(200)) and state.phi.sum() > 0.0
    assert len(np.unique(cells.porosity[1][cells.fibre[1]])) == 20


def test_measured_yarns_of_a_file(tmp_path: Path) -> None:
    """At 0.05 mm a cell: warp 8 of 10 cells, weft 8 of 8, for the file states no thickness of it."""
    (tmp_path / "a.wif").write_text(WIF)
    cells, _ = build(tmp_path, weave={"plugin": "wif", "file": "a.wif", "measured": True})
    assert cells.fibre[0].all() and cells.fibre[1].mean() == 0.8
    assert np.array_equal(cells.up[1, ::8, ::10], np.tile(draw_plain(), (3, 2))[:5])
    with pytest.raises(BadInput, match=r"(?s)finer than a cell.*0.0004 m"):
        build(tmp_path, weave={"plugin": "wif", "file": "a.wif", "measured": True}, cell_size="0.41 mm")
    (tmp_path / "b.wif").write_text(WIF.replace("Spacing=0.04\n", ""))
    with pytest.raises(BadInput, match=r"\[WEFT\] Spacing"):
        build(tmp_path, weave={"plugin": "wif", "file": "b.wif", "measured": True})


def test_a_draft_says_how_large_its_cloth_is(tmp_path: Path) -> None:
    """Two ends 0.5 mm apart and two picks 0.4 mm apart; or, where yarns are so many cells wide, 10 cells each."""
    (tmp_path / "a.wif").write_text(WIF)
    for weave, shape in (({"measured": True}, (16, 20)), ({}, (20, 20))):
        cells, _ = build(tmp_path, cells=None, weave={"plugin": "wif", "file": "a.wif", **weave})
        assert cells.fibre.shape == (2, *shape)
        assert np.array_equal(np.unique(cells.yarns[0]), [0, 1]) and np.array_equal(np.unique(cells.yarns[1]), [0, 1])  # type: ignore[index]
    said, _ = build(tmp_path, cells=[50, 40], weave={"plugin": "wif", "file": "a.wif", "measured": True})
    assert said.fibre.shape == (2, 40, 50)
    other, _ = build(tmp_path, cells=None)
    assert other.fibre.shape == (2, 200, 200)


def test_undyed_yarns_have_the_colours_of_the_draft(tmp_path: Path) -> None:
    """The end of each colour, where it is up; the weft, of which the file says nothing, is white."""
    table = "[COLOR TABLE]\n1=255,0,0\n2=0,51,102\n[WARP COLORS]\n1=1\n2=2\n"
    (tmp_path / "a.wif").write_text(WIF + table)
    cells, state = build(tmp_path, cells=None, weave={"plugin": "wif", "file": "a.wif"})
    dye = DyeColour(light="#808080", mid="#404040", dark="#000000")

    def draw(amounts: np.ndarray, **config: Any) -> np.ndarray:
        look, plugin = YarnsPictureConfig(texture=None, **config), YarnsPicture()
        prepared = plugin.prepare(look, Folder(tmp_path), cells, [dye], Window(0, 20, 0, 20), 1)
        return plugin.draw(prepared, amounts)

    undyed = draw(state.phi)
    red, blue, white = [255, 0, 0], [0, 51, 102], [255, 255, 255]
    assert [undyed[5, 5].tolist(), undyed[15, 15].tolist()] == [red, blue] and cells.up[1, 5, 5] and cells.up[1, 15, 15]
    assert undyed[5, 15].tolist() == undyed[15, 5].tolist() == white
    assert (draw(np.ones_like(state.phi)) == 0).all(), "dye at its darkest covers any yarn"
    assert (draw(state.phi, ground="#336699")[5, 5] == [0x33, 0x66, 0x99]).all(), "the scene's own word counts first"


def test_resists_leave_the_product_of_their_room_and_drops_fill_it(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 2, (40, 40)) * 1.0
    write_image(tmp_path / "s.png", image)
    paste = {"kind": "paste", "points": [["1 mm", 0], ["1 mm", "2 mm"]], "width": "0.4 mm", "strength": 0.5}
    stencil = {"kind": "image", "file": "s.png"}
    cells, state = build(
        tmp_path, dyes=2, v_max=2.0, resist=[paste, stencil], supply=[DROP, {"kind": "bath", "dye": 1, "amount": 0.25}]
    )
    alone, _ = build(tmp_path, resist=[paste])
    assert set(np.unique(alone.resist)) == {0.0, 0.5}
    assert np.allclose(cells.resist, 1.0 - (1.0 - alone.resist) * (1.0 - image), atol=1e-15)
    assert np.array_equal(state.phi[1], 0.25 * cells.mobile_room)
    wet = np.hypot(*(np.indices((40, 40)) + 0.5 - 20.0)) <= 6.0
    assert np.array_equal(state.phi[0], cells.mobile_room * wet) and cells.mobile_room.max() == 1.0


def test_it_is_dyed_and_the_dye_is_kept(tmp_path: Path) -> None:
    """The paper's step, 200 of them: balance within rounding, dye along yarns first where tau 3 V alone is large."""
    cells, state = build(tmp_path, supply=[DROP])
    total = float(state.phi.sum())
    langmuir = Langmuir().prepare(Langmuir.Config.model_validate({"K": 2.0}))
    system = DyeSystem(cells, (Dye("blue", 1.93e-6 / 3600.0, 0.01, langmuir),))
    solver = Explicit()
    config = Explicit.Config()
    assert solver.limit(config, system) > 1.8
    report = solver.advance(system, state, solver.prepare(config, system, state), 200, 1.8)
    assert report.status == "ok" and state.fixed.sum() > 0.0
    assert abs(report.mobile[0] + report.fixed[0] - total) <= 1e-13 * np.sqrt(200) * total
    # Weft carries it along x, warp along y.
    spread = [(state.phi + state.fixed)[0, layer].sum(axis=axis) for layer, axis in ((0, 0), (0, 1), (1, 0), (1, 1))]
    place = (np.arange(40) + 0.5 - 20.0) ** 2
    along_x, along_y, across_x, across_y = (float(s @ place / s.sum()) for s in spread)
    assert along_x > 1.2 * along_y and across_y > 1.2 * across_x


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        ({"supply": [DROP | {"dye": 1}]}, r"(?s)supply\[0\].dye.*limit:  0 dye0"),
        ({"supply": [DROP, DROP | {"place": ["9 mm", 0]}]}, r"(?s)supply\[1\].place: the part holds no cell.*0.002 m"),
        (
            {"supply": [{"kind": "bath", "region": {"shape": "disc", "centre": [1, 1], "diameter": 1e-3}}]},
            r"(?s)supply\[0\].region: the part holds no cell",
        ),
        ({"weave": {"plugin": "satin", "ends": 6, "step": 2}}, "^weave.step: no satin on 6 ends"),
        ({"weave": {"plugin": "matrix", "rows": ["10", "1"]}}, r"^weave.rows\[1\]: rows differ"),
        ({"weave": {"plugin": "matrix", "rows": ["11", "11"]}}, "^weave.rows: the warp is above"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, scene: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput) as refused:
        build(tmp_path, **scene)
    assert re.search(said, str(refused.value))


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        ({"weave": {"plugin": "knit"}}, "knit"),
        ({"weft": {"porosity": 1.1}}, "porosity"),
        ({"warp": {"twist": -0.1}}, "twist"),
        ({"tau3": {"I": 2.0, "II": 1.0, "III": 1.0}}, "tau3.I"),
        ({"cells": [0, 40]}, "cells"),
    ],
)
def test_numbers_out_of_range_are_refused(tmp_path: Path, scene: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        build(tmp_path, **scene)


@pytest.mark.parametrize(("weave", "cells", "told"), [
    ({"plugin": "wif", "file": "draft.wif"}, [20, 20], None),
    ({"plugin": "wif", "file": "draft.wif"}, [200, 200], None),
    ({"plugin": "wif", "file": "draft.wif"}, None, None),
    ({"plugin": "wif", "file": "draft.wif"}, [10, 20], "1 of 2 ends and 2 of 2 picks"),
    ({"plugin": "wif", "file": "draft.wif", "measured": True}, [100, 40], "2 of 2 ends and 1 of 2 picks"),
    ({"plugin": "wif", "file": "draft.wif", "measured": True}, [100, 80], None),
    ({"plugin": "matrix", "rows": ["1010", "0101", "1100"]}, [400, 20], "4 of 4 ends and 2 of 3 picks"),
    ({"plugin": "satin", "ends": 64, "step": 5}, None, "20 of 64 ends and 20 of 64 picks"),
])  # fmt: skip
def test_what_cells_cut_off_is_told(tmp_path: Path, weave: dict[str, Any], cells: Any, told: str | None) -> None:
    """In even yarns of ten cells, and as measured, of 0.5 mm and 0.4 mm, in cells of 0.01 mm."""
    (tmp_path / "draft.wif").write_text(WIF)
    given = {"weave": weave, "cells": cells, "cell_size": 1e-5, "tau2": 0.47, "tau3": {"I": 0.1, "II": 0.1, "III": 0.1}}
    config = WovenClothConfig.model_validate(given)
    found = WovenCloth().left_out(config, Folder(tmp_path))  # type: ignore[arg-type]
    assert len(found) == (told is not None) and all(told is not None and told in text for text in found)
