"""A garment that is dyed while it moves: two services in lockstep, each with the bits that it has alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from garment_scene import DROP, PASTE, alone, write
from live_run import Run
from numpy.typing import NDArray

import nuno
from nuno.bus.encodings import decode_arrays
from nuno.cli import main
from nuno.dye.run import DyeRun
from nuno.recording.reader import control_events
from nuno.replay.publisher import Replay
from nuno.resimulation.verification import verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import CONCENTRATION, DYE_STATUS, STATE, STATUS


@pytest.mark.full
@pytest.mark.parametrize("how", [{}, {"processes": True}])
def test_each_has_the_bits_that_it_has_alone(how: dict[str, Any], tmp_path: Path) -> None:
    both = nuno.run(write(tmp_path), record=tmp_path / "both.mcap", **how)
    cloth = nuno.run(write(tmp_path, dye=None), record=tmp_path / "cloth.mcap")
    dye = nuno.run(alone(tmp_path), record=tmp_path / "dye.mcap")
    assert both.report["services"] == ["simulation", "dye", "collision", "recorder"]
    assert both.recording.complete and both.recording.counts[CONCENTRATION.name] == 11
    assert both.recording.marks() == cloth.recording.marks()
    assert both.recording.marks(DYE_STATUS.name) == dye.recording.marks()
    assert both.digest == cloth.digest and both.report["dye_steps"]["digest"] == dye.digest
    assert both.report["dye"] == dye.report["dye"] and both.report["energy"] == cloth.report["energy"]
    assert np.array_equal(both.x, cloth.x) and np.array_equal(both.phi, dye.phi)
    found = verify(both.recording)
    assert (found.frame, found.compared, found.dyed) == (None, 11, 11)
    rows = both.recording.series()
    assert np.array_equal(rows["mobile_blue"], dye.recording.series()["mobile_blue"])
    assert rows["steps"].tolist() == cloth.recording.series()["steps"].tolist()
    assert rows["dye_steps"].tolist() == dye.recording.series()["steps"].tolist()


def test_the_cloth_of_the_dye_says_what_it_lies_on(tmp_path: Path) -> None:
    path = nuno.run(write(tmp_path), record=tmp_path / "both.mcap").path
    with nuno.open(path) as recording:
        message = recording.last("dye/cloth")
        assert message is not None and decode_arrays(message.payload)[1]["object"] == "sheet"
    assert main(["export", str(path), "--npz", str(tmp_path / "out.npz"), "--csv", str(tmp_path / "out.csv")]) == 0
    with np.load(tmp_path / "out.npz") as out:
        assert sorted(out) == ["fixed", "phi", "t", "v", "x"]


def test_the_verification_of_both_finds_what_differs_in_either(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = nuno.run(write(tmp_path), record=tmp_path / "both.mcap")
    with monkeypatch.context() as patch:
        patch.setattr("nuno.dye.run.DyeRun.digest", lambda self: "another")
        found = verify(result.recording)
        assert found.frame == 0 and found.compared > 0
    with monkeypatch.context() as patch:
        patch.setattr("nuno.simulation.run.Simulation.digest", lambda self: "another")
        found = verify(result.recording)
        assert found.frame == 0 and found.compared == 0


def test_both_are_resumed_from_the_last_frame_that_both_have_kept(tmp_path: Path) -> None:
    whole = nuno.run(write(tmp_path), record=tmp_path / "whole.mcap")
    part = nuno.run(write(tmp_path), "duration=0.12", record=tmp_path / "part.mcap")
    cut = _without_last_checkpoint(part.path, "dye/checkpoint")
    for path, frame in ((part.path, 6), (cut, 4)):
        with nuno.open(path) as recording:
            assert round(recording.common_checkpoint().t * 50) == frame
        options = Options(record=tmp_path / "on.mcap", resume=path)
        resumed = supervisor.supervise(scene_file.read(write(tmp_path)), options)
        assert resumed.state == "done" and resumed.summary["digest"] == whole.digest
        assert resumed.services["dye"]["summary"]["digest"] == whole.report["dye_steps"]["digest"]
        with nuno.open(tmp_path / "on.mcap") as ours:
            assert ours.marks() == whole.recording.marks()
            assert ours.marks(DYE_STATUS.name) == whole.recording.marks(DYE_STATUS.name)
            _require_the_columns_of(ours, whole.recording, part.recording.series(), frame)
            found = verify(ours)
            assert (found.frame, found.compared, found.dyed) == (None, 11, 11)


def _require_the_columns_of(
    ours: nuno.Recording, whole: nuno.Recording, part: dict[str, NDArray[Any]], frame: int
) -> None:
    """All columns are those of the unbroken run, and wall times until the checkpoint those of the resumed one."""
    columns, others = ours.series(), whole.series()
    assert columns.keys() == others.keys()
    for name in columns:
        if name in ("step_seconds", "dye_step_seconds"):
            assert np.array_equal(columns[name][: frame + 1], part[name][: frame + 1])
        else:
            assert np.array_equal(columns[name], others[name]), name
    counts = [[one.said(m)["counts"] for m in one.messages([STATUS.name])] for one in (ours, whole)]
    assert counts[0] == counts[1]


def _without_last_checkpoint(path: Path, topic: str) -> Path:
    """A copy of a recording in which one service has not come to its last checkpoint."""
    from nuno.recording.writer import RecordingWriter
    from nuno.scene.provenance import assets, describe_run
    from nuno.scene.recorded_scene import restored_scene
    from nuno_schemas.messages import Header

    cut = path.with_name("cut.mcap")
    with nuno.open(path) as recording, restored_scene(recording) as loaded:
        last = recording.last(topic)
        assert last is not None
        writer = RecordingWriter(cut, describe_run(loaded, "cut"), assets(loaded))
        for message in recording.messages():
            if (message.topic, message.seq) != (topic, last.seq):
                writer.write(
                    message.topic, Header(run="", service="", seq=message.seq, frame=0, t=message.t), message.payload
                )
        writer.finish({})
    return cut


def test_one_control_holds_both(tmp_path: Path) -> None:
    run = Run(write(tmp_path, duration=400.0), tmp_path / "long.mcap")
    assert run.moved.wait(60)
    run.control("pause")
    paused = run.wait_until_paused()
    run.control("step", frames=3)
    assert run.wait_until_paused() == paused + 3
    added = run.control("add", item=json.dumps({"resist": PASTE}))
    assert added["field"] == "dye.cloth.resist[0]" and (added["state"], added["frame"]) == ("paused", paused + 3)
    refused = run.control("add", item=json.dumps({"resist": PASTE | {"width": 0}}))
    assert not refused["ok"] and "dye.cloth.resist[1].width" in refused["error"]
    refused = run.control("set", item="dye.dyes.0.D0=1")
    assert not refused["ok"] and "nuno control RUN add" in refused["error"]
    assert run.control("set", item="gravity=[0, -1, 0]")["ok"]
    run.control("step", frames=2)
    assert run.wait_until_paused() == paused + 5
    run.control("resume")
    assert run.stop().state == "stopped"
    with nuno.open(run.record) as recording:
        assert recording.complete and recording.counts[STATE.name] == recording.counts[CONCENTRATION.name]
        cloth, dye = recording.marks(), recording.marks(DYE_STATUS.name)
        assert cloth.keys() == dye.keys() and len(cloth) > paused + 5
        texts = [event.text for event in control_events(recording)]
        assert texts == ["pause", "step", "add", "set", "step", "resume", "stop"]
        found = verify(recording)
        assert (found.frame, found.compared, found.dyed) == (None, len(cloth), len(dye))


def test_while_paused_both_stand_at_the_same_frame(tmp_path: Path) -> None:
    run = Run(write(tmp_path, duration=400.0), tmp_path / "long.mcap")
    assert run.moved.wait(60)
    run.control("pause")
    frame = run.wait_until_paused()
    # An addition is applied at the frame of the dye: the answer comes from there.
    answers = {run.control("add", item=json.dumps({"supply": DROP | {"amount": 0.1}}))["frame"] for _ in range(3)}
    run.stop()
    with nuno.open(run.record) as recording:
        assert answers <= {frame} and len(recording.marks(DYE_STATUS.name)) == frame + 1


def test_a_dye_that_does_not_answer_does_not_end_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The addition waits for the frame that is being dyed, whoever asked for it does not."""
    before, slow = DyeRun.advance, threading.Event()

    def advance(self: DyeRun) -> Any:
        if slow.is_set():
            time.sleep(0.3)
        return before(self)

    monkeypatch.setattr(DyeRun, "advance", advance)
    monkeypatch.setattr("nuno.runtime.driver.FOLLOWER_TIMEOUT", 0.05)
    run = Run(write(tmp_path, duration=400.0), tmp_path / "long.mcap")
    assert run.moved.wait(60)
    slow.set()
    answers = [run.control("add", item=json.dumps({"supply": DROP})) for _ in range(3)]
    slow.clear()
    refused = [answer for answer in answers if not answer["ok"]]
    assert refused and all("may still do" in answer["error"] for answer in refused)
    assert run.stop().state == "stopped"
    with nuno.open(run.record) as recording:
        assert recording.complete and verify(recording).frame is None


def test_cloth_that_comes_to_rest_ends_the_dyeing(tmp_path: Path) -> None:
    """Without gravity it rests from the start: after a tenth of a second."""
    result = nuno.run(
        write(tmp_path, until="rest", gravity=[0, 0, 0], bodies=[], duration=10.0), record=tmp_path / "both.mcap"
    )
    assert result.report["rested"] and result.recording.complete
    frames = [len(result.recording.marks(topic)) for topic in (None, DYE_STATUS.name)]
    assert frames[0] == frames[1] < 20
    assert verify(result.recording).dyed == frames[1]


def test_a_replay_sends_the_digests_of_both(tmp_path: Path) -> None:
    from nuno.bus.messages import Bus, Inbox, Message
    from nuno.bus.sessions import hub_at

    result = nuno.run(write(tmp_path), record=tmp_path / "both.mcap")
    with hub_at(None, None) as (session, _):
        inbox = Inbox(Bus(session, "again", "test"), [STATE, CONCENTRATION])
        Replay(None).run(Bus(session, "again", "replay"), result.recording)
        got: dict[str, list[str]] = {STATE.name: [], CONCENTRATION.name: []}
        while isinstance(item := inbox.get(1.0), Message):
            got[item.topic].append(item.header.digest)
    assert got[STATE.name] == [digest for _, digest in result.recording.marks().values()]
    assert got[CONCENTRATION.name] == [digest for _, digest in result.recording.marks(DYE_STATUS.name).values()]


def test_a_dye_that_fails_ends_the_run_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = DyeRun.advance

    def advance(self: DyeRun) -> Any:
        if self.frame == 3:
            raise ArithmeticError("no more dye")
        return before(self)

    monkeypatch.setattr(DyeRun, "advance", advance)
    outcome = supervisor.supervise(scene_file.read(write(tmp_path)), Options(record=tmp_path / "both.mcap"))
    assert outcome.state == "failed" and "dye service died: ArithmeticError: no more dye" in outcome.error


PROGRAM = """
import json, os, sys
from nuno.cli import main
code = main(["run", "scene.yaml", "--no-view", "--record", "one.mcap"])
print(json.dumps([code, sorted(sys.modules)]))
sys.stdout.flush()
os._exit(0)
"""

MESH = "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"
TILED = "v 0 0 0\nv 1 0 0\nv 0 0 1\nvt 0 0\nvt 3 0\nvt 0 3\nf 1/1 2/2 3/3\n"


@pytest.mark.parametrize(
    ("fields", "field", "words"),
    [
        ({"dye": {"object": "sheat"}}, "dye.object", "did you mean 'sheet'"),
        ({"dye": {"object": "sheet"}, "objects": []}, "dye.object", "known: none"),
        ({"dye": {"object": "cape"}, "mesh": MESH}, "objects[0].model", "'cape'"),
        ({"dye": {"object": "cape"}, "mesh": MESH}, "objects[0].model", "give the mesh texture coordinates"),
        ({"dye": {"object": "cape"}, "mesh": TILED}, "objects[0].model", "0 to 3"),
        ({"dye": {"on": "sheet"}}, "dye.on", "the object that is dyed is `object`: write object: sheet"),
        ({"dye": {True: "sheet"}}, "dye.true", "write object: sheet"),
        ({"dye": {"object": None}}, "objects", "name the object that is dyed as dye.object"),
        ({"dye": {"solver": {"plugin": "explicit", "dt": "100 s"}}}, "dye.solver.dt", "a dye.speed of at least 5000"),
        ({"dye": {"dyes": []}}, "dye.dyes", "too short"),
        ({"dye": {"picture": {"crop": {"low": [0, 0], "high": [1, 1]}}}}, "dye.picture.crop", "shows all of the cloth"),
    ],
)
def test_garments_are_refused_by_name(fields: dict[str, Any], field: str, words: str, tmp_path: Path) -> None:
    mesh = fields.get("mesh")
    if mesh is not None:
        (tmp_path / "cape.obj").write_text(mesh)
        fields = {"dye": fields["dye"], "objects": [{"name": "cape", "model": {"plugin": "mesh", "file": "cape.obj"}}]}
    with pytest.raises(BadInput) as refused:
        nuno.run(write(tmp_path, **fields), record=tmp_path / "run.mcap")
    assert f"{field}: " in str(refused.value) and words in str(refused.value)
    assert list(tmp_path.glob("*.mcap*")) == []


@pytest.mark.full
def test_a_garment_without_bodies_starts_no_collision_service(tmp_path: Path) -> None:
    write(tmp_path, bodies=[])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, env=os.environ, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    code, modules = json.loads(done.stdout.splitlines()[-1])
    assert code == 0 and "nuno.dye.service" in modules and "nuno.simulation.service" in modules
    assert [name for name in modules if "nuno.collision.service" in name or "nuno_contact" in name] == []


def test_a_plan_names_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(write(tmp_path))]) == 0
    said = capsys.readouterr().out
    assert "services  simulation, dye, collision, recorder" in said
    assert (
        "on sheet, 0.55 mm x 0.45 mm: 198 cells" in said
        and "72 vertices" in said
        and "wrinkles: the scene has none" in said
    )
    assert "720 s of dyeing" in said
