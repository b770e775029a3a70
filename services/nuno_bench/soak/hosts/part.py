"""Many hosts: the same bits as in one process however long the way, how fast, and what a cut of the network does."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import nuno
from nuno.wire.sessions import SILENCE_SECONDS
from nuno_bench.report.result import Result
from nuno_bench.soak import namespaces, small
from nuno_bench.soak.hosts.deployed import ROLES, Deployed, Line, deployed
from nuno_bench.soak.namespaces import Host

WITHIN, BEYOND = 5.0, SILENCE_SECONDS + 10.0
"""Cuts [s] after which a run goes on, and after which whoever is cut off counts as gone."""
LAST_WORDS = 2.0
"""What those who are left may take to end after they have noticed [s]."""
CLOSING = 12.0
"""What whoever is cut off may take [s]: zenoh waits for 10 s until it closes a session that nobody answers."""
FAST = Line(0.001)
"""The way in runs that are cut."""
CUT_AT = 60
"""Frame after which the network is cut: there is a checkpoint then."""


@dataclass
class Undisturbed:
    """A scene and what it gives in one process."""

    scene: Path
    digests: list[str]
    rate: float
    """Frames a second."""


def run(quick: bool, seed: int) -> list[Result]:
    """Ways of several lengths and widths, then cuts; quick: one of each, of a tiny sheet."""
    del seed
    lines = [Line(0.01)] if quick else [*map(Line, (0.0, 0.001, 0.01, 0.05)), Line(0.0, 100e6 / 8)]
    sizes = (6,) if quick else (16, 64)
    with tempfile.TemporaryDirectory(prefix="nuno-hosts-") as name, _hosts() as (hosts, note):
        where, results = Path(name), []
        for columns in sizes:
            alone = undisturbed(where, columns, 0.4 if quick else 1.0)
            case = f"{columns} x {columns} vertices"
            results.append(Result(case, "one process", "frames/s", (alone.rate,), note=note))
            for line in lines:
                results += measure_line(where, alone, hosts, line, case)
                note = ""
        alone = undisturbed(where, 6, 4.0 if quick else 20.0)
        for role in ("collision",) if quick else ROLES:
            results += cut_within(where, alone, hosts, role)
        for role in () if quick else ("collision", "supervisor"):
            results += cut_beyond(where, alone, hosts, role)
        return results


@contextmanager
def _hosts() -> Iterator[tuple[list[Host], str]]:
    """A host for the router and one for each role, and what to say of them."""
    number = 1 + len(ROLES)
    try:
        with namespaces.hosts(number) as made:
            yield made, ""
    except PermissionError as error:
        yield namespaces.local_hosts(number), f"all on loopback: {error}"


def undisturbed(where: Path, columns: int, duration: float) -> Undisturbed:
    """Run a sheet in one process."""
    folder = where / f"alone-{columns}-{duration:g}"
    folder.mkdir()
    scene = small.write(folder, duration, columns)
    result = nuno.run(scene, record=folder / "alone.mcap")
    frames = digests(folder / "alone.mcap")
    return Undisturbed(scene, frames, len(frames) / float(result.report["wall_seconds"]))


def digests(recording: Path) -> list[str]:
    """Digest of every frame that a recording holds."""
    with nuno.open(recording) as opened:
        return [frame.digest for frame in opened.frames()]


def differing(found: list[str], wanted: list[str]) -> int:
    """Frames that are not the same, or missing."""
    return sum(a != b for a, b in zip_longest(found, wanted))


def measure_line(where: Path, alone: Undisturbed, hosts: list[Host], line: Line, case: str) -> list[Result]:
    """One run over lines of a kind: frames and bytes a second, and frames that differ."""
    folder = Path(tempfile.mkdtemp(dir=where)) / "run"
    with deployed(folder, alone.scene, hosts, line) as state:
        codes = state.wait()
        carried = state.forwarded
    if any(codes.values()):
        return [Result(case, f"hosts, {line}", "", failure=_words(state))]
    with nuno.open(state.recording) as recording:
        wall = float(recording.report()["wall_seconds"])
    what = f"hosts, {line}"
    wrong = differing(digests(state.recording), alone.digests)
    return [
        Result(case, what, "frames/s", (len(alone.digests) / wall,)),
        Result(case, f"{what}: on the wires", "MB/s", (1e-6 * carried / wall,)),
        Result(case, f"{what}: other digests", "", (wrong,), bar=0, at_most=True),
    ]


def cut_within(where: Path, alone: Undisturbed, hosts: list[Host], role: str) -> list[Result]:
    """A cut that nobody need notice: the run goes on where it was."""
    folder, case = Path(tempfile.mkdtemp(dir=where)) / "run", f"{_called(role)}, cut off for {WITHIN:g} s"
    with deployed(folder, alone.scene, hosts, FAST) as state:
        state.wait_for_frame(CUT_AT)
        state.ways[role].cut(WITHIN)
        codes = state.wait()
    if any(codes.values()):
        return [Result(case, "other digests", "", failure=_words(state))]
    wrong = differing(digests(state.recording), alone.digests)
    return [Result(case, "other digests", "", (wrong,), bar=0, at_most=True)]


def cut_beyond(where: Path, alone: Undisturbed, hosts: list[Host], role: str) -> list[Result]:
    """A cut after which the peer counts as gone: the run ends, says so, and is resumed to the same digests."""
    folder, case = Path(tempfile.mkdtemp(dir=where)) / "run", f"{_called(role)}, cut off for {BEYOND:g} s"
    with deployed(folder, alone.scene, hosts, FAST) as state:
        state.wait_for_frame(CUT_AT)
        begin = time.monotonic()
        cut = threading.Thread(target=state.ways[role].cut, args=(BEYOND,))
        cut.start()
        codes = state.wait()
        cut.join()
    if codes["supervisor"] != 1 or "failed: " not in state.words["supervisor"]:
        return [Result(case, "until the others have ended", "s", failure=f"exit codes {codes}: {_words(state)}")]
    left = max(ended for name, ended in state.ended.items() if name != role) - begin
    last = state.ended[role] - begin
    said = state.words["supervisor"].strip().splitlines()[-1]
    kept, wrong = digests(_kept(state)), differing(_resume(state, folder), alone.digests)
    lost = sum(a != b for a, b in zip(kept, alone.digests, strict=False))
    bar = SILENCE_SECONDS + LAST_WORDS
    return [
        Result(case, "until the others have ended", "s", (left,), bar=bar, at_most=True, note=said),
        Result(case, "until it has ended itself", "s", (last,), bar=SILENCE_SECONDS + CLOSING, at_most=True),
        Result(case, "frames kept", "", (len(kept),), bar=CUT_AT),
        Result(case, "other digests among them", "", (lost,), bar=0, at_most=True),
        Result(case, "resumed: other digests", "", (wrong,), bar=0, at_most=True),
    ]


def _kept(state: Deployed) -> Path:
    """The recording, or what there is of it where its recorder could not close it."""
    part = state.recording.with_name(state.recording.name + ".part")
    return state.recording if state.recording.exists() else part


def _resume(state: Deployed, folder: Path) -> list[str]:
    """Go on from what was kept, here and in one process; the digests of all frames."""
    target = folder / "resumed.mcap"
    words = ["run", "--resume", str(_kept(state)), "--record", str(target), "--no-view"]
    command = [sys.executable, "-m", "nuno", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False)
    if done.returncode:
        raise RuntimeError(f"not resumed: {done.stderr}")
    return digests(target)


def _called(role: str) -> str:
    return "the supervisor" if role == "supervisor" else f"the {role} service"


def _words(state: Deployed) -> str:
    """The last line of each process that said something."""
    last = {name: words.strip().splitlines()[-1] for name, words in state.words.items() if words.strip()}
    return "; ".join(f"{name}: {words}" for name, words in last.items())
