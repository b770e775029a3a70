"""What makes a run doubtful before its first step is said by the plan, by the run, in its report and to Python."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.report import lines


def told(capsys: pytest.CaptureFixture[str], *command: str) -> str:
    assert main(list(command)) == 0
    said = capsys.readouterr()
    return said.out + said.err


@pytest.mark.parametrize(
    ("duration", "end"), [("0.04 s", 0.1), ("0.25 s", 0.2), (0.31, 0.3), (0.2, None), ("0.3 s", None)]
)
def test_a_duration_that_is_not_whole_frames_is_said_where_it_ends(
    duration: str | float, end: float | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, duration=duration, frame_rate=10)
    said = f"the run ends at {end:g} s" if end is not None else "duration:"
    plan = told(capsys, "plan", str(scene))
    assert ((said in plan), plan.count("WARNING")) == (end is not None, int(end is not None))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = nuno.run(scene, record=tmp_path / "run.mcap")
    assert result.t == pytest.approx(end or float(str(duration).split()[0]))
    expected = [text for text in result.report["warnings"] if said in text]
    assert len(expected) == len(result.report["warnings"]) == int(end is not None)
    assert [str(one.message) for one in caught if one.category is UserWarning] == expected
    assert ("warning", *expected) in lines(result.report) or end is None


def test_intervals_of_a_recording_that_are_rounded_are_said_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fields = {"duration": 0.4, "frame_rate": 10, "record": {"checkpoint_every": 0.14}}
    said = told(capsys, "run", str(write_scene(tmp_path, **fields)), "--no-record", "--no-view")
    warning = "record.checkpoint_every: 0.14 s is 1.4 frames at 10 Hz: taken as 0.1 s"
    assert said.count(warning) == 2  # at the start and in the report
