"""One scene, one digest: the same scenes in every way that they can be run, paused, resumed and verified."""

from __future__ import annotations

import importlib.util
import json
import os
import random
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from nuno.scene import scene_file
from nuno.scene.choose import decide
from nuno.scene.scene_file import Loaded
from nuno.service import Options
from nuno.verify import verify
from nuno_bench.report.result import Result
from nuno_bench.soak.same_bits.run import Seen, Way, resume, take
from nuno_bench.soak.same_bits.scenes import CASES, Case

QUICK = ("net, changed",)
"""Case of a quick look, without processes."""
RESUMED = 3
"""Frames, drawn at random, at which a run of a case is stopped and goes on."""


def run(quick: bool, seed: int, names: tuple[str, ...] = ()) -> list[Result]:
    """For each case how many ways and how many different digests; law: one digest."""
    found = []
    for name in names or (QUICK if quick else tuple(CASES)):
        print(f"  {name}", file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
            found += judge(name, dict(each_way(CASES[name], Path(folder), quick, random.Random(f"{seed} {name}"))))
    return found


def judge(name: str, seen: dict[str, Seen]) -> list[Result]:
    """Ways, and different digests among them: of the last state, or of any frame."""
    first = next(iter(seen.values()))
    other = [way for way, one in seen.items() if one.last != first.last or one.frames not in ((), first.frames)]
    lasts, frames = {one.last for one in seen.values()}, {one.frames for one in seen.values() if one.frames}
    note = f"others than {next(iter(seen))}: {', '.join(other)}" if other else ""
    return [
        Result(name, "ways", "", (len(seen),)),
        Result(name, "different digests", "", (max(len(lasts), len(frames)),), bar=1, at_most=True, note=note),
    ]


def each_way(case: Case, folder: Path, quick: bool, rng: random.Random) -> Iterator[tuple[str, Seen]]:
    """Each way to run a case, by name, and its digests."""
    loaded = read(case, folder)

    def recorded(name: str, threads: int = 0) -> Options:
        return Options(record=folder / f"{name}.mcap", threads=threads)

    alone = recorded("alone", 1)
    first = take(loaded, Way(alone), case.changes)
    yield "1 thread", first
    yield "2 threads", take(loaded, Way(recorded("threads", 2)), case.changes)
    yield "not recorded", take(loaded, Way(Options()), case.changes)
    last = max(frame for frame, _ in first.frames)
    pauses = tuple(sorted(rng.sample(range(1, last), min(3, last - 1))))
    yield f"paused at {', '.join(map(str, pauses))}", take(loaded, Way(recorded("paused"), pauses=pauses), case.changes)
    if importlib.util.find_spec("rerun") is not None and not quick:
        watched = Options(record=folder / "watched.mcap", save=folder / "watched.rrd", must_see=())
        yield "watched", take(loaded, Way(watched), case.changes)
    if not quick:
        yield "a process each", take(loaded, Way(recorded("processes"), processes=True), case.changes)
        core = min(os.sched_getaffinity(0))
        one = Way(recorded("core"), processes=True, core=core)
        yield "processes on one core", take(loaded, one, case.changes)
    for frame in sorted(rng.sample(range(1, last), min(1 if quick else RESUMED, last - 1))):
        part = folder / f"part-{frame}.mcap"
        take(loaded, Way(Options(record=part), stop=frame), case.changes)
        whole = folder / f"resumed-{frame}.mcap"
        yield f"resumed at {frame}", resume(part, Way(Options(record=whole)), case.changes, None)
        yield f"resumed at {frame}, verified", verified(whole, first)
    yield "verified", verified(folder / "alone.mcap", first)
    yield "verified on 2 threads", verified(folder / "paused.mcap", first, 2)


def verified(path: Path, first: Seen, threads: int = 1) -> Seen:
    """The digests that a re-simulation agrees with: the first run's, or another where it differs."""
    from nuno.recording.reader import open_recording

    with open_recording(path) as recording:
        found = verify(recording, threads)
    return first if found.frame is None else Seen((f"{path.stem} differs at frame {found.frame}: {found.difference}",))


def read(case: Case, folder: Path) -> Loaded:
    """A case's scene, with its solver chosen."""
    if isinstance(case.scene, str):
        return decide(scene_file.read(scene_file.find(case.scene), case.overrides))
    path = folder / "scene.yaml"
    path.write_text(json.dumps(case.scene))
    return decide(scene_file.read(path, case.overrides))
