"""`nuno bench accuracy`: what is delivered is measured against a converged run, of cloth and of dye."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from dye_scene import write_scene
from line_net import write_net

from nuno.cli import main
from nuno_bench.precision import accuracy


def delivered(path: Path, out: Path, *flags: str) -> list[dict[str, Any]]:
    """The results that the command writes; its exit code says whether all agree."""
    code = main(["bench", "accuracy", str(path), "--out", str(out), *flags])
    results: list[dict[str, Any]] = json.loads((out / "accuracy.json").read_text())["results"]
    assert code == int(any(one["verdict"] != "agrees" for one in results))
    with (out / "accuracy.csv").open() as stream:
        assert [row["verdict"] for row in csv.DictReader(stream)] == [one["verdict"] for one in results]
    page = (out / "accuracy.html").read_text()
    assert all(one["verdict"] in page for one in results)
    return results


def test_levels_of_cloth_deliver_what_they_promise(tmp_path: Path) -> None:
    found = delivered(write_net(tmp_path), tmp_path / "out", "--duration", "0.2 s", "--levels", "preview,normal")
    assert [(one["accuracy"], one["verdict"]) for one in found] == [("preview", "agrees"), ("normal", "agrees")]
    assert all(0.0 < one["error"] <= accuracy.WITHIN * one["promised"] and one["floor"] < 1e-10 for one in found)


def test_a_solver_that_is_named_is_judged_with_the_step_chosen_for_it(tmp_path: Path) -> None:
    """And a scene's own is not, unless it is named: the promise is that of the choice."""
    path = write_net(tmp_path, solver={"plugin": "rk4", "dt": "1 ms"})
    flags = ("--duration", "0.2 s", "--levels", "preview")
    (chosen,) = delivered(path, tmp_path / "chosen", *flags)
    (named,) = delivered(path, tmp_path / "named", *flags, "--solver", "leapfrog")
    assert chosen["solver"] != "rk4" and named["solver"] == "leapfrog"
    assert chosen["verdict"] == named["verdict"] == "agrees"


@pytest.mark.full
def test_a_level_of_dye_delivers_what_it_promises(tmp_path: Path) -> None:
    (one,) = delivered(write_scene(tmp_path), tmp_path / "out", "--duration", "20 s", "--levels", "normal")
    assert one["verdict"] == "agrees" and 0.0 < one["error"] <= one["promised"] and one["within"] == 1.0


def test_more_than_was_promised_fails_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "WITHIN", 1e-12)
    found = delivered(write_net(tmp_path), tmp_path / "out", "--duration", "0.2 s", "--levels", "preview")
    assert [one["verdict"] for one in found] == ["failed"]


@pytest.mark.full
def test_kicks_of_wind_deliver_what_is_promised_against_solvers_without_kicks(
    shared_data: Path, tmp_path: Path
) -> None:
    """Of a measured fabric in wind, whose error stayed at 2 % of its size however short the step was."""
    scene = shared_data / "cases" / "33-respa-auto-no-order" / "scene.yaml"
    found = delivered(
        scene, tmp_path / "out", "--solver", "respa", "--duration", "0.5 s", "--levels", "normal,reference"
    )
    assert [(one["solver"], one["verdict"]) for one in found] == 2 * [("respa", "agrees")]
    assert found[1]["error"] < 0.2 * found[0]["error"]
