"""What the page on Python and the notebooks show runs, cell by cell, and what a notebook would show of it is there."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import matplotlib
import pytest
from doc_pages import ROOT, blocks

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What they write goes with the test, and plots need no screen."""
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")


def run_cell(source: str, found: dict[str, Any]) -> Any:
    """Run it as a notebook does; the value of its last line, if that is an expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), found)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), found)  # type: ignore[attr-defined]


def cells(notebook: Path, kind: str) -> list[str]:
    data = json.loads(notebook.read_text(encoding="utf-8"))
    assert (data["nbformat"], len({cell["id"] for cell in data["cells"]})) == (4, len(data["cells"]))
    assert not any(cell.get("outputs") for cell in data["cells"]), "outputs are for whoever runs it"
    return ["".join(cell["source"]) for cell in data["cells"] if cell["cell_type"] == kind]


def test_there_are_three() -> None:
    text = (ROOT / "docs" / "how-to" / "python.md").read_text()
    assert len(NOTEBOOKS) == 3 and all(f"notebooks/{path.name}" in text for path in NOTEBOOKS)


@pytest.mark.quick(notebook=[path for path in NOTEBOOKS if path.stem == "first-run"])
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(notebook: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first of its cells of code shows a picture, after three lines at most."""
    found: dict[str, Any] = {}
    shown = [run_cell(source, found) for source in cells(notebook, "code")]
    if notebook.stem == "first-run":
        assert len([line for line in cells(notebook, "code")[0].splitlines() if line]) <= 3
        assert "data:image/png;base64," in shown[0]._repr_html_()
        said = capsys.readouterr().out
        assert "rk4, dt" in said and "did you mean 'fabric'?" in said
    elif notebook.stem == "sweep":
        assert shown[0]._repr_html_().count("<img") == 4
        assert list(shown[-1]["state"]) == ["done", "refused"] and "stability limit" in shown[-1]["why"][1]
    else:
        assert shown[-2:] == [19, pytest.approx(0.4)] and {"gravity", "contact"} <= shown[2].keys()


@pytest.mark.full
def test_the_page_on_python_runs(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    found: dict[str, Any] = {}
    for block in blocks(ROOT / "docs" / "how-to" / "python.md", "python"):
        # Where the viewer in a notebook is not installed, that says so; the rest of the page is run.
        run_cell(block.replace("result.show()", "result.show"), found)
    assert found["longer"].t == pytest.approx(0.7) and (tmp_path / "run.glb").is_file()
    assert "did you mean 'duration'?" in capsys.readouterr().out
    assert list(found["found"].to_dataframe()["state"]) == ["done"] * 4
