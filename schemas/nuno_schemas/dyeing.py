"""The part of a scene that describes dyeing: dyes and their presets, the solver, and the look of dyed cloth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.errors import nearest
from nuno_schemas.parts import AUTO, Choice, Colour, Interval, Metres, Name, Part, Solver, require_distinct
from nuno_schemas.preset import Measure, Preset
from nuno_schemas.units import quantity

# Presets of dyes. The diffusion coefficient follows from the molar mass; most other values are assumed, and marked so.
#
# D0       3.6 sqrt(76 / M) mm^2/h, M in g/mol (dye paper, equation 5), unless measured.
# isotherm its measured kind, if any: indigo on silk follows Langmuir (Kongkachuichay et al., Chiang Mai Journal of
#          Science 37(2), 2010, 363-367), madder on wool Nernst and Temkin (Chemchame et al., International Journal of
#          Chemical Sciences 19(1), 2021, 306). Amounts here are shares of a cell's capacity, so that constants from a
#          laboratory, in grams per litre, cannot be used: all constants are chosen.
# colour   chosen by eye from dyed cloth, without a colour standard.

MM2_PER_HOUR = 1e-6 / 3600.0
"""[m^2/s]."""


@dataclass(frozen=True)
class KnownDye:
    """A dye preset: fields of the scene's dye, in SI; fibre and mordant they apply to; the origin `how` of each of
    these: `measured`, or `derived` or `assumed`, a colon and the reason; source; molar mass of the colourant [g/mol].
    """

    fields: Mapping[str, Any]
    fibre: str
    mordant: str
    how: Mapping[str, str]
    source: str
    mass: float | None = None


def spread(mass: float) -> float:
    """Return the diffusion coefficient in water [m^2/s] of a dye of this molar mass [g/mol]."""
    return 3.6 * math.sqrt(76.0 / mass) * MM2_PER_HOUR


def _natural(
    colourant: str, mass: float, fibre: str, mordant: str, source: str, isotherm: Mapping[str, Any], kind: str,
    colour: Mapping[str, str] | None = None,
) -> KnownDye:  # fmt: skip
    fields: dict[str, Any] = {"D0": spread(mass), "adsorption": 0.01, "isotherm": isotherm}
    how = {
        "D0": f"derived: 3.6 sqrt(76 / M) mm^2/h of {colourant}, M = {mass:g} g/mol",
        "adsorption": "assumed: as of the dye paper's figure 9",
        "isotherm": f"assumed: {kind}; its constant is chosen",
        "fibre": "assumed: a fibre that is dyed so",
        "mordant": "assumed: as is customary",
    }
    if colour is not None:
        fields["colour"], how["colour"] = colour, "assumed: by eye"
    return KnownDye(fields, fibre, mordant, how, source, mass)


_PARTITION = {"plugin": "partition", "k": 0.5}
_MADDER = {"light": "#f7eeee", "mid": "#d0605a", "dark": "#7a1518"}
_WELD = {"light": "#f6f4e4", "mid": "#e8c94a", "dark": "#c08a10"}
_WALNUT = {"light": "#f5f0ea", "mid": "#a87c50", "dark": "#46290f"}

PRESETS: dict[str, KnownDye] = {
    "indigo": _natural(
        "indigotin", 262.26, "silk", "none, from a vat",
        "kind of isotherm: Kongkachuichay et al., Chiang Mai Journal of Science 37(2), 2010, 363-367",
        {"plugin": "langmuir", "K": 5.0}, "Langmuir, as measured on silk",
    ),
    "madder": _natural(
        "alizarin", 240.21, "wool", "alum",
        "kind of isotherm: Chemchame et al., International Journal of Chemical Sciences 19(1), 2021, 306",
        _PARTITION, "partition, which with Temkin's was measured to fit on wool", _MADDER,
    ),
    "weld": _natural("luteolin", 286.24, "wool", "alum", "no measurement", _PARTITION, "as of madder", _WELD),
    "walnut": _natural("juglone", 174.15, "wool", "none", "no measurement", _PARTITION, "as of madder", _WALNUT),
    "dye-paper": KnownDye(
        {"D0": 1.93 * MM2_PER_HOUR, "adsorption": 0.01, "isotherm": _PARTITION}, "not said", "not said",
        {
            "D0": "assumed: of table 1, for which 264 g/mol would do",
            "adsorption": "assumed: of table 1, figure 9",
            "isotherm": "assumed: of figure 9(a); its constant is not printed, and chosen",
            "fibre": "assumed: not said",
            "mordant": "assumed: not said",
        },
        "the dye of the dye paper's figures, which it does not name",
    ),
}  # fmt: skip
"""A preset without a colour has the default colour of a scene's dye."""


def written_out(name: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """Return a dye's fields as in a scene: those of the preset, replaced by those in `own`, also within the colour."""
    fields = {"name": name, **PRESETS[name].fields, **own}
    colour, changed = PRESETS[name].fields.get("colour"), own.get("colour")
    if isinstance(colour, Mapping) and isinstance(changed, Mapping):
        fields["colour"] = {**colour, **changed}
    return fields


def list_dyes() -> tuple[Preset, ...]:
    """Return every preset, in units of scenes, with the constants of its isotherm by name."""
    return tuple(_preset(name, known) for name, known in PRESETS.items())


def _preset(name: str, known: KnownDye) -> Preset:
    isotherm = known.fields["isotherm"]
    measures = (
        Measure("M", "g/mol", known.mass),
        Measure("D0", "mm^2/h", known.fields["D0"] / MM2_PER_HOUR),
        Measure("adsorption", "", known.fields["adsorption"]),
        *(Measure(constant, "", isotherm.get(constant)) for constant in ("k", "K")),
    )
    source = f"{isotherm['plugin']}; fibre: {known.fibre}; mordant: {known.mordant}; {known.source}"
    return Preset(name, source, measures, known.how)


# The part of a scene that describes the look of dyed cloth: a dye's colours, and the picture.

Amount = Annotated[float, quantity("", gt=0)]

YARNS = "yarns"
"""The default plugin for pictures of dyed cloth."""
DyeView = Literal["all", "fixed", "mobile"]
"""Dye that is shown: all, fixed by fibre, or mobile."""
Form = Literal["straight", "smooth"]
"""Form of yarns as curves."""
Scale = Annotated[int, Field(strict=True, ge=1, le=256)]


class DyeColour(Part):
    """A dye's colours on cloth; indigo on cotton unless given."""

    light: Colour = Field(
        default="#eef2f7", description="where there is none of it; of the dye's own hue, for hues between are passed"
    )
    mid: Colour = Field(default="#5f86b3", description="at half of the full amount")
    dark: Colour = Field(default="#16264f", description="at the full amount, and beyond")
    full: Amount = Field(default=0.25, description="the amount that is dark, as a share of v_max")


class Crop(Part):
    """A part of the cloth, from its upper left corner, x to the right and y down."""

    low: tuple[Metres, Metres] = Field(description="upper left corner [m]")
    high: tuple[Metres, Metres] = Field(description="lower right corner [m]")

    @model_validator(mode="after")
    def _holds_something(self) -> Crop:
        if not (self.low[0] < self.high[0] and self.low[1] < self.high[1]):
            problem = "there is nothing between the corners; low is the upper left one, y counts down"
            raise PydanticCustomError("empty_crop", problem, {"inside": ("high",)})
        return self


class DyePicture(Choice):
    """The plugin that draws dyed cloth, and its settings; all other fields are the plugin's own."""

    plugin: str = Field(default=YARNS, description="its name; nuno plugins lists what is installed")
    view: DyeView = Field(default="all", description="all dye, what fibre has fixed of it, or what is mobile")
    scale: Scale | Literal["auto"] = Field(
        default="auto", description="pixels a cell; auto: the picture about 1000 pixels wide or high"
    )
    crop: Crop | None = Field(default=None, description="the part that is shown; left out: all of the cloth")
    every: Interval | None = Field(
        default=None, description="at most one picture in this time in the viewer [s]; left out: one a frame"
    )


# The part of a scene that describes dyeing.

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
    uptake: Literal["difference", "amount"] = Field(
        default="difference",
        description="what drives adsorption: the difference of mobile and fixed dye, which ends it where they are "
        "equal; or the amount of mobile dye, until fibre holds what the isotherm allows",
        examples=["amount"],
    )
    weisz_zollinger: WeiszZollinger | None = Field(default=None, description="how D falls with dye; else D = D0 P T")
    colour: DyeColour = Field(default=DyeColour(), description="on cloth, in pictures")

    @model_validator(mode="before")
    @classmethod
    def _of_preset(cls, data: Any) -> Any:
        """Replace a preset by its fields: the scene is then equal to one with these fields."""
        fields = {"preset": data} if isinstance(data, str) else data
        if not isinstance(fields, dict) or fields.get("preset") is None:
            return data
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
        if self.uptake == "amount" and not self.adsorption:
            problem = "fibre that fixes no dye has no uptake; give adsorption and an isotherm, or leave uptake out"
            raise PydanticCustomError("no_uptake", problem, {"inside": ("uptake",)})
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
