"""The part of a scene that describes dyeing."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.errors import nearest
from nuno_schemas.look import DyeColour, DyePicture
from nuno_schemas.parts import Choice, Name, Part, require_distinct
from nuno_schemas.solver import AUTO, Solver
from nuno_schemas.units import quantity

Diffusion = Annotated[float, quantity("m^2/s", ge=0)]
Speed = Annotated[float, quantity("", gt=0, le=1e9)]


class DyeSolver(Solver):
    """What spreads the dye, and its step; `solver: NAME` is short for `solver: {plugin: NAME}`."""

    substeps: Literal["refused", "allowed"] = Field(
        default="refused", description="allowed: a step above the stability limit is taken as several shorter ones"
    )


class WeiszZollinger(Part):
    """Diffusion that is slower where there is more dye: D = D0 P T min(cap, phi0 / phi) (dye paper, equation 4).

    The flux through a face follows from the integral of D over phi between the amounts on its sides.
    """

    phi0: float = Field(gt=0, le=1e6, description="mobile dye at equilibrium; where there is as much, D = D0 P T")
    cap: float = Field(gt=0, le=1e6, description="the most that phi0 / phi counts as, which has no bound without dye")

    @model_validator(mode="before")
    @classmethod
    def _capped(cls, data: Any) -> Any:
        if isinstance(data, dict) and "cap" not in data:
            problem = "phi0 / phi has no bound where there is no dye; add a cap, for example cap: 10"
            raise PydanticCustomError("no_cap", problem)
        return data


def _presets() -> list[str]:
    from nuno_schemas.dye_presets import PRESETS

    return list(PRESETS)


def _may_be_named(schema: dict[str, Any]) -> None:
    """Make name and D0 optional in the JSON Schema of a dye that names a preset."""
    del schema["required"]
    schema["anyOf"] = [{"required": ["name", "D0"]}, {"required": ["preset"]}]
    schema["properties"]["preset"] = {**schema["properties"]["preset"], "enum": _presets()}
    schema["properties"]["preset"].pop("anyOf")


def _or_named(schema: dict[str, Any]) -> None:
    """Allow the name of a preset in the place of a dye, in the JSON Schema of a list of dyes."""
    schema["items"] = {"anyOf": [schema["items"], {"type": "string", "enum": _presets()}]}


class Dyestuff(Part):
    """One of the dyes in a cloth; they do not act on each other. A preset's name alone stands for all of its fields."""

    model_config = ConfigDict(json_schema_extra=_may_be_named)

    preset: str | None = Field(
        default=None, description="whose fields hold where none are given (nuno dyes lists them), also its name"
    )
    name: Name = Field(description="of the dye; no other has it")
    D0: Diffusion = Field(description="its diffusion coefficient in water, 3.6 sqrt(76 / M) mm^2/h [m^2/s]")
    adsorption: float = Field(
        default=0.0, ge=0, le=1e6, description="D_ab / D0, how fast fibre fixes dye; 0: it fixes none"
    )
    isotherm: Choice | None = Field(default=None, description="how much fibre fixes at most: a plugin and its fields")
    weisz_zollinger: WeiszZollinger | None = Field(default=None, description="how D falls with dye; else D = D0 P T")
    colour: DyeColour = Field(default=DyeColour(), description="on cloth, in pictures")

    @model_validator(mode="before")
    @classmethod
    def _of_preset(cls, data: Any) -> Any:
        """Replace a preset by its fields: the scene is then equal to one with these fields."""
        fields = {"preset": data} if isinstance(data, str) else data
        if not isinstance(fields, dict) or fields.get("preset") is None:
            return data
        from nuno_schemas.dye_presets import PRESETS, written_out  # not imported for scenes without presets

        overrides = {key: value for key, value in fields.items() if key != "preset"}
        name = fields["preset"]
        if not isinstance(name, str) or name not in PRESETS:
            context = {"name": str(name), "known": nearest(str(name), PRESETS)}
            inside = () if isinstance(data, str) else ("preset",)
            raise PydanticCustomError("no_dye", "unknown dye preset '{name}'; {known}", {**context, "inside": inside})
        return written_out(name, overrides)

    @model_validator(mode="after")
    def _fixed_by_a_law(self) -> Dyestuff:
        if self.adsorption and self.isotherm is None:
            problem = (
                "fibre that fixes dye needs an isotherm; add isotherm: {plugin: partition, k: 1}, or adsorption: 0"
            )
            raise PydanticCustomError("no_isotherm", problem, {"inside": ("adsorption",)})
        return self


class Dyeing(Part):
    """A cloth that is dyed: a piece of cloth by itself, or one of the scene's objects."""

    object: Name | None = Field(
        default=None,
        description="the object that is dyed, whose texture the cloth's cells cover; left out: a cloth that does not "
        "move, and no objects",
    )
    cloth: Choice = Field(description="what builds it: a plugin and its fields")
    solver: DyeSolver = Field(
        default=DyeSolver(plugin=AUTO),
        description="a plugin with its fields, and its step; auto: chosen for the scene and `accuracy`",
    )
    dyes: list[Dyestuff] = Field(
        min_length=1,
        max_length=16,
        description="what the cloth is dyed with: presets' names, or dyes",
        json_schema_extra=_or_named,
    )
    speed: Speed = Field(
        default=1.0, description='seconds of dyeing in a second of the scene, 1800 or "30 min/s"; supplies count these'
    )
    picture: DyePicture = Field(
        default=DyePicture(), description="how it is drawn: a plugin with its fields, and what is shown"
    )

    @model_validator(mode="before")
    @classmethod
    def _object_not_on(cls, data: Any) -> Any:
        # `on` is the obvious word, and YAML 1.1 readers turn it into true.
        for name in ("on", "true"):
            if isinstance(data, dict) and name in data:
                problem = "no such field; the object that is dyed is `object`: write object: {value}"
                raise PydanticCustomError("object_not_on", problem, {"value": str(data[name]), "inside": (name,)})
        return data

    @field_validator("dyes")
    @classmethod
    def _names_differ(cls, dyes: list[Dyestuff]) -> list[Dyestuff]:
        return require_distinct(dyes)
