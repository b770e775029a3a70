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
"""Presets that are similar to cloth of another name."""


def _require_preset(preset: str) -> str:
    if preset not in PRESETS:
        like = f"much like it is {LIKE[preset]!r}; " if preset in LIKE else ""
        if preset.endswith((".yaml", ".yml")):
            like = "write what stands under `fabric` in such a file into the scene, as fabric: {...}; "
        raise ValueError(f"unknown fabric preset {preset!r}; {like}{nearest(preset, PRESETS)}")
    return preset


MOST_BENT = 250.0
"""Curvature to which KES bends cloth [1/m], above which no residual curvature can be measured."""


class Measured(Config):
    """A fabric in measured units: a preset with some of its values replaced, or all values."""

    preset: str | None = Field(
        default=None, description="a preset, for all values that are not given (nuno fabrics lists them)"
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
        description="bending rigidity of a strip cut at 45 degrees to both [N*m]; derived from the two unless given",
    )
    bend_poisson: float | None = Field(
        default=None,
        gt=-1,
        lt=1,
        description="Poisson's ratio of bending, by which bent cloth curls up across; 0 unless given",
    )
    hysteresis_warp: MomentPerWidth | None = Field(
        default=None,
        description="2HB, moment per width that the bent warp has lost when it returns [N]; its residual curvature is "
        "2HB / 2B; 0 unless given",
    )
    hysteresis_weft: MomentPerWidth | None = Field(default=None, description="2HB of the weft [N]; 0 unless given")
    damping_ratio: Ratio | None = Field(
        default=None, description="damping of each spring as a part of its critical damping; 0.05 unless given"
    )

    @field_validator("preset")
    @classmethod
    def _preset_exists(cls, preset: str | None) -> str | None:
        return preset if preset is None else _require_preset(preset)

    @model_validator(mode="after")
    def _complete(self) -> Measured:
        missing = [name for name in MEASURES if getattr(self, name) is None]
        if self.preset is None and missing:
            raise ValueError(f"without a preset every measure is needed; missing: {', '.join(missing)}")
        material = self.material()
        for yarn in ("warp", "weft"):
            rigidity, width = getattr(material, f"bend_{yarn}"), getattr(material, f"hysteresis_{yarn}")
            if 0.5 * width > MOST_BENT * rigidity:
                problem = f"would stay bent by more than the {MOST_BENT:g} 1/m to which cloth is tested"
                limit = f"hysteresis_{yarn} at most {2.0 * MOST_BENT * rigidity:.3g} N"
                raise ValueError(f"cloth whose bend_{yarn} is {rigidity:.3g} N*m {problem}: {limit}")
        if material.bend_bias is not None:
            if 0.0 in (material.bend_warp, material.bend_weft, material.bend_bias):
                raise ValueError("cloth with a bend_bias has bend_warp, bend_weft and bend_bias above 0")
            if material.bend_bias * material.bias_compliance >= 4.0:
                most = 4.0 / material.bias_compliance
                limit = f"below {most:.3g} N*m, which would take an endless stiffness against twist"
                raise ValueError(f"bend_bias of {material.bend_bias:.3g} N*m does not go with warp and weft: {limit}")
        return self

    def material(self) -> Material:
        values: dict[str, Any] = self.model_dump(exclude={"preset"}, exclude_none=True)
        if self.preset is None:
            return Material(**values, how=dict.fromkeys(values, "measured"))
        base = PRESETS[self.preset]
        if not values:
            return base
        source = f"{base.source}, changed: {', '.join(values)}"
        return replace(base, **values, source=source, how={**base.how, **dict.fromkeys(values, "measured")})


def _as_pair(value: object) -> object:
    """Return [warp, weft], which are equal if one number is given."""
    return value if isinstance(value, (list, tuple)) else (value, value)


Pair = Annotated[
    tuple[Modulus, Modulus], BeforeValidator(_as_pair, json_schema_input_type=Modulus | tuple[Modulus, Modulus])
]


class HandSet(Config):
    """Constants per spring, as the papers tune them, whatever the mesh."""

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


def _discriminate(value: object) -> Literal["name", "by hand", "measured"]:
    if isinstance(value, str):
        return "name"
    by_hand = "structural" in value if isinstance(value, dict) else isinstance(value, HandSet)
    return "by hand" if by_hand else "measured"


FABRIC = (
    "a preset's name (nuno fabrics lists them), a preset with some values replaced, measured values, or constants "
    "per spring set by hand"
)
FabricChoice = Annotated[
    Annotated[str, Field(json_schema_extra={"enum": sorted(PRESETS)}), BeforeValidator(_require_preset), Tag("name")]
    | Annotated[Measured, Tag("measured")]
    | Annotated[HandSet, Tag("by hand")],
    Discriminator(_discriminate),
]


class Materials(NamedTuple):
    """Several fabrics, and the index of each triangle's fabric (f,)."""

    fabrics: tuple[Material, ...]
    fabric_index: Int

    def by_triangle(self, measure: str) -> Float:
        """Return a measure of Material by triangle (f,)."""
        return np.array([float(getattr(one, measure)) for one in self.fabrics])[self.fabric_index]

    @staticmethod
    def spread(material: Material | Materials, triangles: int) -> Materials:
        """Return one material for all of so many triangles, or the materials unchanged."""
        return material if isinstance(material, Materials) else Materials((material,), np.zeros(triangles, np.int32))


def resolve(choice: str | Measured | HandSet) -> Material | HandSet:
    """Return the material in measured units, or the constants set by hand."""
    if isinstance(choice, str):
        return PRESETS[choice]
    return choice.material() if isinstance(choice, Measured) else choice
