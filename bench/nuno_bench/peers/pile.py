"""Five squares of cloth that fall on a ball and on each other, as plain arrays, and how a second of it is judged.

ipc-toolkit has no solver: it is asked the same questions about the same frames as our own code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import ClassVar

import numpy as np

from nuno.collision.crossings import find_crossings, mesh_of
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.peers.page import Comparison, fastest
from nuno_bench.peers.problem import RATE
from nuno_bench.peers.python import Nuno
from nuno_bench.piles import Oracle
from nuno_bench.report.page import Part, Report, Sections, Table, number, spread_of
from nuno_bench.speed.timing import seconds
from nuno_contact.offset.contact_state import TOUCHING
from nuno_schemas.fabric import Float, Int

SCENE = "contact/five-sheets"
SIDES = (20, 19, 18, 17, 16)
"""Vertices along each side of the squares, which come finer and of jersey in the scene."""
DENSITY, STRETCH, SHEAR, BEND = 0.2, 300.0, 100.0, 1e-5
"""Constants of the cloth [kg/m^2, N/m with the width held, N/m, N m]. A sheet of springs is isotropic where it is
three times as stiff in tension as in shear; both its Lame constants are then its shear stiffness, which an engine that
knows only isotropic cloth can be given.
"""
THICKNESS, FRICTION = 2e-3, 0.3
"""Distance from which on cloth pushes cloth away [m], and Coulomb's coefficient of cloth on cloth."""
CENTRE, RADIUS, RUB = (0.0, 0.5, 0.0), 0.2, 0.4
"""Centre and radius of the ball [m], and Coulomb's coefficient of cloth on it."""
FABRIC = (
    f"{{density: {DENSITY}, warp: {STRETCH} N/m, weft: {STRETCH} N/m, shear: {SHEAR} N/m, bend_warp: {BEND!r} N*m, "
    f"bend_weft: {BEND!r} N*m}}"
)
OVERRIDES = (
    "damping=0",
    "forces=[]",
    f"frame_rate={RATE}",
    f"cloth_contact={{plugin: offset, thickness: {THICKNESS!r}, friction: {FRICTION}}}",
    f"bodies=[{{name: ball, friction: {RUB}, collider: {{plugin: sphere, centre: {list(CENTRE)}, radius: {RADIUS}}}}}]",
    *(f"objects.{i}.model.fabric={FABRIC}" for i in range(len(SIDES))),
    *(f"objects.{i}.model.resolution=[{side}, {side}]" for i, side in enumerate(SIDES)),
)
"""Changes of the shipped scene, so that every engine can hold it: no air, no floor, one isotropic cloth."""
LEAD = (
    f"A second of the scene contact/five-sheets: squares of {SIDES[0]} x {SIDES[0]} to {SIDES[-1]} x {SIDES[-1]} "
    f"vertices fall on a ball and on each other. All engines have one mesh, {DENSITY:g} kg/m2, {STRETCH:g} N/m in "
    f"tension, {SHEAR:g} N/m in shear, {1e6 * BEND:g} uN m in bending, no air, {1e3 * THICKNESS:g} mm of thickness and "
    f"a friction of {FRICTION:g}, each in a process of its own, on the processor."
)
PAIRS, MOTION, CROSSED = "pairs nearer than the thickness", "the way to the next frame", "edges through triangles"
ASKED = {
    PAIRS: ("make a list and find what touches", "NormalCollisions.build"),
    MOTION: ("the same, and go until cloth meets", "compute_collision_free_stepsize"),
    CROSSED: ("the collision service's check", "has_intersections"),
}
"""Of each question what of ours answers it, and what of ipctk."""
FIRST, EVERY = 10, 5
"""Frames of the questions: in the first of them the lowest square is on the ball."""
ASKING = (
    f"The same questions about every {EVERY}th frame of our first run, from the {FIRST}th on, on average a frame: "
    "repeats in turns, in one process, with all cores. Our list is made for many steps of a solver: it holds more than "
    "the pairs that are near. ipctk's are by its own defaults."
)
Question = Callable[[Float, Float], object]
"""Asks about a frame and the next, both (n, 3) [m]."""


@dataclass(frozen=True)
class Pile:
    """Cloth at rest, level along y: x (n, 3) [m], triangles (f, 3), mass (n,) [kg], gravity (3,) [m/s^2]."""

    x: Float
    faces: Int
    mass: Float
    gravity: Float

    @property
    def edges(self) -> Int:
        return mesh_of(self.faces).edges


@dataclass(frozen=True)
class PileScore:
    """Measures of the published frames of a run.

    frames   how many there are
    crossed  numbers, from 1 on, of those in which an edge goes through a triangle, by ipctk
    stretch  the largest elongation of any edge in any frame
    height   of the centre of mass in the last frame [m]
    """

    frames: int
    crossed: tuple[int, ...]
    stretch: float
    height: float


def five_sheets(*overrides: str) -> Pile:
    """The pile as plain arrays."""
    simulation = Simulation.with_bodies(scene_file.read(shipped.find(SCENE), (*OVERRIDES, *overrides)), 1)
    fabric = simulation.fabric
    return Pile(fabric.position.copy(), fabric.faces, fabric.mass, np.asarray(simulation.system.gravity, np.float64))


def look(pile: Pile, frames: Float) -> PileScore:
    """At the positions (frames, n, 3) [m] that any engine has published. Needs ipctk."""
    oracle, ends = Oracle(pile.x, pile.faces), pile.edges
    crossed = tuple(number for number, x in enumerate(frames, 1) if oracle.crossed(x))
    longest = max(float((_lengths(x, ends) / _lengths(pile.x, ends)).max()) for x in frames)
    height = float(pile.mass @ frames[-1, :, 1] / pile.mass.sum())
    return PileScore(len(frames), crossed, longest - 1.0, height)


def _lengths(x: Float, ends: Int) -> Float:
    return np.asarray(np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1))


@dataclass(frozen=True)
class Answer:
    """Mean times of a question about a frame, one per repeat: ours and ipctk's [ms]."""

    question: str
    ours: tuple[float, ...]
    theirs: tuple[float, ...]


def ask(pile: Pile, frames: Float, repeats: int) -> list[Answer]:
    """Of a run's positions (frames, n, 3) [m]; of every frame both in turns, so that what slows one slows the other."""
    asked = list(zip(frames[FIRST - 1 : -1 : EVERY], frames[FIRST::EVERY], strict=True))
    both = own_answers(pile), their_answers(pile)
    found = []
    for name in ASKED:
        spent = np.zeros((repeats + 1, 2))  # the first compiles
        for row in spent:
            for before, after in asked:
                row += [seconds(partial(each[name], before, after)) for each in both]
        ours, theirs = (1e3 / len(asked) * spent[1:]).T.tolist()
        found.append(Answer(name, tuple(ours), tuple(theirs)))
    return found


def own_answers(pile: Pile) -> Mapping[str, Question]:
    """Return our answers: by the solvers' cloth contact, whose lists serve many steps, and by the collision service."""
    simulation = Simulation.with_bodies(scene_file.read(shipped.find(SCENE), OVERRIDES), cores())
    term = next(term for term in simulation.system.terms if term.name == "cloth_contact")
    assert isinstance(term.data, tuple)
    (meeting,) = term.data
    begin, hold = (type(meeting).kernels.find(role) for role in ("begin", "hold"))
    mesh = mesh_of(pile.faces)

    def pairs(before: Float, after: Float) -> int:
        meeting.plan.reference[:] = np.nan
        begin(meeting, np.ascontiguousarray(before.T), 1.0 / RATE, cores())
        return int(meeting.counts[TOUCHING])

    def motion(before: Float, after: Float) -> bool:
        pairs(before, after)
        x, v = np.array(after.T, order="C"), np.array((after - before).T * RATE, order="C")
        hold(meeting, x, v, 1.0, cores())
        return bool((x == after.T).all())

    return {PAIRS: pairs, MOTION: motion, CROSSED: lambda before, after: len(find_crossings(before, mesh).edges) > 0}


def their_answers(pile: Pile) -> Mapping[str, Question]:
    """Return the answers of ipctk, with its own defaults."""
    import ipctk

    mesh = ipctk.CollisionMesh(pile.x, pile.edges, pile.faces)

    def pairs(before: Float, after: Float) -> int:
        found = ipctk.NormalCollisions()
        found.build(mesh, before, THICKNESS)
        return len(found)

    return {
        PAIRS: pairs,
        MOTION: lambda before, after: ipctk.compute_collision_free_stepsize(mesh, before, after) >= 1.0,
        CROSSED: lambda before, after: ipctk.has_intersections(mesh, before),
    }


class PileSolver(Nuno):
    """With cloth contact, on the pile; other scenes with it derive from this."""

    scene, overrides = SCENE, OVERRIDES

    def __init__(self, posed: object, solver: str) -> None:
        super().__init__(posed, solver, overrides=self.overrides)

    def advance(self, seconds: float) -> Float:
        frames = np.array([x.copy() for x in self.frames(seconds)])
        cut, steps = self.simulation.present().report.counts["cut_short"], self.simulation.steps
        self.remark = f"{cut:,} of {steps * frames[..., 0].size:,} steps of vertices cut short"
        return frames


JUDGED = (
    "Crossed: published frames, of 60, in which ipctk finds an edge that goes through a triangle. Stretch: the most of "
    "any edge in any frame. Height: of the centre of mass at the end. Time: the median over the repeats of the "
    "simulated second. Start, from a fresh process to the end of the first frame with all that is compiled, is in no "
    "time. Times ours: over that of our fastest with no more frames crossed; the bar is met where it is above 1. A "
    "setting is not repeated once it has used a third of its limit."
)
QUERIES = ("question", "of ours", "time [ms]", "min - max", "of ipctk", "time [ms]", "min - max", "times ours")


@dataclass(frozen=True)
class PileComparison(Comparison[PileScore]):
    """The comparison on the pile; answers: what ipctk and our code take to answer questions."""

    answers: Sequence[Answer]
    title: ClassVar[str] = "Cloth that meets cloth in other engines"
    judged: ClassVar[str] = JUDGED
    measures: ClassVar[tuple[str, ...]] = ("crossed", "stretch [%]", "height [mm]")

    def cells(self, score: PileScore) -> list[str]:
        return list(map(number, (len(score.crossed), 100 * score.stretch, 1e3 * score.height)))

    def no_worse(self, one: PileScore, other: PileScore) -> bool:
        return len(one.crossed) <= len(other.crossed)

    def tables(self) -> list[Table]:
        return [self.settings(), self.queries()]

    def queries(self) -> Table:
        """Return a table with a row per question."""
        rows = [
            [one.question, ASKED[one.question][0], number(median(one.ours)), spread_of(one.ours),
             ASKED[one.question][1], number(median(one.theirs)), spread_of(one.theirs),
             number(median(one.theirs) / median(one.ours))]
            for one in self.answers
        ]  # fmt: skip
        return Table(QUERIES, rows, ASKING)

    def verdicts(self) -> list[str]:
        """Return a sentence on the fastest setting of each engine among those with the fewest crossed frames."""
        texts = []
        for kind in self.kinds:
            scores = [point.score for point in self.of(kind) if point.score is not None]
            if not scores:
                continue
            fewest = min(scores, key=lambda seen: len(seen.crossed))
            one = fastest(self.of(kind), partial(self.no_worse, other=fewest))
            assert one is not None
            times = self.times_ours(one)
            beside = f", {number(times)} times as long as ours" if times is not None else ""
            passed = f"cloth through cloth in {len(fewest.crossed)} of {fewest.frames} frames"
            texts.append(f"{one.kind} ({one.setting}): {number(one.median)} s{beside}, {passed}.")
        return texts

    def report(self, about: Mapping[str, str]) -> Report:
        table, asked = self.settings(), self.queries()
        sections: Sections = [("", []), ("All settings", [table]), ("Questions that ipc-toolkit answers, too", [asked])]
        brief: list[Part] = [LEAD, table, JUDGED, asked, ASKING if asked.rows else ""]
        return self.compose(LEAD, sections, brief, about, answers=self.answers)
