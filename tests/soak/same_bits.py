"""One scene, one digest: the same scenes in every way that they can be run, paused, resumed and verified."""

from __future__ import annotations

import importlib.util
import json
import os
import random
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from live_run import Live

from nuno.recording.reader import open_recording
from nuno.resimulation.verification import verify
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment
from nuno.scene import scene_file, shipped
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.cloth import decide
from nuno_bench.report.page import Result
from nuno_schemas.errors import RunFailed
from soak.processes import Digests, digests
from soak.scenes import CASES, Case, Changes

QUICK = ("net, changed",)
"""Case of a quick look, without processes."""
RESUMED = 3
"""Frames, drawn at random, at which a run of a case is stopped and goes on."""


@dataclass(frozen=True)
class Seen:
    """A run's digests: the last of each service that steps, and of each frame where they were recorded."""

    last: tuple[str, ...]
    frames: tuple[tuple[str, int, str], ...] = ()


@dataclass(frozen=True)
class Way:
    """How a scene is run; the bits may not depend on it.

    core    the one processor that its processes may use
    pauses  frames at which it stands still for a moment
    stop    frame at which it is stopped
    """

    options: Options
    processes: bool = False
    core: int | None = None
    pauses: tuple[int, ...] = ()
    stop: int | None = None


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

    first = take(loaded, Way(recorded("alone", 1)), case.changes)
    last = max(frame for _, frame, _ in first.frames)
    pauses = tuple(sorted(rng.sample(range(1, last), min(3, last - 1))))
    ways = {
        "2 threads": Way(recorded("threads", 2)),
        "not recorded": Way(Options()),
        f"paused at {', '.join(map(str, pauses))}": Way(recorded("paused"), pauses=pauses),
    }
    if not quick:
        if importlib.util.find_spec("rerun") is not None:
            ways["watched"] = Way(replace(recorded("watched"), save=folder / "watched.rrd"))
        ways["a process each"] = Way(recorded("processes"), processes=True)
        ways["processes on one core"] = Way(recorded("core"), processes=True, core=min(os.sched_getaffinity(0)))
    yield "1 thread", first
    for name, way in ways.items():
        yield name, take(loaded, way, case.changes)
    for frame in sorted(rng.sample(range(1, last), min(1 if quick else RESUMED, last - 1))):
        part, whole = recorded(f"part-{frame}"), recorded(f"resumed-{frame}")
        take(loaded, Way(part, stop=frame), case.changes)
        yield f"resumed at {frame}", resumed(part, whole, case.changes)
        yield f"resumed at {frame}, verified", verified(whole.record, first)
    yield "verified", verified(folder / "alone.mcap", first)
    yield "verified on 2 threads", verified(folder / "paused.mcap", first, 2)


def read(case: Case, folder: Path) -> Loaded:
    """A case's scene, with its solver chosen."""
    if isinstance(case.scene, str):
        return decide(scene_file.read(shipped.find(case.scene), case.overrides))
    path = folder / "scene.yaml"
    path.write_text(json.dumps(case.scene))
    return decide(scene_file.read(path, case.overrides))


def take(loaded: Loaded, way: Way, changes: Changes = ()) -> Seen:
    """Run a scene. Raises RunFailed where it does not end as it should."""
    frames = {*way.pauses, *(frame for frame, _, _ in changes), *([way.stop] if way.stop is not None else [])}
    halts = sorted(frame for frame in frames if way.stop is None or frame <= way.stop)
    live = Live(loaded, way.options, Deployment(processes=way.processes, paused=bool(halts)), way.core)

    def ask(action: str, **request: object) -> None:
        if not (answer := live.control(action, **request)).get("ok"):
            raise RunFailed(str(answer.get("error")))

    try:
        for frame in halts:
            live.step_to(frame)
            for _, action, item in (change for change in changes if change[0] == frame):
                ask(action, item=item)
        if halts:
            ask("stop" if way.stop is not None else "resume")
    except BaseException:
        if live.thread.is_alive():
            live.stop()
        raise
    outcome, record = live.join(), way.options.record
    if outcome.problem:
        raise RunFailed(outcome.problem)
    summaries = [answer["summary"] for answer in outcome.services.values() if "summary" in answer]
    return Seen(tuple(str(summary["digest"]) for summary in summaries), tuple(_whole(record) if record else []))


def _whole(record: Path) -> Digests:
    with open_recording(record) as recording:
        if not recording.complete:
            raise RunFailed(f"the recording is incomplete: {recording.missing}")
    return digests(record)


def resumed(part: Options, whole: Options, changes: Changes) -> Seen:
    """Go on from a recording's last checkpoint, with the changes that were to come after it."""
    assert part.record is not None
    with open_recording(part.record) as recording, restored_scene(recording) as loaded:
        at = round(recording.common_checkpoint().t * loaded.scene.frame_rate)
        left = tuple(change for change in changes if change[0] > at)
        return take(loaded, Way(replace(whole, resume=part.record)), left)


def verified(path: Path | None, first: Seen, threads: int = 1) -> Seen:
    """The digests that a re-simulation agrees with: the first run's, or another where it differs."""
    assert path is not None
    with open_recording(path) as recording:
        found = verify(recording, threads)
    return first if found.frame is None else Seen((f"{path.stem} differs at frame {found.frame}: {found.difference}",))
