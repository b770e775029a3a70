"""Cost of contact of cloth with cloth: steps with it over steps without, their parts, and a query as the mesh
grows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from nuno.collision.crossings import Mesh, find_crossings, mesh_of
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.piles import pile, sheet
from nuno_bench.report.page import Result
from nuno_bench.speed.timing import seconds
from nuno_contact.offset.candidate_pairs import choose_near, make_list
from nuno_contact.offset.ccd import is_thorough, pass_by
from nuno_contact.offset.contact_state import CHOICES, LISTED, LISTS_MADE, STEPS, ContactState
from nuno_contact.offset.force import drag_anchors, find_touching
from nuno_contact.offset.impulse import SWEEPS, apply_impulses
from nuno_integrators.packing import copy_term, silence
from nuno_kernels.step.acceleration import evaluate
from nuno_kernels.step.blocks import sum_rows
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
"""Layers: length of an edge, distance along y, length and height of a wave, and their unevenness: cloth
that moves is not flat to the last digit [m]."""
STEEPEST = 1.15
"""The bar of the exponent."""
MOST = 3
"""Repeats of whole scenes."""
LOOKS = 6
"""Moments of a scene at which parts are timed."""
DECK = "contact/cards", tuple(f"objects.card-{k}.model.resolution=[12, 15]" for k in range(1, 53)), 0.6, 1.5
"""A deck as fine as published ones, which falls and lands: scene, overrides, duration and bar of a frame [s]."""
CALLS = 3
"""Of each part at a moment: the fastest counts, less what it takes Python to call anything with such a term."""


@dataclass(frozen=True)
class ContactCost:
    """A scene's steps with contact and without [s each], what contact goes into, and what was run."""

    on: float
    off: float
    parts: Mapping[str, float]
    frame: float
    """Time of the steps of a frame with contact [s]."""
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


def shares(what: str, found: Sequence[ContactCost]) -> list[Result]:
    """Return the parts of a step's time: the other forces and the update, each part of contact, and what is left."""

    def figure(name: str, values: Iterable[float]) -> Result:
        return Result("contact", f"{what}: {name}", "us a step", tuple(1e6 * value for value in values))

    parts = [figure(name, (one.parts[name] for one in found)) for name in found[0].parts]
    rest = (max(0.0, one.on - one.off - sum(one.parts.values())) for one in found)
    return [figure("without contact", (one.off for one in found)), *parts, figure("the rest of contact", rest)]


def on_over_off(name: str, overrides: Sequence[str], duration: float) -> ContactCost:
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
    moved = on.fabric.number * parts.contact_steps
    note = (
        f"{both[0].frame} frames of {both[0].steps} steps, {both[0].fabric.number:,} vertices, "
        f"{report.counts['cloth_contacts']:,} contacts at the end, {report.counts['cut_short']:,} of {moved:,} steps "
        "of vertices in contact cut short"
    )
    a_step = [total / (frames * both[0].steps) for total in spent]
    return ContactCost(a_step[0], a_step[1], parts.each(), spent[0] / frames, note)


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
        notes.append(f"{int(meeting.counts[LISTED]):,} pairs in the list")
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
        meeting.plan.reference[:] = np.nan
        begin(meeting, meeting.surface.start, 1.0 / 60.0, None)

    return ask


def look(fabric: Fabric, mesh: Mesh) -> None:
    """As at a published frame. Raises RunFailed if anything crosses, which would take longer."""
    if len(find_crossings(fabric.position, mesh).edges):
        raise RunFailed("the layers pass through each other")


class Parts:
    """Times of the parts [s], at moments of a run with an explicit solver, and how often its steps need each."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.moments: list[dict[str, float]] = []
        self.begun, self.first = self._counted(), simulation.frame

    @property
    def contact_steps(self) -> int:
        """Steps of contact so far: with `respa` each stands for several steps of tension."""
        return self._counted()[2]

    def look(self) -> None:
        """Time the parts as the cloth lies now; the run goes on as if it had not been looked at."""
        packed, state, dt = self._packed, self.simulation.state, self.simulation.dt
        m, threads = copy_term(self._meeting), packed.threads
        x, v = m.last.copy(), np.zeros_like(m.last)
        v[:, : len(state.v)] = state.v.T
        there = sum_rows(x, dt, v)
        calls: dict[str, Callable[[], Any]] = {
            "planes between pairs": lambda: pass_by(m, there, v, dt, threads),
            "what touches": lambda: find_touching(m, threads),
            "anchors of friction": lambda: drag_anchors(m, v, threads),
            "brakes": lambda: apply_impulses(m, v.copy(), dt, SWEEPS[1 if len(m.bodies.local) else 0], threads),
            "what is near": lambda: choose_near(m, threads),
            "lists": lambda: make_list(m, threads),
        }
        terms = packed.forces.again(m if isinstance(one, ContactState) else one for one in packed.forces)
        own, a = packed._replace(forces=terms), v.copy()
        alone, cloth, rates = silence(own, "cloth_contact"), x[:, : len(state.v)].copy(), v[:, : len(state.v)].copy()
        forces = fastest_call(lambda: evaluate(cloth, rates, 0.0, a, own))
        forces -= fastest_call(lambda: evaluate(cloth, rates, 0.0, a, alone))
        call = fastest_call(lambda: is_thorough(m))
        times = {name: fastest_call(part) - call for name, part in calls.items()}
        self.moments.append({name: max(0.0, time) for name, time in ({"forces of pairs": forces} | times).items()})

    def each(self) -> dict[str, float]:
        """Return the time of each part in a step [s], averaged over the moments."""
        lists, choices, steps = (end - begin for end, begin in zip(self._counted(), self.begun, strict=True))
        taken = self.simulation.steps * (self.simulation.frame - self.first)
        often = {"lists": lists / taken, "what is near": choices / taken}
        return {
            name: often.get(name, steps / taken) * float(np.mean([moment[name] for moment in self.moments]))
            for name in self.moments[0]
        }

    def _counted(self) -> tuple[int, int, int]:
        """Lists made so far, choices of what is near of them, and steps of contact."""
        m = self._meeting
        return int(m.counts[LISTS_MADE]), int(m.counts[CHOICES]), int(m.so_far[STEPS])

    @property
    def _packed(self) -> Any:
        work: Any = self.simulation.memory.work
        return work.packed

    @property
    def _meeting(self) -> ContactState:
        (meeting,) = (term for term in self._packed.forces if isinstance(term, ContactState))
        return meeting


def fastest_call(call: Callable[[], Any]) -> float:
    """Wall time of the fastest of some calls [s], after one that may compile."""
    call()
    return min(seconds(call) for _ in range(CALLS))
