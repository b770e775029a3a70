"""The solver of a scene's cloth or dye, and the step that it takes."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.parts import Choice, Interval

AUTO = "auto"
"""The solver that is chosen for the scene, with its step."""

Accuracy = Literal["preview", "normal", "reference"]


class Solver(Choice):
    """What steps the cloth, or spreads the dye, and its step; `solver: NAME` is short for `solver: {plugin: NAME}`."""

    dt: Interval | Literal["auto"] = Field(
        default="auto",
        description="step [s], rounded to the nearest that divides the frame; auto: the largest that is safely stable",
    )
    strict: bool = Field(default=False, description="refuse a dt that does not divide the frame")

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, value: Any) -> Any:
        return {"plugin": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _auto_alone(self) -> Solver:
        given = [*self.config, *(name for name in self.model_fields_set if name != "plugin")]
        beside = next((name for name in given if getattr(self, name) != "auto"), None)
        if self.plugin == AUTO and beside is not None:
            problem = "auto chooses this as well; leave it out, or name a solver"
            raise PydanticCustomError("beside_auto", problem, {"inside": (beside,)})
        return self
