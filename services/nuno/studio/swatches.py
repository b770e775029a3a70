"""What presets look like where they are chosen: a dye by its colours, a fabric by its weight and by how it bends."""

from __future__ import annotations

from typing import Any

from nuno import registry
from nuno_schemas.dye_presets import PRESETS
from nuno_schemas.look import DyeColour
from nuno_schemas.preset import Preset

SHADES = ("light", "mid", "dark")


def swatches() -> dict[str, Any]:
    """Of each dye its colours from light to dark; of each fabric its areal density [g/m^2] and its bending rigidity,
    the mean of warp and weft [uN m].
    """
    model = registry.offering("nuno.models", "presets", "lists fabrics")
    return {
        "dyes": {name: _shades(dye.fields.get("colour", {})) for name, dye in PRESETS.items()},
        "fabrics": {preset.name: _feel(preset) for preset in model.presets()},
    }


def _shades(given: dict[str, str]) -> list[str]:
    colour = DyeColour.model_validate(given)
    return [str(getattr(colour, shade)) for shade in SHADES]


def _feel(preset: Preset) -> dict[str, float]:
    given = {one.name: one.given for one in preset.measures}
    bends = [value for name in ("bend_warp", "bend_weft") if (value := given.get(name)) is not None]
    return {"density": given["density"] or 0.0, "bend": sum(bends) / len(bends)}
