"""Quantities with units, converted to SI once, when a scene is read.

A bare number is SI already. Text such as `"1 ms"` or `"27 N/m"` goes through pint, which is
imported only then: it takes longer to load than a small scene takes to run.
"""

from __future__ import annotations

import contextlib
import functools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from pydantic import BeforeValidator, Field, WithJsonSchema

_LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}


_OF_CLOTH = "gsm = g / m^2", "osy = oz / yd^2", "momme = 4.340 g / m^2"
"""Units of weight per area as merchants of cloth write them."""


@functools.cache
def _registry() -> Any:
    import pint

    make = functools.partial(pint.UnitRegistry, autoconvert_offset_to_baseunit=True)
    try:
        registry = make(cache_folder=":auto:")
    except Exception:  # the folder is not writable, or a file in it is truncated: read the units anew
        registry = make(cache_folder=None)
    for unit in _OF_CLOTH:
        registry.define(unit)
    return registry


def to_si(value: object, unit: str) -> float:
    """Convert a number or a text with a unit to a float in the SI `unit`.

    Raises ValueError for text that is not a quantity, an unknown unit or a wrong dimension.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ValueError(f"must be a quantity; {_example(unit)}")
    if isinstance(value, str):
        value = _parse(value, unit)
    try:
        number = float(value)
    except OverflowError:  # an integer of more than 308 digits
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("must be finite")
    return number


_POWER = r"(?:\*\*|\^)\s*\(?\s*[+-]?\d{1,2}\s*\)?\s*"
_NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?")
_FRACTION = re.compile(r"\s*(\d{1,9})\s*/\s*([1-9]\d{0,8})(?!\.)\b(.*)")
"""A fraction, as common for steps: 1/240 s."""
_DECIMAL_COMMA = re.compile(r"\s*([+-]?)(\d*),(\d+)((?:[^\d.,][^,]*)?)")
_ANGLE_BELOW = re.compile(r"([^\W\d_]+)\s*/\s*([^\W\d_]+)\s*[*.·⋅× ]\s*(deg(?:rees?)?|rad(?:ians?)?|°)(?![\w])")
"""An angle behind a product behind a slash: KES-F's gf/cm·degree means gf/(cm*degree), and reads as gf*degree/cm."""
_MARKS = "_*/().%‰°·⋅×"
"""Characters of units besides letters and blanks."""
_AMBIGUOUS = {"gr": "g for gram, or grain", "grad": "deg for degree, or gon", "Grad": "deg", "qm": "m^2"}
"""Symbols that people and pint read as different units, and their unambiguous replacements."""


def _is_plain(text: str) -> bool:
    """Return whether a text is one number and units.

    pint evaluates whole expressions: "9**9**9**9 m" would never end. After the number, digits
    are allowed only in powers of units, and "1" in "1/s"; pint would read "2 1 s" as a product,
    "5² m" as 25 m, and drop commas, fractions such as "½", and any other unknown character.
    """
    number = _NUMBER.match(text)
    if number is None:
        return False
    units = text[number.end() :]
    rest = re.sub(_POWER + r"|(?<![\w.])1\s*/|(?<=[^\W\d_])⁻?[⁰¹²³⁴-⁹]+", " ", units)
    powers = re.search(f"(?:{_POWER}){{2}}", units) or "**" in rest
    return not powers and all(each.isalpha() or each.isspace() or each in _MARKS for each in rest)


def decimal_point(text: str) -> str:
    """Return a remedy for a number with a decimal comma; empty for any other text."""
    if not (comma := _DECIMAL_COMMA.fullmatch(text)):
        return ""
    sign, whole, decimals, units = comma.groups()
    more = f", or {sign}{whole}{decimals}{units} if thousands are meant"
    return f"write {sign}{whole or 0}.{decimals}{units}{more if len(decimals) == 3 and whole.strip('0') else ''}"


def _parse(text: str, unit: str) -> float:
    import pint

    if len(text) > 100:
        raise ValueError("a quantity has at most 100 characters")
    if remedy := decimal_point(text):
        raise ValueError(f"a decimal comma; {remedy}")
    if fraction := _FRACTION.fullmatch(text):
        text = f"{int(fraction[1]) / int(fraction[2])!r}{fraction[3]}"
    with contextlib.suppress(ValueError):
        return float(text)
    text = re.sub(r"(?<![^\W\d_])([cdkmu]?m)([23])(?![\w.])", r"\1^\2", text)  # g/m2, as people write it
    if not _is_plain(text):
        raise ValueError(f"not a quantity; {_example(unit)}")
    if angle := _ANGLE_BELOW.search(text):  # angles have no dimension, so that pint finds no mistake in it
        raise ValueError(f"{angle[0].strip()} is of two meanings; write {angle[1]}/({angle[2]}*{angle[3]})")
    if ambiguous := _AMBIGUOUS.keys() & set(re.findall(r"[^\W\d]+", text)):
        raise ValueError(f"{min(ambiguous)} is of two meanings; write {_AMBIGUOUS[min(ambiguous)]}")
    registry = _registry()
    try:
        return float(registry.Quantity(text).to(unit or "dimensionless").magnitude)
    except pint.UndefinedUnitError as error:
        names = [error.unit_names] if isinstance(error.unit_names, str) else error.unit_names
        raise ValueError(f"unknown unit {', '.join(map(repr, names))}; {_example(unit)}") from None
    except pint.DimensionalityError as error:
        raise ValueError(
            f"{error.units1} cannot be converted to {unit or 'a plain number'}; {_example(unit)}"
        ) from None
    except Exception:  # any other error of pint for the text: the unit definitions are loaded already
        raise ValueError(f"not a quantity; {_example(unit)}") from None


def _example(unit: str) -> str:
    return f"write for example '1 {unit}', or a plain number in {unit}" if unit else "write a plain number"


@dataclass(frozen=True)
class Plausible:
    """Bare numbers of a quantity that are accepted without a warning: 0, and magnitudes from `low` to `high` in `unit`.

    A value with a unit is never warned of.
    """

    low: float
    high: float
    meant: tuple[str, ...] = ()
    """Probable units of a number outside these bounds."""
    source: str = ""
    unit: str = ""


PLAUSIBLE = {
    "m": Plausible(0.0, 5.0, ("cm", "mm")),
    "rad": Plausible(0.0, 7.0, ("deg",)),
    "m/s": Plausible(0.0, 100.0, ("km/h", "cm/s")),
    "m/s^2": Plausible(0.0, 100.0, ("cm/s^2", "mm/s^2")),
    "m^2/s": Plausible(1e-14, 1e-6, ("mm^2/h", "mm^2/s")),
}
"""Default plausible range of each unit: for objects of the size of people, in metres and seconds."""
ANY = Plausible(0.0, math.inf)


@dataclass(frozen=True)
class Quantity(Plausible):
    """Metadata by which pydantic reads a quantity, an item of an `Annotated[float, ...]`; `limits` as in `quantity`."""

    limits: tuple[tuple[str, Any], ...] = ()
    __is_annotated_types_grouped_metadata__: ClassVar[bool] = True

    def __iter__(self) -> Iterator[Any]:
        number = {"type": "number"} | {_LIMITS[name]: value for name, value in self.limits}
        yield BeforeValidator(functools.partial(to_si, unit=self.unit))
        yield Field(**dict(self.limits))
        yield WithJsonSchema({"anyOf": [number, {"type": "string"}], "unit": self.unit})


def quantity(unit: str, plausible: Plausible | None = None, **limits: Any) -> Quantity:
    """Return metadata that makes a float a quantity in the SI `unit`: `Length = Annotated[float, quantity("m", gt=0)]`.

    `limits` are those of `pydantic.Field`, outside of which values are refused.
    """
    usual = plausible or PLAUSIBLE.get(unit, ANY)
    return Quantity(usual.low, usual.high, usual.meant, usual.source, unit, tuple(limits.items()))
