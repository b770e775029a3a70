"""Nothing lost: messages by the hundred thousand through the hub into a recording, and who cannot keep up meanwhile."""

from __future__ import annotations

import json
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from nuno.bus.health import Watch
from nuno.bus.messages import Bus
from nuno.bus.sessions import hub_at, identity
from nuno.recording.reader import Recording, count_gaps, open_recording
from nuno.recording.recorded import Recorded
from nuno.runtime.service import SUPERVISOR
from nuno_bench.report.page import Result
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import STATE
from soak import scenes
from soak.processes import Processes, kept
from soak.traffic import payload_of, template

KB, MB = 1_000, 1_000_000
MOST_FACTOR, MOST_GROWTH = 1.1, 32 * MB
"""Memory counts as flat if it grows by no more than this share, or by no more than this many bytes."""
LOOK_SECONDS = 0.2
PATIENCE = 3600.0
"""Longest that one stream may take [s]."""
SLOW = 0.01, 1e6
"""What a slow subscriber takes for a message, and one that hangs [s]."""
SPARE = 2**30
"""Free space that is left over [bytes]."""


@dataclass(frozen=True)
class Stream:
    """A case: how many messages of what size, and who cannot keep up.

    disk     bytes a second that the recorder's disk takes; None: as many as it can
    seconds  what each of some other subscribers takes for a message
    stopped  seconds for which the recorder is stopped, a third of the way (by its file's size)
    frozen   whether one more subscriber is stopped for good
    """

    name: str
    count: int
    size: int
    disk: float | None = None
    seconds: tuple[float, ...] = ()
    stopped: float = 0.0
    frozen: bool = False


def streams(quick: bool) -> list[Stream]:
    """The cases, whole or as a small share of each."""
    part, slow, stop = (1000, 1, 1.0) if quick else (1, 20, 8.0)
    beside = "100 KB, beside a slow, a hung and a stopped subscriber"
    return [
        Stream("1 KB", 900_000 // part, KB),
        Stream("100 KB", 90_000 // part, 100 * KB),
        Stream("1 MB", 10_000 // part, MB),
        Stream("100 KB, disk of 20 MB/s", 100 * slow, 100 * KB, disk=20 * MB),
        Stream("100 KB, disk of 1 MB/s", 20 * slow, 100 * KB, disk=MB),
        Stream(beside, 500 * slow, 100 * KB, seconds=SLOW, frozen=True),
        Stream(f"100 KB, recorder stopped for {stop:g} s", 500 * slow, 100 * KB, stopped=stop),
    ]


def run(quick: bool, seed: int) -> list[Result]:
    """Every stream, then a long run. Raises BadInput where there is not enough room on the disk."""
    del seed
    with tempfile.TemporaryDirectory(prefix="nuno-lost-") as name:
        folder, results = Path(name), []
        for stream in streams(quick):
            need_room(folder, stream.count * stream.size)
            results += measure(folder, stream, judge_memory=not quick)
        return results + long_run(folder, 500 if quick else 20_000, judge_memory=not quick)


def need_room(folder: Path, size: int) -> None:
    """Raises BadInput where a file of `size` bytes, uncompressed as recordings are, would not fit."""
    free = shutil.disk_usage(folder).free
    if free < size + SPARE:
        remedy = "give another folder with TMPDIR, or take --quick"
        limit = f"{(size + SPARE) / 1e9:.1f} GB"
        raise BadInput("not enough room for the recording", str(folder), value=f"{free / 1e9:.1f} GB free", limit=limit,
                       remedy=remedy)  # fmt: skip


def measure(folder: Path, stream: Stream, judge_memory: bool) -> list[Result]:
    """One stream: what was lost, how fast it went, and how memory grew."""
    with Processes(folder) as live:
        try:
            sent, memory, answer = send(live, stream)
            lost, wrong = count_lost(live.record, stream)
        finally:
            kept(live.record).unlink(missing_ok=True)
    case = f"{stream.count:,} x {stream.name}"
    return [
        Result(case, "messages lost", "", (lost,), bar=0, at_most=True),
        Result(case, "messages changed", "", (wrong,), bar=0, at_most=True),
        Result(case, "recording complete", "", (float(bool(answer["complete"])),), bar=1),
        Result(case, "rate", "MB/s", (sent["bytes"] / sent["seconds"] / MB,)),
        Result(case, "longest wait of the publisher", "s", (sent["longest"],)),
        *(growth(case, memory) if judge_memory else []),
    ]


def send(live: Processes, stream: Stream) -> tuple[dict[str, Any], dict[str, Memory], dict[str, Any]]:
    """Send a stream from process to process; what the publisher did, memory, and what the recorder says."""
    with ExitStack() as stack:
        trusted = [identity(live.run, name) for name in ("simulation", "recorder")]
        session, endpoint = stack.enter_context(hub_at(None, None, trusted))
        supervisor = Bus(session, live.run, SUPERVISOR)
        alive = supervisor.alive()

        def start(role: str, name: str, **options: Any) -> Any:
            words = json.dumps({"endpoint": endpoint, "run": live.run} | options)
            return live.start(name, role, words, module="soak.traffic")

        recorder = start("recorder", "recorder", path=str(live.record), rate=stream.disk)
        for seconds in (*stream.seconds, *((0.0,) if stream.frozen else ())):
            other = start("subscriber", f"subscriber-{seconds:g}", seconds=seconds)
            if not live.wait_for("ready", f"subscriber-{seconds:g}"):
                raise RunFailed(f"a subscriber ended: {live.said()}")
            if seconds == 0.0:
                other.send_signal(signal.SIGSTOP)
        if Watch(supervisor).wait_for({"recorder"}, 120.0):
            raise RunFailed(f"the recorder did not start within 120 s: {live.said('recorder')}")
        publisher = start("publisher", "publisher", size=stream.size, count=stream.count)
        watched = {"publisher": Memory(publisher.pid), "recorder": Memory(recorder.pid)}
        for memory in watched.values():
            stack.enter_context(memory)
        if stream.stopped:
            threading.Thread(target=_stop, args=(recorder, live.record, stream), daemon=True).start()
        if not live.wait_for("{", "publisher", PATIENCE):
            raise RunFailed(f"the publisher ended: {live.said('publisher')}")
        sent = json.loads(live.said("publisher"))
        question = {"expected": {STATE.name: sent["sent"]}, "state": "done"}
        answer = supervisor.ask_json("finish/recorder", question, PATIENCE)
        if code := live.code("recorder", 60.0):
            raise RunFailed(f"the recorder ended with code {code}: {live.said('recorder')}")
        alive.undeclare()
        return sent, watched, answer


def _stop(recorder: Any, record: Path, stream: Stream) -> None:
    """Stop the recorder when a third of the stream is in its file, and let it go on."""
    third = stream.count * stream.size // 3
    while recorder.poll() is None and not (kept(record).exists() and kept(record).stat().st_size > third):
        time.sleep(0.01)
    recorder.send_signal(signal.SIGSTOP)
    time.sleep(stream.stopped)
    recorder.send_signal(signal.SIGCONT)


def count_lost(path: Path, stream: Stream) -> tuple[int, int]:
    """Messages that are not in the file, and those that are not what was sent under their number."""
    head, tail = template(stream.size)
    seen = wrong = 0

    def read(recording: Recording) -> Iterator[Recorded]:
        nonlocal seen, wrong
        for message in recording.messages([STATE.name]):
            seen += 1
            wrong += message.payload != payload_of(message.seq, head, tail)
            yield message

    with open_recording(path) as recording:
        gaps = sum(count_gaps(read(recording)).values())
    return max(stream.count - seen, gaps), wrong


@dataclass
class Memory:
    """Resident bytes of a process, looked at again and again while the block lasts."""

    pid: int
    samples: list[int] = field(default_factory=list)
    _over: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> Memory:
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        with suppress(psutil.Error):
            process = psutil.Process(self.pid)
            while not self._over.wait(LOOK_SECONDS):
                self.samples.append(process.memory_info().rss)


def growth(case: str, memory: dict[str, Memory]) -> list[Result]:
    """The most of the later three quarters of the time over that of the first.

    Memory is flat by its share or by its bytes, whichever is kinder to a small process.
    """
    found = []
    for who, seen in memory.items():
        quarter = max(1, len(seen.samples) // 4)
        first, later = max(seen.samples[:quarter]), max(seen.samples[quarter:] or seen.samples)
        bar = max(MOST_FACTOR, 1.0 + MOST_GROWTH / first)
        note = f"at most {first / MB:.1f} MB in the first quarter of the time, {later / MB:.1f} MB later"
        what = f"memory of the {who}, later over first"
        found.append(Result(case, what, "", (later / first,), bar=bar, at_most=True, note=note))
    return found


def long_run(folder: Path, frames: int, judge_memory: bool) -> list[Result]:
    """A tiny scene for many frames, as a user runs it."""
    scene = scenes.sheet(folder, frames / scenes.RATE, record={"checkpoint_every": 10.0})
    with Processes(folder) as live:
        begin = time.perf_counter()
        live.supervise(scene, "--no-view")
        with Memory(live.children["supervisor"].pid) as memory:
            live.wait_end(PATIENCE)
        seconds = time.perf_counter() - begin
    with open_recording(live.record) as recording:
        lost, complete = frames + 1 - recording.counts[STATE.name], recording.complete
    case = f"a run of {frames:,} frames of 36 vertices"
    return [
        Result(case, "frames lost", "", (lost,), bar=0, at_most=True),
        Result(case, "recording complete", "", (float(complete),), bar=1),
        Result(case, "frames", "1/s", (frames / seconds,)),
        *(growth(case, {"run": memory}) if judge_memory else []),
    ]
