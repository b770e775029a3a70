"""The coarse version of a scene, in which its cloth comes to rest first."""

from __future__ import annotations

from dataclasses import replace

from nuno.scene.scene_file import Loaded
from nuno_schemas.operation import arranges

SPEED = 2e-3
"""Speed below which cloth rests [m/s], unless the scene has one."""


def coarser(loaded: Loaded) -> Loaded | None:
    """Return the scene with its models on fewer vertices, until rest; None where no model allows that."""
    models = list(loaded.models)
    for i, model in enumerate(models):
        make_coarser = getattr(model.plugin, "coarser", None)
        config = make_coarser(model.config) if make_coarser else None
        models[i] = model if config is None else replace(model, config=config)
    if models == loaded.models:
        return None
    kept = [i for i, operation in enumerate(loaded.operations) if arranges(operation.plugin)]
    operations = [loaded.scene.operations[i] for i in kept]
    speed = loaded.scene.rest_speed or SPEED
    update = {"until": "rest", "rest_speed": speed, "operations": operations, "dye": None}
    scene = loaded.scene.model_copy(update=update)
    return replace(loaded, scene=scene, models=models, operations=[loaded.operations[i] for i in kept], dye=None)
