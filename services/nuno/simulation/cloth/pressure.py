"""Pressure of knits on bodies, by the operation `pressure`, for reports, tables and pictures."""

from __future__ import annotations

from nuno.plugin_contract import registry
from nuno.scene.scene_file import Loaded
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.operation import Outcome
from nuno_schemas.plugin import Landmarked

OPERATION = "pressure"


def has_pressure(fabric: Fabric) -> bool:
    """Return whether the fabric is a net of yarns with areas, as knits are."""
    return fabric.yarns is not None and fabric.cells is not None and len(fabric.cells) > 0


def named_heights(loaded: Loaded) -> dict[str, float]:
    """Return the heights [m] of named places on bodies at rest; if several bodies have a name, the first one counts."""
    heights: dict[str, float] = {}
    for collider, motion in zip(loaded.colliders, loaded.motions, strict=True):
        if motion is None and isinstance(collider.plugin, Landmarked):
            heights = {**collider.plugin.heights(collider.config), **heights}
    return heights


def find_pressure(loaded: Loaded, fabric: Fabric, x: Float) -> Outcome:
    """Apply the operation at x (n, 3) [m]: array `pressure` (n,) [Pa], and facts, also at `named_heights`."""
    operation = registry.load("nuno.operations", OPERATION)
    config = operation.Config.model_validate({"heights": named_heights(loaded)})
    outcome: Outcome = operation.apply(config, fabric, State(x, 0.0 * x), None)
    return outcome
