"""Lines tried on the cloth as the scene begins, so that what is wrong with them is said as they are drawn."""

from __future__ import annotations

from typing import Any

from nuno import registry
from nuno.cloth import build
from nuno.scene.scene_file import Loaded
from nuno_schemas.fabric import Fabric

OPERATION = "wrinkle"


class Trial:
    """The cloth of a scene's objects at the start."""

    def __init__(self, loaded: Loaded) -> None:
        names = [spec.name for spec in loaded.scene.objects]
        self._fabrics: dict[str, Fabric] = dict(zip(names, build.build_fabrics(loaded), strict=True))
        self._plugin = registry.load("nuno.operations", OPERATION)

    def apply(self, operation: dict[str, Any]) -> None:
        """Try an operation, as a scene has it; nothing is kept. Raises BadInput."""
        fabric = self._fabrics[operation["object"]]
        beside = ("plugin", "object")
        config = self._plugin.Config.model_validate({k: v for k, v in operation.items() if k not in beside})
        self._plugin.apply(config, fabric, build.start_state(fabric), None)
