"""A measured drape (Cusick's drapemeter, ISO 9073-9): a coefficient and nodes, or a photograph of the shadow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nuno_cloth.fabrics.columns import PER_CENT, Column, values_of
from nuno_cloth.fabrics.shadow import count_nodes, read_shadow
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.units import Plausible

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
