"""Fabrics and yarns that a scene can name, with what their sources say and virtual tests find."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Measure:
    """One property of a fabric or a yarn.

    unit      of all its values, as a scene may write it; "" for a ratio
    given     what the source says, None where it says nothing
    measured  what virtual tests find on a mesh, by the test's name
    """

    name: str
    unit: str
    given: float | None
    measured: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Preset:
    """A fabric or a yarn that a scene can name. A model that knows some lists them by `presets()` and by `yarns()`.

    how  of each value, also of those that `measures` leaves out: `measured`, by the source, or `derived` or `assumed`
         with a colon and the reason
    """

    name: str
    source: str
    measures: tuple[Measure, ...]
    how: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Imported:
    """A fabric from a laboratory's sheet, of a model that reads some by `import_fabric(given, like, folder)`.

    fabric    values in SI by their names in a scene's `fabric`
    units     of all values
    how       of each value, also of those that `fabric` leaves to it: `measured`, `derived` or `assumed` and the reason
    unused    values of the sheet that nothing here is made of
    measured  what virtual tests find of each on a mesh, where there is a test
    drape     what was measured of its drape, for virtual ones to be held against: nothing is made of it
    """

    fabric: Mapping[str, float]
    units: Mapping[str, str]
    how: Mapping[str, str]
    unused: tuple[str, ...] = ()
    measured: Mapping[str, float] = field(default_factory=dict)
    drape: Mapping[str, float] = field(default_factory=dict)
