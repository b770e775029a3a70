"""Pages of a paper's figures: verdicts follow from what was measured, and what is not reproduced must say why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import write_scene

from nuno.cli import main
from nuno_bench.gallery import command as gallery
from nuno_bench.gallery.kind import Figure, Finding, Gallery, Measures, ShownScene
from nuno_bench.report.page import Table

PICTURE = np.zeros((4, 6, 3), np.uint8)


def swept() -> Table:
    return Table(("radius [mm]", "value"), [["1", "0.5"]], "Smaller radii give less.")


@pytest.fixture
def use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Makes the galleries of two papers, of a scene each with a measured value, whose figure asks for more than 1."""

    def use(sweep: Callable[[], Table] | None = None, **values: float) -> None:
        def judge(measured: Measures) -> Finding:
            value = next(iter(measured.values()))["value"]
            return Finding(f"{value:g}", value > 1.0, "the hem is too stiff")

        for kind, value in values.items():
            path = write_scene(tmp_path).rename(tmp_path / f"{kind}-scene.yaml")

            def run_scene(path: Path, value: float = value) -> ShownScene:
                pictures = [("before", PICTURE), ("after", PICTURE), ("aside", PICTURE)]
                return ShownScene(path.stem, "A sheet.", pictures, {"value": value})

            figure = Figure("4", "It widens.", "more than 1", (path.stem,), judge, ("before", "after"), sweep=sweep)
            made = Gallery(kind, "Lead.", lambda path=path: {path.stem: path}, run_scene, "m", figures=(figure,),
                           alike=True)  # fmt: skip
            monkeypatch.setitem(gallery.KINDS, kind, made)

    return use


def show(folder: Path, *words: str) -> tuple[int, str]:
    code = main(["gallery", *words, "--out", str(folder)])
    return code, (folder / f"{words[0]}.html").read_text()


@pytest.mark.parametrize(("value", "sweep", "code"), [(2.0, None, 0), (0.5, swept, 0), (0.5, None, 1)])
def test_a_figure_that_is_not_reproduced_stands_by_its_sweep_alone(
    use: Callable[..., None], tmp_path: Path, value: float, sweep: Callable[[], Table] | None, code: int
) -> None:
    use(sweep, knit=value)
    found, text = show(tmp_path, "knit")
    word = "reproduced" if value > 1.0 else "not reproduced"
    assert found == code and text.count(f">{word}</td>") == 2 and text.count("data:image/png") == 2
    assert ("the hem is too stiff" in text) == (value < 1.0) and ("Smaller radii" in text) == (sweep is not None)


def test_a_picture_stands_under_the_first_of_its_figures(use: Callable[..., None], tmp_path: Path) -> None:
    use(knit=2.0)
    kind = gallery.KINDS["knit"]
    gallery.KINDS["knit"] = replace(kind, figures=(*kind.figures, replace(kind.figures[0], number="5", labels=())))
    _, text = show(tmp_path, "knit")
    first, second = text.split("<h2>Figure 4</h2>")[1].split("<h2>Figure 5</h2>")
    assert (first.count("data:image/png"), second.count("data:image/png")) == (2, 1)


def test_a_picture_stands_under_a_later_figure_that_names_it(use: Callable[..., None], tmp_path: Path) -> None:
    use(knit=2.0)
    kind = gallery.KINDS["knit"]
    gallery.KINDS["knit"] = replace(kind, figures=(replace(kind.figures[0], number="3", labels=()), *kind.figures))
    _, text = show(tmp_path, "knit")
    first, second = text.split("<h2>Figure 3</h2>")[1].split("<h2>Figure 4</h2>")
    assert (first.count("data:image/png"), second.count("data:image/png")) == (1, 2)


def test_all_papers_are_on_one_page(use: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use(swept, knit=2.0, dye=0.5)
    monkeypatch.setattr(gallery, "PAPERS", {"knit": "stocking", "dye": "dye"})
    code, text = show(tmp_path, "papers")
    assert code == 0 and text.count(">reproduced</td>") == 2 and text.count(">not reproduced</td>") == 2
    assert text.index("Stocking paper: Figure 4") < text.index("Dye paper: Figure 4")
    _, text = show(tmp_path, "papers", "--scenes", "dye-scene")
    assert ">reproduced</td>" not in text
    assert main(["gallery", "papers", "--scenes", "dye-scen"]) == 2
