"""The figures of the dye paper: what its text says of each holds, by criteria that are known for drawn cloths."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nuno.cli import parser_of
from nuno.scene import scene_file
from nuno_bench.gallery import command as gallery
from nuno_bench.gallery import dye as dye_gallery
from nuno_bench.gallery.dye import Dyed, contrast, dyed_share, follows, kept_near, mottle, rim, streaks
from nuno_bench.gallery.kind import ShownScene
from nuno_schemas.dye import Cells, Tortuosity
from nuno_schemas.errors import BadInput

SIZE, PITCH, SIDE = 5e-5, 10, 20


@pytest.fixture(scope="module")
def shown() -> dict[str, ShownScene]:
    return {name: dye_gallery.run_scene(path) for name, path in dye_gallery.scenes().items()}


@pytest.mark.full
def test_what_the_paper_says_of_each_figure_holds(shown: dict[str, ShownScene]) -> None:
    measured = {name: one.measured for name, one in shown.items()}
    found = {figure.number: figure.judge(measured) for figure in dye_gallery.FIGURES}
    assert len(found) == len(dye_gallery.FIGURES) and all(one.holds for one in found.values()), found


@pytest.mark.full
def test_each_run_keeps_its_dye(shown: dict[str, ShownScene]) -> None:
    assert all(one.measured[dye_gallery.BALANCE] < 1e-13 * 5000**0.5 and not one.failed for one in shown.values())


@pytest.mark.full
def test_sweeps_show_where_a_sentence_holds_and_where_it_does_not() -> None:
    """After all steps the readings that are shipped hold, and those that are printed do not."""
    for sweep, steps in ((dye_gallery.sweep_mottle, "5,000"), (dye_gallery.sweep_isotherms, "50,000")):
        table = sweep()
        column = table.headings.index("steps")
        found = {row[0]: row[-1] for row in table.rows if row[column] == steps}
        assert {word for says, word in found.items() if "shipped" in says} == {"yes"}, found
        assert {word for says, word in found.items() if says.startswith((dye_gallery.PRINTED, "D0 P T"))} == {"no"}, (
            found
        )


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


def test_what_stays_near_and_what_is_dyed_are_those_of_a_drawn_disc() -> None:
    y, x = np.mgrid[0:200, 0:200] - 99.5
    disc = np.where(np.hypot(x, y) <= 60.0, 0.1, 0.0)
    assert kept_near(cloth(disc)) == pytest.approx(0.25, rel=5e-3)  # a radius of 30 cells of 60
    assert dyed_share(cloth(disc)) == pytest.approx(np.pi * 0.09, rel=5e-3)
    assert rim(cloth(disc)) == 0.0 and rim(cloth(np.where(x > 0.0, disc, 0.1))) == 0.1


def test_contrast_is_that_of_the_layers_and_follows_finds_the_weave() -> None:
    """Dye of the weft alone right and left of the drop, of the warp alone above and below it."""
    y, x = np.mgrid[0:200, 0:200] - 99.5
    fade = np.exp(-np.hypot(x, y) / 40.0)
    weft = np.where(np.abs(x) > np.abs(y), 5.0, 3.0) * fade
    for name in dye_gallery.WEAVES:
        cells = dye_gallery.undyed(name)
        dyed = Dyed(cells, np.stack([weft, 8.0 * fade - weft]), np.zeros((2, 200, 200)), PITCH)
        assert contrast(dyed) == pytest.approx(0.25, rel=0.1)  # less on the diagonals, which halve crossings
        fits = {other: follows(dyed, dye_gallery.undyed(other)) for other in dye_gallery.WEAVES}
        assert max(fits, key=lambda other: fits[other]) == name and fits[name] > 0.5 > 2.0 * sorted(fits.values())[1]


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


@pytest.mark.full
def test_the_page_holds_every_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module, parser = parser_of("gallery")
    assert module is gallery
    assert gallery.gallery_command(parser.parse_args(["dye", "--scenes", "fig8a,fig8c", "--out", str(tmp_path)])) == 0
    text = (tmp_path / "dye.html").read_text()
    assert text.count("data:image/png;base64,") == 2 and "the layers differ" in text
    assert capsys.readouterr().out.count("reproduced") == 2


def test_a_name_that_is_no_figure_is_answered_with_one_that_is() -> None:
    with pytest.raises(BadInput, match="fig8g"):
        gallery.choose(dye_gallery.KIND, "fig8")
