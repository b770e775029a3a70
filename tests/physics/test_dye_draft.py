"""A draft drawn as weavers draw it: what it shows is the draft again, in its colours and proportions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pattern_files import Folder
from PIL import Image

from nuno.cli import main
from nuno_dye.cloths.woven_cloth import WovenCloth, WovenClothConfig
from nuno_dye.drafts.drawing import MARGIN, MARK
from nuno_dye.drafts.wif import read_wif
from nuno_schemas.errors import BadInput

ENDS, PICKS = 12, 10
SPACING = [0.05 if k % 4 else 0.1 for k in range(ENDS)]
RED, CREAM, GREEN = (150, 30, 40), (235, 225, 200), (40, 70, 60)
LOOM = f"""[WIF]
[WEAVING]
Shafts=4
Treadles=4
[COLOR PALETTE]
Range=0,255
[COLOR TABLE]
1=150,30,40
2=235,225,200
3=40,70,60
[WARP]
Threads={ENDS}
Units=centimeters
Spacing=0.05
[WEFT]
Threads={PICKS}
Units=centimeters
Spacing=0.08
Color=3
[WARP SPACING]
{"".join(f"{k + 1}={spacing}{chr(10)}" for k, spacing in enumerate(SPACING))}
[WARP COLORS]
{"".join(f"{k + 1}={1 + k // 2 % 2}{chr(10)}" for k in range(ENDS))}
[THREADING]
{"".join(f"{k + 1}={(k * k) % 4 + 1}{chr(10)}" for k in range(ENDS))}
"""
TREADLES = f"""[TIEUP]
1=1,2
2=2,3
3=3
4=1,4
[TREADLING]
{"".join(f"{k + 1}={(3 * k) % 4 + 1}{chr(10)}" for k in range(PICKS))}
"""
LIFTS = "[LIFTPLAN]\n" + "".join(f"{k + 1}={k % 3 + 1},4\n" for k in range(PICKS))
WARP = np.array([(RED, CREAM)[k // 2 % 2] for k in range(ENDS)])


def write(folder: Path, text: str) -> Path:
    path = folder / "a.wif"
    path.write_text(text)
    return path


def middles(start: int, pitches: np.ndarray) -> np.ndarray:
    """Pixels of the middles of yarns or squares that begin at `start`."""
    return np.floor(start + np.cumsum(pitches) - 0.5 * pitches).astype(int)


def pitch_of(pixel: float) -> int:
    """Pixels of the mean yarn, and so of a square beside the drawdown."""
    return round((sum(SPACING) + 0.08 * PICKS) / (ENDS + PICKS) * 0.01 / pixel)


@pytest.mark.parametrize("how", [TREADLES, LIFTS])
def test_the_drawdown_follows_from_the_marks_that_are_drawn_beside_it(how: str, tmp_path: Path) -> None:
    path = write(tmp_path, LOOM + how)
    drawn, draft = WovenCloth().draw_draft(path), read_wif(path)
    assert drawn.pixel is not None
    square = drawn.pixel and round(
        np.concatenate([0.01 * np.array(SPACING), np.full(PICKS, 8e-4)]).mean() / drawn.pixel
    )
    columns = middles(MARGIN, 0.01 * np.array(SPACING) / drawn.pixel)
    head = middles(MARGIN, np.full(4, square))
    below, beyond = MARGIN + 4 * square + square + 2 * (square // 2), MARGIN + 0.01 * sum(SPACING) / drawn.pixel
    rows = middles(below, np.full(PICKS, 8e-4 / drawn.pixel))
    right = middles(round(beyond) + square + 2 * (square // 2), np.full(4, square))
    marked = (drawn.picture == MARK).all(axis=2)
    threading, pressed = marked[np.ix_(head, columns)][::-1].T, marked[np.ix_(rows, right)]
    lifts = pressed if how is LIFTS else (pressed.astype(int) @ marked[np.ix_(head, right)][::-1].T.astype(int)) > 0
    woven = (lifts.astype(int) @ threading.T.astype(int)) > 0
    assert np.array_equal(woven, draft.drawdown) and woven.any() and not woven.all()
    assert marked[np.ix_(head, right)].any() == (how is TREADLES)
    shown = drawn.picture[np.ix_(rows, columns)].astype(int)
    expected = np.where(woven[..., None], WARP[None], np.array(GREEN))
    assert np.abs(shown - expected).max() <= 1


def test_yarns_of_a_drawdown_are_as_wide_as_they_are_apart(tmp_path: Path) -> None:
    """To a pixel, all along: where the warp changes its colour, every two ends. Without spacing there is no scale."""
    drawn = WovenCloth().draw_draft(write(tmp_path, LOOM + TREADLES))
    assert drawn.pixel is not None and drawn.facts["size"] == "7.5 mm x 8 mm"
    square = pitch_of(drawn.pixel)
    width = round(7.5e-3 / drawn.pixel)
    line = drawn.picture[MARGIN + 5 * square, MARGIN : MARGIN + width, 0]
    changes = np.flatnonzero(np.diff(line.astype(int))) + 1
    assert np.abs(changes - np.cumsum(SPACING)[1:-1:2] * 0.01 / drawn.pixel).max() <= 0.5 + 1e-9
    bare = WovenCloth().draw_draft(write(tmp_path, (LOOM + TREADLES).replace("Spacing=0.08\n", "")))
    assert bare.pixel is None and "no spacing" in bare.facts["size"]


def test_undyed_cloth_repeats_the_draft_s_colours_at_their_measure(tmp_path: Path) -> None:
    """In twice and a half as much cloth as the draft's 7.5 mm: where a place lies in it, modulo that."""
    write(tmp_path, LOOM + TREADLES)
    config = WovenClothConfig.model_validate({
        "cells": [375, 100], "cell_size": "0.05 mm", "weave": {"plugin": "wif", "file": "a.wif", "measured": True},
        "tau3": {"I": 1, "II": 1, "III": 1}})  # fmt: skip
    cells, _ = WovenCloth().build(config, Folder(tmp_path), 0, ["dye"])
    assert cells.ground is not None
    ends = np.cumsum(SPACING) * 10
    place = (np.arange(375) + 0.5) * 0.05 % 7.5
    expected = WARP[np.searchsorted(ends, place)] / 255
    assert np.array_equal(cells.ground[1], expected) and (cells.ground[0] == np.array(GREEN) / 255).all()


def test_nuno_weave_draws_a_draft_with_its_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write(tmp_path, LOOM + TREADLES), tmp_path / "out.png"
    assert main(["weave", str(path), "--png", str(out)]) == 0
    said = capsys.readouterr().out
    assert "7.5 mm x 8 mm" in said and str(out) in said
    drawn = WovenCloth().draw_draft(path)
    with Image.open(out) as image:
        picture = np.asarray(image)
    height = len(drawn.picture)
    assert np.array_equal(picture[:height], drawn.picture)
    # The bar of the strip is the longest dark run, and says 1, 2 or 5 times a power of ten of the drawdown's own scale.
    dark = (picture[height + 15, :, 0] < 100).astype(int)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], dark, [0]])))
    assert drawn.pixel is not None
    assert (edges[1::2] - edges[::2]).max() == pytest.approx(2e-3 / drawn.pixel, abs=1)
    assert main(["weave", str(tmp_path / "none.wif")]) == 2
    assert "no such file" in capsys.readouterr().err


def test_what_a_file_lacks_is_said_of_it(tmp_path: Path) -> None:
    text = (LOOM + TREADLES).replace("[COLOR TABLE]", "[COLOURS]").replace("5=1\n", "").replace("4=2\n", "4=3\n", 1)
    facts = WovenCloth().draw_draft(write(tmp_path, text)).facts
    assert facts["colours"].startswith("the file numbers those of warp and weft, but has no [COLOR TABLE]")
    assert not {"colours", "on no shaft"} & WovenCloth().draw_draft(write(tmp_path, LOOM + TREADLES)).facts.keys()
    threads = "".join(f"{k + 1}={(k * k) % 4 + 1}\n" for k in range(ENDS))
    without = LOOM.replace(threads, threads.replace("5=1\n", "5=0\n").replace("9=1\n", "9=0\n"))
    facts = WovenCloth().draw_draft(write(tmp_path, without + TREADLES)).facts
    assert facts["on no shaft"] == "2 ends, which never rise: 5, 9"


def test_yarns_are_measured_or_given_in_cells(tmp_path: Path) -> None:
    write(tmp_path, LOOM + TREADLES)
    config = {"cells": (20, 20), "cell_size": 1e-4, "tau3": {"I": 0.1, "II": 0.1, "III": 0.1},
              "weave": {"plugin": "wif", "file": "a.wif", "measured": True}, "warp": {"width": 3}}  # fmt: skip
    with pytest.raises(BadInput, match="as the file measures them") as refused:
        WovenCloth().build(WovenClothConfig.model_validate(config), Folder(tmp_path), 0, ["indigo"])
    assert refused.value.field == "warp.width"
