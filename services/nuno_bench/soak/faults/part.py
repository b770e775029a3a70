"""Every service, the router and the supervisor killed at random moments of a run, and what is left of it."""

from __future__ import annotations

import contextlib
import random
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from nuno.recording.reader import END, open_recording
from nuno.recording.writer import part_of
from nuno_bench.report.result import Result
from nuno_bench.soak.faults.run import HUNG, SERVICES, FaultRun, kill, nuno, shared_bytes, started
from nuno_bench.soak.faults.scene import write
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import DYE_STATUS

TARGETS = (*SERVICES, "router", "supervisor")
KILLS, FEW, ATTEMPTS = 100, 4, 5
PHASES = {"start": 0.25, "run": 0.5, "close": 0.25}
"""Parts of a run that moments are drawn from, and how often. By hand nothing is killed at the start: what dies before
it has said that it is there cannot be told from what is yet to be started."""
COLD = 400.0
"""Longest that a run may take that compiles its kernels [s]."""
FIRST, LAST = "0.00 of", "2.00 of"
"""What `nuno run` says of its first and its last frame."""
NOTICE = 2.0
"""Longest that the others may take to notice [s]."""
Digests = tuple[str, str]


@dataclass
class Span:
    """Seconds that the parts of an undisturbed run take, and its digests."""

    seconds: dict[str, float]
    digests: Digests


@dataclass
class Tally:
    """What happened to the runs of which one service was killed."""

    kills: int = 0
    notice: list[float] = field(default_factory=list)
    ended: list[float] = field(default_factory=list)
    resumed: int = 0
    faults: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    """What must not be, by kind: each with the run it was seen in."""


def run(quick: bool, seed: int) -> list[Result]:
    """Kill `KILLS` times, the targets in turn, half of the runs started by hand."""
    rng = random.Random(seed)
    tallies: dict[str, Tally] = defaultdict(Tally)
    with tempfile.TemporaryDirectory(prefix="nuno-faults-") as name:
        folder = Path(name)
        write(folder)
        undisturbed(folder, False)  # what has to be compiled is compiled here
        spans = {by_hand: undisturbed(folder, by_hand) for by_hand in (False, True)}
        if spans[False].digests != spans[True].digests:
            return [Result("undisturbed", "digests", "", failure="differ between the two ways to start services")]
        before = shared_bytes()
        for i in range(FEW if quick else KILLS):
            target = TARGETS[i % len(TARGETS)] if not quick else rng.choice(TARGETS)
            by_hand = target == "router" or (i // len(TARGETS)) % 2 == 1
            for _ in range(ATTEMPTS):
                if disturb(folder, target, by_hand, spans[by_hand], rng, tallies[target]):
                    break
        undisturbed(folder, False)  # the next clean start takes away what killed processes left
        left = max(0, shared_bytes() - before) / 2**20
    shared = Result("all kills", "shared memory left after the next run", "MiB", (left,), bar=32.0, at_most=True)
    return [*(row for name in TARGETS if name in tallies for row in _rows(name, tallies[name])), shared]


def undisturbed(folder: Path, by_hand: bool) -> Span:
    """A run that nothing happens to. Raises RunFailed."""
    with started(folder, by_hand) as live:
        begin = time.monotonic()
        live.wait_for(LAST, COLD)
        live.wait_end(COLD)
        end = time.monotonic()
        if live.code != 0:
            raise RunFailed(f"a run that nothing happened to ended with {live.code}: {live.said[:1500]}")
        digests = digests_of(live.record)
    first, last = (next(t for t, line in live.lines if line.startswith(text)) for text in (FIRST, LAST))
    return Span({"start": first - begin, "run": last - first, "close": end - last}, digests)


def digests_of(path: Path) -> Digests:
    """Digests of the cloth and of the dye at the end of a recording."""
    with open_recording(path) as recording:
        dye = recording.last(DYE_STATUS.name)
        of_dye = str(recording.json(dye.payload).get("digest", "")) if dye is not None else ""
        return str(recording.metadata.get(END, {}).get("digest", "")), of_dye


def disturb(folder: Path, target: str, by_hand: bool, span: Span, rng: random.Random, tally: Tally) -> bool:
    """One run, one kill; what came of it goes to the tally. False where it came too late."""
    phases = {name: share for name, share in PHASES.items() if name != "start" or not by_hand}
    phase = rng.choices(list(phases), list(phases.values()))[0]
    delay = rng.random() * span.seconds[phase]
    where = f"{target} {'by hand' if by_hand else 'processes'} {phase} {delay:.2f} s"
    with started(folder, by_hand) as live, _removed(folder, live.run):
        if phase != "start":
            live.wait_for({"run": FIRST, "close": LAST}[phase], COLD)
        time.sleep(delay)
        victim = live.find(target)
        while victim is None and phase == "start" and live.supervisor.poll() is None:
            time.sleep(0.01)  # not started yet
            victim = live.find(target)
        if victim is None:
            return False
        kill(victim)
        at = time.monotonic()
        ended = live.wait_end()
        code, left = live.code, live.stop()
        tally.kills += 1
        tally.ended.append(ended)
        tally.notice.append(_noticed(live, at, ended))
        if left or ended >= HUNG:
            tally.faults["left over"].append(f"{where}: {', '.join(left)}")
        if problem := _wrong_words(target, phase, code, live.said):
            tally.faults["other words"].append(f"{where}: exit code {code}, {problem}")
        _read_and_resume(folder, live, span, tally, where, early=phase == "start")
    return True


@contextlib.contextmanager
def _removed(folder: Path, run: str) -> Iterator[None]:
    """Leave no file of a run behind."""
    try:
        yield
    finally:
        for path in folder.glob(f"{run}*"):
            path.unlink()


def _noticed(live: FaultRun, at: float, ended: float) -> float:
    """Seconds until the supervisor says something of the kill, or until all have ended."""
    words = ("the services end in order", "goes on without", "did not finish")
    times = [t - at for t, line in live.lines if t >= at and any(word in line for word in words)]
    return min([*times, ended])


def _wrong_words(target: str, phase: str, code: int | None, said: str) -> str:
    """What is wrong about how `nuno run` ended; "" for nothing."""
    if target == "supervisor":
        return "" if code == -9 else "was killed"
    if code == 0 and phase == "close":
        return ""  # the killed one had done its work
    if code != 1:
        return "not 1"
    named = "the connection to the hub" if target == "router" else target
    last = said.splitlines()[-1] if said else "nothing said"
    return "" if named in last and "Traceback" not in said else f"said: {last}"


def _read_and_resume(folder: Path, live: FaultRun, span: Span, tally: Tally, where: str, early: bool) -> None:
    """Read the recording to its end, and go on from it."""
    path = live.record if live.record.exists() else part_of(live.record)
    try:
        with open_recording(path) as recording:
            for _ in recording.messages():
                pass
            whole = recording.complete
    except BadInput as error:
        if not early:
            tally.faults["unreadable"].append(f"{where}: {error}")
        return
    target = folder / f"{live.run}-resumed.mcap"
    if not whole:
        words = nuno("run", "--resume", path, "--no-view", "--threads", "1", "--record", target)
        done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
        if done.returncode == 2 and "holds no checkpoint" in done.stderr:
            return
        if done.returncode != 0:
            tally.faults["other digests"].append(f"{where}: not resumed: {done.stderr[-300:]}")
            return
        tally.resumed += 1
    if digests_of(path if whole else target) != span.digests:
        tally.faults["other digests"].append(where)


def _rows(name: str, tally: Tally) -> list[Result]:
    case = f"kill {name}, {tally.kills} times"
    if not tally.kills:
        return [Result(case, "kills", "", failure="none came in time")]
    rows = [
        Result(case, "slowest notice", "s", (max(tally.notice),), bar=NOTICE, at_most=True),
        Result(case, "slowest end of all", "s", (max(tally.ended),), bar=HUNG, at_most=True),
    ]
    for kind in ("other words", "unreadable", "other digests", "left over"):
        found = tally.faults[kind]
        note = "; ".join(found[:3])
        rows.append(Result(case, kind, "runs", (float(len(found)),), bar=0.0, at_most=True, note=note))
    rows.append(Result(case, "gone on with --resume", "runs", (float(tally.resumed),)))
    return rows
