"""A scene: what to simulate, written in YAML, validated before anything starts. SI inside."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.units import quantity

if TYPE_CHECKING:  # to a type checker a quantity is the float it becomes
    Interval = float
    Duration = float
    Rate = float
    Stiffness = float
    Acceleration = float
    Damping = float
    Angle = float
    Distance = float
    Metres = float
else:
    Interval = quantity("s", gt=0)
    Duration = quantity("s", gt=0, le=1e9)
    Rate = quantity("Hz", gt=0, le=100_000)
    Stiffness = quantity("N/m", gt=0)
    Acceleration = quantity("m/s^2")
    Damping = quantity("1/s", ge=0)
    Angle = quantity("rad")
    Distance = quantity("m", gt=0)
    Metres = quantity("m")


def _written(pattern: str, problem: str) -> Any:
    """Text of a form: editors learn the pattern, people read the words."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(problem)
        return text

    return Annotated[str, AfterValidator(check), Field(json_schema_extra={"pattern": f"^{pattern}$"})]


if TYPE_CHECKING:
    Name = str
    Colour = str
else:
    Name = _written(
        "[A-Za-z][A-Za-z0-9_-]{0,63}", "not a name; write a letter, then at most 63 letters, digits, - or _"
    )
    Colour = _written("#[0-9a-fA-F]{6}", "not a colour; write red, green and blue as #rrggbb, for example #c04030")
Vector = Annotated[tuple[Metres, Metres, Metres], Field(description="x, y, z [m]; y is up")]


class Part(BaseModel):
    """Base of every part of a scene: unknown fields are refused by name."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Choice(BaseModel):
    """A plugin and its configuration; the fields beside `plugin` are the plugin's own."""

    model_config = ConfigDict(extra="allow", frozen=True)
    plugin: str

    @property
    def config(self) -> dict[str, Any]:
        return dict(self.__pydantic_extra__ or {})


class Solver(Choice):
    """The integrator and its step."""

    dt: Annotated[Interval, Field(description="step [s], or auto")] | Literal["auto"] = "auto"


class Object(Part):
    """A piece of cloth."""

    name: Name
    model: Choice
    colour: Colour | None = Field(None, description="#rrggbb; stretch is shown where it is left out")


class Body(Part):
    """Something the cloth meets."""

    name: Name
    collider: Choice
    motion: Choice | None = Field(None, description="left out: the body does not move")
    stiffness: Stiffness | Literal["auto"] = "auto"
    damping: Annotated[float, Field(ge=0, le=10)] = Field(
        0.5, description="normal damping in contact, as a ratio of critical"
    )
    friction: Annotated[float, Field(ge=0, le=100)] = Field(0.3, description="Coulomb coefficient")


class Record(Part):
    """What goes into the recording."""

    checkpoint_every: Interval | None = Field(
        default=None, description="interval of float64 checkpoints; the last state is always kept"
    )


class View(Part):
    """How pictures are taken; what is left out is fitted to the scene."""

    azimuth: Angle = Field(default=0.6, description="[rad] round the vertical, 0 looks along -z")
    elevation: Angle = 0.2
    target: Vector | None = None
    distance: Distance | None = None
    size: tuple[Annotated[int, Field(ge=16, le=8192)], Annotated[int, Field(ge=16, le=8192)]] = (960, 720)


class Scene(Part):
    """The whole scene. Quantities carry units ("1 ms", "27 N/m"); a bare number is SI."""

    nuno: Literal[1] = Field(description="scene schema version")
    name: Name
    description: str = ""
    duration: Duration
    frame_rate: Rate = 60.0
    solver: Solver
    allow_unstable: bool = Field(False, description="accept a step above the stability limit")
    gravity: tuple[Acceleration, Acceleration, Acceleration] = (0.0, -9.81, 0.0)
    damping: Damping = Field(0.0, description="viscous, per unit mass [1/s]")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    objects: list[Object] = Field(default_factory=list, max_length=1000)
    bodies: list[Body] = Field(default_factory=list, max_length=1000)
    forces: list[Choice] = Field(default_factory=list, max_length=1000)
    contact: Choice = Choice(plugin="penalty")
    record: Record = Record()
    view: View = View()

    @field_validator("objects", "bodies")
    @classmethod
    def _names_differ(cls, parts: list[Any]) -> list[Any]:
        first: dict[str, int] = {}
        for i, part in enumerate(parts):
            if first.setdefault(part.name, i) != i:
                # pydantic places an error of a list at the list; `inside` says where in it.
                raise PydanticCustomError(
                    "same_name",
                    "the name '{name}' is used twice; rename one of them",
                    {"name": part.name, "inside": (i, "name")},
                )
        return parts

    @property
    def frames(self) -> int:
        """Whole frames in the duration, at least one."""
        return max(1, round(float(self.duration * self.frame_rate)))
