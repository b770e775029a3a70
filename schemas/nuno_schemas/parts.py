"""Building blocks of a scene: names, colours, common quantities, and choices of a plugin."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.colour import HEX, as_hex, names
from nuno_schemas.units import quantity

Interval = Annotated[float, quantity("s", gt=0)]
Metres = Annotated[float, quantity("m")]


def _written(pattern: str, problem: str) -> Any:
    """Return the type of a text that matches a pattern: editors read the pattern, people the problem."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(problem)
        return text

    return Annotated[str, AfterValidator(check), Field(json_schema_extra={"pattern": f"^{pattern}$"})]


def _colours(schema: dict[str, Any]) -> None:
    """Describe a colour in a JSON Schema: the notation in numbers, and the names to choose from."""
    del schema["type"]
    schema["anyOf"] = [{"type": "string", "pattern": f"^{HEX}$"}, {"type": "string", "enum": sorted(names())}]


if TYPE_CHECKING:
    Name = str
    Colour = str
else:
    Name = _written(
        "[A-Za-z][A-Za-z0-9_-]{0,63}", "not a name; write a letter, then at most 63 letters, digits, - or _"
    )
    Colour = Annotated[str, AfterValidator(as_hex), Field(json_schema_extra=_colours)]


class Part(BaseModel):
    """Base of every part of a scene: unknown fields are refused by name, and truth values where numbers belong."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _refuse_truth_values(cls, data: Any) -> Any:
        """To pydantic true is the number 1, and YAML reads `yes` and `on` as true."""
        for name, field in cls.model_fields.items() if isinstance(data, dict) else ():
            value, kind = data.get(name), str(field.annotation)
            if isinstance(value, bool) and re.search(r"\b(int|float)\b", kind) and not re.search(r"\bbool\b", kind):
                problem = "{value}, as YAML also reads yes, no, on and off, is not a number"
                raise PydanticCustomError("truth_value", problem, {"value": str(value).lower(), "inside": (name,)})
        return data


class Choice(BaseModel):
    """A plugin and its configuration; all fields but `plugin` are the plugin's own."""

    model_config = ConfigDict(extra="allow", frozen=True)
    plugin: str = Field(description="its name; nuno plugins lists what is installed")

    @property
    def config(self) -> dict[str, Any]:
        return dict(self.__pydantic_extra__ or {})


def require_distinct(parts: list[Any]) -> list[Any]:
    """Refuse a list with two parts of the same name."""
    first: dict[str, int] = {}
    for i, part in enumerate(parts):
        if first.setdefault(part.name, i) != i:
            # pydantic places an error of a list at the list; `inside` is the place within it.
            problem = "the name '{name}' is used twice; rename one of them"
            raise PydanticCustomError("same_name", problem, {"name": part.name, "inside": (i, "name")})
    return parts


# The solver of a scene's cloth or dye, and its step.

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
