"""What `nuno bench contact` shows: counts by solver, body, cloth and fabric, and every scene that was not clean."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from nuno_bench.contact.run import Passed
from nuno_bench.report.page import Report, Sections, Table

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
BY: Mapping[str, Callable[[Passed], Sequence[str]]] = {
    "solver": lambda one: (one.solver,),
    "body": lambda one: (one.body,),
    "cloth": lambda one: one.cloths,
    "fabric": lambda one: one.fabrics,
}


def is_bad(one: Passed) -> bool:
    """Whether a scene shows a fault; a solver that gives up and says so is none."""
    return one.verdict not in ("clean", "failed")


def share(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def row(group: Sequence[Passed]) -> list[str]:
    """Of some scenes, under HEADINGS."""
    steps = sum(one.vertex_steps for one in group)
    return [
        str(len(group)), f"{sum(one.frames for one in group):,}", str(sum(len(one.crossed) for one in group)),
        str(sum(len(one.own) for one in group)), share(sum(one.cut for one in group) / max(1, steps)),
        share(max(one.share for one in group)), str(sum(one.left_out > 0 for one in group)),
        str(sum(one.verdict == "failed" for one in group)), str(sum(map(is_bad, group))),
    ]  # fmt: skip


def table(found: Sequence[Passed], by: str, caption: str = "") -> Table:
    """A row for each of a kind, most scenes first, and one of all."""
    named = BY[by]
    names = sorted({name for one in found for name in named(one)})
    groups = {name: [one for one in found if name in named(one)] for name in names}
    rows = [[name, *row(group)] for name, group in groups.items()]
    return Table((by, *HEADINGS), [*rows, ["all", *row(found)]], caption)


def tables(found: Sequence[Passed]) -> list[Table]:
    return [table(found, by, CAPTION if i == 0 else "") for i, by in enumerate(BY)]


def line(one: Passed) -> str:
    """What is to be said of a scene that was not clean; empty of one that was."""
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


def summary(found: Sequence[Passed]) -> str:
    """The counts in a sentence."""
    frames, crossed = sum(one.frames for one in found), sum(len(one.crossed) for one in found)
    own, cut = sum(len(one.own) for one in found), [one.share for one in found]
    wrong, early = sum(map(is_bad, found)), sum(one.verdict == "failed" for one in found)
    met = sum(one.touching > 0 for one in found)
    return (
        f"{len(found)} scenes, in {met} of which cloth met cloth, {frames:,} frames: cloth passes through cloth in "
        f"{crossed} by ipctk and in {own} by our own check; {wrong} scenes went wrong, {early} ended early; "
        f"steps cut short: median {share(float(np.median(cut)))} of a scene, most {share(max(cut))}"
    )


def scenes(found: Iterable[Passed]) -> Table:
    """A line a scene."""
    rows = [
        [str(one.seed), one.solver, one.body, ", ".join(one.cloths), ", ".join(one.fabrics), f"{one.rate:g}",
         str(one.vertices), str(one.frames), str(len(one.crossed)), share(one.share), str(one.held), str(one.left_out),
         str(one.touching), f"{one.seconds:.1f}", one.verdict]
        for one in found
    ]  # fmt: skip
    heads = ("seed", "solver", "body", "cloth", "fabric", "frames/s", "vertices", "frames", "crossed", "cut short",
             "held", "left out", "touching", "time [s]", "verdict")  # fmt: skip
    return Table(heads, rows, "Every scene; held: steps of held vertices that were cut short.")


def report(found: Sequence[Passed], duration: float, about: Mapping[str, str]) -> Report:
    """The page."""
    unclean = Table(
        ("verdict", "seed", "solver", "body", "frame", "why"),
        [[one.verdict, str(one.seed), one.solver, one.body, str(one.frames), line(one).partition("frames: ")[2]]
         for one in found if one.verdict != "clean"],
        "Scenes that were not clean.", prose=True,
    )  # fmt: skip
    said = f"{summary(found)}."
    parts = tables(found)
    sections: Sections = [
        ("", [said]), ("Scenes that were not clean", [unclean]), ("Counts", parts), ("Every scene", [scenes(found)]),
    ]  # fmt: skip
    each = scenes(found)
    rows = [dict(zip(each.headings, cells, strict=True)) for cells in each.rows]
    data = {"duration": duration, "scenes": [vars(one) | {"verdict": one.verdict} for one in found]}
    return Report("Cloth meets cloth", LEAD, sections, about, data, [said, *parts, unclean], rows)
