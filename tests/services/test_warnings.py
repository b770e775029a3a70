"""What makes a run doubtful before its first step is said by the plan, by the run, in its report and to Python."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.recording.reader import Recording
from nuno.report import lines
from nuno_schemas.messages import EVENT


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


def ball(x: float, depth: float) -> dict[str, object]:
    """A scene in which the chain's vertex at x begins so deep [m] in a ball, and no other vertex in it."""
    collider = {"plugin": "sphere", "centre": [x, depth - 0.08, 0.0], "radius": 0.08}
    return {"bodies": [BALL[0] | {"collider": collider}], "duration": 0.1}


def warned(recording: Recording) -> list[str]:
    """Warnings that the simulation gave before its first step."""
    events = [recording.json(message.payload) for message in recording.messages([f"{EVENT.name}/simulation"])]
    return [one["text"] for one in events if (one["kind"], one["frame"]) == ("warning", 0)]


@pytest.mark.parametrize(("x", "what"), [(0.3, "6 vertices"), (0.0, "1 held vertices")])
def test_depths_are_those_before_the_first_step(
    x: float, what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, **ball(x, 0.031))
    warning = f"1 of {what} start in a body, up to 31 mm deep"
    assert warning in told(capsys, "plan", str(scene))
    with pytest.warns(UserWarning, match=warning):
        result = nuno.run(scene, record=tmp_path / "run.mcap")
    with result.recording as recording:
        said = warned(recording)
    assert said == result.report["warnings"]
    assert sum(warning in text for text in said) == 1
    through = [text for text in said if "the edge that is held" in text]
    assert (len(said), len(through)) == ((1, 0) if x else (2, 1))


def test_cloth_that_hardly_touches_is_not_said_to_start_inside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, **ball(0.3, 0.0049))
    assert "WARNING" not in told(capsys, "plan", str(scene))
    assert nuno.run(scene, record=tmp_path / "run.mcap").report["warnings"] == []


def test_a_run_that_goes_on_does_not_say_again_how_it_began(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, path = write_scene(tmp_path, **ball(0.0, 0.031)), tmp_path / "run.mcap"
    assert "start in a body" in told(capsys, "run", str(scene), "--record", str(path), "--no-view")
    on = ("run", "--resume", str(path), "--set", "duration=0.2", "--record", str(tmp_path / "on.mcap"), "--no-view")
    assert "start in a body" not in told(capsys, *on)


def test_a_body_through_a_waistband_is_said(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Hips of a captured walk are higher than those that the shipped skirt is cut for."""
    small = ("--set", "objects.0.model.columns=80", "--set", "objects.0.model.rows=24", "--set", "duration=0.1")
    said = told(capsys, "plan", "skirt-walk", *small)
    assert "WARNING" not in said
    walk = f"bodies.walker.motion.file={shared_data / 'cmu_12_01_walk.bvh'}"
    said = told(capsys, "plan", "skirt-walk", *small, "--set", walk)
    assert "a body is through the edge that is held" in said
