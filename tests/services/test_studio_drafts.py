"""Weaves drawn on the page of `nuno studio`: saved as drafts, opened again, refused, and woven."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studio_desk import FILE, ask

from nuno.cli import main
from nuno.dye.run import build_cloth
from nuno.scene import shipped
from nuno.studio import scenes
from nuno.studio.desk import Desk
from nuno_dye.weaving_drafts.wif import read_wif
from nuno_schemas.errors import BadInput

ROWS = ["1100", "0110", "0011", "1001", "1111"]
DROPS = "drops.yaml"


@pytest.fixture(autouse=True)
def empty(desk: Desk) -> None:
    """The desk's folder."""
    Path(FILE).unlink()


def save(desk: Desk, rows: object = ROWS, name: object = "mine", **more: object) -> dict[str, Any]:
    return ask(desk, "save_draft", rows=rows, name=name, **more)


def drawdown(rows: list[str]) -> list[list[bool]]:
    return [[up == "1" for up in row] for row in rows]


def test_a_drawn_weave_is_the_draft_that_is_read(desk: Desk, capfd: pytest.CaptureFixture[str]) -> None:
    told = save(desk)
    assert (told["file"], told["kind"], told["mistakes"]) == ("mine.wif", "draft", [])
    assert read_wif(Path("mine.wif")).drawdown.tolist() == drawdown(ROWS)
    assert ask(desk, "drawdown", file="mine.wif") == {"rows": ROWS, "text": told["text"]}
    assert main(["weave", "mine.wif"]) == 0
    assert capfd.readouterr().out.split()[:5] == ["mine.wif", "ends", "4", "picks", "5"]


@pytest.mark.parametrize("seed", range(8))
def test_any_size_that_can_be_drawn_is_saved(desk: Desk, seed: int) -> None:
    rng = np.random.default_rng(seed)
    picks, ends = (100, 100) if seed == 0 else rng.integers(2, 101, 2).tolist()
    rows = ["".join(map(str, row)) for row in rng.integers(0, 2, (picks, ends)).tolist()]
    save(desk, rows, f"w{seed}.wif")
    assert ask(desk, "drawdown", file=f"w{seed}.wif")["rows"] == rows


@pytest.mark.parametrize(
    ("rows", "field"),
    [
        (["10", "01"] * 51, "rows"),
        (["10" * 51, "01" * 51], "rows"),
        (["1" * 101, "0"], "rows"),
        ([], "rows"),
        ([""], "rows"),
        (["10", "0"], "rows[1]"),
        (["10", "02"], "rows[1][1]"),
        (["10", "0\n"], "rows[1][1]"),
        (["11", "11"], "rows"),
        (["0"], "rows"),
        ("10", "rows"),
        ([[1, 0], [0, 1]], "rows"),
        (None, "rows"),
    ],
)
def test_what_is_no_weave_is_refused_and_nothing_written(desk: Desk, rows: object, field: str) -> None:
    with pytest.raises(BadInput) as error:
        save(desk, rows)
    assert error.value.field == field and error.value.limit
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("name", ["", None, 3, "mine.yaml", "../mine.wif", ".wif", "a/b.wif", "-x.wif", "w" * 200])
def test_names_are_those_of_files_in_the_folder(desk: Desk, name: object) -> None:
    with pytest.raises(BadInput) as error:
        save(desk, name=name)
    assert error.value.field == "name" and error.value.limit
    assert list(Path().iterdir()) == []


def test_a_draft_is_saved_over_only_by_whoever_has_it_as_it_is(desk: Desk) -> None:
    first = save(desk)["text"]
    with pytest.raises(BadInput, match="there already"):
        save(desk, ["10", "01"])
    other = save(desk, ["10", "01"], before=first)["text"]
    assert read_wif(Path("mine.wif")).drawdown.tolist() == [[True, False], [False, True]]
    with pytest.raises(BadInput, match="changed since"):
        save(desk, before=first)
    assert Path("mine.wif").read_text() == other


def test_a_draft_that_holds_more_than_its_weave_is_not_saved_over(desk: Desk) -> None:
    shutil.copyfile(shipped.folder() / "dye" / "draft.wif", "rosepath.wif")
    opened = ask(desk, "drawdown", file="rosepath.wif")
    assert opened["text"] is None and drawdown(opened["rows"]) == read_wif(Path("rosepath.wif")).drawdown.tolist()
    before = Path("rosepath.wif").read_bytes()
    with pytest.raises(BadInput, match="there already"):
        save(desk, opened["rows"], "rosepath.wif", before=opened["text"])
    assert Path("rosepath.wif").read_bytes() == before


def test_a_draft_too_large_to_draw_is_not_opened(desk: Desk) -> None:
    text = save(desk, ["10", "01"])["text"]
    ends = "".join(f"{end}={1 + end % 2}\n" for end in range(3, 102))
    longer = text.replace("[WARP]\nThreads=2", "[WARP]\nThreads=101").replace("2=2\n\n[TIEUP]", f"2=2\n{ends}\n[TIEUP]")
    Path("long.wif").write_text(longer)
    assert read_wif(Path("long.wif")).drawdown.shape == (2, 101)
    with pytest.raises(BadInput) as error:
        ask(desk, "drawdown", file="long.wif")
    assert error.value.value == "2 picks x 101 ends"


def test_a_saved_draft_is_the_weave_of_a_scene(desk: Desk) -> None:
    """Put into a scene as the page does, and woven by what is offered for drafts."""
    save(desk)
    text = shipped.find("dye/drops").read_text()
    Path(DROPS).write_text(text)
    weave = {"plugin": "wif", "file": "mine.wif"}
    answer = ask(desk, "change", scene=DROPS, text=text, path=["dye", "cloth", "weave"], value=weave)
    assert answer["mistakes"] == []
    up = build_cloth(scenes.load(answer["text"], Path(DROPS)))[0].up[1]
    width = 7  # yarn and gap, in cells
    assert np.array_equal(up[: 5 * width : width, : 4 * width : width], drawdown(ROWS))
    scene = ask(desk, "make", file="mine.wif", offer="weave", chosen={})["scene"]
    assert ask(desk, "open", scene=scene)["mistakes"] == []
