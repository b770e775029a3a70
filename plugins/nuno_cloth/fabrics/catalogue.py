"""The presets as a table: values of their sources, and results of virtual tests on a mesh."""

from __future__ import annotations

from collections.abc import Callable

from nuno_cloth.fabrics.kes import Measures, measure
from nuno_cloth.fabrics.presets import PRESETS, Material, complete
from nuno_schemas.fabric import Fabric
from nuno_schemas.preset import Measure, Preset

COLUMNS = (
    ("density", "g/m^2", 1e3),
    ("warp", "N/m", 1.0),
    ("weft", "N/m", 1.0),
    ("shear", "N/m", 1.0),
    ("bend_warp", "uN*m", 1e6),
    ("bend_weft", "uN*m", 1e6),
)
"""Fields of a material, units of the table, and the number of these in one SI unit."""


RESOLUTION, SIZE = (9, 9), (0.05, 0.05)
"""Vertices of a specimen, and its sides [m]."""


def list_presets(cut: Callable[[str], Fabric]) -> tuple[Preset, ...]:
    """Return every preset with tests of a specimen, RESOLUTION and SIZE, that `cut` makes by the preset's name. With
    the sides held a specimen has the preset's values but for the tests' geometry (kes.py); with free sides, as in the
    apparatus, it narrows and is softer in tension.
    """
    return tuple(_preset(name, material, cut(name)) for name, material in PRESETS.items())


def _preset(name: str, material: Material, piece: Fabric) -> Preset:
    held, free = (measure(piece, RESOLUTION, SIZE, sides_held) for sides_held in (True, False))
    measures = tuple(_measure(material, held, free, *column) for column in COLUMNS)
    damping = Measure("damping_ratio", "", material.damping_ratio)
    return Preset(name, material.source, (*measures, damping), complete(material.how))


def _measure(material: Material, held: Measures, free: Measures, field: str, unit: str, per_si: float) -> Measure:
    tests = {"sides held": held, "sides free": free}
    measured = {test: getattr(results, field) * per_si for test, results in tests.items()}
    return Measure(field, unit, getattr(material, field) * per_si, measured)
