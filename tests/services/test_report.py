"""The report says what its numbers are of: peak or last, since when, and what makes them doubtful."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import write_scene as write_dye_scene
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.report.run_report import Report, brief, lines
from nuno.runtime.stepper import Stepped
from nuno.scene import scene_file
from nuno.scene.warnings import MOST_DEPTHS, MOST_STRETCH, SEEN_DEPTH
from nuno.simulation import cloth
from nuno.simulation.run import Simulation
from nuno.simulation.yarns import measure_stretch
from soak.fuzz.files import BVH


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> nuno.Result:
    """A chain that falls on a ball and swings off it."""
    folder = tmp_path_factory.mktemp("report")
    return nuno.run(write_scene(folder, bodies=BALL, duration=1.0), record=folder / "run.mcap")


def rows(report: Report, heading: str) -> list[str]:
    return [text for name, text in lines(report) if name == heading]


def test_penetration_is_the_peak_and_the_last_frames(result: nuno.Result) -> None:
    with result.recording as recording:
        depth = recording.series()["depth"]
    assert depth.max() > depth[-1]
    assert result.report["penetration"] == depth.max()
    assert result.report["last_penetration"] == depth[-1]
    (text,) = rows(result.report, "penetration")
    assert text.startswith(f"at most {depth.max() * 1e3:.3g} mm, {depth[-1] * 1e3:.3g} mm at the end")


def test_friction_says_how_near_to_coulombs_law_it_is(result: nuno.Result) -> None:
    (text,) = rows(result.report, "friction")
    assert f"up to {result.report['slip_speed'] * 1e3:.3g} mm/s faster" in text
    assert (
        rows(result.report | {"slip_speed": 0.0}, "friction")
        == rows(result.report | {"slip_speed": None}, "friction")
        == []
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stretch": MOST_STRETCH}, ""),
        ({"stretch": 1.001 * MOST_STRETCH}, "stretched by more than 100%"),
        ({"stretch": 1.5 * MOST_STRETCH, "yarns": {"elastane": {"length": 1.0, "longest": 1.0}}}, ""),
        ({"stretch": None}, ""),
        ({"penetration": 1.001 * SEEN_DEPTH, "rest_depth": 1e-4}, "50 times as deep"),
        ({"penetration": 0.999 * SEEN_DEPTH, "rest_depth": 1e-4}, ""),
        ({"penetration": 1.001 * MOST_DEPTHS * 0.01, "rest_depth": 0.01}, "5 times as deep"),
        ({"penetration": 0.999 * MOST_DEPTHS * 0.01, "rest_depth": 0.01}, ""),
        ({"penetration": 0.1, "rest_depth": 0.0}, "bodies deeper than"),
        ({"penetration": 0.1, "rest_depth": None}, ""),
        ({"counts": {"cut_short": 7, "held_cut_short": 0, "steps_without_motion": 0}}, ""),
        ({"counts": {"steps_without_motion": 1200}}, "all cloth stood still in 1,200 steps"),
        ({"counts": {"held_cut_short": 3}}, "held back by cloth 3 times"),
    ],
)
def test_doubtful_results_carry_a_warning(result: nuno.Result, change: dict[str, Any], words: str) -> None:
    quiet = result.report | {"stretch": 0.1, "penetration": 1e-4, "rest_depth": 1e-4}
    assert rows(quiet, "warning") == []
    found = rows(quiet | change, "warning")
    assert len(found) == bool(words)
    assert words in "".join(found)


def test_stretch_at_the_start_is_told_apart_from_what_loads_do(tmp_path: Path) -> None:
    """A spring drawn out to 2.5 times its rest length, and critically damped; the load stretches it by a quarter."""
    ends = {"x": np.array([[0.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), "v": np.zeros((2, 3)), "m": np.ones(2)}
    spring = {"springs": np.array([[0, 1]]), "k": np.full(1, 100.0), "rest": np.full(1, 0.4), "c": np.full(1, 20.0)}
    np.savez(tmp_path / "spring.npz", pinned=np.array([True, False]), **ends, **spring)
    objects = [{"name": "spring", "model": {"plugin": "net", "file": "spring.npz"}}]
    report = nuno.run(write_scene(tmp_path, objects=objects, duration=1.5)).report
    assert report["start_stretch"] == pytest.approx(1.5) and report["stretch"] == pytest.approx(9.81 / 40.0, rel=0.01)
    assert rows(report, "warning") == []
    (text,) = rows(report, "stretch")
    assert text.startswith(f"at most {report['stretch']:.2%}; 150.00% at the start; at the end 99% of the area below ")
    last, sunk = report["last_stretch"], 9.81 / 100.0
    assert last["vertex"] in (0, 1) and last["most"] == pytest.approx(sunk / 0.4, rel=0.01)


def test_the_stretch_of_the_area_is_that_of_its_rest(tmp_path: Path) -> None:
    """A hung square that is 5 % longer, but for one corner, which is drawn out to three times its rest."""
    sheet = {"plugin": "sheet", "size": [1, 1], "resolution": [51, 51], "fabric": "denim", "pin": ["top-corners"]}
    scene = write_scene(tmp_path, objects=[{"name": "cloth", "model": sheet}])
    fabric, _ = cloth.build_fabric(scene_file.read(scene))
    x = fabric.position * np.array([1.0, 1.05, 1.0])
    corner = int(np.lexsort(fabric.position.T)[-1])
    x[corner] += np.array([0.04, 0.0, 0.0])
    found = measure_stretch(fabric, x)
    assert (
        found["below"] == pytest.approx(0.05) and found["most"] > 1.5 and found["place"] == x[found["vertex"]].tolist()
    )
    assert np.linalg.norm(x[found["vertex"]] - x[corner]) < 0.07
    assert measure_stretch(fabric, np.full_like(x, np.nan)) == {}


@pytest.mark.full
def test_the_stretch_of_the_area_converges_where_the_largest_grows(tmp_path: Path) -> None:
    """Hung denim, refined: all its weight hangs from two points, and the cloth at a point stretches without end."""
    settings = ("solver={plugin: implicit_euler, dt: auto}", "duration=1.5", "frame_rate=30")
    sizes = (f"objects.0.model.resolution=[{n}, {n}]" for n in (33, 65))
    coarse, fine = (nuno.run("hanging-sheet", size, *settings).report["last_stretch"] for size in sizes)
    assert fine["most"] > 1.4 * coarse["most"] and fine["below"] == pytest.approx(coarse["below"], rel=0.1)
    for last in (coarse, fine):
        assert np.abs(last["place"]) == pytest.approx([0.5, 0.5, 0.0], abs=1e-6)  # at a pinned corner


def test_all_rows_have_a_heading_and_one_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Those that name the files that a run has left, too, and those of nuno info."""
    file = tmp_path / "run.mcap"
    assert main(["run", str(write_scene(tmp_path, duration=0.1)), "--record", str(file), "--no-view"]) == 0
    said = capsys.readouterr().out
    texts = dict(re.findall(r"^(digest|recording|total)( +)", said, re.MULTILINE))
    assert {len(name + text) for name, text in texts.items()} == {12} and len(texts) == 3
    assert main(["info", str(file)]) == 0
    assert all(line.strip() for line in capsys.readouterr().out.splitlines())


def test_energy_goes_only_where_there_is_something_to_take_it(result: nuno.Result) -> None:
    (text,) = rows(result.report, "balance")
    assert text.endswith("J by damping, friction and moving bodies")
    (text,) = rows(result.report | {"left_out": []}, "balance")
    assert text.endswith("J by damping, wind and other forces, friction and moving bodies")
    (text,) = rows(result.report | {"left_out": ["the scene has no bodies", "wind: the scene names none"]}, "balance")
    assert text.endswith("J by damping")


def test_a_report_is_a_few_lines_unless_all_is_asked_for(
    result: nuno.Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """How fast, how accurate, how far from the limit, and what was left out; in the whole one also why."""
    short, whole = brief(result.report), lines(result.report)
    assert {"time", "step", "stretch", "frames", "digest", "left out"} <= {name for name, _ in short}
    assert {name for name, _ in whole} - {name for name, _ in short} >= {"energy", "balance", "parts"}
    assert len(short) < 0.6 * len(whole)
    names = ", ".join(text.partition(": ")[0] for text in result.report["left_out"])
    assert short[-1] == ("left out", f"{names}  (why, and more: --report)")
    path = write_scene(tmp_path, duration=0.1)
    for flags in ([], ["--report"]):
        assert main(["run", str(path), "--no-view", "--no-record", *flags]) == 0
        assert ("\nenergy " in capsys.readouterr().out) is bool(flags)


def test_a_run_whose_service_dies_on_its_way_is_not_said_to_have_been_prepared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is recorded is counted, and why the run ended is kept."""
    step = Simulation.step

    def fail(self: Simulation) -> Stepped:
        if self.frame == 4:
            raise OSError("the loom is on fire")
        return step(self)

    monkeypatch.setattr(Simulation, "step", fail)
    path = tmp_path / "a.mcap"
    assert main(["run", str(write_scene(tmp_path)), "--no-view", "--record", str(path)]) == 1
    capsys.readouterr()
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr().out
    assert "5 frames are recorded" in said and "prepared" not in said
    assert "the simulation service died: OSError: the loom is on fire" in said


@pytest.mark.parametrize(("name", "drawn", "fields"), [
    ("relaxes", 1.3, {"gravity": [0, 0, 0], "damping": 200.0}),
    ("relaxes, then falls and is drawn out", 1.3, {"damping": {"first": 200.0, "over": "0.2 s", "last": 0.0}}),
    ("is drawn out from the start", 1.0, {}),
])  # fmt: skip
def test_frames_in_which_cloth_relaxes_are_left_out(
    name: str, drawn: float, fields: dict[str, Any], tmp_path: Path
) -> None:
    scene = write_scene(tmp_path, **fields)
    with np.load(tmp_path / "chain.npz") as chain:
        np.savez(tmp_path / "chain.npz", **dict(chain) | {"x": drawn * chain["x"]})
    result = nuno.run(scene, record=tmp_path / "run.mcap")
    with result.recording as recording:
        every = recording.series()["stretch"]
    rises = np.flatnonzero(~(np.diff(every) <= 0.0)) + 1
    counted = every[rises[0] :] if len(rises) else every[-1:]
    assert result.report["start_stretch"] == every[0] == pytest.approx(drawn - 1.0)
    assert result.report["stretch"] == counted.max()
    assert (name == "relaxes") == (len(rises) == 0) and (drawn == 1.0) == (counted.max() == every.max())


def test_a_resumed_runs_report_is_of_the_whole_recording(
    result: nuno.Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "on.mcap"
    command = ["run", "--resume", str(result.path), "--set", "duration=1.2", "--record", str(target), "--no-view"]
    assert main([*command, "--report"]) == 0
    with nuno.open(target) as recording:
        assert recording.report()["began"] == 1.0
        assert recording.report()["simulated_seconds"] == pytest.approx(0.2)
        assert recording.report()["energy"][0] == result.report["energy"][0]
    assert "resumed     at 1 s; time, " in capsys.readouterr().out
    assert rows(result.report, "resumed") == []


@pytest.mark.parametrize("kind", ["chain", "ball", "walker", "field", "dye"])
def test_a_plan_states_the_size_that_a_recording_has(kind: str, tmp_path: Path) -> None:
    """Within a tenth: positions, bodies, contact forces, status, checkpoints, files and the file's own bytes. A
    distance field is not recorded.
    """
    if kind == "dye":
        scene = write_dye_scene(tmp_path)
    elif kind == "walker":
        walk = tmp_path / "walk.bvh"
        walk.write_bytes(BVH)
        body = {"name": "body", "collider": {"plugin": "skeleton"}, "motion": {"plugin": "bvh", "file": walk.name}}
        scene = write_scene(tmp_path, bodies=[body], duration=1.0)
    elif kind == "field":
        solid = {"plugin": "sdf", "shape": "box", "size": [0.3, 0.3, 0.3], "centre": [0.3, -0.5, 0.0]}
        scene = write_scene(tmp_path, bodies=[{"name": "block", "collider": solid}], duration=1.0)
    else:
        more: dict[str, Any] = {"bodies": BALL, "record": {"contact_forces": True}} if kind == "ball" else {}
        scene = write_scene(tmp_path, duration=2.0, **more)
    storage = next(text for heading, text in nuno.plan(scene) if heading == "storage")
    number, unit = storage.split()[:2]
    stated = float(number) * {"kB": 1e3, "MB": 1e6, "GB": 1e9}[unit]
    written = nuno.run(scene, record=tmp_path / "run.mcap").path.stat().st_size
    assert stated == pytest.approx(written, rel=0.1)
