"""Values of a laboratory's sheet: each has its own unit, and a range in which fabrics are known."""

from __future__ import annotations

import re
from dataclasses import dataclass

from nuno_schemas.errors import BadInput
from nuno_schemas.units import Plausible, decimal_point, to_si

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
    """Return a value in SI, for warp and weft if there are two; an empty text is a missing one. Raises BadInput."""
    parts = list(entry) if isinstance(entry, (list, tuple)) else [entry]
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
            remedy = decimal_point(str(part)) or f"a plain number is in {column.unit or 'no unit'}"
            raise BadInput(str(error).partition("; ")[0], field=name, value=part, remedy=remedy) from None
        if value < 0.0:
            raise BadInput("it cannot be negative", field=name, value=part, limit="0 or more")
        usual = column.plausible
        if not usual.low <= value <= usual.high:
            low, high = (edge / to_si(f"1 {column.unit}", column.si) for edge in (usual.low, usual.high))
            source = f"; {usual.source} {column.si}" if usual.source else ""
            raise BadInput(
                "no fabric is known to have that: is it in the instrument's unit?", field=name, value=part,
                limit=f"{low:.3g} to {high:.3g} {column.unit}{source}", remedy=f"a plain number is in {column.unit}",
            )  # fmt: skip
        if with_unit is not part and 0.0 < value < column.least:
            remedy = f"write {1e4 * value:.4g}, or '{part} {column.unit}'"
            limit = f"{100.0 * column.least:.3g} {column.unit} without a unit"
            raise BadInput(f"a fraction, or so little in {column.unit}?", None, None, name, part, limit, remedy)
        values.append(value)
    return tuple(values * 2 if column.pair and len(values) == 1 else values)
