"""A fabric from a laboratory's sheet: KES-F (Kawabata 1980), FAST (CSIRO 1989) or a cantilever (ASTM D1388).

Sheets hold numbers in their instrument's units, for warp and weft if there are two. The measures of a fabric:

density       W.
bending       B of KES-F and FAST; of a bending length c, B = W g c^3 (Peirce 1930), C45 along the bias.
hysteresis    2HB of KES-F, read between 0.5 and 1.5 1/cm.
tension       the secant at 5 gf/cm, about what garments bear by their own weight. FAST gives the strain there, E5.
              KES-F gives it at F_m = 500 gf/cm, EMT, and the linearity LT = WT / (F_m EMT / 2): with
              F = F_m (e / EMT)^p that is 2 / (p + 1), so that e(5 gf/cm) = EMT / 100^(1 / p). Specimens are wide, as
              if their sides were held.
shear         the mean of G along warp and weft; of FAST's bias extension, G = 123 N/m / EB5 (EB5 in per cent).

A sheet of any instrument may hold a drape by Cusick's drapemeter (ISO 9073-9): the drape coefficient and the nodes, or
a photograph of the shadow. `nuno test` compares with it; it does not change the fabric.
"""

from __future__ import annotations

import math
import re
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
from nuno_schemas.units import Plausible, decimal_point, to_si

# Values of a laboratory's sheet: each has its own unit, and a range in which fabrics are known.

PER_CENT = "percent"
BARE = re.compile(r"[-+\d.,/\s]*\d(?:\.?[eE][-+]?\d+)?\.?\s*")
"""A number, or its text, without a unit."""


@dataclass(frozen=True)
class Column:
    """A value of a sheet: its unit, the SI unit, and the plausible range in SI."""

    unit: str
    si: str
    plausible: Plausible
    pair: bool = True
    least: float = 0.0
    """A smaller number in SI needs its unit: per cent may be written as a fraction."""


def values_of(name: str, entry: object, column: Column) -> tuple[float, ...]:
    """Return a value in SI, for warp and weft if there are two; no text, or n/a, is a missing one. Raises BadInput."""
    parts = list(entry) if isinstance(entry, (list, tuple)) else [entry]
    parts = ["" if str(part).strip().lower() in ("n/a", "na") else part for part in parts]
    if "" in parts and column.pair:
        remedy = "measure it, or write the other's number again if it holds for both"
        raise BadInput(f"the {('warp', 'weft')[parts.index('')]}'s number is missing", field=name, remedy=remedy)
    parts = [part for part in parts if part != ""]
    if len(parts) > (2 if column.pair else 1) or not parts:
        limit = "one number, or [warp, weft]" if column.pair else "one number"
        raise BadInput("too many values, or none", field=name, value=entry, limit=limit)
    values = []
    for part in parts:
        with_unit = f"{part} {column.unit}" if column.unit and BARE.fullmatch(str(part)) else part
        try:
            value = to_si(with_unit, column.si)
        except ValueError as error:
            problem, _, remedy = str(error).partition("; ")
            if remedy.startswith("write for example") or not remedy:
                remedy = f"a plain number is in {column.unit or 'no unit'}"
            remedy = decimal_point(str(part)) or remedy
            raise BadInput(problem, field=name, value=part, remedy=remedy) from None
        if value < 0.0:
            raise BadInput("it cannot be negative", field=name, value=part, limit="0 or more")
        usual = column.plausible
        if not usual.low <= value <= usual.high:
            low, high = (edge / to_si(f"1 {column.unit}", column.si) for edge in (usual.low, usual.high))
            source = f"; {usual.source} {column.si}" if usual.source else ""
            raise BadInput(
                "no fabric is known to have that: is it in the instrument's unit?", field=name, value=part,
                limit=f"{low:.3g} to {high:.3g} {column.unit}".rstrip() + source,
                remedy=f"a plain number is in {column.unit}" if column.unit else "write it as a ratio",
            )  # fmt: skip
        if with_unit is not part and 0.0 < value < column.least:
            remedy = f"write {1e4 * value:.4g}, or '{part} {column.unit}'"
            limit = f"{100.0 * column.least:.3g} {column.unit} without a unit"
            raise BadInput(f"a fraction, or so little in {column.unit}?", None, None, name, part, limit, remedy)
        values.append(value)
    return tuple(values * 2 if column.pair and len(values) == 1 else values)


# A measured drape (Cusick's drapemeter, ISO 9073-9): a coefficient and nodes, or a photograph of the shadow.

DRAPE = {
    "drape coefficient": Column(PER_CENT, "", Plausible(0.01, 1.0), pair=False),
    "nodes": Column("", "", Plausible(0.0, 50.0), pair=False),
    "mm per pixel": Column("mm", "m", Plausible(1e-5, 5e-3), pair=False),
    "specimen": Column("cm", "m", Plausible(0.1, 0.5), pair=False),
    "support": Column("cm", "m", Plausible(0.05, 0.4), pair=False),
}
ALIASES = {"dc": "drape coefficient", "number of nodes": "nodes", "millimetres per pixel": "mm per pixel"}
DRAPED = {"drape_coefficient": "%", "nodes": "", "specimen": "cm", "support": "cm"}
"""Units of the values that a drape gives."""


def read_drape(entries: Mapping[str, Any], folder: Path) -> tuple[dict[str, float], dict[str, str]]:
    """Return a drape's values, in the units of DRAPED, and the origin of each. `entries` hold the `drape coefficient`
    [%] and the `nodes`, or a photograph of the `shadow`, in this folder, and its scale in `mm per pixel`; the diameters
    of `specimen` and `support` are 30 cm and 18 cm by default. Raises BadInput that names the value at fault.
    """
    names, values = dict[str, str](), {"specimen": 0.3, "support": 0.18}
    for name, value in entries.items():
        key = _drape_key(name)
        if not is_drape(name):
            raise BadInput("not a value of a drape", field=name, remedy=nearest(str(name), (*DRAPE, "shadow")))
        if key in names:
            raise BadInput(f"{names[key]} is the same value: it is given twice", field=name, remedy="leave one out")
        names[key] = name
        if key in DRAPE:
            (values[key],) = values_of(name, value, DRAPE[key])
    if values["support"] >= values["specimen"]:
        field, limit = names.get("support", names.get("specimen")), f"below {100.0 * values['specimen']:g} cm"
        value = f"{100.0 * values['support']:g} cm"
        raise BadInput("the support is as wide as the specimen", field=field, value=value, limit=limit)
    if values.get("nodes", 0.0) % 1.0:
        raise BadInput("nodes are a whole number", field=names["nodes"], value=values["nodes"], limit="0, 1, 2, ...")
    how: dict[str, str] = {key: f"measured: {names[key]}" for key in ("drape coefficient", "nodes") if key in names}
    if "shadow" in names or "mm per pixel" in names:
        picture = _measure_shadow(entries, names, values, folder)
        how = dict.fromkeys(("drape coefficient", "nodes"), f"measured: {picture}")
    if not how:
        return {}, {}
    how |= {key: "measured: diameter" if key in names else "assumed: diameter" for key in ("specimen", "support")}
    drape = {key.replace(" ", "_"): 100.0 * values[key] if key != "nodes" else values[key] for key in how}
    return drape, {key.replace(" ", "_"): words for key, words in how.items()}


def _measure_shadow(
    entries: Mapping[str, Any], names: Mapping[str, str], values: dict[str, float], folder: Path
) -> str:
    """Add the drape coefficient and nodes of a photograph to the values, and return its name."""
    for key, other in (("shadow", "mm per pixel"), ("mm per pixel", "shadow")):
        if key not in names:
            raise BadInput(
                f"a photograph goes with its scale, and {key} is missing", field=names[other],
                value=entries[names[other]], limit="shadow and mm per pixel, or neither", remedy=f"add {key}",
            )  # fmt: skip
    for key in ("drape coefficient", "nodes"):
        if key in names:
            remedy = f"leave out {names[key]}, or {names['shadow']}"
            raise BadInput("the photograph tells this too", field=names[key], value=entries[names[key]], remedy=remedy)
    name, pixel = entries[names["shadow"]], values["mm per pixel"]
    picture = str(name[0] if isinstance(name, list) and len(name) == 1 else name)  # of CSV, a list of cells
    shadow = read_shadow(folder / picture, names["shadow"])
    area = float(shadow.sum()) * pixel**2
    least, most = (0.25 * math.pi * values[key] ** 2 for key in ("support", "specimen"))
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


def _drape_key(name: str) -> str:
    plain = str(name).lower().replace("_", " ")
    return ALIASES.get(plain, plain)


def is_drape(name: str) -> bool:
    return _drape_key(name) in (*DRAPE, "shadow")


GRAVITY = 9.80665
PULL, MOST = 5.0 * 0.980665, 500.0 * 0.980665
"""5 and 500 gf/cm [N/m]."""
AGREE = 0.1
"""Largest relative difference of LT and the same of WT: laboratories round both."""
COMPUTED = 0.2
"""Largest relative difference of FAST's B and W g C^3, and of its G and 123 / EB5: C is rounded, and cubed."""
CURVATURE = 250.0
"""Largest curvature of KES-F [1/m]."""
STRAIN = Plausible(1e-5, 2.0)
COMMON = {
    "W": (0.031, 0.488, ("density",), ("mg/cm^2", "g/m^2")),
    "B": (9e-7, 1.1e-4, ("bend_warp", "bend_weft"), ("gf*cm^2/cm", "uN*m")),
}
"""5th and 95th percentiles of measured weights [kg/m^2] and rigidities [N*m], as in WEIGHT and BENDING, the measures
that they are, and the usual units of sheets."""


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
        "EMT": Column(PER_CENT, "", STRAIN, least=3e-3),
    },
    "FAST": {
        "W": WEIGHED,
        "C": Column("mm", "m", Plausible(1e-3, 0.2)),
        "B": Column("uN*m", "N*m", BENDING),
        "E5": Column(PER_CENT, "", STRAIN, least=5e-4),
        "E20": Column(PER_CENT, "", STRAIN, least=5e-4),
        "E100": Column(PER_CENT, "", STRAIN, least=5e-4),
        "EB5": Column(PER_CENT, "", STRAIN, pair=False, least=5e-4),
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
"""Values of sheets that no force here uses: hysteresis of shear, compression, surface, thickness."""
NEEDED = {
    "density": "kg/m^2", "warp": "N/m", "weft": "N/m", "shear": "N/m", "bend_warp": "N*m", "bend_weft": "N*m",
}  # fmt: skip
MORE = {"bend_bias": "N*m", "hysteresis_warp": "N", "hysteresis_weft": "N"}
"""Units of the measures that a fabric needs, and of those that it may have."""


@dataclass
class Sheet:
    """A laboratory's sheet: values in SI, for warp and weft, and the fabric's measures with the origin of each."""

    values: dict[str, tuple[float, ...]]
    fabric: dict[str, float] = field(default_factory=dict)
    how: dict[str, str] = field(default_factory=dict)

    def take(self, names: Sequence[str], values: Sequence[float], how: str) -> None:
        for name, value in zip(names, values, strict=True):
            self.fabric[name], self.how[name] = value, how


def read_sheet(entries: Mapping[str, Any], like: str | None = None, folder: Path = Path()) -> Imported:
    """Return the fabric of a sheet: `instrument`, and values by the instrument's names, one number or [warp, weft], in
    its units or as text with another. Missing measures are those of a preset `like`. Pictures are in the sheet's
    folder.

    Raises BadInput that names the value at fault.
    """
    instrument = _instrument(entries)
    columns, unused = SHEETS[instrument], UNUSED[instrument]
    sheet = Sheet({})
    known = {name.lower(): name for name in columns.keys() | unused}
    for name, value in entries.items():
        key = known.get(name.lower(), name)
        if key in sheet.values:
            raise BadInput(f"{key} is the same value: it is given twice", field=name, remedy="leave one out")
        if key in columns:
            sheet.values[key] = values_of(name, value, columns[key])
        elif key not in unused and name != "instrument" and not is_drape(name):
            raise _unknown(name, instrument)
    READ[instrument](sheet)
    _fill(sheet, like, instrument)
    for name, entry in entries.items():
        if (key := known.get(name.lower(), name)) in COMMON and key in sheet.values:
            parts = list(entry) if isinstance(entry, (list, tuple)) else [entry]
            for measure, part in zip(COMMON[key][2], 2 * parts, strict=False):
                if BARE.fullmatch(str(part)):
                    sheet.how[measure] += _doubt(sheet.fabric[measure], columns[key], key)
    drape, how = read_drape({name: value for name, value in entries.items() if is_drape(name)}, folder)
    ignored = tuple(name for name in entries if known.get(name.lower()) in unused)
    return Imported(sheet.fabric, NEEDED | MORE | DRAPED, complete(sheet.how) | how, ignored, drape=drape)


def _instrument(entries: Mapping[str, Any]) -> str:
    name = entries.get("instrument")
    instruments = {each.lower(): each for each in SHEETS}
    if not isinstance(name, str) or name.lower() not in instruments:
        raise BadInput(
            "which instrument's sheet is this?", field="instrument", value=name, limit=f"one of {', '.join(SHEETS)}",
            remedy="write for example instrument: KES-F: names and units follow from it",
        )  # fmt: skip
    return instruments[name.lower()]


def _doubt(value: float, column: Column, key: str) -> str:
    """Return a remark on a weight or rigidity in SI without a unit that few fabrics have, and many in the other usual
    unit.
    """
    low, high, _, units = COMMON[key]
    other = units[units[0] == column.unit]
    meant = value * to_si(f"1 {other}", column.si) / to_si(f"1 {column.unit}", column.si)
    if low <= value <= high or not low <= meant <= high:
        return ""
    doubt = f"{value:.3g} {column.si}: few fabrics have that, write its unit"
    return f" in {column.unit}, {doubt}; in {other} {meant:.3g}"


def _unknown(name: str, instrument: str) -> BadInput:
    others = [other for other in SHEETS if other != instrument and name in SHEETS[other].keys() | UNUSED[other]]
    if others:
        problem, remedy = f"a sheet of {instrument} has no such value", f"is it instrument: {others[0]}?"
        return BadInput(problem, field=name, remedy=remedy)
    names = SHEETS[instrument].keys() | UNUSED[instrument] | {"instrument", "shadow"} | DRAPE.keys()
    return BadInput(f"not a value of a sheet of {instrument}", field=name, remedy=nearest(name, names))


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
    by_work = tuple(w / (0.5 * MOST * e) for w, e in zip(values.get("WT", ()), strains, strict=False))
    for lt, other, name in zip(values.get("LT", ()), by_work, ("warp", "weft"), strict=False):
        if abs(other - lt) > AGREE * lt:
            raise BadInput(
                f"LT, EMT and WT do not fit: WT / (500 gf/cm EMT / 2) is {other:.3g}, {name}", field="LT",
                value=f"{lt:.3g}, {name}", limit=f"within {AGREE:.0%}", remedy="look at all three, or drop WT or LT",
            )  # fmt: skip
    if "LT" in values:
        lts, key = values["LT"], "LT"
    elif "WT" in values:
        lts, key = by_work, "WT"
    else:
        lts, key = (1.0, 1.0), "assuming LT = 1, for neither LT nor WT is given"
    exponents = [2.0 / lt - 1.0 for lt in lts]
    for name, lt, exponent in zip(("warp", "weft"), lts, exponents, strict=True):
        if not exponent > 0.0:
            raise BadInput(
                "no cloth gets so much softer as it is pulled", field=key, value=f"LT {lt:.3g}, {name}",
                limit="an LT below 2", remedy="look at WT and EMT",
            )  # fmt: skip
    stiff = [PULL / (e * (PULL / MOST) ** (1.0 / p)) for e, p in zip(strains, exponents, strict=True)]
    sheet.take(("warp", "weft"), stiff, f"derived: secant at 5 gf/cm, from EMT and {key}")


def _fast(sheet: Sheet) -> None:
    values = sheet.values
    for low, high in (("E5", "E20"), ("E20", "E100"), ("E5", "E100")):
        for less, more in zip(values.get(low, ()), values.get(high, ()), strict=False):
            if less > more:
                raise BadInput(
                    f"{low} is above {high}, at a higher load", field=low, value=f"{100.0 * less:.3g} percent",
                    limit=f"{high}, {100.0 * more:.3g} percent", remedy="look at both",
                )  # fmt: skip
    _bend(sheet)
    if "B" in values:
        by_length = tuple(sheet.fabric[name] for name in ("bend_warp", "bend_weft") if name in sheet.fabric)
        how = f"measured: B{_require_fit('B', 'C', values['B'], by_length, 'W g C^3', 'uN*m')}"
        sheet.take(("bend_warp", "bend_weft"), values["B"], how)
    if "E5" in values:
        sheet.take(("warp", "weft"), [PULL / e for e in values["E5"]], "measured: E5")
    if "EB5" in values:
        sheet.take(("shear",), (1.23 / values["EB5"][0],), "derived: 123 / EB5")
    if "G" in values:
        by_strain = (sheet.fabric["shear"],) if "shear" in sheet.fabric else ()
        how = f"measured: G{_require_fit('G', 'EB5', values['G'], by_strain, '123 / EB5', 'N/m')}"
        sheet.take(("shear",), values["G"], how)


def _require_fit(
    name: str, other: str, values: Sequence[float], computed: Sequence[float], formula: str, unit: str
) -> str:
    """Return in words that values fit those `computed` from another value by a formula; "" without any. Raises
    BadInput.
    """
    for value, expected, direction in zip(values, computed, ("warp", "weft"), strict=False):
        if abs(value - expected) > COMPUTED * expected:
            one = to_si(f"1 {unit}", unit.replace("u", ""))
            where = f", {direction}" if len(values) > 1 else ""
            raise BadInput(
                f"{name} and {other} do not fit: {formula} is {expected / one:.3g} {unit}{where}", field=name,
                value=f"{value / one:.3g} {unit}{where}", limit=f"within {COMPUTED:.0%}",
                remedy=f"look at both, or drop one: FAST computes {name} from {other}",
            )  # fmt: skip
    return f", which fits {formula}" if computed else ""


def _bend(sheet: Sheet) -> None:
    values = sheet.values
    if "C" in values and "W" in values:
        bend = [values["W"][0] * GRAVITY * c**3 for c in values["C"]]
        for c, rigidity in zip(values["C"], bend, strict=True):
            if not BENDING.low <= rigidity <= BENDING.high:
                edges = (BENDING.low, BENDING.high)
                low, high = (1e3 * (edge / (values["W"][0] * GRAVITY)) ** (1.0 / 3.0) for edge in edges)
                raise BadInput(
                    f"no fabric is known to bend so: W g C^3 is {1e6 * rigidity:.3g} uN*m", field="C",
                    value=f"{1e3 * c:.4g} mm", limit=f"{low:.3g} to {high:.3g} mm at this W; {BENDING.source} N*m",
                    remedy="a plain number is in mm; in centimetres write, for example, '1.8 cm'",
                )  # fmt: skip
        sheet.take(("bend_warp", "bend_weft"), bend, "derived: W g C^3")
        if "C45" in values:
            sheet.take(("bend_bias",), [values["W"][0] * GRAVITY * values["C45"][0] ** 3], "derived: W g C45^3")


READ: dict[str, Callable[[Sheet], None]] = {"KES-F": _kes, "FAST": _fast, "cantilever": _bend}


def _fill(sheet: Sheet, like: str | None, instrument: str) -> None:
    """Add the density, and missing measures from a preset."""
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
