"""ipc-toolkit has no solver: what it and ours take to answer the same questions about the same frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from nuno.collision.crossings import find_crossings
from nuno.collision.pairs import mesh_of
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.peers.contact.problem import OVERRIDES, SCENE, THICKNESS, Pile
from nuno_bench.peers.problem import RATE
from nuno_bench.speed.timing import seconds
from nuno_contact.offset.places import TOUCHING
from nuno_schemas.fabric import Float

PAIRS, MOTION, CROSSED = "pairs nearer than the thickness", "the way to the next frame", "edges through triangles"
ASKED = {
    PAIRS: ("make a list and find what touches", "NormalCollisions.build"),
    MOTION: ("the same, and go until cloth meets", "compute_collision_free_stepsize"),
    CROSSED: ("the collision service's check", "has_intersections"),
}
"""Of each question what of ours answers it, and what of ipctk."""
FIRST, EVERY = 10, 5
"""Which frames are asked about: by the first of them the lowest square is on the ball."""
Question = Callable[[Float, Float], object]
"""Asks about a frame and the next, both (n, 3) [m]."""


@dataclass(frozen=True)
class Answer:
    """What a question about a frame takes on average, once a repeat: ours and ipctk's [ms]."""

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
    """Those of the solvers' cloth contact, which lists what it needs for many steps, and of the collision service."""
    simulation = Simulation.with_bodies(scene_file.read(shipped.find(SCENE), OVERRIDES), cores())
    term = next(term for term in simulation.system.terms if term.name == "cloth_contact")
    assert isinstance(term.data, tuple)
    (meeting,) = term.data
    begin, hold = (type(meeting).kernels.find(role) for role in ("begin", "hold"))
    mesh = mesh_of(pile.faces)

    def pairs(before: Float, after: Float) -> int:
        meeting.reference[:] = np.nan
        begin(meeting, np.ascontiguousarray(before.T), 1.0 / RATE, cores())
        return int(meeting.number[TOUCHING])

    def motion(before: Float, after: Float) -> bool:
        pairs(before, after)
        x, v = np.array(after.T, order="C"), np.array((after - before).T * RATE, order="C")
        hold(meeting, x, v, 1.0, cores())
        return bool((x == after.T).all())

    return {PAIRS: pairs, MOTION: motion, CROSSED: lambda before, after: len(find_crossings(before, mesh).edges) > 0}


def their_answers(pile: Pile) -> Mapping[str, Question]:
    """Those of ipctk, with its own defaults."""
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
