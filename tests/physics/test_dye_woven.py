"""Woven cells: the laws of the layout, for every weave."""

from __future__ import annotations

import numpy as np
import pytest

from nuno_dye.cloths.woven_cloth import (
    MOST_CELLS,
    VaryConfig,
    WovenConfig,
    YarnConfig,
    build_cells,
    lay_evenly,
    lay_measured,
)
from nuno_dye.drafts.weaves import draw_plain, draw_satin, draw_twill, read_matrix
from nuno_dye.laws.diffusivity import face_values
from nuno_schemas.dye import Tortuosity
from nuno_schemas.errors import BadInput

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
