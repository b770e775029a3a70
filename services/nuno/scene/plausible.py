"""Warnings of bare numbers that are implausible in SI units: their unit was probably forgotten."""

from __future__ import annotations

import typing
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from pydantic import BaseModel

from nuno.scene.scene_file import Loaded
from nuno.scene.yaml_lines import Path, dotted
from nuno_schemas.errors import BadInput
from nuno_schemas.units import Plausible, to_si

MOST = 10
"""Most warnings of a scene; the last one counts the others."""

Found = tuple[Path, float, Plausible]


def implausible_numbers(loaded: Loaded) -> list[str]:
    """Return warnings of bare numbers out of the ranges that their quantities declare (`nuno_schemas.units`)."""
    out = [_words("", *found) for found in _in_model(loaded.data, loaded.scene)]
    for chosen in loaded.chosen:
        out += [_words(f"{chosen.field}.", *found) for found in _in_model(chosen.given, chosen.config)]
    return out if len(out) <= MOST else [*out[:MOST], f"and {len(out) - MOST:,} more bare numbers are implausible"]


def implausible_fields(given: Mapping[str, Any], model: BaseModel, field: str) -> list[str]:
    """Return such warnings of the given fields of one model, each after `field`."""
    return [_words(field, *found) for found in _in_model(given, model)]


def with_doubts(loaded: Loaded, place: str, error: BadInput) -> BadInput:
    """Locate an error at a part of a scene, and add the doubt about a number there to its remedy."""
    error = loaded.at(place, error)
    doubt = next((text for text in implausible_numbers(loaded) if text.startswith(f"{place}.")), None)
    if doubt is None:
        return error
    return replace(error, remedy=f"{doubt} If not: {error.remedy}" if error.remedy else doubt)


def _words(field: str, place: Path, number: float, usual: Plausible) -> str:
    unit, low = usual.unit, f"{usual.low:g} to " if usual.low else "up to "
    source = f" ({usual.source})" if usual.source else ""
    others = [(f"{number:g} {other}", number * to_si(f"1 {other}", unit)) for other in usual.meant]
    meant = [f"{text}, which is {si:.4g} {unit}" for text, si in others if _is_plausible(si, usual)]
    question = f"; or was it {'; or '.join(meant)}?" if meant else ""
    usually = f"{low}{usual.high:g} {unit} is plausible{source}"
    return f"{field}{dotted(place)}: a bare {number:g} is {number:g} {unit}, where {usually}{question}"


def _is_plausible(number: float, usual: Plausible) -> bool:
    return number == 0.0 or usual.low <= abs(number) <= usual.high


def _in_model(given: Mapping[str, Any], model: BaseModel, place: Path = ()) -> Iterator[Found]:
    """Yield implausible numbers in the given fields of a model, with their paths."""
    for name, field in type(model).model_fields.items():
        if name in given:
            usual = _declared((field.annotation, *field.metadata))
            yield from _in_value(given[name], getattr(model, name, None), usual, (*place, name))


def _in_value(given: Any, value: Any, usual: Plausible | None, place: Path) -> Iterator[Found]:
    """Yield implausible numbers in a given value; the model's `value` selects one of several models."""
    if isinstance(given, Mapping):
        if isinstance(value, BaseModel):
            yield from _in_model(given, value, place)
        elif isinstance(value, Mapping):
            for key, one in given.items():
                yield from _in_value(one, value.get(key), usual, (*place, key))
    elif isinstance(given, list) and isinstance(value, list | tuple):
        for i, (one, its) in enumerate(zip(given, value, strict=False)):
            yield from _in_value(one, its, usual, (*place, i))
    elif usual is not None and (number := _bare(given)) is not None and not _is_plausible(number, usual):
        yield place, number, usual


def _bare(given: Any) -> float | None:
    """The number that is written without a unit."""
    try:
        return float(given) if isinstance(given, int | float | str) else None
    except ValueError:
        return None


def _declared(kinds: tuple[Any, ...]) -> Plausible | None:
    """Return the range of the first quantity among types and their metadata."""
    for kind in kinds:
        plausible = kind if isinstance(kind, Plausible) else _declared(typing.get_args(kind))
        if plausible is not None:
            return plausible
    return None
