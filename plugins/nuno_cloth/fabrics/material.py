"""The `fabric` entry of a model: a preset, measured values, or spring constants set by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, field_validator, model_validator

from nuno_cloth.fabrics.presets import MEASURES, PRESETS, Material
from nuno_cloth.quantities import Density, Modulus, MomentPerWidth, Ratio, Rigidity, SpringDamping, Tensile
from nuno_schemas.errors import nearest
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Config

LIKE = {"jeans": "denim", "jersey": "interlock", "knit": "interlock"}
"""Presets that are much like a cloth of another name."""


def _known(preset: str) -> str:
    if preset not in PRESETS:
        like = f"much like it is {LIKE[preset]!r}; " if preset in LIKE else ""
        raise ValueError(f"unknown fabric preset {preset!r}; {like}{nearest(preset, PRESETS)}")
    return preset


MOST_BENT = 250.0
"""Curvature to which KES bends cloth [1/m]; what stays bent by more was not measured so."""


class Measured(Config):
    """A fabric in measured units: a preset, some of its values replaced, or all of them given."""

    preset: str | None = Field(
        default=None, description="whose values hold where none is given (nuno fabrics lists them)"
    )
    density: Density | None = Field(default=None, description="areal density [kg/m^2]")
    warp: Tensile | None = Field(
        default=None, description="tensile stiffness along the warp, per width, width held [N/m]"
    )
    weft: Tensile | None = Field(
        default=None, description="tensile stiffness along the weft, per width, width held [N/m]"
    )
    shear: Modulus | None = Field(default=None, description="shear stiffness: force per width and shear angle [N/m]")
    bend_warp: Rigidity | None = Field(default=None, description="bending rigidity of the warp yarns, per width [N*m]")
    bend_weft: Rigidity | None = Field(default=None, description="bending rigidity of the weft yarns, per width [N*m]")
    bend_bias: Rigidity | None = Field(
        default=None,
        description="the same of a strip cut at 45 degrees to both [N*m]; follows from the two unless given",
    )
    bend_poisson: float | None = Field(
        default=None,
        gt=-1,
        lt=1,
        description="how far cloth that is bent curls up across: Poisson's ratio of bending; 0 unless given",
    )
    hysteresis_warp: MomentPerWidth | None = Field(
        default=None,
        description="2HB, moment per width that warp bent to and fro has lost on its way back [N]; it keeps the "
        "curvature 2HB / 2B; 0 unless given",
    )
    hysteresis_weft: MomentPerWidth | None = Field(default=None, description="2HB of the weft [N]; 0 unless given")
    damping_ratio: Ratio | None = Field(
        default=None, description="damping of each spring as a part of its critical damping; 0.05 unless given"
    )

    @field_validator("preset")
    @classmethod
    def _preset_exists(cls, preset: str | None) -> str | None:
        return preset if preset is None else _known(preset)

    @model_validator(mode="after")
    def _complete(self) -> Measured:
        missing = [name for name in MEASURES if getattr(self, name) is None]
        if self.preset is None and missing:
            raise ValueError(f"without a preset every measure is needed; missing: {', '.join(missing)}")
        material = self.material()
        for yarn in ("warp", "weft"):
            rigidity, width = getattr(material, f"bend_{yarn}"), getattr(material, f"hysteresis_{yarn}")
            if 0.5 * width > MOST_BENT * rigidity:
                kept = f"would stay bent by more than the {MOST_BENT:g} 1/m to which cloth is tested"
                limit = f"hysteresis_{yarn} at most {2.0 * MOST_BENT * rigidity:.3g} N"
                raise ValueError(f"cloth whose bend_{yarn} is {rigidity:.3g} N*m {kept}: {limit}")
        if material.bend_bias is not None:
            if 0.0 in (material.bend_warp, material.bend_weft, material.bend_bias):
                raise ValueError("cloth with a bend_bias has bend_warp, bend_weft and bend_bias above 0")
            if material.bend_bias * material.straight >= 4.0:
                limit = f"below {4.0 / material.straight:.3g} N*m, which would take an endless stiffness against twist"
                raise ValueError(f"bend_bias of {material.bend_bias:.3g} N*m does not go with warp and weft: {limit}")
        return self

    def material(self) -> Material:
        given: dict[str, Any] = self.model_dump(exclude={"preset"}, exclude_none=True)
        if self.preset is None:
            return Material(**given, how=dict.fromkeys(given, "measured"))
        base = PRESETS[self.preset]
        if not given:
            return base
        source = f"{base.source}, changed: {', '.join(given)}"
        return replace(base, **given, source=source, how={**base.how, **dict.fromkeys(given, "measured")})


def _pair(value: object) -> object:
    """One constant stands for warp and weft alike."""
    return value if isinstance(value, (list, tuple)) else (value, value)


Pair = Annotated[
    tuple[Modulus, Modulus], BeforeValidator(_pair, json_schema_input_type=Modulus | tuple[Modulus, Modulus])
]


class HandSet(Config):
    """Constants per spring, as the papers tune them: they do not follow the mesh."""

    density: Density = Field(description="areal density [kg/m^2]")
    structural: Pair = Field(description="springs between neighbours [N/m]: one number, or [warp, weft]")
    shear: Modulus = Field(default=0.0, description="springs along diagonals [N/m]")
    bending: Pair = Field(
        default=(0.0, 0.0),
        description="the papers' springs between vertices two apart [N/m]: one number, or [warp, weft]",
    )
    hinge: Rigidity = Field(default=0.0, description="stiffness of each fold line [N*m]")
    damping: SpringDamping = Field(default=0.0, description="of each spring, along it [N*s/m]")
    damping_ratio: Ratio = Field(
        default=0.0, description="damping of each spring as a part of its critical damping, added to `damping`"
    )


def _form(value: object) -> Literal["name", "by hand", "measured"]:
    if isinstance(value, str):
        return "name"
    by_hand = "structural" in value if isinstance(value, dict) else isinstance(value, HandSet)
    return "by hand" if by_hand else "measured"


FABRIC = (
    "a preset's name (nuno fabrics lists them), a preset with some values replaced, measured values, or constants "
    "per spring set by hand"
)
FabricChoice = Annotated[
    Annotated[str, Field(json_schema_extra={"enum": sorted(PRESETS)}), BeforeValidator(_known), Tag("name")]
    | Annotated[Measured, Tag("measured")]
    | Annotated[HandSet, Tag("by hand")],
    Discriminator(_form),
]


class Materials(NamedTuple):
    """Several fabrics, and which of them each triangle is of: (f,) places in `each`."""

    each: tuple[Material, ...]
    of: Int

    def by_triangle(self, measure: str) -> Float:
        """(f,) a measure of Material."""
        return np.array([float(getattr(one, measure)) for one in self.each])[self.of]

    @staticmethod
    def spread(material: Material | Materials, triangles: int) -> Materials:
        """One fabric for so many triangles, unless it says itself which is where."""
        return material if isinstance(material, Materials) else Materials((material,), np.zeros(triangles, np.int32))


def resolve(choice: str | Measured | HandSet) -> Material | HandSet:
    """The material in measured units, or the constants set by hand."""
    if isinstance(choice, str):
        return PRESETS[choice]
    return choice.material() if isinstance(choice, Measured) else choice
