"""Values of a laboratory's sheet: each has a unit of its own, and a range in which fabrics are known."""

from __future__ import annotations

import re
from dataclasses import dataclass

from nuno_schemas.errors import BadInput
from nuno_schemas.units import Plausible, decimal_point, to_si

PER_CENT = "percent"
_BARE = re.compile(r"[-+\d.,/\s]*\d(?:\.?[eE][-+]?\d+)?\.?\s*")
"""A number, or the text of one, that has no unit of its own."""


@dataclass(frozen=True)
class Column:
    """A value of a sheet: its own unit, the SI unit, and what is plausible in that."""

    unit: str
    si: str
    plausible: Plausible
    pair: bool = True


def values_of(name: str, given: object, column: Column) -> tuple[float, ...]:
    """In SI: of warp and weft where there are two. Raises BadInput."""
    parts = list(given) if isinstance(given, (list, tuple)) else [given]
    if len(parts) > (2 if column.pair else 1) or not parts:
        limit = "one number, or [warp, weft]" if column.pair else "one number"
        raise BadInput("too many values, or none", field=name, value=given, limit=limit)
    found = []
    for part in parts:
        own = f"{part} {column.unit}" if column.unit and _BARE.fullmatch(str(part)) else part
        try:
            value = to_si(own, column.si)
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
        found.append(value)
    return tuple(found * 2 if column.pair and len(found) == 1 else found)
