"""Cloth comes to rest on fewer vertices first, where its model can: a frame of a garment at half the length of edges
takes five to ten times as long, and what is left to do from the coarser rest is small.

It also makes sizes of triangles agree: friction holds cloth where it came to lie, so that meshes that are put on by
themselves hang differently by as much as friction bears.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from nuno.cloth.build import build_fabric
from nuno.cloth.numbering import takes_any_numbering
from nuno.scene.coarse_scene import coarser
from nuno.scene.scene_file import Loaded
from nuno.simulation.relax import Stillness
from nuno.stepping.stepper import Stepped
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.plugin import Rested

LONGEST = 6.0
"""What does not rest within this time [s] goes on as it is then: whatever the scene's duration is, so that a run that
is resumed for longer has begun in the same place."""


class Settling(Protocol):
    """What is used of a simulation."""

    fabric: Fabric
    state: State
    frame: int
    stillness: Stillness

    def step(self) -> Stepped: ...


@dataclass(frozen=True)
class Settled:
    """Each object as it has come to rest; none where no model wants that. And what is to be said of it."""

    objects: tuple[Rested, ...] = ()
    told: tuple[dict[str, Any], ...] = ()


def settle(loaded: Loaded, simulate: Callable[[Loaded], Settling]) -> Settled:
    """Let a scene come to rest on fewer vertices, while its bodies stand where they start.

    Raises BadInput where these vertices are too few, or a force knows vertices by number, and RunFailed where a step
    fails.
    """
    coarse = coarser(loaded)
    if coarse is None:
        return Settled()
    stops = np.cumsum([model.plugin.count(model.config, coarse.files) for model in coarse.models]).tolist()
    if loaded.settled is not None and len(loaded.settled[0]) == stops[-1]:
        return Settled(_split(coarse, stops, *loaded.settled))
    first = next(i for i, model in enumerate(loaded.models) if model is not coarse.models[i])
    if not takes_any_numbering(loaded):
        numbered = BadInput("a force knows vertices by number: on coarser triangles they are others",
                            remedy="leave it out")  # fmt: skip
        raise loaded.at(f"objects[{first}].model.coarse", numbered)
    begin = time.perf_counter()
    try:
        simulation = simulate(coarse)
    except BadInput as error:
        if not (error.field or "").startswith(("objects", "cloth_contact")):
            raise
        build_fabric(loaded)  # which also refuses what is wrong at any size of triangles
        remedy, value = "make their sides shorter, or leave it out", loaded.models[first].given.get("coarse")
        problem = BadInput(f"on such triangles {error.problem}", value=value, remedy=remedy)
        raise loaded.at(f"objects[{first}].model.coarse", problem) from error
    while not simulation.stillness.rests and simulation.frame < LONGEST * loaded.scene.frame_rate:
        report = simulation.step().report
        if report.status != "ok":
            raise RunFailed(f"on coarser triangles, frame {simulation.frame}: {report.message or report.status}")
    facts = {
        "vertices": float(simulation.fabric.number), "frames": float(simulation.frame),
        "rested": float(simulation.stillness.rests), "seconds": time.perf_counter() - begin,
    }  # fmt: skip
    objects = _split(coarse, stops, simulation.fabric.position, simulation.state.x)
    return Settled(objects, ({"operation": "coarse", "object": "", "facts": facts},))


def _split(coarse: Loaded, stops: list[int], start: Float, x: Float) -> tuple[Rested, ...]:
    """Each object's part of where vertices (n, 3) of them all began and came to lie."""
    bounds = zip(coarse.models, [0, *stops[:-1]], stops, strict=True)
    return tuple(Rested(model.config, start[a:b].copy(), x[a:b].copy()) for model, a, b in bounds)
