"""`nuno bench contact`: random scenes of cloth that meets cloth; ipctk and our own code check every frame."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from nuno.collision.crossings import find_crossings, mesh_of
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench import machine, options
from nuno_bench.piles import CLOTHS, Oracle, random_pile
from nuno_bench.report import page
from nuno_bench.report.page import Report, Sections, Table
from nuno_bench.sweep.executor import (
    Executor,
    SweepFile,
    add_executor_arguments,
    open_executor,
    require_kept,
    versions,
)
from nuno_schemas.errors import BadInput, RunFailed

# One random scene, stepped to its end: in which frames cloth passes through cloth, by ipctk and by our own check.

Verdict = Literal["clean", "crossed", "disagrees", "failed", "refused", "crashed"]


@dataclass(frozen=True)
class PileOutcome:
    """Outcome of a random scene.

    fabrics, cloths  of its pieces: presets or `springs`; quads, triangles, irregular triangles or a skirt
    frames           that were stepped and looked at, the start left out
    crossed, own     numbers of those in which cloth passes through cloth, by ipctk and by the collision service's check
    vertex_steps     vertices times steps
    cut, held        of these, those that were cut short: of free vertices, and of held ones
    left_out         pairs that found no place in a list
    touching         most pairs that touched after a frame
    status, message  of the last frame, or why there was none
    """

    seed: int
    solver: str = ""
    body: str = ""
    fabrics: Sequence[str] = ()
    cloths: Sequence[str] = ()
    rate: float = 0.0
    vertices: int = 0
    frames: int = 0
    crossed: list[int] = field(default_factory=list)
    own: list[int] = field(default_factory=list)
    vertex_steps: int = 0
    cut: int = 0
    held: int = 0
    left_out: int = 0
    touching: int = 0
    status: str = "ok"
    message: str = ""
    seconds: float = 0.0

    @property
    def verdict(self) -> Verdict:
        if self.crossed or self.own:
            return "crossed" if self.crossed == self.own else "disagrees"
        if self.status in ("refused", "crashed"):
            return "refused" if self.status == "refused" else "crashed"
        return "clean" if self.status == "ok" else "failed"

    @property
    def share(self) -> float:
        """Of free vertices' steps, how many were cut short."""
        return self.cut / self.vertex_steps if self.vertex_steps else 0.0


def run_pile(task: tuple[int, float]) -> PileOutcome:
    """The scene of a seed, for a duration [s]. What goes wrong, whatever it raises, is a finding about the scene."""
    (seed, duration), begun = task, time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        found = PileOutcome(seed)
        try:
            path = random_pile(seed, duration, Path(folder))
            found = made_of(seed, scene_file.read(path).data)
            simulation = Simulation.with_bodies(scene_file.read(path), 1)
        except BadInput as error:
            return replace(found, status="refused", message=" ".join(str(error).split()))
        except Exception as error:
            return replace(found, status="crashed", message=f"{type(error).__name__}: {error}")
        found = watch(simulation, found)
    return replace(found, seconds=time.perf_counter() - begun)


def made_of(seed: int, scene: dict[str, Any]) -> PileOutcome:
    """Describe the parts of a scene, from its data."""
    models = [part["model"] for part in scene["objects"]]
    bodies = scene.get("bodies", [])
    worn = any("attach" in model for model in models)
    fabrics = {model["fabric"] if isinstance(model["fabric"], str) else "springs" for model in models}
    cloths = {model.get("cells", "skirt" if model["plugin"] == "skirt" else CLOTHS[-1]) for model in models}
    body = "wearer" if worn else bodies[0]["collider"]["plugin"] if bodies else "none"
    return PileOutcome(seed, scene["solver"]["plugin"], body, tuple(sorted(fabrics)), tuple(sorted(cloths)),
                       scene["frame_rate"])  # fmt: skip


def watch(simulation: Simulation, found: PileOutcome) -> PileOutcome:
    """Step to the end, or to where it stops, and look at every frame that would be published."""
    faces, number = simulation.fabric.faces, simulation.fabric.number
    oracle, mesh = Oracle(simulation.state.x, faces), mesh_of(faces)
    crossed, own, steps, most, counts = list[int](), list[int](), 0, 0, dict[str, int]()
    frames, status, message = 0, "ok", ""
    while not simulation.finished and status == "ok":
        try:
            report = simulation.step().report
        except Exception as error:
            status, message = "crashed", f"{type(error).__name__}: {error}"
            break
        status, message, steps = report.status, report.message, steps + report.steps
        if status != "ok":
            break
        counts, most = dict(report.counts), max(most, report.counts["cloth_contacts"])
        frames, x = simulation.frame, simulation.state.x
        crossed += [frames] * oracle.crossed(x)
        own += [frames] * (len(find_crossings(x, mesh).edges) > 0)
    return replace(
        found, vertices=number, frames=frames, crossed=crossed, own=own,
        vertex_steps=number * steps, cut=counts.get("cut_short", 0), held=counts.get("held_cut_short", 0),
        left_out=counts.get("pairs_left_out", 0), touching=most, status=status, message=message,
    )  # fmt: skip


FOLDER, KEPT = "contact", "contact.jsonl"
"""Of --out: into the first go scenes that went wrong, into the second what is finished, line by line."""
HEADINGS = ("scenes", "frames", "crossed", "own check", "cut short", "most", "left out", "ended early", "wrong")
CAPTION = (
    "Crossed: frames in which an edge goes through a triangle, by ipctk; own check: the same by the collision "
    "service's routine. Cut short: share of the steps of free vertices, and the most of a scene. Left out: scenes in "
    "which a list had no place for a pair. Ended early: scenes whose solver gave up, with a message. Wrong: scenes in "
    "which cloth passed through cloth, the checks disagree, or which crashed or were refused. A scene of several "
    "fabrics or cloths is counted with each."
)
LEAD = (
    "Random scenes by a seed: two or three pieces of random cloth fly at each other and at a body, under random wind, "
    "friction, thickness, solver and frame rate. Every frame is looked at by ipctk, and by our own check."
)
BY: Mapping[str, Callable[[PileOutcome], Sequence[str]]] = {
    "solver": lambda one: (one.solver,),
    "body": lambda one: (one.body,),
    "cloth": lambda one: one.cloths,
    "fabric": lambda one: one.fabrics,
}


def contact_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("seeds", nargs="*", type=int, metavar="SEED", help="of the scenes (default: 1 to --count)")
    options.add_count(parser, "--count", "scenes, where no seed is given (default: %(default)s)", 200)
    options.add_seconds(parser, "--duration", 0.5, "of each scene; a shorter run shows its beginning")
    add_executor_arguments(parser)
    options.add_shared(parser, "--resume", "--out", "--docs")


def contact_command(args: argparse.Namespace) -> int:
    """Run the scenes, print tables; 1 where cloth passed through cloth, or a scene could not be run."""
    if any(seed < 0 for seed in args.seeds):
        raise BadInput("a seed is not negative", field="SEED", value=min(args.seeds), limit="0 and more")
    options.require_package("cloth is looked at by", "ipctk")
    page.check_section(args.docs, "contact")
    if args.resume:
        require_kept([args.out / KEPT])
    others, seeds = machine.OtherLoad(), args.seeds or list(range(1, args.count + 1))
    say, identity = partial(print, file=sys.stderr), {"duration": args.duration, "versions": versions()}
    with SweepFile(args.out / KEPT, identity, args.resume, say) as kept, open_executor(args) as where:
        found = run_all(seeds, args.duration, kept, where, say)
    for table in count_tables(found):
        print(table.text(), end="\n\n")
    print("\n".join([*map(describe, found), summary(found)]).lstrip())
    folder = keep(found, args.duration, args.out / FOLDER)
    about = machine.about(others) | ({"scenes that went wrong": str(folder)} if folder else {})
    report(found, args.duration, about).write_beside(args.out / "contact", args.docs, "contact")
    return int(any(is_bad(one) for one in found))


def run_all(
    seeds: Sequence[int], duration: float, kept: SweepFile, where: Executor, say: Callable[[str], None]
) -> list[PileOutcome]:
    """Return the outcomes of all seeds, in their order; those in the sweep's file are not run again."""
    found = {one.seed: one for one in (PileOutcome(**line) for line in kept.lines)}
    left = [(seed, duration) for seed in dict.fromkeys(seeds) if seed not in found]
    for (seed, _), one in where.run(run_pile, left):
        if isinstance(one, BadInput | RunFailed):
            one = PileOutcome(seed, status="crashed", message=str(one))
        found[seed] = one
        kept.add(vars(one))
        say(f"{len(found)} of {len(seeds)}: {describe(one) or f'seed {seed}, {one.solver}: clean'}")
    return [found[seed] for seed in dict.fromkeys(seeds)]


def keep(found: Sequence[PileOutcome], duration: float, folder: Path) -> Path | None:
    """Write the scenes that went wrong or failed, each with its files; the folder, None where there is none."""
    wrong = [one for one in found if one.verdict != "clean"]
    for one in wrong:
        (own := folder / str(one.seed)).mkdir(parents=True, exist_ok=True)
        random_pile(one.seed, duration, own)
    return folder if wrong else None


def is_bad(one: PileOutcome) -> bool:
    """Whether a scene shows a fault; a solver that gives up and says so is none."""
    return one.verdict not in ("clean", "failed")


def percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def counts_of(group: Sequence[PileOutcome]) -> list[str]:
    """Of some scenes, under HEADINGS."""
    steps = sum(one.vertex_steps for one in group)
    return [
        str(len(group)), f"{sum(one.frames for one in group):,}", str(sum(len(one.crossed) for one in group)),
        str(sum(len(one.own) for one in group)), percent(sum(one.cut for one in group) / max(1, steps)),
        percent(max(one.share for one in group)), str(sum(one.left_out > 0 for one in group)),
        str(sum(one.verdict == "failed" for one in group)), str(sum(map(is_bad, group))),
    ]  # fmt: skip


def count_tables(found: Sequence[PileOutcome]) -> list[Table]:
    """Return a table by solver, body, cloth and fabric: a row for each, and one of all scenes."""
    tables = list[Table]()
    for by, named in BY.items():
        names = sorted({name for one in found for name in named(one)})
        rows = [[name, *counts_of([one for one in found if name in named(one)])] for name in names]
        rows.append(["all", *counts_of(found)])
        tables.append(Table((by, *HEADINGS), rows, "" if tables else CAPTION))
    return tables


def describe(one: PileOutcome) -> str:
    """Describe what went wrong in a scene; return "" for a clean one."""
    if one.verdict == "clean":
        return ""
    frames = (
        f"frames {listed(one.crossed)} by ipctk, {listed(one.own)} by our own check" if one.crossed + one.own else ""
    )
    said = ", ".join(filter(None, [frames, one.message]))
    return f"{one.verdict}: seed {one.seed}, {one.solver}, {one.body}, after {one.frames} frames: {said}"


def listed(frames: Iterable[int], most: int = 5) -> str:
    """The first few numbers."""
    numbers = list(frames)
    return ", ".join([*map(str, numbers[:most]), *["..."] * (len(numbers) > most)]) or "none"


def summary(found: Sequence[PileOutcome]) -> str:
    """The counts in a sentence."""
    frames, crossed = sum(one.frames for one in found), sum(len(one.crossed) for one in found)
    own, cut = sum(len(one.own) for one in found), [one.share for one in found]
    wrong, early = sum(map(is_bad, found)), sum(one.verdict == "failed" for one in found)
    met = sum(one.touching > 0 for one in found)
    return (
        f"{len(found)} scenes of {frames:,} frames, {met} with contact of cloth: cloth passes through cloth in "
        f"{crossed} by ipctk and in {own} by our own check; {wrong} scenes went wrong, {early} ended early; "
        f"steps cut short: median {percent(float(np.median(cut)))} of a scene, most {percent(max(cut))}"
    )


def scene_table(found: Iterable[PileOutcome]) -> Table:
    """A line a scene."""
    rows = [
        [str(one.seed), one.solver, one.body, ", ".join(one.cloths), ", ".join(one.fabrics), f"{one.rate:g}",
         str(one.vertices), str(one.frames), str(len(one.crossed)), percent(one.share), str(one.held),
         str(one.left_out), str(one.touching), f"{one.seconds:.1f}", one.verdict]
        for one in found
    ]  # fmt: skip
    heads = ("seed", "solver", "body", "cloth", "fabric", "frames/s", "vertices", "frames", "crossed", "cut short",
             "held", "left out", "touching", "time [s]", "verdict")  # fmt: skip
    return Table(heads, rows, "Every scene; held: steps of held vertices that were cut short.")


def report(found: Sequence[PileOutcome], duration: float, about: Mapping[str, str]) -> Report:
    """The page."""
    unclean = Table(
        ("verdict", "seed", "solver", "body", "frame", "why"),
        [[one.verdict, str(one.seed), one.solver, one.body, str(one.frames), describe(one).partition("frames: ")[2]]
         for one in found if one.verdict != "clean"],
        "Scenes that were not clean.", prose=True,
    )  # fmt: skip
    said = f"{summary(found)}."
    parts, each = count_tables(found), scene_table(found)
    sections: Sections = [
        ("", [said]), ("Scenes that were not clean", [unclean]), ("Counts", parts), ("Every scene", [each]),
    ]  # fmt: skip
    rows = [dict(zip(each.headings, cells, strict=True)) for cells in each.rows]
    data = {"duration": duration, "scenes": [vars(one) | {"verdict": one.verdict} for one in found]}
    return Report("Cloth meets cloth", LEAD, sections, about, data, [said, *parts, unclean], rows)
