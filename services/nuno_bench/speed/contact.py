"""What contact of cloth with cloth costs: steps with it over steps without, and a query as the mesh grows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from nuno.collision.crossings import find_crossings
from nuno.collision.pairs import Mesh, mesh_of
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.problem.piles import pile, sheet
from nuno_bench.report.result import Result
from nuno_bench.speed.timing import seconds
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric

ON, OFF = "cloth_contact={plugin: offset}", "cloth_contact=none"
SCENES: dict[str, tuple[str, tuple[str, ...], float, float, float | None]] = {
    "a skirt that swings": ("skirt-hula", (), 2.0, 1.6, 1.3),
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


def contact(repeats: int) -> list[Result]:
    """Steps of scenes with it over without; exponents of queries."""
    results = []
    for what, (name, overrides, duration, bar, aim) in SCENES.items():
        ratios, note = zip(*(on_over_off(name, overrides, duration) for _ in range(min(repeats, MOST))), strict=True)
        results.append(Result("contact", f"{what}: steps with contact over without", "times", ratios, bar=bar, aim=aim,
                              at_most=True, note=note[0]))  # fmt: skip
    return results + queries(repeats)


def on_over_off(name: str, overrides: Sequence[str], duration: float) -> tuple[float, str]:
    """Wall time of a scene's frames with cloth contact over that without, and what was run.

    Both take the step that the scene has with contact, and frames in turns, so that a slow machine slows both.
    """
    chosen = (*overrides, f"duration={duration!r}")

    def made(*more: str) -> Simulation:
        simulation = Simulation.with_bodies(scene_file.read(scene_file.find(name), (*chosen, *more)), cores())
        simulation.present()
        return simulation

    on = made(ON)
    step = f"solver.dt={on.dt!r}"
    both = made(ON, step), made(OFF, step)
    if both[0].steps != both[1].steps:
        raise RunFailed(f"{name} takes {both[0].steps} steps a frame with contact and {both[1].steps} without")
    for simulation in both:
        simulation.step()  # compiles
    spent, report = [0.0, 0.0], on.present().report
    while not both[0].finished:
        for i, simulation in enumerate(both):
            frame = simulation.step()
            spent[i] += frame.seconds
            if (report := frame.report if i == 0 else report).status != "ok":
                raise RunFailed(f"{report.status}: {report.message}")
    moved = on.fabric.number * both[0].steps * both[0].frame
    note = (
        f"{both[0].frame} frames of {both[0].steps} steps, {both[0].fabric.number:,} vertices, "
        f"{report.counts['cloth_contacts']:,} contacts at the end, {report.counts['cut_short']:,} of {moved:,} steps "
        "of vertices cut short"
    )
    return spent[0] / spent[1], note


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
        notes.append(f"{int(meeting.number[0]):,} pairs in the list")
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
