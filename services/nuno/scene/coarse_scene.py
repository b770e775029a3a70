"""A scene on fewer vertices, on which it comes to rest first."""

from __future__ import annotations

from dataclasses import replace

from nuno.scene.scene_file import Loaded
from nuno_schemas.operation import arranges

SPEED = 2e-3
"""What moves slower than this [m/s] rests, where the scene does not say."""


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
    speed = loaded.scene.rest_speed or SPEED
    update = {"until": "rest", "rest_speed": speed, "operations": operations, "dye": None}
    scene = loaded.scene.model_copy(update=update)
    return replace(loaded, scene=scene, models=models, operations=[loaded.operations[i] for i in kept], dye=None)
