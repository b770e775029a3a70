"""A scene: what to simulate, written in YAML, validated before anything starts. SI inside."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from nuno_schemas.units import quantity

if TYPE_CHECKING:  # to a type checker a quantity is the float it becomes
    Step = float
    Interval = float
    Rate = float
    Stiffness = float
    Acceleration = float
    Damping = float
    Angle = float
    Distance = float
else:
    Step = Interval = quantity("s", gt=0)
    Rate = quantity("Hz", gt=0, le=100_000)
    Stiffness = quantity("N/m", gt=0)
    Acceleration = quantity("m/s^2")
    Damping = quantity("1/s", ge=0)
    Angle = quantity("rad")
    Distance = quantity("m", gt=0)
Vector = Annotated[tuple[float, float, float], Field(description="x, y, z; y is up")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]


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
    colour: Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")] | None = Field(
        None, description="#rrggbb; stretch is shown where it is left out"
    )


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
    duration: Interval
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
        names = [part.name for part in parts]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"the name {name!r} is used twice")
        return parts

    @property
    def frames(self) -> int:
        """Whole frames in the duration, at least one."""
        return max(1, round(float(self.duration * self.frame_rate)))
