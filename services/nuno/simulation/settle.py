"""Cloth comes to rest on fewer vertices first, where its model can: a frame of a garment at half the length of edges
takes five to ten times as long, and what is left to do from the coarser rest is small.

It also makes sizes of triangles agree: friction holds cloth where it came to lie, so that meshes that are put on by
themselves hang differently by as much as friction bears.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from nuno.cloth.build import build_fabric
from nuno.scene.scene_file import Loaded
from nuno.simulation.relax import Stillness
from nuno.stepping.stepped import Stepped
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.operation import arranges
from nuno_schemas.plugin import Rested


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
    """Let a scene come to rest on fewer vertices, within its duration, while its bodies stand where they start.

    Raises BadInput where these vertices are too few, and RunFailed where a step fails.
    """
    coarse = coarser(loaded)
    if coarse is None:
        return Settled()
    if loaded.rested is not None:
        return Settled(_split(coarse, *loaded.rested))
    begin = time.perf_counter()
    try:
        simulation = simulate(coarse)
    except BadInput as error:
        build_fabric(loaded)  # which also refuses what is wrong at any size of triangles
        changed = next(i for i, model in enumerate(loaded.models) if model is not coarse.models[i])
        remedy, value = "make their sides shorter, or leave it out", loaded.models[changed].given.get("coarse")
        problem = BadInput(f"on such triangles {error.problem}", value=value, remedy=remedy)
        raise loaded.at(f"objects[{changed}].model.coarse", problem) from error
    while not simulation.stillness.rests and simulation.frame < loaded.scene.frames:
        report = simulation.step().report
        if report.status != "ok":
            raise RunFailed(f"on coarser triangles, frame {simulation.frame}: {report.message or report.status}")
    facts = {
        "vertices": float(simulation.fabric.number), "frames": float(simulation.frame),
        "rested": float(simulation.stillness.rests), "seconds": time.perf_counter() - begin,
    }  # fmt: skip
    objects = _split(coarse, simulation.fabric.position, simulation.state.x)
    return Settled(objects, ({"operation": "coarse", "object": "", "facts": facts},))


def _split(coarse: Loaded, start: Float, x: Float) -> tuple[Rested, ...]:
    """Each object's part of where vertices (n, 3) of them all began and came to lie."""
    stops = np.cumsum([model.plugin.count(model.config, coarse.files) for model in coarse.models]).tolist()
    bounds = zip(coarse.models, [0, *stops[:-1]], stops, strict=True)
    return tuple(Rested(model.config, start[a:b].copy(), x[a:b].copy()) for model, a, b in bounds)


def coarser(loaded: Loaded) -> Loaded | None:
    """The scene with its models on fewer vertices, until it rests; None where no model has any."""
    models = list(loaded.models)
    for i, model in enumerate(models):
        fewer = getattr(model.plugin, "coarser", None)
        config = fewer(model.config) if fewer else None
        models[i] = model if config is None else replace(model, config=config)
    if models == loaded.models:
        return None
    kept = [i for i, one in enumerate(loaded.operations) if arranges(one.plugin)]
    operations = [loaded.scene.operations[i] for i in kept]
    scene = loaded.scene.model_copy(update={"until": "rest", "operations": operations, "dye": None})
    return replace(loaded, scene=scene, models=models, operations=[loaded.operations[i] for i in kept], dye=None)
