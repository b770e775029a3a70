"""The result of trials of cloth and dye, and the scene with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from nuno.formatting import many
from nuno.scene import scene_file
from nuno.scene.override import as_override
from nuno.scene.scene_file import Loaded
from nuno_schemas.parts import Accuracy

PROMISE: dict[Accuracy, float] = {"preview": 1e-2, "normal": 1e-3, "reference": 1e-4}
"""Largest error of each accuracy. For cloth, the distance to the exact motion, root mean square over vertices and
frames, as a share of the cloth's size (the diagonal of its bounding box), as long as the motion can be predicted: until
a disturbance has grown a thousandfold. For dye, the difference of any cell's amount to the exact evolution of the
cells, at the end of any frame, as a share of the largest amount at the end of any frame."""


@dataclass(frozen=True)
class Selection:
    """A solver with its steps a frame, its error [sizes, or largest amounts], and its cost a frame [evaluations of the
    forces, or explicit steps]; `tried` is False where the error is extrapolated from fewer steps by the order of the
    method.
    """

    name: str
    steps: int
    error: float
    cost: float
    tried: bool = True

    @property
    def said(self) -> tuple[str, str]:
        """Steps and error in words."""
        return f"{many(self.steps, 'step')} a frame", f"{self.error:.2g}" if self.tried else f"about {self.error:.2g}"


def written(loaded: Loaded, solver: Mapping[str, Any], reason: str, dyed: bool = False) -> Loaded:
    """Return the scene with this solver of its cloth or its dye, as if it were written in it."""
    chosen, data = dict(solver), dict(loaded.data)
    overrides = [as_override("dye.solver" if dyed else "solver", chosen)]
    if dyed:
        data["dye"] = {**data["dye"], "solver": chosen}
    else:
        data["solver"] = chosen
    if not (dyed and loaded.scene.moves):  # otherwise the cloth's step is not chosen yet
        data.pop("accuracy", None)
        overrides.append("accuracy=null")
    decided = scene_file.load(data, loaded.lines, loaded.file, loaded.files)
    reasons = f"{reason}; dye: {loaded.why}" if loaded.why else reason
    return replace(decided, overrides=(*loaded.overrides, *overrides), path=loaded.path, why=reasons)
