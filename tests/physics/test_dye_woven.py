"""Woven cells and the cloth that a scene makes of them: weaves, layout, yarns, resist."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pattern_files import Folder, write_image
from pydantic import ValidationError

from nuno_dye.cloths.woven_cloth import (
    MOST_CELLS,
    VaryConfig,
    WovenCloth,
    WovenClothConfig,
    WovenConfig,
    YarnConfig,
    build_cells,
    lay_evenly,
    lay_measured,
)
from nuno_dye.laws.diffusivity import face_values
from nuno_dye.laws.isotherms import Langmuir
from nuno_dye.picture import YarnsPicture, YarnsPictureConfig
from nuno_dye.solvers.explicit import Explicit
from nuno_dye.weaving_drafts.weaves import draw_plain, draw_satin, draw_twill, find_satin_steps, read_matrix
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem, Tortuosity
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import Window


def longest_float(drawdown: np.ndarray) -> int:
    """Longest run of True along the picks of a repeat that goes on for ever."""
    longest = 0
    for end in np.tile(drawdown, (2, 1)).T:
        runs = "".join("x" if up else " " for up in end).split()
        longest = max([longest, *map(len, runs)])
    return longest


def test_plain_alternates_along_every_yarn() -> None:
    twice = np.tile(draw_plain(), (2, 2))
    assert (twice[1:] != twice[:-1]).all() and (twice[:, 1:] != twice[:, :-1]).all()


@pytest.mark.parametrize(("over", "under"), [(1, 2), (2, 1), (2, 2), (3, 1), (4, 3), (1, 1)])
def test_twill_floats_over_and_under_and_moves_by_one_pick(over: int, under: int) -> None:
    n = over + under
    for direction, to_the_right in (("right", -1), ("left", 1)):
        weave = draw_twill(over, under, direction)  # type: ignore[arg-type]
        assert weave.shape == (n, n)
        assert (weave.sum(axis=0) == over).all() and (weave.sum(axis=1) == over).all()
        assert longest_float(weave) == over and longest_float(~weave) == under
        # A step to the right is a step up for a right-hand twill: row 0 is on top.
        for end in range(n):
            assert np.array_equal(weave[:, (end + 1) % n], np.roll(weave[:, end], to_the_right))


@pytest.mark.parametrize("n", range(5, 24))
def test_satin_binds_every_end_once_and_no_two_side_by_side(n: int) -> None:
    assert find_satin_steps(n) == tuple(s for s in range(2, n - 1) if math.gcd(s, n) == 1)
    for step in find_satin_steps(n):
        sateen = draw_satin(n, step, "weft")
        assert (sateen.sum(axis=0) == 1).all() and (sateen.sum(axis=1) == 1).all()
        # No binding touches another, not even at a corner, also from repeat to repeat.
        around = sum(np.roll(sateen, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0))
        assert not (sateen & (np.asarray(around) > 0)).any()
        assert np.array_equal(draw_satin(n, step, "warp"), ~sateen)


@pytest.mark.parametrize(
    ("n", "step"), [(5, 1), (5, 4), (5, 0), (5, 5), (8, 2), (8, 4), (9, 6), (6, 5), (5, -2), (5, 7)]
)
def test_what_is_no_satin_is_refused_with_the_steps_that_are(n: int, step: int) -> None:
    with pytest.raises(BadInput) as refused:
        draw_satin(n, step)
    steps = find_satin_steps(n)
    assert refused.value.field == "step" and refused.value.value == step
    assert all(str(known) in str(refused.value.limit) for known in steps or ("none",))


def test_a_matrix_is_read_as_written() -> None:
    weave = read_matrix(["110", "011"])
    assert weave.dtype == np.bool_ and weave.tolist() == [[True, True, False], [False, True, True]]
    assert np.array_equal(weave, read_matrix([[1, 1, 0], [0, 1, 1]]))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([], "0 picks"),
        ([""], "0 ends"),
        (["10", "1"], r"rows\[1\].*\n.*1 entries\D*2 entries"),
        (["10", "1x"], r"rows\[1\]\[1\]"),
        ([[0, 2]], r"rows\[0\]\[1\]"),
        (["11", "11"], "warp is above the weft everywhere"),
        (["00"], "weft is above the warp everywhere"),
        (["01" * 10_000], "20000 ends"),
        ([range(5000)] * 5000, "5000 picks"),
    ],
)
def test_what_is_no_drawdown_is_refused(rows: list[str], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        read_matrix(rows)


TAU = Tortuosity(0.005, 0.005, 0.005, 1.0, 1.0, 0.47)
WEAVES = {
    "plain": draw_plain(),
    "twill": draw_twill(2, 1),
    "satin": draw_satin(5, 2),
    "matrix": read_matrix(["1100", "0110", "0011"]),
}
WIDTHS = [(8, 2), (4, 1), (6, 0), (1, 3)]


def woven(weave: str, width: int = 8, gap: int = 2, cells: tuple[int, int] = (90, 70), **more: object) -> WovenConfig:
    yarn = YarnConfig(width=width, gap=gap)
    return WovenConfig.model_validate({"cells": cells, "weft": yarn, "warp": yarn, **more})


@pytest.mark.parametrize("weave", WEAVES)
@pytest.mark.parametrize(("width", "gap"), WIDTHS)
def test_every_place_has_one_layer_up_and_the_weave_says_which(weave: str, width: int, gap: int) -> None:
    drawdown = WEAVES[weave]
    cells = build_cells(drawdown, woven(weave, width, gap), TAU, 0)
    assert np.array_equal(cells.up[0], ~cells.up[1])
    picks, ends = drawdown.shape
    pitch = width + gap
    for y, x in np.ndindex(70, 90):
        assert cells.up[1, y, x] == drawdown[y // pitch % picks, x // pitch % ends]


@pytest.mark.parametrize(("width", "gap"), WIDTHS)
def test_a_yarn_is_one_run_of_cells_and_gaps_lie_between_yarns_only(width: int, gap: int) -> None:
    pitch = width + gap
    cells = build_cells(WEAVES["plain"], woven("plain", width, gap, (7 * pitch, 5 * pitch)), TAU, 0)
    weft, warp = cells.fibre
    assert (weft == weft[:, :1]).all() and (warp == warp[:1]).all()
    for across, yarns in ((weft[:, 0], 5), (warp[0], 7)):
        edges = np.diff(across.astype(int), prepend=0, append=0)
        assert across.sum() == yarns * width and (~across).sum() == yarns * gap
        starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        if gap:
            assert (stops - starts == width).all() and (np.diff(starts) == pitch).all() and len(starts) == yarns
        else:
            assert (stops - starts).tolist() == [yarns * width]


@pytest.mark.parametrize("weave", WEAVES)
def test_the_cloth_turned_over_its_diagonal_has_its_layers_exchanged(weave: str) -> None:
    """The weft of a drawdown is the warp of its complement's transpose."""
    a, b = YarnConfig(width=8, gap=2, porosity=0.4), YarnConfig(width=5, gap=1, porosity=0.7, twist=0.6)
    one = build_cells(WEAVES[weave], WovenConfig(cells=(60, 40), weft=a, warp=b), TAU, 0)
    other = build_cells(~WEAVES[weave].T, WovenConfig(cells=(40, 60), weft=b, warp=a), TAU, 0)
    for name in ("fibre", "up", "porosity", "twist", "resist"):
        mine, turned = getattr(one, name), getattr(other, name)
        assert np.array_equal(mine, turned[::-1].transpose(0, 2, 1)), name
    mine_faces, turned_faces = face_values(one), face_values(other)
    assert np.array_equal(mine_faces.along, turned_faces.down[::-1].transpose(0, 2, 1))
    assert np.array_equal(mine_faces.across, turned_faces.across.T)


@pytest.mark.parametrize("weave", WEAVES)
def test_tau_2_acts_along_yarns_once_per_turn(weave: str) -> None:
    """A weft turns where the drawdown changes from end to end, and nowhere else."""
    drawdown = WEAVES[weave]
    cells = build_cells(drawdown, woven(weave, 8, 2, (10 * 20, 70)), TAU, 0)
    along = face_values(cells).along[0, :, :-1]
    for y in np.flatnonzero(cells.fibre[0, :, 0]):
        row = drawdown[y // 10 % drawdown.shape[0]][np.arange(20) % drawdown.shape[1]]
        turns = int((row[1:] != row[:-1]).sum())
        assert np.isclose(along[y], 0.5 * 0.47).sum() == turns
        assert np.isclose(along[y], 0.5).sum() == along.shape[1] - turns


def test_factors_are_one_per_yarn_in_their_range_and_the_seed_s() -> None:
    config = woven("plain", vary=VaryConfig(of=("P", "T")))
    cells = build_cells(WEAVES["plain"], config, TAU, 7)
    again, other = build_cells(WEAVES["plain"], config, TAU, 7), build_cells(WEAVES["plain"], config, TAU, 8)
    for name, nominal in (("porosity", 0.5), ("twist", 1.0)):
        values = getattr(cells, name)
        assert values.tobytes() == getattr(again, name).tobytes() != getattr(other, name).tobytes()
        weft, warp = values[0][:, 0], values[1][0]
        assert (values[0] == weft[:, None]).all() and (values[1] == warp).all()
        for across, fibre in ((weft, cells.fibre[0, :, 0]), (warp, cells.fibre[1, 0])):
            yarns = across[: len(across) // 10 * 10].reshape(-1, 10)
            inside = fibre[: len(across) // 10 * 10].reshape(-1, 10)
            assert all(len(set(y[i])) == 1 for y, i in zip(yarns, inside, strict=True))
            r = yarns[inside].reshape(-1, 8)[:, 0] / nominal
            assert len(set(r)) == len(r) and (r >= 0.5).all() and (r <= 1.0).all()
            assert (yarns[~inside] == (0.5 if name == "porosity" else 1.0)).all()
    assert not np.array_equal(cells.porosity / 0.5, cells.twist)
    assert not cells.resist.any()


def test_factors_are_uniform() -> None:
    """Mean 3/4 and variance 1/48 of 40,000 yarns, within four standard errors."""
    config = WovenConfig(cells=(40_000, 1), warp=YarnConfig(width=1, gap=0, resist=1.0), vary=VaryConfig(of=("B",)))
    r = build_cells(WEAVES["plain"], config, TAU, 3).resist[1, 0]
    assert abs(r.mean() - 0.75) < 4 * np.sqrt(1 / 48 / r.size)
    assert abs(r.var() - 1 / 48) < 4 * np.sqrt((1 / 1280 - 1 / 48**2) / r.size)


def test_more_wefts_leave_the_warps_as_they_are() -> None:
    vary = VaryConfig(of=("P",))
    short, tall = (
        build_cells(WEAVES["plain"], woven("plain", cells=(50, ny), vary=vary), TAU, 1).porosity for ny in (20, 90)
    )
    assert np.array_equal(short[1, 0], tall[1, 0]) and np.array_equal(short[0], tall[0, :20])


def test_a_gap_takes_its_layer_s_porosity_or_the_one_given() -> None:
    yarns = {"weft": YarnConfig(porosity=0.3), "warp": YarnConfig(porosity=0.6)}
    for given, expected in ((None, (0.3, 0.6)), (1.0, (1.0, 1.0))):
        cells = build_cells(WEAVES["plain"], WovenConfig(**yarns, gap_porosity=given), TAU, 0)  # type: ignore[arg-type]
        for layer in range(2):
            assert (cells.porosity[layer][~cells.fibre[layer]] == expected[layer]).all()


def test_measured_yarns_are_even_yarns_where_they_are_even() -> None:
    measured = lay_measured(np.array([1e-3] * 3), np.array([0.8e-3] * 3), 1e-4, 97)
    even = lay_evenly(8, 2, 97)
    assert np.array_equal(measured.yarn, even.yarn) and np.array_equal(measured.fibre, even.fibre)


def test_measured_yarns_keep_their_pitch_and_width() -> None:
    lay = lay_measured(np.array([4e-4, 8e-4]), np.array([2e-4, 6e-4]), 1e-4, 24)
    assert lay.yarn.tolist() == [0] * 4 + [1] * 8 + [2] * 4 + [3] * 8
    assert "".join(".#"[int(f)] for f in lay.fibre) == 2 * (".##." + ".######.")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"cells": (65_536, 65_536)}, f"2 x 65536 x 65536.*\n.*{MOST_CELLS}"),
        ({"vary": {"low": 0.9, "high": 0.4}}, "vary.low.*\n.*0.9\n.*0.4"),
        ({"vary": {"of": ("B",)}}, "stays 0"),
    ],
)
def test_what_cannot_be_woven_is_refused(more: dict[str, object], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        build_cells(WEAVES["plain"], WovenConfig.model_validate(more), TAU, 0)


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
