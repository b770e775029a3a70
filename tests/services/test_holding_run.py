"""Cloth that is taken hold of while a run goes on: by the command line, by whoever asks on the bus, and recorded."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import zenoh
from live_run import Run
from scenes import BALL, write_scene

import nuno
from nuno.bus.sessions import spoke
from nuno.cli import main
from nuno.resimulation.verification import verify

SHEET = {"plugin": "sheet", "size": [0.2, 0.2], "resolution": [9, 9], "plane": "xz", "centre": [0.3, -0.09, 0.0]}


def hanging(folder: Path) -> Path:
    """A sheet, held at two corners, on a ball."""
    return write_scene(
        folder, bodies=BALL, objects=[{"name": "cloth", "model": SHEET}], solver="symplectic_euler", duration=0.4
    )


def ask(session: zenoh.Session, run: Run, **request: object) -> dict[str, object]:
    """What a program that knows nothing of nuno does: a question to `nuno/RUN/control`, in JSON."""
    replies = session.get(f"nuno/{run.run}/control", payload=json.dumps(request), timeout=60.0)
    for reply in replies:
        assert reply.ok is not None
        answer: dict[str, object] = json.loads(reply.ok.payload.to_bytes())
        return answer
    raise AssertionError("no answer")


@pytest.mark.parametrize("way", ["command", "bus"])
def test_a_run_is_told_to_hold_and_to_let_go(tmp_path: Path, way: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Both are recorded, what is refused is told and leaves no trace, and the run is verified to the last bit, as is
    one that goes on from a checkpoint in between.
    """
    run = Run(hanging(tmp_path), tmp_path / "run.mcap", paused=True)
    run.step_to(3)
    with spoke(run.endpoint) as session:

        def add(item: str) -> tuple[bool, str]:
            if way == "command":
                code = main(["control", run.run, "add", item])
                return code == 0, capsys.readouterr().err
            answer = ask(session, run, action="add", item=item)
            return bool(answer["ok"]), str(answer.get("error"))

        held, told = add("release: {body: ball}")
        assert not held and "nothing is attached to this body" in told
        assert add("attach: {body: ball, within: 1 cm}")[0]
        held, told = add("attach: {body: ball, within: 1 cm}")
        assert not held and "held already" in told
        run.step_to(12)
        assert add("release: {body: ball}")[0]
    run.control("resume")
    assert run.join().state == "done"
    with nuno.open(tmp_path / "run.mcap") as recording:
        found = verify(recording)
        assert found.frame is None and found.compared == 21
        done = [(event.frame, event.args["item"].split(":")[0]) for event in recording.events() if event.text == "add"]
    assert done == [(3, "attach"), (12, "release")]
    assert [change["operation"] for change in run.report["changes"]] == ["attach", "release"]
