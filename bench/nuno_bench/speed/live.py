"""Poses from another process into a skirt that swings by the clock: what is lost on the way, and how old it is then."""

from __future__ import annotations

import multiprocessing
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import yaml

import nuno
from nuno.bus.messages import ALL, Bus, Inbox, Message
from nuno.bus.sessions import spoke
from nuno.collision.messages import decode_poses
from nuno.runtime import runs, supervisor
from nuno.runtime.outcome import Outcome
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment
from nuno.scene import scene_file
from nuno.simulation.solver_selection.cloth import decide
from nuno_bench.machine import cores
from nuno_bench.report.page import Result
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import BODIES, STATE

RATE, SECONDS, BODY = 100.0, 4.0, "hips"
"""Poses and frames a second; how long they are sent; whom."""
MOST = 3
"""Runs at most."""
PATIENCE = 120.0
"""Longest that a run is waited for before it stands still at its first frame [s]: it may compile."""
SWING = 0.1
"""Amplitude of the hips' motion [m]."""


def live(repeats: int) -> list[Result]:
    """A skirt of 3,072 vertices on hips that another process moves a hundred times a second."""
    found = [measure() for _ in range(min(repeats, MOST))]
    what = "3,072-vertex skirt, poses at 100 Hz on loopback: "

    def of(name: str) -> tuple[float, ...]:
        return tuple(one[name] for one in found)

    note = "from sending poses to receiving the first state that they are in, frames of 10 ms"
    return [
        Result("live", what + "poses that did not come", "poses", of("lost"), bar=0.0, at_most=True),
        Result("live", what + "frames that did not come", "frames", of("missing"), bar=0.0, at_most=True),
        Result("live", what + "frames that were late", "frames", of("late")),
        Result("live", what + "age, median", "frames", of("median"), bar=2.0, at_most=True, note=note),
        Result("live", what + "age, 99 of 100", "frames", of("most"), bar=2.0, at_most=True, note=note),
    ]


def measure() -> dict[str, float]:
    """Measure one run. Raises RunFailed if it does not reach its end."""
    with tempfile.TemporaryDirectory() as folder, _standing(Path(folder)) as (run, endpoint, outcome):
        receiver, sender = multiprocessing.get_context("spawn").Pipe(duplex=False)
        arrived = _Arrivals(run, endpoint)
        process = multiprocessing.get_context("spawn").Process(target=send_poses, args=(run, endpoint, sender))
        process.start()
        assert receiver.recv() == "sending"
        supervisor.control(run, endpoint, {"action": "resume"})
        sent = np.array(receiver.recv())
        process.join()
        ended = outcome()
        arrived.join()
    if ended.state != "done":
        raise RunFailed(f"{ended.state}: {ended.error}")
    followed = ended.services["collision"]["followed"][BODY]
    first = {number: at for at, number in sorted(arrived.ages(), reverse=True)}
    ages = [(at - sent[number]) * RATE for number, at in first.items()]
    return {
        "lost": float(len(sent) - followed["heard"]),
        "missing": float(arrived.skipped),
        "late": float(ended.summary["clock"]["late"]),
        "median": float(np.median(ages)),
        "most": float(np.percentile(ages, 99)),
    }


def send_poses(run: str, endpoint: str, connection: Connection) -> None:
    """Send poses whose heights encode their numbers, and then the times at which they were sent [s]."""
    with nuno.drive(run, BODY, connect=endpoint) as body:
        body.send((0.0, 0.0, 0.0))
        connection.send("sending")
        start, sent = time.monotonic(), [time.monotonic()]
        for number in range(1, round(SECONDS * RATE)):
            due = start + number / RATE
            time.sleep(max(0.0, due - time.monotonic()))
            sent.append(time.monotonic())
            body.send((SWING * np.sin(2.0 * np.pi * number / RATE), height_of(number), 0.0))
        connection.send(sent)


def height_of(number: int) -> float:
    """By how much the hips are raised with the pose of a number [m]: too little to be seen, and exact to the bit."""
    return 1e-6 * number


class _Arrivals(threading.Thread):
    """Records the arrival times of a run's states, and the number of the pose that each follows."""

    def __init__(self, run: str, endpoint: str) -> None:
        super().__init__(daemon=True)
        self.run_id, self.endpoint, self.skipped = run, endpoint, 0
        self._states: dict[int, float] = {}
        self._poses: dict[int, int] = {}
        self._listens = threading.Event()
        self.start()
        self._listens.wait()

    def run(self) -> None:
        """Listen until the run is over."""
        with spoke(self.endpoint) as session:
            bus = Bus(session, self.run_id, "bench")
            inbox = Inbox(bus, [ALL], newest_only=True)
            bus.present()  # once this is answered, the hub knows of who listens
            self._listens.set()
            while (message := inbox.get(timeout=2.0)) is not None:
                if not isinstance(message, Message):
                    continue
                if message.topic == STATE.name:
                    self._states[message.header.frame] = time.monotonic()
                    self.skipped += message.skipped
                elif message.topic == BODIES.name:
                    height = decode_poses(message.payload).translation[0, 1]
                    self._poses[message.header.frame] = round(height / height_of(1))

    def ages(self) -> Iterator[tuple[float, int]]:
        """Yield the arrival time [s] and the pose's number of each state that follows a pose."""
        for frame, at in self._states.items():
            if self._poses.get(frame, 0) > 0:
                yield at, self._poses[frame]


@contextmanager
def _standing(folder: Path) -> Iterator[tuple[str, str, Callable[[], Outcome]]]:
    """A run that stands at its first frame: its id, its endpoint, and what waits for how it ends."""
    skirt = {
        "plugin": "skirt", "waist_radius": "13 cm", "hem_radius": "22 cm", "length": "45 cm", "columns": 96, "rows": 32,
        "attach": {"body": BODY, "frame": "body"}, "fabric": "denim",
    }  # fmt: skip
    scene = {
        "nuno": 1, "name": "live", "duration": SECONDS, "frame_rate": RATE, "damping": 1.0, "accuracy": "preview",
        "objects": [{"name": "skirt", "model": skirt}],
        "bodies": [{
            "name": BODY, "motion": {"plugin": "topic"},
            "collider": {"plugin": "capsule", "a": [0, -0.1, 0], "b": [0, 0.1, 0], "radius": "12 cm"},
        }],
    }  # fmt: skip
    path = folder / "live.yaml"
    path.write_text(yaml.safe_dump(scene))
    loaded, run = decide(scene_file.read(path)), runs.new_id("live")
    ended: list[Outcome] = []
    options = Options(threads=cores())

    def go() -> None:
        ended.append(supervisor.supervise(loaded, options, Deployment(run=run, paused=True)))

    thread = threading.Thread(target=go, daemon=True)
    thread.start()
    end = time.monotonic() + PATIENCE
    while run not in runs.running() or not _stands(run):
        if time.monotonic() > end or not thread.is_alive():
            raise RunFailed("the run did not come to its first frame")
        time.sleep(0.05)

    def outcome() -> Outcome:
        thread.join()
        return ended[0]

    yield run, runs.running()[run], outcome


def _stands(run: str) -> bool:
    try:
        return bool(supervisor.control(run, runs.running()[run], {"action": "status"})["state"] == "paused")
    except (RunFailed, KeyError):
        return False
