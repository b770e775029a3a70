"""Pictures that are drawn while a scene runs: of which frames, in which files, and the same as those drawn later."""

from __future__ import annotations

import io
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image
from refusals import Refused

from nuno.bus.encodings import decode_picture
from nuno.bus.messages import Inbox, Message, Query
from nuno.cli import main
from nuno.exports.yarns import Artist, export_yarn_picture
from nuno.recording.reader import open_recording
from nuno.recording.recorded import Frame
from nuno.runtime import supervisor
from nuno.runtime.launch import make_plan
from nuno.runtime.service import Context, Options
from nuno.runtime.supervisor import DRAWING, UNDRAWN
from nuno.scene import scene_file
from nuno_schemas.messages import PICTURE, REPORT, FrameStatus

LEG = {"plugin": "mesh", "shape": "leg", "resolution": 16}


def write(folder: Path, **view: Any) -> Path:
    """A tube of a few stitches about a calf, five frames long."""
    knit = {
        "plugin": "knit", "form": "tube", "wales": 6, "courses": 7, "spacing": [0.04, 0.02], "mass": 1,
        "centre": [0.0, 0.32, 0.0], "yarns": [{"name": "soft", "k": 1}],
    }  # fmt: skip
    scene: dict[str, Any] = {
        "nuno": 1,
        "name": "calf",
        "duration": 0.5,
        "frame_rate": 10,
        "solver": {"plugin": "symplectic_euler", "dt": 0.01},
        "gravity": [0, 0, 0],
        "bodies": [{"name": "leg", "collider": LEG}],
        "contact": {"plugin": "sliding"},
        "objects": [{"name": "knit", "model": knit, "colour": "#203a8c"}],
        "view": {"size": [48, 64], "yarns": {"plugin": "yarns", "samples": 2, "radius": "3 mm"}} | view,
    }
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    return path


def read(payload: bytes) -> Any:
    return np.asarray(Image.open(io.BytesIO(decode_picture(payload))))


@pytest.mark.parametrize(("pictures", "times"), [("end", [0.5]), ("0.2 s", [0.0, 0.2, 0.4, 0.5])])
def test_pictures_are_of_the_frames_that_were_asked_for(pictures: str, times: list[float], tmp_path: Path) -> None:
    """The last frame's, to which the camera is fitted, is the one that is drawn from the recording."""
    path, record = write(tmp_path, pictures=pictures), tmp_path / "run.mcap"
    assert main(["run", str(path), "--no-view", "--record", str(record)]) == 0
    with open_recording(record) as recording:
        found = list(recording.messages([PICTURE.name]))
        assert [one.t for one in found] == pytest.approx(times) and recording.missing == {}
        images = [read(one.payload) for one in found]
        assert images[0].shape == (64, 48, 3) and len({image.tobytes() for image in images}) == len(times)
        if pictures == "end":
            again = export_yarn_picture(recording, tmp_path / "again.png")
            assert np.array_equal(np.asarray(Image.open(again)), images[0])


@pytest.mark.usefixtures("interruptible")
def test_who_would_not_wait_for_pictures_has_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while the last ones are drawn: the one that is begun is the last, and the report is kept."""
    draw, pressed = Artist.draw, threading.Event()

    def slow(self: Artist, frame: Frame) -> Any:
        assert pressed.wait(30)
        return draw(self, frame)

    def press(status: FrameStatus | str) -> None:
        if status == DRAWING:
            threading.Timer(0.2, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT)).start()
        elif status == UNDRAWN:
            threading.Timer(0.5, pressed.set).start()

    monkeypatch.setattr(Artist, "draw", slow)
    loaded, record = scene_file.read(write(tmp_path, pictures="0.1 s")), tmp_path / "run.mcap"
    outcome = supervisor.supervise(
        loaded, Options(record=record), None, press, lambda outcome: {"state": outcome.state}
    )
    left = outcome.services["render"]["undrawn"]
    assert left > 0 and outcome.services["render"]["pictures"] + left == 6
    assert (outcome.state, outcome.error) == ("failed", f"render: interrupted, pictures left undrawn: {left}")
    with open_recording(record) as recording:
        assert recording.missing == {} and not recording.complete
        assert sum(1 for _ in recording.frames()) == 6
        assert sum(1 for _ in recording.messages([REPORT.name])) == 1


def test_the_viewer_shows_them(tmp_path: Path) -> None:
    from rrd import columns

    path, saved = write(tmp_path, pictures="end"), tmp_path / "run.rrd"
    assert main(["run", str(path), "--save", str(saved), "--record", str(tmp_path / "run.mcap")]) == 0
    (row,) = columns(saved, "EncodedImage:blob")["/render/yarns"]
    with open_recording(tmp_path / "run.mcap") as recording:
        (message,) = recording.messages([PICTURE.name])
    assert np.array(row, np.uint8).tobytes() == decode_picture(message.payload)


def test_it_runs_only_where_pictures_are_asked_for(tmp_path: Path) -> None:
    plans = {one: make_plan(scene_file.read(write(tmp_path, pictures=one)), Options()) for one in (None, "end", 2)}
    assert [("render" in plan.services) for plan in plans.values()] == [False, True, True]
    assert any("view.pictures" in text for text in plans[None].left_out)
    assert not any("render" in plan.must_see for plan in plans.values())


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> Refused:
    return Refused(capfd, tmp_path)


@pytest.mark.parametrize(
    ("view", "says"),
    [
        ({"pictures": "end", "target": [0, 0.4, 0], "distance": 0.01}, ["eye is inside a body", "view.distance"]),
        ({"pictures": "end", "yarns": {"plugin": "yarns", "radius": [1e-3, 2e-3]}}, ["one radius for each", "1: soft"]),
        ({"pictures": "often"}, ["view.pictures"]),
        ({"pictures": 0}, ["view.pictures"]),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_anything_starts(
    view: dict[str, Any], says: list[str], tmp_path: Path, refused: Refused
) -> None:
    said = refused("run", write(tmp_path, **view), "--no-view", "--record", tmp_path / "out" / "run.mcap")
    assert all(word in said for word in says), said
    assert not (tmp_path / "out" / "run.mcap").exists()


def test_a_plan_refuses_what_the_run_would(tmp_path: Path, refused: Refused) -> None:
    assert "eye is inside a body" in refused("plan", write(tmp_path, pictures="end", target=[0, 0.4, 0], distance=0.01))


def test_a_sheet_has_no_yarns_to_draw(refused: Refused) -> None:
    assert "no yarns to draw" in refused.run(view={"pictures": "end"})


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_run_fails_whose_renderer_is_gone_when_it_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for pictures while frames come, so that a run may be over before it is missed."""

    def vanish(context: Context, inbox: Inbox, handle: Callable[[Message], None]) -> Query:
        with context.bus.alive():
            while not isinstance(item := inbox.get(1.0), Message) or item.header.frame < 5:
                pass
        raise SystemExit

    monkeypatch.setattr("nuno.render.service.each_message", vanish)
    record = tmp_path / "run.mcap"
    outcome = supervisor.supervise(scene_file.read(write(tmp_path, pictures="end")), Options(record=record))
    # Whichever comes first: that it is gone, or its own last word.
    assert outcome.problem in ("failed: the render service died: SystemExit: ", "failed: render: SystemExit: ")
    with open_recording(record) as recording:
        assert not recording.complete
        assert recording.metadata["end"]["state"] == "failed"
        assert recording.series()["frame"].tolist() == [0, 1, 2, 3, 4, 5]
