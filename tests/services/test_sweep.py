"""`nuno sweep` and `nuno.sweep`: a scene for each combination of values, in one table."""

from __future__ import annotations

import base64
import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from scenes import write_chain, write_scene

import nuno
from nuno.cli import main
from nuno_bench.sweep import grid
from nuno_bench.sweep.command import values_of
from nuno_schemas.errors import BadInput

CHAIN = {
    "nuno": 1,
    "name": "chain",
    "duration": 0.1,
    "frame_rate": 50,
    "solver": {"plugin": "symplectic_euler", "dt": "1 ms"},
    "objects": [{"name": "chain", "model": {"plugin": "net", "file": "chain.npz"}}],
}
OVER = {"solver.plugin": ["symplectic_euler", "rk4"], "solver.dt": [1e-3, "2 ms", 1.0]}


@pytest.fixture
def roots(tmp_path: Path) -> list[Path]:
    write_chain(tmp_path)
    return [tmp_path]


def test_each_combination_is_the_run_of_its_values(roots: list[Path]) -> None:
    """In order, the first field's values changing last; what is refused has a row that says why, and no picture."""
    found = nuno.sweep(CHAIN, OVER, roots=roots, jobs=1, side="front")
    pairs = [(one, step) for one in OVER["solver.plugin"] for step in OVER["solver.dt"]]
    assert [(row["solver.plugin"], row["solver.dt"]) for row in found.rows] == pairs
    for (solver, step), row in zip(pairs, found.rows, strict=True):
        if step == 1.0:
            assert row["state"] == "refused" and "solver.dt: " in row["why"] and "picture" not in row
            continue
        result = nuno.run(CHAIN, {"solver.plugin": solver, "solver.dt": step}, roots=roots)
        assert (row["state"], row["digest"], row["dt"]) == ("done", result.digest, result.report["dt"])
        with result.recording as recording:
            assert row["energy_kinetic"] == recording.series()["energy_kinetic"][-1]
        with Image.open(io.BytesIO(base64.b64decode(row["picture"]))) as image:
            assert image.size == grid.SIZE
    table = found.to_dataframe()
    assert list(table["state"]) == ["done", "done", "refused"] * 2 and "picture" not in table
    assert found._repr_html_().count("<img") == 4 and found._repr_html_().count("<tr>") == 7


def test_processes_find_the_same(roots: list[Path]) -> None:
    digests = [
        [row["digest"] for row in nuno.sweep(CHAIN, {"seed": [1, 2]}, roots=roots, jobs=jobs, side="").rows]
        for jobs in (1, 2)
    ]
    assert digests[0] == digests[1]


def test_an_interrupted_sweep_goes_on_where_it_was(roots: list[Path], tmp_path: Path) -> None:
    """What is done is not run again; another sweep's is not taken."""
    over, out, heard = {"duration": [0.04, 0.06, 0.08]}, tmp_path / "out", list[str]()

    def stop(text: str) -> None:
        heard.append(text)
        if len(heard) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, told=stop)
    found = nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, resume=True, told=heard.append)
    assert [text.partition(":")[0] for text in heard] == ["1 of 3", "2 of 3", "3 of 3"]
    assert [row["simulated_seconds"] for row in found.rows] == pytest.approx([0.04, 0.06, 0.08])
    with (out / "sweep.csv").open(newline="") as stream:
        assert [float(row["duration"]) for row in csv.DictReader(stream)] == [0.04, 0.06, 0.08]
    with pytest.raises(BadInput, match="another sweep"):
        nuno.sweep(CHAIN, over, "seed=3", roots=roots, jobs=1, out=out, resume=True)


def test_the_command_writes_a_page_and_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    sheet = ["sweep", "hanging-sheet", "--set", "duration=0.04", "--jobs", "1", "--over"]
    assert main([*sheet, "objects.0.model.fabric=denim, jacket"]) == 0
    assert "jacket" in capsys.readouterr().out
    (folder,) = (tmp_path / "recordings" / "sweep").iterdir()
    rows = json.loads((folder / "sweep.json").read_text())["rows"]
    assert [row["objects.0.model.fabric"] for row in rows] == ["denim", "jacket"]
    assert (folder / "sweep.html").read_text().count("<img") == 2
    assert main([*sheet, "solver.dt=9 s", "--side", "none"]) == 1
    assert "refused, solver.dt" in capsys.readouterr().err


def test_values_are_those_of_yaml() -> None:
    assert values_of("a.b=1 ms, 2,[0, 1, 0],{plugin: rk4}, x") == (
        "a.b", ["1 ms", 2, [0, 1, 0], {"plugin": "rk4"}, "x"]
    )  # fmt: skip


REFUSED: dict[str, tuple[Callable[[list[Path]], Any], str]] = {
    "a field": (lambda to: nuno.sweep(CHAIN, {"solver.dtt": [1, 2]}, roots=to), "over: solver.dtt: no such field"),
    "a value": (lambda to: nuno.sweep(CHAIN, {"duration": [1, "soon"]}, roots=to), "over: duration: "),
    "no values": (lambda to: nuno.sweep(CHAIN, {"duration": []}, roots=to), "over: nothing to sweep over"),
    "a side": (lambda to: nuno.sweep(CHAIN, {"seed": [1]}, roots=to, side="fromt"), "did you mean 'front'"),
    "two places": (lambda to: nuno.sweep(CHAIN, {"seed": [1]}, roots=to, jobs=2, dask="tcp://a:1"), "either jobs or"),
}


@pytest.fixture
def unrun(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Points that were run nevertheless."""
    ran: list[object] = []
    monkeypatch.setattr(grid, "measure", ran.append)
    return ran


@pytest.mark.parametrize("fault", REFUSED)
def test_what_cannot_be_swept_is_refused_before_anything_runs(
    fault: str, roots: list[Path], unrun: list[object]
) -> None:
    call, words = REFUSED[fault]
    with pytest.raises(BadInput) as caught:
        call(roots)
    assert words in str(caught.value) and "--" not in str(caught.value)
    assert not unrun


def test_the_command_names_its_flag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write_scene(tmp_path))
    for over, words in (("solver.dtt=1", "--over: solver.dtt: no such field"), ("x", "--over: a sweep goes over")):
        assert main(["sweep", path, "--over", over]) == 2
        assert words in capsys.readouterr().err
    assert main(["sweep", path]) == 2
    assert "--over: nothing to sweep over" in capsys.readouterr().err
