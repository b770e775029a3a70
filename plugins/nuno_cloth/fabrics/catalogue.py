"""The presets as a table: what their source gives, and what virtual tests measure on a mesh."""

from __future__ import annotations

from nuno_cloth.fabrics.kes import Measures, measure
from nuno_cloth.fabrics.presets import PRESETS, Material
from nuno_schemas.preset import Measure, Preset

COLUMNS = (
    ("density", "g/m^2", 1e3),
    ("warp", "N/m", 1.0),
    ("weft", "N/m", 1.0),
    ("shear", "N/m", 1.0),
    ("bend_warp", "uN*m", 1e6),
    ("bend_weft", "uN*m", 1e6),
)
"""Field of a material, unit of the table, and the table's units in one SI unit."""


def list_presets() -> tuple[Preset, ...]:
    """Every preset, measured on a specimen of 5 cm x 5 cm and 9 x 9 vertices.

    With the sides held a specimen gives back the preset's own values but for the tests' geometry
    (kes.py); with free sides, as in the apparatus, it narrows and gives less in tension.
    """
    return tuple(_preset(name, material) for name, material in PRESETS.items())


def _preset(name: str, material: Material) -> Preset:
    held, free = measure(name), measure(name, sides_held=False)
    measures = tuple(_measure(material, held, free, *column) for column in COLUMNS)
    damping = Measure("damping_ratio", "", material.damping_ratio)
    return Preset(name, material.source, (*measures, damping))


def _measure(material: Material, held: Measures, free: Measures, field: str, unit: str, per_si: float) -> Measure:
    tests = {"sides held": held, "sides free": free}
    measured = {test: getattr(found, field) * per_si for test, found in tests.items()}
    return Measure(field, unit, getattr(material, field) * per_si, measured)
