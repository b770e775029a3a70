"""Nothing lost: messages by the hundred thousand through the hub into a recording, and who cannot keep up meanwhile."""

from __future__ import annotations

import json
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL, PIPE
from typing import Any

from mcap.writer import CompressionType, Writer

from nuno.recording.gaps import gaps_of
from nuno.recording.reader import Recording, open_recording
from nuno.recording.recorded import Recorded
from nuno.service import SUPERVISOR
from nuno.supervision import runs
from nuno.wire.bus import Bus
from nuno.wire.sessions import hub_at, identity
from nuno.wire.watch import Watch
from nuno_bench.report.result import Result
from nuno_bench.soak import small
from nuno_bench.soak.lost.processes import Memory, ended, started
from nuno_bench.soak.lost.traffic import payload_of, template
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import STATE

KB, MB = 1_000, 1_000_000
MOST_FACTOR, MOST_GROWTH = 1.1, 32 * MB
"""Memory counts as flat if it grows by no more than this share, or by no more than this many bytes."""
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
    part = 1000 if quick else 1
    slow, stop = (1, 1.0) if quick else (20, 8.0)
    return [
        Stream("1 KB", 900_000 // part, KB),
        Stream("100 KB", 90_000 // part, 100 * KB),
        Stream("1 MB", 10_000 // part, MB),
        Stream("100 KB, disk of 20 MB/s", 100 * slow, 100 * KB, disk=20 * MB),
        Stream("100 KB, disk of 1 MB/s", 20 * slow, 100 * KB, disk=MB),
        Stream(
            "100 KB, beside a slow, a hung and a stopped subscriber", 500 * slow, 100 * KB, seconds=SLOW, frozen=True
        ),
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
    path = folder / "stream.mcap"
    try:
        sent, memory, answer = send(path, stream)
        lost, wrong = count_lost(path, stream)
    finally:
        path.unlink(missing_ok=True)
        path.with_name(path.name + ".part").unlink(missing_ok=True)
    case = f"{stream.count:,} x {stream.name}"
    rate = sent["bytes"] / sent["seconds"] / MB
    results = [
        Result(case, "messages lost", "", (lost,), bar=0, at_most=True),
        Result(case, "messages changed", "", (wrong,), bar=0, at_most=True),
        Result(case, "recording complete", "", (float(bool(answer["complete"])),), bar=1),
        Result(case, "rate", "MB/s", (rate,)),
        Result(case, "longest wait of the publisher", "s", (sent["longest"],)),
    ]
    if stream.disk is None and not stream.seconds and not stream.stopped:
        results.append(Result(case, "rate over that of mcap's own writer", "", (rate / plain_rate(path, stream),)))
    return results + (_growth(case, memory) if judge_memory else [])


def _growth(case: str, memory: dict[str, Memory]) -> list[Result]:
    """Rows about memory: it is flat by its share or by its bytes, whichever is kinder to a small process."""
    found = []
    for who, seen in memory.items():
        first, later = seen.largest()
        bar = max(MOST_FACTOR, 1.0 + MOST_GROWTH / first)
        note = f"at most {first / MB:.1f} MB in the first quarter of the time, {later / MB:.1f} MB later"
        what = f"memory of the {who}, later over first"
        found.append(Result(case, what, "", (later / first,), bar=bar, at_most=True, note=note))
    return found


def send(path: Path, stream: Stream) -> tuple[dict[str, Any], dict[str, Memory], dict[str, Any]]:
    """Send a stream from process to process; what the publisher did, memory, and what the recorder says."""
    run = runs.new_id("lost")
    with ExitStack() as stack:
        trusted = [identity(run, name) for name in ("simulation", "recorder")]
        session, endpoint = stack.enter_context(hub_at(None, None, trusted))
        supervisor = Bus(session, run, SUPERVISOR)
        alive = supervisor.alive()
        where = {"endpoint": endpoint, "run": run}
        recorder = stack.enter_context(_child("recorder", where | {"path": str(path), "rate": stream.disk}))
        frozen = (0.0,) if stream.frozen else ()
        for seconds in (*stream.seconds, *frozen):
            other = stack.enter_context(_child("subscriber", where | {"seconds": seconds}, stdin=PIPE, stdout=PIPE))
            assert other.stdout is not None
            assert other.stdout.readline() == "ready\n"
            if seconds == 0.0:
                other.send_signal(signal.SIGSTOP)
        if Watch(supervisor).wait_for({"recorder"}, 120.0):
            raise TimeoutError("the recorder did not start within 120 s")
        options = where | {"size": stream.size, "count": stream.count}
        publisher = stack.enter_context(_child("publisher", options, stdout=PIPE))
        watched = {"publisher": Memory(publisher.pid), "recorder": Memory(recorder.pid)}
        for memory in watched.values():
            stack.enter_context(memory)
        if stream.stopped:
            threading.Thread(target=_stop, args=(recorder, path, stream), daemon=True).start()
        sent = json.loads(ended(publisher, PATIENCE))
        question = {"expected": {STATE.name: sent["sent"]}, "state": "done"}
        answer = supervisor.ask_json("finish/recorder", question, PATIENCE)
        ended(recorder, 60.0)
        alive.undeclare()
        return sent, watched, answer


def _child(role: str, options: dict[str, Any], **pipes: Any) -> Any:
    pipes = {"stdin": DEVNULL} | pipes
    return started(["nuno_bench.soak.lost.traffic", role, json.dumps(options)], **pipes)


def _stop(recorder: Any, path: Path, stream: Stream) -> None:
    """Stop the recorder when a third of the stream is in its file, and let it go on."""
    part, third = path.with_name(path.name + ".part"), stream.count * stream.size // 3
    while recorder.poll() is None and not (part.exists() and part.stat().st_size > third):
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
        gaps = sum(gap.number for gap in gaps_of(read(recording)))
    return max(stream.count - seen, gaps), wrong


def plain_rate(path: Path, stream: Stream) -> float:
    """MB/s of the mcap library's own writer, in one process, of at most 1 GB of such messages."""
    head, tail = template(stream.size)
    payload, count = payload_of(0, head, tail), min(stream.count, 1000 * MB // stream.size)
    begin = time.perf_counter()
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4 * 2**20, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel(STATE.name, STATE.encoding, writer.register_schema("x", "protobuf", b""))
        for number in range(count):
            writer.add_message(channel, number, payload, number, number)
        writer.finish()
    path.unlink()
    return count * len(payload) / (time.perf_counter() - begin) / MB


def long_run(folder: Path, frames: int, judge_memory: bool) -> list[Result]:
    """A tiny scene for many frames, as a user runs it."""
    scene, path = small.write(folder, frames / 50, record={"checkpoint_every": 10.0}), folder / "long.mcap"
    begin = time.perf_counter()
    arguments = ["nuno", "run", str(scene), "--record", str(path), "--no-view"]
    with started(arguments, stdout=DEVNULL, stderr=DEVNULL) as child, Memory(child.pid) as memory:
        ended(child, PATIENCE)
        seconds = time.perf_counter() - begin
    with open_recording(path) as recording:
        lost, complete = frames + 1 - recording.counts[STATE.name], recording.complete
    path.unlink()
    case = f"a run of {frames:,} frames of 36 vertices"
    return [
        Result(case, "frames lost", "", (lost,), bar=0, at_most=True),
        Result(case, "recording complete", "", (float(complete),), bar=1),
        Result(case, "frames", "1/s", (frames / seconds,)),
        *(_growth(case, {"run": memory}) if judge_memory else []),
    ]
