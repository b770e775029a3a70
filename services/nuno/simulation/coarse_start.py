"""A coarse start: cloth comes to rest on fewer vertices first, where its model allows that. A frame of a garment at
half the length of edges takes five to ten times as long, and the motion that is left from the coarse rest is small.

Meshes of several sizes also agree better so: friction holds cloth where it came to lie, and meshes that start apart
hang differently by as much as friction bears.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from nuno.runtime.stepper import Stepped
from nuno.scene.coarse_scene import coarser
from nuno.scene.scene_file import Loaded
from nuno.simulation.cloth.build import build_fabric
from nuno.simulation.cloth.numbering import takes_any_numbering
from nuno.simulation.relax import Stillness
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.plugin import Rested

LONGEST = 6.0
"""Longest time of the coarse start [s], after which its state is taken even in motion. It does not depend on the
scene's duration, so that a run that is resumed for longer has the same start."""


class Settling(Protocol):
    """The part of a simulation that the coarse start uses."""

    fabric: Fabric
    state: State
    frame: int
    stillness: Stillness

    def step(self) -> Stepped: ...


@dataclass(frozen=True)
class Settled:
    """Coarse state at rest of each object, and the facts for the report; both are empty where no model asks for it."""

    objects: tuple[Rested, ...] = ()
    facts: tuple[dict[str, Any], ...] = ()


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
    coarsened = next(i for i, model in enumerate(loaded.models) if model is not coarse.models[i])
    if not takes_any_numbering(loaded):
        error_of_force = BadInput("a force knows vertices by number: on coarser triangles they are others",
                            remedy="leave it out")  # fmt: skip
        raise loaded.at(f"objects[{coarsened}].model.coarse", error_of_force)
    begin = time.perf_counter()
    try:
        simulation = simulate(coarse)
    except BadInput as error:
        if not (error.field or "").startswith(("objects", "cloth_contact")):
            raise
        build_fabric(loaded)  # raises for faults at any size of triangles
        remedy, value = "make their sides shorter, or leave it out", loaded.models[coarsened].given.get("coarse")
        problem = BadInput(f"on such triangles {error.problem}", value=value, remedy=remedy)
        raise loaded.at(f"objects[{coarsened}].model.coarse", problem) from error
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
    """Split the start and the rest of all vertices (n, 3) [m] by object."""
    bounds = zip(coarse.models, [0, *stops[:-1]], stops, strict=True)
    return tuple(Rested(model.config, start[a:b].copy(), x[a:b].copy()) for model, a, b in bounds)
