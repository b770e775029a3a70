"""Every service, the router and the supervisor killed at random moments of a run, and what is left of it."""

from __future__ import annotations

import contextlib
import random
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from nuno.recording.reader import open_recording
from nuno_bench.report.page import Result
from nuno_schemas.errors import BadInput, RunFailed
from soak import scenes
from soak.processes import COLD, HUNG, POLL, Digests, Processes, digests, kept, kill, resume

SERVICES = ("simulation", "collision", "dye", "render", "recorder", "viewer")
TARGETS = (*SERVICES, "router", "supervisor")
KILLS, FEW, ATTEMPTS = 100, 4, 5
PHASES = {"start": 0.25, "run": 0.5, "close": 0.25}
"""Parts of a run that moments are drawn from, and how often. By hand nothing is killed at the start: what dies before
it has said that it is there cannot be told from what is yet to be started."""
DURATION = 2.0
"""Simulated seconds, which take about as long."""
FIRST, LAST = "0.00 of", f"{DURATION:.2f} of"
"""What `nuno run` says of its first and its last frame."""
NOTICE = 2.0
"""Longest that the others may take to notice [s]."""
WORDS = ("the services end in order", "goes on without", "did not finish")
"""With which they say that they have."""
MUST_NOT = ("other words", "unreadable", "other digests", "left over")


@dataclass
class Span:
    """Seconds that the parts of an undisturbed run take, and its digests."""

    seconds: dict[str, float]
    digests: Digests


@dataclass
class Tally:
    """What happened to the runs of which one service was killed; `faults` is what must not be, by kind."""

    kills: int = 0
    notice: list[float] = field(default_factory=list)
    ended: list[float] = field(default_factory=list)
    resumed: int = 0
    faults: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))


def run(quick: bool, seed: int) -> list[Result]:
    """Kill `KILLS` times, the targets in turn, half of the runs started by hand."""
    rng = random.Random(seed)
    tallies: dict[str, Tally] = defaultdict(Tally)
    with tempfile.TemporaryDirectory(prefix="nuno-faults-") as name:
        scene = scenes.everything(Path(name), DURATION)
        undisturbed(scene, False)  # what has to be compiled is compiled here
        spans = {by_hand: undisturbed(scene, by_hand) for by_hand in (False, True)}
        if spans[False].digests != spans[True].digests:
            return [Result("undisturbed", "digests", "", failure="differ between the two ways to start services")]
        before = shared_bytes()
        for i in range(FEW if quick else KILLS):
            target = TARGETS[i % len(TARGETS)] if not quick else rng.choice(TARGETS)
            by_hand = target == "router" or (i // len(TARGETS)) % 2 == 1
            for _ in range(ATTEMPTS):
                if disturb(scene, target, by_hand, spans[by_hand], rng, tallies[target]):
                    break
        undisturbed(scene, False)  # the next clean start takes away what killed processes left
        left = max(0, shared_bytes() - before) / 2**20
    shared = Result("all kills", "shared memory left after the next run", "MiB", (left,), bar=32.0, at_most=True)
    return [*(row for name in TARGETS if name in tallies for row in _rows(name, tallies[name])), shared]


@contextmanager
def started(scene: Path, by_hand: bool) -> Iterator[Processes]:
    """A run with every service, by `nuno run` or by hand, which leaves no process and no file behind."""
    try:
        with Processes(scene.parent) as live:
            view = ("--save", live.record.with_suffix(".rrd"))
            if by_hand:
                live.serve(scene, SERVICES, "--threads", 1, viewer=view)
            else:
                live.supervise(scene, "--processes", "--threads", 1, *view)
            yield live
    finally:
        for path in scene.parent.glob(f"{live.run}*"):
            path.unlink()


def undisturbed(scene: Path, by_hand: bool) -> Span:
    """A run that nothing happens to. Raises RunFailed."""
    with started(scene, by_hand) as live:
        begin = time.monotonic()
        live.wait_for(LAST)
        live.wait_end(COLD)
        end = time.monotonic()
        if live.code() != 0:
            raise RunFailed(f"a run that nothing happened to ended with {live.code()}: {live.said()[:1500]}")
        found = digests(live.record)
        first, last = (next(t for t, _, line in live.lines if line.startswith(text)) for text in (FIRST, LAST))
    return Span({"start": first - begin, "run": last - first, "close": end - last}, found)


def disturb(scene: Path, target: str, by_hand: bool, span: Span, rng: random.Random, tally: Tally) -> bool:
    """One run, one kill; what came of it goes to the tally. False where it came too late."""
    phases = {name: share for name, share in PHASES.items() if name != "start" or not by_hand}
    phase = rng.choices(list(phases), list(phases.values()))[0]
    delay = rng.random() * span.seconds[phase]
    where = f"{target} {'by hand' if by_hand else 'processes'} {phase} {delay:.2f} s"
    with started(scene, by_hand) as live:
        if phase != "start":
            live.wait_for({"run": FIRST, "close": LAST}[phase])
        time.sleep(delay)
        victim = live.find(target)
        while victim is None and phase == "start" and "supervisor" not in live.ended:
            time.sleep(POLL)  # not started yet
            victim = live.find(target)
        if victim is None:
            return False
        kill(victim)
        at = time.monotonic()
        ended = live.wait_end()
        code, left = live.code(), live.stop()
        said = [t - at for t, _, line in live.lines if t >= at and any(word in line for word in WORDS)]
        tally.kills += 1
        tally.ended.append(ended)
        tally.notice.append(min([*said, ended]))
        if left or ended >= HUNG:
            tally.faults["left over"].append(f"{where}: {', '.join(left)}")
        if problem := _wrong_words(target, phase, code, live.said("supervisor")):
            tally.faults["other words"].append(f"{where}: exit code {code}, {problem}")
        kind, problem = _read_and_resume(live.record, span, tally)
        if kind and not (kind == "unreadable" and phase == "start"):
            tally.faults[kind].append(f"{where}: {problem}")
    return True


def _wrong_words(target: str, phase: str, code: int | None, said: str) -> str:
    """What is wrong about how `nuno run` ended; "" for nothing."""
    if target == "supervisor":
        return "" if code == -9 else "was killed"
    if code == 0 and phase == "close":
        return ""  # the killed one had done its work
    if code != 1:
        return "not 1"
    named = "the connection to the hub" if target == "router" else target
    last = next((line for line in said.splitlines()[::-1] if line.startswith("failed: ")), "nothing said")
    return "" if named in last and "Traceback" not in said else f"said: {last}"


def _read_and_resume(record: Path, span: Span, tally: Tally) -> tuple[str, str]:
    """Read the recording to its end, and go on from it; what must not be, and what is known of it."""
    path = kept(record)
    try:
        with open_recording(path) as recording:
            for _ in recording.messages():
                pass
            whole = recording.complete
    except BadInput as error:
        return "unreadable", str(error)
    if not whole:
        path = record.with_name(f"{record.stem}-resumed.mcap")
        code, said = resume(record, path)
        if code == 2 and "holds no checkpoint" in said:
            return "", ""
        if code != 0:
            return "other digests", f"not resumed: {said}"
        tally.resumed += 1
    return ("", "") if digests(path) == span.digests else ("other digests", "")


def _rows(name: str, tally: Tally) -> list[Result]:
    case = f"kill {name}, {tally.kills} times"
    if not tally.kills:
        return [Result(case, "kills", "", failure="none came in time")]
    rows = [
        Result(case, "slowest notice", "s", (max(tally.notice),), bar=NOTICE, at_most=True),
        Result(case, "slowest end of all", "s", (max(tally.ended),), bar=HUNG, at_most=True),
    ]
    for kind in MUST_NOT:
        found = tally.faults[kind]
        note = "; ".join(found[:3])
        rows.append(Result(case, kind, "runs", (len(found),), bar=0, at_most=True, note=note))
    return [*rows, Result(case, "gone on with --resume", "runs", (tally.resumed,))]


def shared_bytes() -> int:
    """Bytes of shared memory of the bus that no process has open: what killed ones left (0 where there is none)."""
    held: set[str] = set()
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            held |= {line.split()[-1] for line in Path(f"/proc/{process.pid}/maps").read_text().splitlines()}
    total = 0
    for path in Path("/dev/shm").glob("*.zenoh"):
        with contextlib.suppress(OSError):
            total += path.stat().st_size if str(path) not in held else 0
    return total
