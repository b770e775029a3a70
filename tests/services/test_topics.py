"""What a run publishes and counts can be found and listened to from outside."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from doc_pages import ROOT, blocks
from live_run import Run, wait_until
from scenes import BALL, write_scene

import nuno
from nuno.bus.health import Health, ask_health
from nuno.bus.messages import Bus, Inbox, Message
from nuno.cli import main
from nuno.cli.active_runs import compare, table
from nuno.runtime import runs
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import STATE, Topic
from nuno_schemas.messages import TOPICS as TOPICS_KNOWN

TOPICS = {
    "sim/fabric", "sim/state", "sim/status", "collision/geometry", "collision/bodies", "collision/report",
    "run/event/simulation", "ack/collision", "ack/recorder",
}  # fmt: skip
LATER = {"sim/checkpoint"}
"""Those that a run of a few frames may have or not."""


def told_of(run: Run, interval: float, capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, Any]]:
    """What `nuno topics` says of a run, by topic."""
    assert main(["topics", run.run, "--interval", str(interval), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["run"], told["endpoint"]) == (run.run, run.endpoint)
    return {line["topic"]: line for line in told["topics"]}


def test_a_run_says_where_its_bus_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Before anything else, and by the name that other commands take."""
    assert main(["run", str(write_scene(tmp_path)), "--run", "r1", "--no-record", "--no-view"]) == 0
    first = capsys.readouterr().err.splitlines()[0]
    assert first.startswith("run r1, its bus at tcp/127.0.0.1:")


def test_topics_are_those_that_a_subscriber_gets(
    paused: tuple[Run, zenoh.Session], capsys: pytest.CaptureFixture[str]
) -> None:
    """Names, numbers and sizes of a run that stands still."""
    run, session = paused
    run.wait_until_paused()
    lines = told_of(run, 0.05, capsys)
    assert set(lines) - LATER == TOPICS and not any(lines[name]["rate"] for name in TOPICS if name.startswith("sim/"))
    inbox = Inbox(Bus(session, run.run, "test"), [Topic("**", "json", "")], newest_only=True)
    run.control("step", frames=3)
    frame = run.wait_until_paused()
    got: list[Message] = []
    while isinstance(item := inbox.get(0.5), Message):
        got.append(item)
    states = [item for item in got if item.topic == STATE.name]
    assert [item.header.seq for item in states] == [lines[STATE.name]["messages"] + i for i in range(3)]
    after = told_of(run, 0.05, capsys)[STATE.name]
    size = after["messages"] * after["size"] - lines[STATE.name]["messages"] * lines[STATE.name]["size"]
    assert size == pytest.approx(sum(len(item.payload) for item in states))
    assert (lines[STATE.name]["type"], lines[STATE.name]["encoding"]) == ("foxglove.PointCloud", "protobuf")
    assert lines[STATE.name]["messages"] == states[0].header.frame == frame - 2
    assert main(["topics", run.run, "--interval", "0.05"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == f"zenoh at {run.endpoint}, keys nuno/{run.run}/TOPIC"
    assert {line.split()[0] for line in shown[2:]} - LATER == TOPICS


def test_rates_are_those_of_a_run_that_goes_on(
    paused: tuple[Run, zenoh.Session], capsys: pytest.CaptureFixture[str]
) -> None:
    """As many positions as statuses, and as many bytes as they have."""
    run, _ = paused
    run.control("resume")
    lines = told_of(run, 0.3, capsys)
    state = lines[STATE.name]
    assert state["rate"] > 0.0 and state["megabytes"] == pytest.approx(1e-6 * state["rate"] * state["size"], rel=0.1)
    assert lines["sim/status"]["rate"] == pytest.approx(state["rate"], rel=0.2)
    assert lines["sim/fabric"]["rate"] == 0.0


def test_the_subscriber_of_the_page_gets_every_frame_of_a_run(tmp_path: Path) -> None:
    """As it is written there: each frame's middle is that of the recording, and it ends with the run."""
    (script,) = blocks(ROOT / "docs" / "how-to" / "bus.md", "python")
    assert len([line for line in script.splitlines() if line.strip()]) <= 26
    (tmp_path / "listen.py").write_text(script)
    run = Run(write_scene(tmp_path), tmp_path / "run.mcap", paused=True)
    wait_until(lambda: run.run in runs.running())
    command = [sys.executable, str(tmp_path / "listen.py"), run.run, run.endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "listening\n"
        wait_until(lambda: run.control("status")["ok"])  # the hub has heard of it by now
        run.control("resume")
        lines = child.stdout.read().splitlines()
        assert child.wait(30) == 0
    assert run.join().state == "done"
    with nuno.open(run.record) as recording:
        kept = [[frame.number, frame.t, *frame.x.mean(axis=0)] for frame in recording.frames()]
    np.testing.assert_allclose([[float(word) for word in line.split()] for line in lines], kept, rtol=0, atol=1e-12)
    assert len(kept) == 26


def test_a_watcher_hears_what_is_recorded(tmp_path: Path) -> None:
    """Typed, frame by frame, from when it listens to the end; of some topics alone, where it asks for those."""
    run = Run(write_scene(tmp_path, bodies=BALL), tmp_path / "run.mcap", paused=True)
    wait_until(lambda: run.run in runs.running())
    every, events = nuno.watch(run.run), nuno.watch(run.run[:-1], "run/event", "sim/status")
    run.wait_until_paused()
    run.control("resume")
    heard, said = list(every), list(events)
    assert run.join().state == "done"
    with nuno.open(run.record) as recording:
        frames, told = list(recording.frames()), recording.events()
        statuses = recording.series()
    states = [one for one in heard if one.topic == "sim/state"]
    assert [(one.frame, one.t) for one in states] == [(frame.number, frame.t) for frame in frames]
    for one, frame in zip(states, frames, strict=True):
        np.testing.assert_array_equal(one.value, frame.x)
    assert [one.value for one in said if one.topic.startswith("run/event/")] == told
    kinetic = [one.value.energy["kinetic"] for one in said if one.topic == "sim/status"]
    np.testing.assert_array_equal(kinetic, statuses["energy_kinetic"])
    assert {one.topic for one in heard} >= {"collision/bodies", "collision/report", "ack/collision"}
    assert not any(one.skipped for one in heard)


def test_a_program_ends_that_has_left_its_listener_open(tmp_path: Path) -> None:
    """Kept in a variable, after a break or an exception: while the run goes on, Python does not wait for it."""
    run = Run(write_scene(tmp_path), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    program = f"import nuno; heard = nuno.watch({run.run!r}); print('listening', flush=True); raise SystemExit(3)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (ended.stdout, ended.stderr, ended.returncode) == ("listening\n", "", 3)
    run.stop()


def test_what_cannot_be_watched_is_said(tmp_path: Path) -> None:
    for words, said in ((("last", "sim/stat"), "did you mean 'sim/state'"), (("nowhere",), "no such run")):
        with pytest.raises(BadInput) as caught:
            nuno.watch(*words)
        assert said in str(caught.value)


def test_the_reference_is_that_of_the_schemas(capsys: pytest.CaptureFixture[str]) -> None:
    """Each field has a meaning, and each topic says when it comes."""
    assert main(["schema", "--messages"]) == 0
    said = capsys.readouterr().out
    rows = [line.split(" | ") for line in said.splitlines() if line.startswith("| `")]
    assert len(rows) > 50 and all(cell.strip("| ") for row in rows for cell in row)
    assert {topic.name for topic in TOPICS_KNOWN.values()} <= {row[0].strip("| `") for row in rows}


SERVICES = {"simulation", "collision", "recorder", "supervisor"}


def test_counts_of_a_paused_run_agree(paused: tuple[Run, zenoh.Session]) -> None:
    """The recorder has taken in all that the others sent, and no one is behind."""
    run, session = paused
    frame = run.wait_until_paused()
    bus = Bus(session, run.run, "test")

    def settled() -> bool:
        found = ask_health(bus, SERVICES)
        return found["recorder"].waiting == 0 and found["recorder"].frame == found["collision"].frame == frame

    wait_until(settled)
    found = ask_health(bus, SERVICES)
    assert set(found) == SERVICES
    assert [name for name, health in found.items() if health.leads] == ["simulation"]
    assert found["recorder"].received == sum(health.sent for health in found.values())
    assert found["recorder"].received_bytes == sum(health.sent_bytes for health in found.values())
    assert sum(health.missing + health.refused for health in found.values()) == 0
    lines = compare(found, ask_health(bus, SERVICES))
    assert (
        lines[0]["service"] == "simulation" and lines[0]["frames"] == 0.0 and {line["behind"] for line in lines} == {0}
    )


def health(service: str, time: float, frame: int, leads: bool = False, **counts: int) -> Health:
    fields = dict.fromkeys(("sent", "sent_bytes", "received", "received_bytes", "waiting", "missing", "refused"), 0)
    place = {"host": "h", "pid": 1, "t": frame / 50, "processor": 0.5 * time, "memory": 2**20, "topics": []}
    return Health.model_validate(
        {"service": service, "time": time, "frame": frame, "frames": frame, "leads": leads} | place | fields | counts
    )


def test_rates_and_what_is_behind_follow_from_two_looks() -> None:
    before = {"recorder": health("recorder", 7.0, 90), "simulation": health("simulation", 3.0, 100, leads=True)}
    after = {
        "recorder": health("recorder", 9.0, 150, received=120, received_bytes=3_000_000, missing=2),
        "simulation": health("simulation", 5.0, 160, leads=True, sent=60),
        "viewer": health("viewer", 1.0, 5),  # has come between the two
    }
    leader, recorder = compare(before, after)
    assert (leader["service"], leader["frames"], leader["sent"], leader["behind"], leader["late"]) == (
        "simulation",
        30.0,
        30.0,
        0,
        0.0,
    )
    assert (recorder["received"], recorder["received_megabytes"], recorder["missing"]) == (60.0, 1.5, 2)
    assert recorder["behind"] == 10 and recorder["late"] == pytest.approx(1000 * 10 / 30)
    assert recorder["processor"] == 0.5
    shown = table([leader, recorder]).splitlines()
    assert shown[1].split()[-4:] == ["50%", "1", "MiB", "h:1"] and shown[2].split()[-3:] == ['"', '"', "h:1"]


def test_one_look_from_the_command_line(paused: tuple[Run, zenoh.Session], capsys: pytest.CaptureFixture[str]) -> None:
    run, _ = paused
    assert main(["top", run.run, "--once", "--interval", "0.05", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["run"] == run.run and {line["service"] for line in told["services"]} == SERVICES
    assert main(["top", run.run, "--once", "--interval", "0.05"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"{run.run}: frame ") and "standing still" in said and "simulation" in said
    assert main(["top", "nothing-of-that-name", "--once"]) == 2
    assert "no such run is going on" in capsys.readouterr().err
    assert main(["top", "nothing-of-that-name", "--once", "--connect", run.endpoint]) == 2
    assert "no such run goes on there" in capsys.readouterr().err
