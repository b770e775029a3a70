"""What is found by trials of cloth and of dye alike, and the scene as if its author had written it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from nuno.formatting import many
from nuno.scene import scene_file
from nuno.scene.override import as_override
from nuno.scene.scene_file import Loaded
from nuno_schemas.solver import Accuracy

PROMISE: dict[Accuracy, float] = {"preview": 1e-2, "normal": 1e-3, "reference": 1e-4}
"""Of cloth, the distance to the exact motion, root mean square over vertices and frames, as a share of the cloth's size
(the diagonal of its bounding box), as long as the motion can be predicted: until a disturbance has grown a
thousandfold. Of dye, that of any cell's amount to the exact evolution of the cells, at the end of any frame, as a share
of the largest amount at the end of any frame."""


@dataclass(frozen=True)
class Selection:
    """A solver with the steps a frame that it needs, its error there [sizes, or largest amounts], and its cost a frame
    [evaluations of the forces, or explicit steps]; `tried` is False where the error follows from fewer steps by the
    order of the method.
    """

    name: str
    steps: int
    error: float
    cost: float
    tried: bool = True

    @property
    def said(self) -> tuple[str, str]:
        """Its steps and its error in words."""
        return f"{many(self.steps, 'step')} a frame", f"{self.error:.2g}" if self.tried else f"about {self.error:.2g}"


def written(loaded: Loaded, solver: Mapping[str, Any], why: str, dyed: bool = False) -> Loaded:
    """The scene as if its author had named the solver of its cloth or its dye, with these fields."""
    chosen, data = dict(solver), dict(loaded.data)
    overrides = [as_override("dye.solver" if dyed else "solver", chosen)]
    if dyed:
        data["dye"] = {**data["dye"], "solver": chosen}
    else:
        data["solver"] = chosen
    if not (dyed and loaded.scene.moves):  # else the cloth's step is still to be chosen for it
        data.pop("accuracy", None)
        overrides.append("accuracy=null")
    decided = scene_file.load(data, loaded.lines, loaded.file, loaded.files)
    both = f"{why}; dye: {loaded.why}" if loaded.why else why
    return replace(decided, overrides=(*loaded.overrides, *overrides), path=loaded.path, why=both)
