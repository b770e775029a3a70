"""A fabric from a laboratory's sheet: KES-F (Kawabata 1980), FAST (CSIRO 1989) or a cantilever (ASTM D1388).

Sheets hold numbers in their instrument's units, of warp and weft where they have two. What a fabric is described by:

density       W.
bending       B of KES-F and FAST; of a bending length c, B = W g c^3 (Peirce 1930), C45 along the bias.
hysteresis    2HB of KES-F, read between 0.5 and 1.5 1/cm.
tension       the secant at 5 gf/cm, about what garments bear by their own weight. FAST gives the strain there, E5.
              KES-F gives it at F_m = 500 gf/cm, EMT, and the linearity LT = WT / (F_m EMT / 2): with
              F = F_m (e / EMT)^p that is 2 / (p + 1), so that e(5 gf/cm) = EMT / 100^(1 / p). Specimens are wide, as
              if their sides were held.
shear         the mean of G along warp and weft; of FAST's bias extension, G = 123 N/m / EB5 (EB5 in per cent).

A sheet of any instrument may hold a drape by Cusick's drapemeter (ISO 9073-9): the drape coefficient and the nodes, or
a photograph of the shadow. It is kept for `nuno test` to be held against, and nothing of the fabric is made of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nuno_cloth.fabrics.presets import PRESETS, complete
from nuno_cloth.fabrics.shadow import count_nodes, read_shadow
from nuno_cloth.quantities import BENDING, WEIGHT
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.preset import Imported
from nuno_schemas.units import Plausible, to_si

GRAVITY = 9.80665
PULL, MOST = 5.0 * 0.980665, 500.0 * 0.980665
"""5 and 500 gf/cm [N/m]."""
CURVATURE = 250.0
"""KES-F bends up to so much [1/m]."""
PER_CENT = "percent"
STRAIN = Plausible(1e-5, 2.0)


@dataclass(frozen=True)
class Column:
    """A value of a sheet: its own unit, the SI unit, and what is plausible in that."""

    unit: str
    si: str
    plausible: Plausible
    pair: bool = True


WEIGHED = Column("g/m^2", "kg/m^2", WEIGHT, pair=False)
SHEETS: dict[str, dict[str, Column]] = {
    "KES-F": {
        "W": Column("mg/cm^2", "kg/m^2", WEIGHT, pair=False),
        "B": Column("gf*cm^2/cm", "N*m", BENDING),
        "2HB": Column("gf*cm/cm", "N", Plausible(0.0, 1.0)),
        "G": Column("gf/cm/degree", "N/m", Plausible(1.0, 2000.0)),
        "2HG": Column("gf/cm", "N/m", Plausible(0.0, 100.0)),
        "2HG5": Column("gf/cm", "N/m", Plausible(0.0, 200.0)),
        "LT": Column("", "", Plausible(0.1, 1.99)),
        "WT": Column("gf/cm", "N/m", Plausible(0.1, 500.0)),
        "EMT": Column(PER_CENT, "", STRAIN),
    },
    "FAST": {
        "W": WEIGHED,
        "C": Column("mm", "m", Plausible(1e-3, 0.2)),
        "B": Column("uN*m", "N*m", BENDING),
        "E5": Column(PER_CENT, "", STRAIN),
        "EB5": Column(PER_CENT, "", STRAIN, pair=False),
        "G": Column("N/m", "N/m", Plausible(1.0, 2000.0), pair=False),
    },
    "cantilever": {
        "W": WEIGHED,
        "C": Column("mm", "m", Plausible(1e-3, 0.2)),
        "C45": Column("mm", "m", Plausible(1e-3, 0.2), pair=False),
    },
}
UNUSED = {
    "KES-F": {"2HG", "2HG5", "RT", "LC", "WC", "RC", "T0", "TM", "MIU", "MMD", "SMD"},
    "FAST": {"E20", "E100", "T2", "T100", "ST", "STR", "RS", "HE", "F"},
    "cantilever": set[str](),
}
"""What sheets hold besides, which no force here has: hysteresis of shear, compression, surface, thickness."""
NEEDED = {
    "density": "kg/m^2", "warp": "N/m", "weft": "N/m", "shear": "N/m", "bend_warp": "N*m", "bend_weft": "N*m",
}  # fmt: skip
MORE = {"bend_bias": "N*m", "hysteresis_warp": "N", "hysteresis_weft": "N"}
"""What it may be described by besides."""
"""What a fabric is described by, and the units."""

DRAPE = {
    "drape coefficient": Column(PER_CENT, "", Plausible(0.01, 1.0), pair=False),
    "nodes": Column("", "", Plausible(0.0, 50.0), pair=False),
    "mm per pixel": Column("mm", "m", Plausible(1e-5, 5e-3), pair=False),
    "specimen": Column("cm", "m", Plausible(0.1, 0.5), pair=False),
    "support": Column("cm", "m", Plausible(0.05, 0.4), pair=False),
}
ALIASES = {"dc": "drape coefficient", "number of nodes": "nodes", "millimetres per pixel": "mm per pixel"}
DRAPED = {"drape_coefficient": "%", "nodes": "", "specimen": "cm", "support": "cm"}
"""What is kept of a drape, and the units."""


@dataclass
class Sheet:
    """Values in SI, of warp and weft, and what is told of how each measure of a fabric was had."""

    values: dict[str, tuple[float, ...]]
    fabric: dict[str, float] = field(default_factory=dict)
    how: dict[str, str] = field(default_factory=dict)

    def take(self, names: Sequence[str], values: Sequence[float], how: str) -> None:
        for name, value in zip(names, values, strict=True):
            self.fabric[name], self.how[name] = value, how


def read_sheet(given: Mapping[str, Any], like: str | None = None, folder: Path = Path()) -> Imported:
    """The fabric of a sheet: `instrument`, and values by the instrument's own names, one number or [warp, weft], in its
    units or as text with another; what it lacks is that of a preset `like`. Pictures lie in the sheet's folder.

    Raises BadInput that names the value at fault.
    """
    instrument = _instrument(given)
    columns, unused = SHEETS[instrument], UNUSED[instrument]
    sheet = Sheet({})
    for name, value in given.items():
        if name in columns:
            sheet.values[name] = _values(name, value, columns[name])
        elif name not in unused and name != "instrument" and not _is_drape(name):
            raise _unknown(name, instrument)
    READ[instrument](sheet)
    _fill(sheet, like, instrument)
    drape, how = read_drape({name: value for name, value in given.items() if _is_drape(name)}, folder)
    left_over = tuple(name for name in given if name in unused)
    return Imported(sheet.fabric, NEEDED | MORE | DRAPED, complete(sheet.how) | how, left_over, drape=drape)


def read_drape(given: Mapping[str, Any], folder: Path) -> tuple[dict[str, float], dict[str, str]]:
    """What was measured of a drape, in the units of DRAPED, and how each was had. `given` holds the `drape coefficient`
    [%] and the `nodes`, or a photograph of the `shadow`, in this folder, and its scale in `mm per pixel`; the diameters
    of `specimen` and `support` are 30 cm and 18 cm unless given. Raises BadInput that names the value at fault.
    """
    names, values = dict[str, str](), {"specimen": 0.3, "support": 0.18}
    for name, value in given.items():
        own = _drape_name(name)
        if not _is_drape(name):
            raise BadInput("not a value of a drape", field=name, remedy=nearest(str(name), (*DRAPE, "shadow")))
        if own in names:
            raise BadInput(f"{names[own]} is the same value: it is given twice", field=name, remedy="leave one out")
        names[own] = name
        if own in DRAPE:
            (values[own],) = _values(name, value, DRAPE[own])
    if values["support"] >= values["specimen"]:
        field, limit = names.get("support", names.get("specimen")), f"below {100.0 * values['specimen']:g} cm"
        value = f"{100.0 * values['support']:g} cm"
        raise BadInput("the support is as wide as the specimen", field=field, value=value, limit=limit)
    if values.get("nodes", 0.0) % 1.0:
        raise BadInput("nodes are a whole number", field=names["nodes"], value=values["nodes"], limit="0, 1, 2, ...")
    how: dict[str, str] = {own: f"measured: {names[own]}" for own in ("drape coefficient", "nodes") if own in names}
    if "shadow" in names or "mm per pixel" in names:
        picture = _measure_shadow(given, names, values, folder)
        how = dict.fromkeys(("drape coefficient", "nodes"), f"measured: {picture}")
    if not how:
        return {}, {}
    how |= {own: "measured: diameter" if own in names else "assumed: diameter" for own in ("specimen", "support")}
    kept = {own.replace(" ", "_"): 100.0 * values[own] if own != "nodes" else values[own] for own in how}
    return kept, {own.replace(" ", "_"): words for own, words in how.items()}


def _measure_shadow(given: Mapping[str, Any], names: Mapping[str, str], values: dict[str, float], folder: Path) -> str:
    """Add to the values what a photograph tells, and return its name."""
    for own, other in (("shadow", "mm per pixel"), ("mm per pixel", "shadow")):
        if own not in names:
            raise BadInput(
                f"a photograph goes with its scale, and {own} is missing", field=names[other],
                value=given[names[other]], limit="shadow and mm per pixel, or neither", remedy=f"add {own}",
            )  # fmt: skip
    for own in ("drape coefficient", "nodes"):
        if own in names:
            remedy = f"leave out {names[own]}, or {names['shadow']}"
            raise BadInput("the photograph tells this too", field=names[own], value=given[names[own]], remedy=remedy)
    name, pixel = given[names["shadow"]], values["mm per pixel"]
    picture = str(name[0] if isinstance(name, list) and len(name) == 1 else name)  # of CSV, a list of cells
    shadow = read_shadow(folder / picture, names["shadow"])
    area = float(shadow.sum()) * pixel**2
    least, most = (0.25 * math.pi * values[own] ** 2 for own in ("support", "specimen"))
    if not least <= area <= most:
        which = "smaller than the support" if area < least else "larger than the specimen"
        raise BadInput(
            f"the shadow is {which}", field=names["shadow"], value=f"{1e4 * area:.4g} cm^2, {picture}",
            limit=f"{1e4 * least:.4g} to {1e4 * most:.4g} cm^2", remedy=f"look at {names['mm per pixel']}",
        )  # fmt: skip
    row, column = (float(each.mean()) for each in np.nonzero(shadow))
    values["drape coefficient"] = (area - least) / (most - least)
    values["nodes"] = float(count_nodes(shadow, pixel, (row, column)))
    return " ".join(picture.split())  # in one line, as a comment holds it


def _drape_name(name: str) -> str:
    plain = str(name).lower().replace("_", " ")
    return ALIASES.get(plain, plain)


def _is_drape(name: str) -> bool:
    return _drape_name(name) in (*DRAPE, "shadow")


def _instrument(given: Mapping[str, Any]) -> str:
    named = given.get("instrument")
    known = {name.lower(): name for name in SHEETS}
    if not isinstance(named, str) or named.lower() not in known:
        raise BadInput(
            "which instrument's sheet is this?", field="instrument", value=named, limit=f"one of {', '.join(SHEETS)}",
            remedy="write for example instrument: KES-F: names and units follow from it",
        )  # fmt: skip
    return known[named.lower()]


def _unknown(name: str, instrument: str) -> BadInput:
    others = [other for other in SHEETS if other != instrument and name in SHEETS[other].keys() | UNUSED[other]]
    if others:
        problem, remedy = f"a sheet of {instrument} has no such value", f"is it instrument: {others[0]}?"
        return BadInput(problem, field=name, remedy=remedy)
    known = SHEETS[instrument].keys() | UNUSED[instrument] | {"instrument", "shadow"} | DRAPE.keys()
    return BadInput(f"not a value of a sheet of {instrument}", field=name, remedy=nearest(name, known))


def _values(name: str, given: object, column: Column) -> tuple[float, ...]:
    """In SI: of warp and weft where there are two."""
    parts = list(given) if isinstance(given, (list, tuple)) else [given]
    if len(parts) > (2 if column.pair else 1) or not parts:
        limit = "one number, or [warp, weft]" if column.pair else "one number"
        raise BadInput("too many values, or none", field=name, value=given, limit=limit)
    found = []
    for part in parts:
        own = f"{part!r} {column.unit}" if isinstance(part, (int, float)) and column.unit else part
        try:
            value = to_si(own, column.si)
        except ValueError as error:
            remedy = f"a plain number is in {column.unit or 'no unit'}"
            raise BadInput(str(error), field=name, value=part, remedy=remedy) from None
        if value < 0.0:
            raise BadInput("it cannot be negative", field=name, value=part, limit="0 or more")
        if not column.plausible.low <= value <= column.plausible.high:
            low, high = (
                edge / to_si(f"1 {column.unit}", column.si) for edge in (column.plausible.low, column.plausible.high)
            )
            source = f"; {column.plausible.source} {column.si}" if column.plausible.source else ""
            raise BadInput(
                "no fabric is known to have that: is it in the instrument's unit?", field=name, value=part,
                limit=f"{low:.3g} to {high:.3g} {column.unit}{source}", remedy=f"a plain number is in {column.unit}",
            )  # fmt: skip
        found.append(value)
    return tuple(found * 2 if column.pair and len(found) == 1 else found)


def _kes(sheet: Sheet) -> None:
    values = sheet.values
    if "B" in values:
        sheet.take(("bend_warp", "bend_weft"), values["B"], "measured: B")
        for direction, width, rigidity in zip(("warp", "weft"), values.get("2HB", ()), values["B"], strict=False):
            if width > 2.0 * rigidity * CURVATURE:
                raise BadInput(
                    "so wide a loop has no room: the moment at the greatest curvature is B times 2.5 1/cm",
                    field="2HB", value=f"{width / to_si('1 gf', 'N'):.3g} gf*cm/cm, {direction}",
                    limit=f"{2.0 * rigidity * CURVATURE / to_si('1 gf', 'N'):.3g} gf*cm/cm",
                    remedy="look whether B and 2HB are in gf*cm^2/cm and gf*cm/cm",
                )  # fmt: skip
        if "2HB" in values:
            sheet.take(("hysteresis_warp", "hysteresis_weft"), values["2HB"], "measured: 2HB")
    if "G" in values:
        sheet.take(("shear",), (sum(values["G"]) / 2.0,), "measured: mean of G along warp and weft")
    if "EMT" not in values:
        return
    strains = values["EMT"]
    if "LT" in values:
        linear, by = values["LT"], "LT"
    elif "WT" in values:
        linear, by = tuple(w / (0.5 * MOST * e) for w, e in zip(values["WT"], strains, strict=True)), "WT"
    else:
        linear, by = (1.0, 1.0), "assuming LT = 1, for neither LT nor WT is given"
    powers = [2.0 / each - 1.0 for each in linear]
    for name, each, power in zip(("warp", "weft"), linear, powers, strict=True):
        if not power > 0.0:
            raise BadInput(
                "no cloth gets so much softer as it is pulled", field=by, value=f"LT {each:.3g}, {name}",
                limit="an LT below 2", remedy="look at WT and EMT",
            )  # fmt: skip
    stiff = [PULL / (e * (PULL / MOST) ** (1.0 / p)) for e, p in zip(strains, powers, strict=True)]
    sheet.take(("warp", "weft"), stiff, f"derived: secant at 5 gf/cm, from EMT and {by}")


def _fast(sheet: Sheet) -> None:
    values = sheet.values
    _bend(sheet)
    if "B" in values:
        sheet.take(("bend_warp", "bend_weft"), values["B"], "measured: B")
    if "E5" in values:
        sheet.take(("warp", "weft"), [PULL / e for e in values["E5"]], "measured: E5")
    if "EB5" in values:
        sheet.take(("shear",), (1.23 / values["EB5"][0],), "derived: 123 / EB5")
    if "G" in values:
        sheet.take(("shear",), values["G"], "measured: G")


def _bend(sheet: Sheet) -> None:
    values = sheet.values
    if "C" in values and "W" in values:
        bend = [values["W"][0] * GRAVITY * c**3 for c in values["C"]]
        sheet.take(("bend_warp", "bend_weft"), bend, "derived: W g C^3")
        if "C45" in values:
            sheet.take(("bend_bias",), [values["W"][0] * GRAVITY * values["C45"][0] ** 3], "derived: W g C45^3")


READ: dict[str, Callable[[Sheet], None]] = {"KES-F": _kes, "FAST": _fast, "cantilever": _bend}


def _fill(sheet: Sheet, like: str | None, instrument: str) -> None:
    """The density, and what is missing, from a preset."""
    if "W" in sheet.values:
        sheet.take(("density",), sheet.values["W"], "measured: W")
    missing = [name for name in NEEDED if name not in sheet.fabric]
    if missing and like is None:
        raise BadInput(
            f"the sheet does not tell {', '.join(missing)}", field="instrument", value=instrument,
            remedy="add what is missing, or take it from a preset: --like trousers",
        )  # fmt: skip
    if like is not None and like not in PRESETS:
        raise BadInput(f"unknown fabric preset {like!r}", field="--like", remedy=nearest(like, PRESETS))
    for name in missing:
        sheet.take((name,), (float(getattr(PRESETS[str(like)], name)),), f"assumed: as of {like}")
    order = {name: sheet.fabric[name] for name in (*NEEDED, *MORE) if name in sheet.fabric}
    sheet.fabric = order
