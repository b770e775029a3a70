"""Quantities with units, converted to SI once, where a scene is read.

A bare number is SI already. Text such as `"1 ms"` or `"27 N/m"` goes through pint, which is
imported only then: it takes longer to load than a small scene takes to run.
"""

from __future__ import annotations

import functools
import math
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, WithJsonSchema

_LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}


@functools.cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True, cache_folder=":auto:")


def to_si(value: object, unit: str) -> float:
    """Convert a number or a text with a unit to a float in the SI `unit`.

    Raises ValueError for text that is no quantity, an unknown unit or a wrong dimension.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ValueError(f"expected a number in {unit or '1'} or a text with a unit such as '1 {unit}'")
    if isinstance(value, str):
        value = _parse(value, unit)
    number = float(value)
    if not math.isfinite(number):
        raise ValueError("must be finite")
    return number


def _parse(text: str, unit: str) -> float:
    import pint

    if len(text) > 100:
        raise ValueError("a quantity has at most 100 characters")
    try:
        return float(text)
    except ValueError:
        pass
    try:
        quantity = _registry().Quantity(text)
        return float(quantity.to(unit or "dimensionless").magnitude)
    except pint.UndefinedUnitError as error:
        raise ValueError(f"unknown unit in {text!r}: {error}; expected a unit that converts to {unit or '1'}") from None
    except pint.DimensionalityError:
        raise ValueError(f"{text!r} cannot be converted to {unit or 'a plain number'}") from None
    except Exception:
        raise ValueError(f"{text!r} is not a quantity; write for example '1 {unit}'") from None


def quantity(unit: str, **limits: Any) -> Any:
    """A pydantic float type in the SI `unit`; `limits` are those of `pydantic.Field`."""
    number = {"type": "number"} | {_LIMITS[name]: value for name, value in limits.items()}
    schema = WithJsonSchema({"anyOf": [number, {"type": "string"}], "unit": unit})
    return Annotated[float, BeforeValidator(functools.partial(to_si, unit=unit)), Field(**limits), schema]
