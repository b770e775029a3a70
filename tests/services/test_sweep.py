"""`nuno sweep` and `nuno.sweep`: a scene for each combination of values, in one table."""

from __future__ import annotations

import base64
import csv
import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scenes import CHAIN, write_chain, write_scene

import nuno
from nuno.cli import main
from nuno_bench.sweep import grid
from nuno_bench.sweep.grid import values_of
from nuno_schemas.errors import BadInput

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


def test_values_may_need_each_other_come_twice_or_be_of_numpy(roots: list[Path]) -> None:
    """A field that only one solver has; and each combination has a row, also of the same values."""
    over: dict[str, Any] = {"solver.plugin": ["xpbd"], "solver.iterations": np.array([3, 3]), "seed": iter([1])}
    found = nuno.sweep(CHAIN, over, roots=roots, jobs=1, side="")
    assert [row["solver.iterations"] for row in found.rows] == [3, 3]
    assert found.rows[0]["digest"] == found.rows[1]["digest"]


def test_a_run_that_fails_has_its_row_and_leaves_nothing(
    roots: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    changes = {"allow_unstable": True, "solver.dt": "20 ms"}
    found = nuno.sweep(CHAIN, {"duration": [0.1, 20]}, changes, roots=roots, jobs=1, side="")
    assert [row["state"] for row in found.rows] == ["done", "failed"] and "diverged" in found.rows[1]["why"]
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.full
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
        nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, progress=stop)
    found = nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, resume=True, progress=heard.append)
    assert [text.partition(":")[0] for text in heard] == ["1 of 3", "2 of 3", "3 of 3"]
    assert [row["simulated_seconds"] for row in found.rows] == pytest.approx([0.04, 0.06, 0.08])
    with (out / "sweep.csv").open(newline="") as stream:
        assert [float(row["duration"]) for row in csv.DictReader(stream)] == [0.04, 0.06, 0.08]
    with pytest.raises(BadInput, match="another sweep"):
        nuno.sweep(CHAIN, {"seed": [1], **over}, roots=roots, jobs=1, out=out, resume=True)
    with pytest.raises(BadInput, match="another sweep"):
        nuno.sweep(CHAIN, over, "seed=3", roots=roots, jobs=1, out=out, resume=True)


def test_the_command_writes_a_page_and_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    sheet = ["sweep", "hanging-sheet", "--set", "duration=0.04", "--jobs", "1", "--over"]
    assert main([*sheet, "objects.0.model.fabric=denim, jacket"]) == 0
    said = capsys.readouterr()
    assert "jacket" in said.out and said.err.startswith("objects.0.model.fabric: denim, jacket\n")
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
    "a field": (lambda to: nuno.sweep(CHAIN, {"solver.dtt": [1, 2]}, roots=to, jobs=1), "over: solver.dtt: no such"),
    "a value": (lambda to: nuno.sweep(CHAIN, {"duration": [1, "soon"]}, roots=to, jobs=1), "over: duration: "),
    "no values": (lambda to: nuno.sweep(CHAIN, {"duration": []}, roots=to, jobs=1), "over: nothing to sweep over"),
    "a side": (lambda to: nuno.sweep(CHAIN, {"seed": [1]}, roots=to, side="fromt", jobs=1), "did you mean 'front'"),
    "a text": (lambda to: nuno.sweep(CHAIN, {"seed": "12"}, roots=to, jobs=1), "over a list of values"),
    "no list": (lambda to: nuno.sweep(CHAIN, {"damping": 0.3}, roots=to, jobs=1), "over a list of values"),
    "nowhere to go on": (lambda to: nuno.sweep(CHAIN, {"seed": [1]}, roots=to, jobs=1, resume=True), "name the folder"),
    "no processes": (lambda to: nuno.sweep(CHAIN, {"seed": [1]}, roots=to, jobs=0), "at least one"),
    "a field that is set": (
        lambda to: nuno.sweep(CHAIN, {"seed": [1]}, "seed=7", roots=to, jobs=1),
        'limit:  "seed=7"',
    ),
    "a part that is set": (
        lambda to: nuno.sweep(CHAIN, {"solver": [{"plugin": "rk4"}]}, {"solver.dt": 5e-4}, roots=to, jobs=1),
        "over: the sweep gives this field its values",
    ),
    "a flat cloth's side": (lambda _: nuno.sweep("dye/drops", {"seed": [1]}, side="left", jobs=1), "lies flat"),
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


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that are done at once."""
    monkeypatch.setattr(grid, "measure", lambda point: {"state": "done", "digest": " ".join(point.overrides)})


def interrupt(text: str) -> None:
    raise KeyboardInterrupt


@pytest.mark.usefixtures("quick")
def test_two_sweeps_at_once_do_not_share_a_folder(roots: list[Path], tmp_path: Path) -> None:
    """The second is refused, also with `resume`, and leaves the rows of the first as they are."""
    out, refused = tmp_path / "out", list[str]()

    def other(text: str) -> None:
        before = (out / grid.KEPT).read_bytes()
        for resume in (False, True):
            with pytest.raises(BadInput, match="another sweep is writing there") as caught:
                nuno.sweep(CHAIN, {"seed": [3]}, roots=roots, jobs=1, out=out, resume=resume)
            refused.append(str(caught.value))
        assert (out / grid.KEPT).read_bytes() == before

    found = nuno.sweep(CHAIN, {"seed": [1, 2]}, roots=roots, jobs=1, out=out, progress=other)
    assert len(refused) == 4 and all(str(out) in text and "another out" in text for text in refused)
    with (out / "sweep.csv").open(newline="") as stream:
        assert [row["digest"] for row in csv.DictReader(stream)] == [row["digest"] for row in found.rows]
    nuno.sweep(CHAIN, {"seed": [3]}, roots=roots, jobs=1, out=out)


@pytest.mark.usefixtures("quick")
def test_an_interrupted_sweep_is_not_lost_to_another(roots: list[Path], tmp_path: Path) -> None:
    """Its rows stay until they are resumed or removed; the message says which of both would work."""
    over, out, heard = {"seed": [1, 2]}, tmp_path / "out", list[str]()
    with pytest.raises(KeyboardInterrupt):
        nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, progress=interrupt)
    kept = (out / grid.KEPT).read_bytes()
    with pytest.raises(BadInput, match=r"(?s)would be lost.*continue it with resume, give another out, or remove"):
        nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out)
    for changed, what in (({"seed": [3]}, "over"), ({**over, "damping": [0.1]}, "over")):
        with pytest.raises(BadInput, match=rf"(?s)would be lost.*has another {what}\n.*: give another out, or remove"):
            nuno.sweep(CHAIN, changed, roots=roots, jobs=1, out=out)
    with pytest.raises(BadInput, match=r"(?s)would be lost.*it has another scene\n"):
        nuno.sweep(CHAIN, over, "damping=0.3", roots=roots, jobs=1, out=out)
    assert (out / grid.KEPT).read_bytes() == kept
    nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, resume=True, progress=heard.append)
    assert [text[:6] for text in heard] == ["2 of 2"]
    nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, resume=True, progress=heard.append)
    assert len(heard) == 1, "a finished one has nothing left"
    nuno.sweep(CHAIN, {"seed": [3]}, roots=roots, jobs=1, out=out, progress=heard.append)
    assert heard[1] == f"the finished sweep in {out / grid.KEPT} is replaced" and heard[2][:6] == "1 of 1"
    (out / grid.KEPT).write_bytes(kept[: kept.index(b"\n") + 1])
    nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out)  # what has finished nothing has nothing to lose


@pytest.mark.usefixtures("quick")
def test_all_tables_have_the_same_columns(roots: list[Path], tmp_path: Path) -> None:
    """Also the one for a reason, where all is well."""
    nuno.sweep(CHAIN, {"seed": [1, 2]}, roots=roots, jobs=1, out=tmp_path)
    with (tmp_path / "sweep.csv").open(newline="") as stream:
        assert [list(row) for row in csv.DictReader(stream)] == [["seed", "state", "why", "digest"]] * 2
