"""Many hosts: the same bits as in one process however long the way, how fast, and what a cut of the network does."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import nuno
from nuno.access import folder
from nuno.wire.sessions import SILENCE_SECONDS, free_port
from nuno_bench.report.result import Result
from nuno_schemas.errors import RunFailed
from soak import scenes
from soak.processes import Digests, Processes, differing, digests, kept, resume
from soak.relay import Relay, relay

ROLES = ("collision", "simulation", "recorder", "supervisor")
WITHIN, BEYOND = 5.0, SILENCE_SECONDS + 10.0
"""Cuts [s] after which a run goes on, and after which whoever is cut off counts as gone."""
LAST_WORDS = 2.0
"""What those who are left may take to end after they have noticed [s]."""
CLOSING = 12.0
"""What whoever is cut off may take [s]: zenoh waits for 10 s until it closes a session that nobody answers."""
END = 600.0
"""How long the end of a run is waited for [s]."""


@dataclass(frozen=True)
class Line:
    """What lies between the hosts: seconds each way, and bytes a second (None: all that there is)."""

    delay: float = 0.0
    rate: float | None = None

    def __str__(self) -> str:
        rate = f", {8e-6 * self.rate:g} Mbit/s" if self.rate else ""
        return f"{1e3 * self.delay:g} ms each way{rate}"


FAST = Line(0.001)
"""The way in runs that are cut."""


@dataclass
class Alone:
    """A scene and what it gives in one process."""

    scene: Path
    duration: float
    digests: Digests
    rate: float
    """Frames a second."""


def run(quick: bool, seed: int) -> list[Result]:
    """Ways of several lengths and widths, then cuts; quick: one of each, of a tiny sheet."""
    del seed
    lines = [Line(0.01)] if quick else [*map(Line, (0.0, 0.001, 0.01, 0.05)), Line(0.0, 100e6 / 8)]
    with tempfile.TemporaryDirectory(prefix="nuno-hosts-") as name:
        where, results = Path(name), []
        for columns in (6,) if quick else (16, 64):
            alone = undisturbed(where, columns, 0.4 if quick else 1.0)
            case = f"{columns} x {columns} vertices"
            results.append(Result(case, "one process", "frames/s", (alone.rate,)))
            for line in lines:
                results += measure_line(alone, line, case)
        alone = undisturbed(where, 6, 4.0 if quick else 20.0)
        for role in ("collision",) if quick else ROLES:
            results += cut_within(alone, role)
        for role in () if quick else ("collision", "supervisor"):
            results += cut_beyond(alone, role)
        return results


def undisturbed(where: Path, columns: int, duration: float) -> Alone:
    """Run a sheet in one process."""
    folder = Path(tempfile.mkdtemp(dir=where))
    scene = scenes.sheet(folder, duration, columns)
    result = nuno.run(scene, record=folder / "alone.mcap")
    frames = digests(folder / "alone.mcap")
    return Alone(scene, duration, frames, len(frames) / float(result.report["wall_seconds"]))


@contextmanager
def deployed(alone: Alone, line: Line) -> Iterator[tuple[Processes, dict[str, Relay]]]:
    """A run with mutual TLS, each role in a process with a way of its own to the router, and the relays on these."""
    where = Path(tempfile.mkdtemp(dir=alone.scene.parent))
    port = free_port()
    folder.make(where / "certs", ("127.0.0.1",), ["router", *ROLES], 1)

    def config(role: str) -> tuple[object, ...]:
        return "--config", where / "certs" / f"{role}.json5"

    with ExitStack() as stack:
        ways = {role: stack.enter_context(relay(("127.0.0.1", port), line.delay, line.rate)) for role in ROLES}
        live = stack.enter_context(Processes(where))
        live.route(f"tls/127.0.0.1:{port}", *config("router"))
        reach = {role: ("--connect", f"tls/127.0.0.1:{way.address[1]}", *config(role)) for role, way in ways.items()}
        live.serve(alone.scene, reach | {"supervisor": (*reach["supervisor"], "--no-view")})
        yield live, ways


def measure_line(alone: Alone, line: Line, case: str) -> list[Result]:
    """One run over lines of a kind: frames and bytes a second, and frames that differ."""
    what = f"hosts, {line}"
    with deployed(alone, line) as (live, ways):
        live.wait_end(END)
        carried = sum(way.forwarded for way in ways.values())
        if problem := _problem(live):
            return [Result(case, what, "", failure=problem)]
    with nuno.open(live.record) as recording:
        wall = float(recording.report()["wall_seconds"])
    wrong = differing(digests(live.record), alone.digests)
    return [
        Result(case, what, "frames/s", (len(alone.digests) / wall,)),
        Result(case, f"{what}: on the wires", "MB/s", (1e-6 * carried / wall,)),
        Result(case, f"{what}: other digests", "", (wrong,), bar=0, at_most=True),
    ]


def cut_within(alone: Alone, role: str) -> list[Result]:
    """A cut that nobody need notice: the run goes on where it was."""
    case = f"{_called(role)}, cut off for {WITHIN:g} s"
    with deployed(alone, FAST) as (live, ways):
        _wait_for_a_tenth(live, alone)
        ways[role].cut(WITHIN)
        live.wait_end(END)
        if problem := _problem(live):
            return [Result(case, "other digests", "", failure=problem)]
    wrong = differing(digests(live.record), alone.digests)
    return [Result(case, "other digests", "", (wrong,), bar=0, at_most=True)]


def cut_beyond(alone: Alone, role: str) -> list[Result]:
    """A cut after which the peer counts as gone: the run ends, says so, and is resumed to the same digests."""
    case = f"{_called(role)}, cut off for {BEYOND:g} s"
    with deployed(alone, FAST) as (live, ways):
        _wait_for_a_tenth(live, alone)
        begin = time.monotonic()
        cut = threading.Thread(target=ways[role].cut, args=(BEYOND,))
        cut.start()
        live.wait_end(END)
        cut.join()
        if live.code() != 1 or "failed: " not in live.said("supervisor"):
            return [Result(case, "until the others have ended", "s", failure=_problem(live) or "did not fail")]
        ends = {name: live.ended[name] - begin for name in ROLES}
    said = next(line for _, who, line in live.lines if who == "supervisor" and line.startswith("failed: "))
    target = live.record.with_name("resumed.mcap")
    code, words = resume(live.record, target)
    if code:
        raise RunFailed(f"not resumed: {words}")
    found = digests(kept(live.record))
    left, bar = max(ended for name, ended in ends.items() if name != role), SILENCE_SECONDS + LAST_WORDS
    return [
        Result(case, "until the others have ended", "s", (left,), bar=bar, at_most=True, note=said),
        Result(case, "until it has ended itself", "s", (ends[role],), bar=SILENCE_SECONDS + CLOSING, at_most=True),
        Result(case, "frames kept", "", (len(found),), bar=len(alone.digests) // 10),
        Result(
            case, "other digests among them", "", (differing(found, alone.digests[: len(found)]),), bar=0, at_most=True
        ),
        Result(case, "resumed: other digests", "", (differing(digests(target), alone.digests),), bar=0, at_most=True),
    ]


def _wait_for_a_tenth(live: Processes, alone: Alone) -> None:
    """Until that much of the run is done: there is a checkpoint then."""
    live.wait_for(f"{0.1 * alone.duration:.2f} of")


def _called(role: str) -> str:
    return "the supervisor" if role == "supervisor" else f"the {role} service"


def _problem(live: Processes) -> str:
    """Exit codes and last lines where not all ended well."""
    codes = {role: live.code(role) for role in ROLES}
    last = {role: live.said(role).strip().splitlines()[-1:] for role in ROLES}
    told = "; ".join(f"{role}: {''.join(words)}" for role, words in last.items() if words)
    return f"exit codes {codes}: {told}" if any(codes.values()) else ""
