"""What contact of cloth with cloth costs: steps with it over steps without, what they go into, and a query as the mesh
grows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from nuno.collision.crossings import find_crossings
from nuno.collision.pairs import Mesh, mesh_of
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.problem.piles import pile, sheet
from nuno_bench.report.result import Result
from nuno_bench.speed.contact_parts import Parts
from nuno_bench.speed.timing import seconds
from nuno_contact.offset.places import LISTED
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric

ON, OFF = "cloth_contact={plugin: offset}", "cloth_contact=none"
SCENES: dict[str, tuple[str, tuple[str, ...], float, float, float | None]] = {
    "a skirt that swings": ("skirt-hula", ("solver.plugin=symplectic_euler",), 2.0, 1.6, 1.3),
    "a sheet that touches nothing": ("hanging-sheet", ("objects.0.model.resolution=[64, 64]",), 1.0, 1.1, None),
}
"""Scene, overrides, duration [s], bar and aim of each."""
SIDES = (36, 51, 71, 101, 142)
"""Vertices a side of each of two layers: about 5,000 to 80,000 triangles together."""
EDGE, GAP, WAVE, HIGH, ROUGH = 0.01, 1.3e-3, 0.5, 0.05, 1e-5
"""Of the layers: length of an edge, distance along y, length of a wave and its height, and how uneven they are: cloth
that moves is not flat to the last digit [m]."""
STEEPEST = 1.15
"""The bar of the exponent."""
MOST = 3
"""Repeats of whole scenes."""
LOOKS = 6
"""Moments of a scene at which parts are timed."""
DECK = "contact/cards", tuple(f"objects.card-{k}.model.resolution=[12, 15]" for k in range(1, 53)), 0.6, 1.5
"""A deck as fine as published ones, which falls and lands: scene, overrides, duration and bar of a frame [s]."""


@dataclass(frozen=True)
class Compared:
    """A scene's steps with contact and without [s each], what contact goes into, and what was run."""

    on: float
    off: float
    parts: Mapping[str, float]
    frame: float
    """What the steps of a frame take with contact [s]."""
    note: str


def contact(repeats: int) -> list[Result]:
    """Steps of scenes with it over without; a deck of cards; exponents of queries."""
    results = []
    for what, (name, overrides, duration, bar, aim) in SCENES.items():
        found = [on_over_off(name, overrides, duration) for _ in range(min(repeats, MOST))]
        ratios = tuple(one.on / one.off for one in found)
        results.append(Result("contact", f"{what}: steps with contact over without", "times", ratios, bar=bar, aim=aim,
                              at_most=True, note=found[0].note))  # fmt: skip
        results += shares(what, found)
    name, overrides, duration, bar = DECK
    deck, what = on_over_off(name, overrides, duration), "52 cards that fall and land"
    results.append(Result("contact", f"{what}: the steps of a frame", "s", (deck.frame,), bar=bar, at_most=True,
                          note=deck.note))  # fmt: skip
    return results + shares(what, [deck]) + queries(repeats)


def shares(what: str, found: Sequence[Compared]) -> list[Result]:
    """What a step's time goes into: the other forces and the update, each part of contact, and what is left."""

    def figure(name: str, values: Iterable[float]) -> Result:
        return Result("contact", f"{what}: {name}", "us a step", tuple(1e6 * value for value in values))

    parts = [figure(name, (one.parts[name] for one in found)) for name in found[0].parts]
    rest = (max(0.0, one.on - one.off - sum(one.parts.values())) for one in found)
    return [figure("without contact", (one.off for one in found)), *parts, figure("the rest of contact", rest)]


def on_over_off(name: str, overrides: Sequence[str], duration: float) -> Compared:
    """A scene's frames with cloth contact and without. Raises RunFailed where one ends early.

    Both take the step that the scene has with contact, and frames in turns, so that a slow machine slows both.
    """
    chosen = (*overrides, f"duration={duration!r}")

    def made(*more: str) -> Simulation:
        simulation = Simulation.with_bodies(scene_file.read(shipped.find(name), (*chosen, *more)), cores())
        simulation.present()
        return simulation

    on = made(ON)
    step = f"solver.dt={on.dt!r}"
    both = made(ON, step), made(OFF, step)
    if both[0].steps != both[1].steps:
        raise RunFailed(f"{name} takes {both[0].steps} steps a frame with contact and {both[1].steps} without")
    for simulation in both:
        simulation.step()  # compiles
    spent, report, parts = [0.0, 0.0], on.present().report, Parts(both[0])
    first, every = both[0].frame, max(1, round(duration * on.loaded.scene.frame_rate / LOOKS))
    while not both[0].finished:
        for i, simulation in enumerate(both):
            frame = simulation.step()
            spent[i] += frame.seconds
            if (report := frame.report if i == 0 else report).status != "ok":
                raise RunFailed(f"{report.status}: {report.message}")
        if both[0].frame % every == 0:
            parts.look()
    frames = both[0].frame - first
    moved = on.fabric.number * both[0].steps * both[0].frame
    note = (
        f"{both[0].frame} frames of {both[0].steps} steps, {both[0].fabric.number:,} vertices, "
        f"{report.counts['cloth_contacts']:,} contacts at the end, {report.counts['cut_short']:,} of {moved:,} steps "
        "of vertices cut short"
    )
    a_step = [total / (frames * both[0].steps) for total in spent]
    return Compared(a_step[0], a_step[1], parts.each(), spent[0] / frames, note)


def layers(side: int) -> list[Fabric]:
    """Two waved sheets, one just above the other."""
    size = (side - 1) * EDGE
    pieces, rng = [sheet(side, size, at=np.array([0.0, GAP * k, 0.0])) for k in (0, 1)], np.random.default_rng(side)
    for piece in pieces:
        piece.position[:, 1] += HIGH * np.sin(2.0 * np.pi * piece.position[:, 0] / WAVE)
        piece.position[:] += ROUGH * rng.standard_normal(piece.position.shape)
    return pieces


def queries(repeats: int) -> list[Result]:
    """Milliseconds of a solver's list and of the collision service's check, and how they grow with the triangles."""
    asked: list[dict[str, Callable[[], Any]]] = []
    triangles, notes = list[int](), list[str]()
    for side in SIDES:
        system = pile(*layers(side))
        fabric, data = system.fabric, system.terms[-1].data
        assert isinstance(data, tuple)
        (meeting,) = data
        asked.append({"list": listing(meeting), "check": partial(look, fabric, mesh_of(fabric.faces))})
        triangles.append(len(fabric.faces))
        for ask in asked[-1].values():
            ask()
        notes.append(f"{int(meeting.number[LISTED]):,} pairs in the list")
    # Each repeat asks for every size, so that a slow machine slows all of them.
    samples = [[{name: 1e3 * seconds(ask) for name, ask in one.items()} for one in asked] for _ in range(repeats)]
    results = []
    for name, what in (("list", "a list of pairs"), ("check", "the collision service's check")):
        each = [[sizes[k][name] for sizes in samples] for k in range(len(SIDES))]
        slopes = [float(np.polyfit(np.log(triangles), np.log([s[name] for s in sizes]), 1)[0]) for sizes in samples]
        results += [
            Result("contact", f"{what}, {count:,} triangles", "ms", tuple(times), note=note)
            for count, times, note in zip(triangles, each, notes, strict=True)
        ]
        results.append(Result("contact", f"{what}: exponent over the triangles", "", tuple(slopes), bar=STEEPEST,
                              at_most=True))  # fmt: skip
    return results


def listing(meeting: Any) -> Callable[[], None]:
    """Begins contact anew, which makes its list and finds what touches."""
    begin = type(meeting).kernels.find("begin")

    def ask() -> None:
        meeting.reference[:] = np.nan
        begin(meeting, meeting.start, 1.0 / 60.0, None)

    return ask


def look(fabric: Fabric, mesh: Mesh) -> None:
    """As at a published frame. Raises RunFailed if anything crosses, which would take longer."""
    if len(find_crossings(fabric.position, mesh).edges):
        raise RunFailed("the layers pass through each other")
