"""The `fabric` entry of a model: a preset, measured values, or spring constants set by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, field_validator, model_validator

from nuno_cloth.presets import PRESETS, Material
from nuno_cloth.quantities import Density, Modulus, Ratio, Rigidity, SpringDamping, Tensile
from nuno_schemas.errors import nearest
from nuno_schemas.plugin import Config

MEASURES = ("density", "warp", "weft", "shear", "bend_warp", "bend_weft")


def _known(preset: str) -> str:
    if preset not in PRESETS:
        raise ValueError(f"unknown fabric preset {preset!r}; {nearest(preset, PRESETS)}")
    return preset


class Measured(Config):
    """A fabric in measured units: a preset, some of its values replaced, or all of them given."""

    preset: str | None = None
    density: Density | None = None
    warp: Tensile | None = None
    weft: Tensile | None = None
    shear: Modulus | None = None
    bend_warp: Rigidity | None = None
    bend_weft: Rigidity | None = None
    damping_ratio: Ratio | None = None

    @field_validator("preset")
    @classmethod
    def _preset_exists(cls, preset: str | None) -> str | None:
        return preset if preset is None else _known(preset)

    @model_validator(mode="after")
    def _complete(self) -> Measured:
        missing = [name for name in MEASURES if getattr(self, name) is None]
        if self.preset is None and missing:
            raise ValueError(f"without a preset every measure is needed; missing: {', '.join(missing)}")
        return self

    def material(self) -> Material:
        given: dict[str, Any] = self.model_dump(exclude={"preset"}, exclude_none=True)
        if self.preset is None:
            return Material(**given)
        base = PRESETS[self.preset]
        return replace(base, **given, source=f"{base.source}, changed: {', '.join(given)}") if given else base


def _pair(value: object) -> object:
    """One constant stands for warp and weft alike."""
    return value if isinstance(value, (list, tuple)) else (value, value)


class HandSet(Config):
    """Constants per spring, as the papers tune them: they do not follow the mesh.

    structural and bending may be one number or [warp, weft].
    """

    density: Density
    structural: Annotated[
        tuple[Modulus, Modulus], BeforeValidator(_pair, json_schema_input_type=Modulus | tuple[Modulus, Modulus])
    ]
    shear: Modulus = 0.0
    bending: Annotated[
        tuple[Modulus, Modulus], BeforeValidator(_pair, json_schema_input_type=Modulus | tuple[Modulus, Modulus])
    ] = (0.0, 0.0)
    hinge: Rigidity = 0.0
    damping: SpringDamping = 0.0


def _form(value: object) -> Literal["name", "by hand", "measured"]:
    if isinstance(value, str):
        return "name"
    by_hand = "structural" in value if isinstance(value, dict) else isinstance(value, HandSet)
    return "by hand" if by_hand else "measured"


FabricChoice = Annotated[
    Annotated[str, Field(json_schema_extra={"enum": sorted(PRESETS)}), BeforeValidator(_known), Tag("name")]
    | Annotated[Measured, Tag("measured")]
    | Annotated[HandSet, Tag("by hand")],
    Discriminator(_form),
]


def resolve(choice: str | Measured | HandSet) -> Material | HandSet:
    """The material in measured units, or the constants set by hand."""
    if isinstance(choice, str):
        return PRESETS[choice]
    return choice.material() if isinstance(choice, Measured) else choice
