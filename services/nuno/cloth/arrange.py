"""Operations that move all cloth of a scene before anything acts on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from nuno.cloth.join import join_fabrics
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric
from nuno_schemas.operation import Surface, arranges


@dataclass(frozen=True)
class Start:
    """The fabric of each object at the start, and what operations said that moved it there: operation, object ("" for
    all) and facts.
    """

    fabrics: list[Fabric]
    told: list[dict[str, Any]]


def arrange(loaded: Loaded, fabrics: list[Fabric], bodies: Surface | None) -> Start:
    """Let the scene's operations that arrange the start do so, in their order, round the bodies that cloth meets as it
    meets cloth. Raises BadInput.

    An operation on one object moves that one alone: all others are held.
    """
    scene, told = loaded.scene, list[dict[str, Any]]()
    stops = np.cumsum([0, *(fabric.number for fabric in fabrics)]).tolist()
    names = [spec.name for spec in scene.objects]
    objects = {name: np.arange(a, b, dtype=np.int32) for name, (a, b) in zip(names, pairwise(stops), strict=True)}
    meet = scene.meet() if scene.meets else np.ones((len(names), len(names)), np.bool_)
    thickness = getattr(loaded.cloth_contact.config, "thickness", None) if loaded.cloth_contact else None
    for i, (applied, chosen) in enumerate(zip(scene.operations, loaded.operations, strict=True)):
        if not arranges(chosen.plugin):
            continue
        whole = join_fabrics(fabrics, scene.name)
        if applied.object is not None:
            held = np.ones(whole.number, np.bool_)
            held[objects[applied.object]] = False
            whole = replace(whole, pinned=whole.pinned | held)
        try:
            made = chosen.plugin.arrange(chosen.config, whole, objects, meet, thickness, bodies)
        except BadInput as error:
            raise loaded.at(f"operations[{i}]", error) from None
        fabrics = [replace(f, position=made.position[a:b]) for f, (a, b) in zip(fabrics, pairwise(stops), strict=True)]
        told.append({"operation": chosen.name, "object": applied.object or "", "facts": dict(made.facts)})
    return Start(fabrics, told)
