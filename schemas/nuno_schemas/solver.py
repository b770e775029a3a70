"""The solver of a scene's cloth or dye, and its step."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.parts import Choice, Interval

AUTO = "auto"
"""Name of the choice that leaves solver and step to nuno."""

Accuracy = Literal["preview", "normal", "reference"]


class Solver(Choice):
    """The solver of the cloth or the dye, and its step; `solver: NAME` is short for `solver: {plugin: NAME}`."""

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
        names = [*self.config, *(name for name in self.model_fields_set if name != "plugin")]
        extra = next((name for name in names if getattr(self, name) != "auto"), None)
        if self.plugin == AUTO and extra is not None:
            problem = "auto chooses this as well; leave it out, or name a solver"
            raise PydanticCustomError("beside_auto", problem, {"inside": (extra,)})
        return self
