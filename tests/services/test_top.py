"""What a run tells of itself: counts that agree with each other, and rates that follow from them."""

from __future__ import annotations

import json

import pytest
import zenoh
from live_run import Run, wait_until

from nuno.bus.health import Health, ask_health
from nuno.bus.messages import Bus
from nuno.cli import main
from nuno.cli.top import compare, table

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
        {"service": service, "time": time, "frame": frame, "leads": leads} | place | fields | counts
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
