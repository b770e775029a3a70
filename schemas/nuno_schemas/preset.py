"""Presets of fabrics and yarns, with the values of their sources and of virtual tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Measure:
    """One property of a fabric or a yarn.

    unit      unit of all values, as in a scene; "" for a ratio
    given     value of the source, or None
    measured  results of virtual tests on a mesh, by the test's name
    """

    name: str
    unit: str
    given: float | None
    measured: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Preset:
    """A preset of a fabric or a yarn. A model with presets lists them by `presets()` and by `yarns()`.

    how  origin of each value, also of values not in `measures`: `measured`, by the source, or `derived` or `assumed`
         with a colon and the reason
    """

    name: str
    source: str
    measures: tuple[Measure, ...]
    how: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Imported:
    """A fabric from a laboratory's data sheet, as a model returns it from `import_fabric(given, like, folder)`.

    fabric    values in SI by their names in a scene's `fabric`
    units     units of all values
    how       origin of each value, also of values not in `fabric`: `measured`, `derived` or `assumed` and the reason
    unused    values of the sheet without a use here
    measured  results of virtual tests on a mesh, for values with a test
    drape     measured drape, only for comparison with virtual drapes
    """

    fabric: Mapping[str, float]
    units: Mapping[str, str]
    how: Mapping[str, str]
    unused: tuple[str, ...] = ()
    measured: Mapping[str, float] = field(default_factory=dict)
    drape: Mapping[str, float] = field(default_factory=dict)
