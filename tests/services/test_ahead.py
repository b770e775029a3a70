"""What a long command says of its length: an estimate first, from what is measured here, then what is left."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest
from scenes import write_scene

from nuno.api import progress
from nuno.api.progress import ProgressLine
from nuno.api.runtime_estimate import RuntimeEstimate, run_seconds
from nuno.cli import main
from nuno.formatting import roughly
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.gallery import command as gallery
from nuno_bench.gallery.kind import Gallery, ShownScene
from nuno_bench.sweep.executor import Executor
from nuno_bench.validation import command as suite
from nuno_bench.validation.law import Outcome


def test_what_is_left_follows_from_what_is_done() -> None:
    """Twice as slow as expected so far: so is the rest taken to be."""
    pace = RuntimeEstimate({"a": 1.0, "b": 2.0, "c": 3.0})
    assert pace.left == 6.0
    pace.taken["b"] = 4.0
    assert pace.left == 8.0
    pace.taken |= {"a": 2.0, "c": 6.0}
    assert pace.left == 0.0
    assert [roughly(s) for s in (0.42, 8.0, 61.0, 480.0, 5000.0)] == [
        "about 0.42 s", "about 8 s", "about 1 min", "about 8 min", "about 1.4 h",
    ]  # fmt: skip


def test_a_scenes_time_is_that_of_a_frame_measured_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Times its frames: a frame that is made to take 20 ms longer shows in the estimate."""
    loaded = scene_file.read(write_scene(tmp_path))
    quick = run_seconds(loaded)
    before = Simulation.advance

    def slow(simulation: Simulation, *poses: object) -> object:
        time.sleep(0.02)
        return before(simulation, *poses)  # type: ignore[arg-type]

    monkeypatch.setattr(Simulation, "advance", slow)
    found = run_seconds(loaded)
    assert quick < 0.02 * loaded.scene.frames <= found < 0.04 * loaded.scene.frames


def test_a_gallery_says_first_how_long_it_takes_and_then_what_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three scenes that are expected to take 60, 120 and 180 s; the first takes a thousandth of that."""
    scenes = {name: write_scene(tmp_path).rename(tmp_path / f"{name}.yaml") for name in ("one", "two", "three")}

    def run_scene(path: Path) -> ShownScene:
        time.sleep(0.06)
        return ShownScene(path.stem, "")

    kind = Gallery("t", "l", lambda: scenes, run_scene, (), "")
    expected = iter((60.0, 120.0, 180.0))
    monkeypatch.setattr(gallery, "KINDS", {"knit": kind})
    monkeypatch.setattr(gallery, "run_seconds", lambda loaded: next(expected))
    assert main(["gallery", "knit", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said[1] == "steps take about 6 min, compiling and pictures apart"
    assert said[2] == "one, 1 of 3 ..."
    left = [float(re.fullmatch(rf"{name}, about ([0-9.]+) s left \.\.\.", line)[1])  # type: ignore[index]
            for name, line in zip(("two, 2 of 3", "three, 3 of 3"), said[3:], strict=True)]  # fmt: skip
    assert 0.3 <= left[0] < 1.5 and 0.1 <= left[1] < left[0]


def test_validate_says_what_is_left_by_the_mean_of_what_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Checks of 10 ms each, said at every one: so many times 10 ms are left."""

    def check_named(task: tuple[str, str]) -> Outcome:
        time.sleep(0.01)
        return Outcome(*task, "passed")

    monkeypatch.setattr(suite, "check_named", check_named)
    monkeypatch.setattr(suite, "SAY_EVERY", 0.0)
    parts, said = suite.choose_parts(["one step", "projectile", "rotation"], []), list[str]()
    outcomes = suite.check_all(parts, Executor(), said.append)
    every = [(case.name, solver) for part in parts for case in part.cases for solver in part.solvers]
    assert [(one.case, one.solver) for one in outcomes] == every
    assert said[0] == f"{len(every)} checks; the first of them tell how long all take"
    for line, done in zip(said[1:], range(2, len(every)), strict=True):
        number, left = re.fullmatch(rf"{done} of {len(every)}, about ([0-9.]+) s left()", line).groups()[::-1]  # type: ignore[union-attr]
        assert number == "" and 0.009 * (len(every) - done) <= float(left) < 0.1 * (len(every) - done)


def test_a_run_says_how_long_it_takes_and_what_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At 0.1 s of the scene in a second of the clock, 0.5 s of it take five; less, where it may end before."""
    clock = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    for until, ends in (("duration", ""), ("rest", " at most, less where it comes to rest before")):
        with ProgressLine(scene_file.read(write_scene(tmp_path, until=until)).scene) as line:
            for frame in range(26):
                line.show(frame / 50)
                clock[0] += 0.2
        said = capsys.readouterr().err.splitlines()
        assert said[0].startswith("0.00 of 0.5 s")
        assert f"the run takes about 5 s{ends}" in said[:6] and sum("the run takes" in text for text in said) == 1
        assert "0.30 of 0.5 s  0.10x real time, about 2 s left" in said
        assert said[-1] == "0.50 of 0.5 s  0.10x real time"


@pytest.mark.parametrize(("seconds", "word"), [(2.0, "longer"), (0.02, "shorter")])
def test_a_run_whose_frames_change_says_how_long_it_takes_now(
    seconds: float, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """50 frames of 0.2 s, then 50 that are ten times as long, or as short: what is said comes to be the truth."""
    clock = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    with ProgressLine(scene_file.read(write_scene(tmp_path, duration=2.0)).scene, bar=False) as line:
        for frame in range(101):
            line.show(frame / 50)
            clock[0] += 0.2 if frame < 50 else seconds
    said = [text for text in capsys.readouterr().err.splitlines() if text.startswith("the run takes")]
    assert said[0] == "the run takes about 20 s"
    assert all(
        re.fullmatch(rf"the run takes about .*, not about .*: frames take {word} now", text) for text in said[1:]
    )
    told = float(re.match(r"the run takes about ([0-9.]+) (s|min)", said[-1])[1])  # type: ignore[index]
    whole = 50 * (0.2 + seconds)
    assert 1 < len(said) <= 6 and told * (60 if " min" in said[-1].partition(",")[0] else 1) == pytest.approx(
        whole, rel=0.5
    )
