"""The figures of the dye paper as scenes: each difference that its text describes shows, by a fifth at least."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nuno.cli import parser_of
from nuno.scene import scene_file
from nuno_bench.gallery import command as gallery
from nuno_bench.gallery import dye as dye_gallery
from nuno_bench.gallery.dye import Dyed, mottle, spread_radius, streaks
from nuno_bench.gallery.kind import ShownScene, compare
from nuno_schemas.dye import Cells, Tortuosity
from nuno_schemas.errors import BadInput

COMPARED = (
    *("fig8a", "fig8b", "fig8d", "fig8e-text", "fig8f-text", "fig8g-text"),
    *("fig9a", "fig9b", "fig9c", "fig10a", "fig10b", "fig10c"),
)
SIZE, PITCH, SIDE = 5e-5, 10, 20


@pytest.fixture(scope="module")
def shown() -> dict[str, ShownScene]:
    return {name: dye_gallery.run_scene(dye_gallery.scenes()[name]) for name in COMPARED}


@pytest.mark.full
def test_what_the_paper_describes_shows(shown: dict[str, ShownScene]) -> None:
    rows = compare(dye_gallery.DIFFERENCES, shown)
    assert len(rows) == 13
    assert [row[-1] for row in rows] == ["bar met"] * 13, rows


@pytest.mark.full
def test_each_run_keeps_its_dye(shown: dict[str, ShownScene]) -> None:
    assert all(one.measured[dye_gallery.BALANCE] < 1e-13 * 5000**0.5 and not one.failed for one in shown.values())


@pytest.mark.full
def test_a_weave_that_is_not_there_is_not_seen(shown: dict[str, ShownScene]) -> None:
    """A drop on cloth that hardly hinders it is not mottled."""
    assert shown["fig8a"].measured[dye_gallery.MOTTLE] < 0.01


def test_every_figure_is_a_scene_of_its_name() -> None:
    for name, path in dye_gallery.scenes().items():
        assert scene_file.read(path).scene.name == name and dye_gallery.figure_of(name) >= 8


def test_scenes_stand_in_the_paper_s_order_however_they_are_named() -> None:
    assert [path.stem for path in gallery.choose(dye_gallery.KIND, "fig10a,fig9b,fig8g-text")] == [
        "fig8g-text",
        "fig9b",
        "fig10a",
    ]


def cloth(amount: np.ndarray) -> Dyed:
    """A cloth of mobile dye (ny, nx) in both layers, all fibre, the weft above everywhere."""
    one, shape = Tortuosity(1.0, 1.0, 1.0, 1.0, 1.0, 1.0), (2, *amount.shape)
    up = np.stack([np.ones(amount.shape, bool), np.zeros(amount.shape, bool)])
    half = np.full(shape, 0.5)
    cells = Cells(np.ones(shape, bool), up, half, np.ones(shape), np.zeros(shape), SIZE, one)
    return Dyed(cells, np.stack([amount, amount]), np.zeros(shape), PITCH)


def test_the_spread_of_a_gaussian_is_that_of_both_its_axes() -> None:
    y, x = np.mgrid[0:200, 0:200] - 99.5
    assert spread_radius(cloth(np.exp(-(x * x + y * y) / 800.0))) == pytest.approx(20.0 * 2.0**0.5 * SIZE, rel=1e-4)


def test_streaks_and_mottle_are_those_that_were_drawn() -> None:
    """Of crossings that differ by a twentieth up and down: by yarns all across, by a chequer board alike."""
    weft, warp = np.mgrid[0:SIDE, 0:SIDE] % 2 * 0.1 - 0.05
    noise = 1e-3 * np.random.default_rng(0).standard_normal((SIDE, SIDE))
    block = np.ones((PITCH, PITCH))
    striped, chequered = (np.kron(1.0 + values, block) for values in (weft + noise, 20.0 * weft * warp))
    assert streaks(cloth(striped)) > 30.0
    assert streaks(cloth(chequered)) == pytest.approx(1.0)
    # The mean of 3 x 3 crossings keeps a ninth of a chequer's own sign.
    assert mottle(cloth(chequered)) == pytest.approx(0.05 * 8.0 / 9.0, rel=1e-6)


def test_the_page_holds_every_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module, parser = parser_of("gallery")
    assert module is gallery
    assert gallery.gallery_command(parser.parse_args(["dye", "--scenes", "fig8a,fig8d", "--out", str(tmp_path)])) == 0
    text = (tmp_path / "dye.html").read_text()
    assert text.count("data:image/png;base64,") == 2 and "bar met" in text
    assert "cloth is mottled" in capsys.readouterr().out


def test_a_name_that_is_no_figure_is_answered_with_one_that_is() -> None:
    with pytest.raises(BadInput, match="fig8a"):
        gallery.choose(dye_gallery.KIND, "fig8")
