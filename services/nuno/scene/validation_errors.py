"""Validation errors in the terms of a scene's author: place, problem, remedy."""

from __future__ import annotations

import inspect
import re
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import yaml
from pydantic import BaseModel, Tag, ValidationError
from pydantic.fields import FieldInfo

from nuno.scene.yaml_lines import Path, dotted
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.units import decimal_point

OVERRIDDEN = 0
"""Line of a field that was set on the command line."""

GIVEN = "--set"
"""Name of the command line in errors."""

UNNUMBERED = -1
"""Line of a field whose scene is not a file of the user."""

NO_FIELD = "no such field"

ADD = "add it"
"""Remedy for a missing field."""

EMPTY = "in YAML # begins a comment, and quotes keep it: '#8c2f39'"
"""Hint for a field without a value."""

Words = tuple[str, object, str | None, str | None]
"""Problem, value, limit and remedy."""

Kind = typing.TypeVar("Kind", bound=BaseModel)

_WRONG_TYPE = {
    "int": "must be a whole number",
    "float": "must be a number",
    "bool": "must be true or false",
    "string": "must be text",
    "list": "must be a list, such as [a, b, c]",
    "tuple": "must be a list, such as [a, b, c]",
    "dict": "must be a mapping of fields, such as {field: value}",
    "model": "must be a mapping of fields, such as {field: value}",
    "finite": "must be finite",
}
_NUMBERS = (_WRONG_TYPE["int"], _WRONG_TYPE["float"])
_BOUNDS = {"greater_than": "more than", "less_than": "less than"}
_BOUNDS |= {"greater_than_equal": "at least", "less_than_equal": "at most"}


def located(error: BadInput, file: str, lines: Mapping[Path, int], field: str) -> BadInput:
    """Add file, line and field to an error that lacks them."""
    if error.file in (file, GIVEN) and error.field is not None:
        return error
    full = f"{field}.{error.field}" if error.field and error.file is None else field
    line = next((n for path, n in sorted(lines.items(), key=lambda i: -len(i[0])) if _under(full, dotted(path))), None)
    if line == OVERRIDDEN:
        file, line = GIVEN, None
    line = None if line == UNNUMBERED else line
    if error.file is None:
        return replace(error, file=file, line=line, field=full)
    # The error is in another file: add the place that names that file.
    place = file if line is None else f"{file}:{line}"
    return replace(error, problem=f"{error.problem} (the file is named in {place}: {full})")


def _under(field: str, path: str) -> bool:
    return field == path or (path != "" and field.startswith(path) and field[len(path)] in ".[")


def validated(
    kind: type[Kind], data: Any, file: str, lines: Mapping[Path, int], prefix: Path = (),
) -> Kind:  # fmt: skip
    """Return `data`, which a file has at `prefix`, as a model of this kind. Raises BadInput for an invalid field."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise explain(error, data, prefix, file, lines, kind) from None


def explain(error: ValidationError, data: Any, prefix: Path, file: str, lines: Mapping[Path, int],
            model: type[BaseModel], others: Sequence[str] = ()) -> BadInput:  # fmt: skip
    """Return the first of pydantic's errors about `data`, which a scene has at `prefix`, as BadInput.

    `others` names allowed fields that are not the model's. Where a value may be one of several
    kinds, pydantic has an error for each; they are merged into one.
    """
    errors = [(_place(e["loc"], data, e["type"]), e) for e in error.errors(include_url=False)]
    errors = [item for item in errors if not _is_consequence(*item, errors)]
    place, first = min(errors, key=lambda item: (item[1]["type"] == "missing", len(item[0])))
    if first["type"] == "extra_forbidden":
        *_, here = model, *(annotation for _, _, annotation in _walk(model, first["loc"][:-1]))
        own = [name for m in models_in(here)[:1] for name in m.model_fields]
        fields = [*own, *(others if len(place) == 1 else ())]
        words: Words = NO_FIELD, None, None, nearest(str(place[-1]), fields)
    else:
        words = _merged([e for where, e in errors if where == place])
    context = first.get("ctx") or {}
    discriminator = (str(context["discriminator"]).strip("'"),) if first["type"] == "union_tag_invalid" else ()
    path = (*prefix, *place, *context.get("inside", discriminator))
    problem, value, limit, remedy = words
    if first["type"] != "missing" and first.get("input", "") is None:
        problem, remedy = f"the field is empty, and {problem}", f"write its value; {EMPTY}"
    if problem in _NUMBERS and isinstance(value, str):
        remedy = decimal_point(value) or remedy
    if remedy in (None, ADD):
        remedy = _example(model, first["loc"]) or remedy
    return located(BadInput(problem, None, None, None, value, limit, remedy), file, lines, dotted(path))


def _is_consequence(place: Path, error: Any, errors: Sequence[tuple[Path, Any]]) -> bool:
    """Return whether an error only follows from another one inside the same value.

    Such an error is that a list or mapping is no name or number, list or mapping, as another kind of the value would
    be; or that a list is too short, which does not count its invalid items.
    """
    kind = str(error["type"])
    kinds = ("int", "float", "bool", "string", "list", "tuple", "dict", "model")
    plain = kind in ("literal_error", "too_short") or kind.removesuffix("_type") in kinds
    plain = plain or "must be a quantity" in str(error["msg"])
    inside = any(len(other) > len(place) and other[: len(place)] == place for other, _ in errors)
    return plain and inside and isinstance(error.get("input"), (dict, list))


def _place(loc: Path, data: Any, kind: str) -> Path:
    """Return the part of a location that is in the data: pydantic also names the branches of unions."""
    place: list[str | int] = []
    for i, part in enumerate(loc):
        inside = part in data if isinstance(data, dict) else isinstance(data, list) and part in range(len(data))
        if inside:
            data = data[part]
        if inside or (kind == "missing" and i == len(loc) - 1):
            place.append(part)
    return tuple(place)


def _merged(errors: Sequence[Any]) -> Words:
    """Merge all errors about one value into one explanation."""
    expected = [str(e["ctx"]["expected"]) for e in errors if e["type"] == "literal_error"]
    names = [name for text in expected for name in re.findall(r"'([^']*)'", text) or [text]]
    others = [e for e in errors if e["type"] != "literal_error"]
    value = errors[0].get("input")
    if not others:
        if isinstance(value, str) and len(names) > 1:
            return "unknown value", value, None, nearest(value, names)
        return f"must be {' or '.join(names)}", value, None, None
    problem, value, limit, remedy = _words(others[0])
    if names and isinstance(value, str) and problem in _WRONG_TYPE.values():
        return "unknown value", value, limit, nearest(value, names)
    if names and len(names) < 4:
        instead = " or ".join(names)
        problem, remedy = (problem, f"{remedy}; or write {instead}") if remedy else (f"{problem}, or {instead}", None)
    return problem, value, limit, remedy


def _words(error: Any) -> Words:
    kind, value, context = str(error["type"]), error.get("input"), error.get("ctx") or {}
    if kind in _BOUNDS:
        return "out of range", value, f"{_BOUNDS[kind]} {next(iter(context.values())):g}", None
    if kind == "missing":
        short = isinstance(error["loc"][-1], int)
        return ("the list is too short" if short else "the field is missing"), None, None, ADD
    if kind in ("too_short", "too_long"):
        limit = context.get("min_length", context.get("max_length"))
        whole = kind == "too_long" and all(isinstance(each, int) for each in value)
        remedy = "write a decimal point, as in 0.3: a comma parts values" if whole else None
        return f"{kind.replace('_', ' ')} a list", value, f"{limit} items", remedy
    if kind == "union_tag_not_found":
        field = str(context["discriminator"]).strip("'")
        return f"must be a mapping of fields with its {field}", value, None, f"add {field}: ..."
    if kind == "union_tag_invalid":
        field, tag = str(context["discriminator"]).strip("'"), str(context["tag"])
        return f"unknown {field}", tag, None, nearest(tag, re.findall(r"'([^']*)'", str(context["expected_tags"])))
    for name, problem in _WRONG_TYPE.items():
        if kind.startswith(name + "_"):
            return problem, value, None, None
    if "inside" in context or isinstance(value, dict):
        value = None  # the problem names the invalid part
    problem, _, remedy = str(error["msg"]).removeprefix("Value error, ").partition("; ")
    return problem, value, None, remedy or None


def _walk(model: Any, loc: Path) -> Iterator[tuple[str | int, FieldInfo | None, Any]]:
    """Yield each part of a location in `model`, its field, if any, and its annotation."""
    here: Any = model
    for part in loc:
        field = None
        if not isinstance(part, int):
            field = next((m.model_fields[part] for m in models_in(here) if part in m.model_fields), None)
            here = field.annotation if field else _tagged(here, part) or here
        yield part, field, here


def _example(model: Any, loc: Path) -> str | None:
    """Return the example of the innermost field of a location that has one."""
    examples = [(part, field.examples[0]) for part, field, _ in _walk(model, loc) if field and field.examples]
    if not examples:
        return None
    written = yaml.safe_dump(dict(examples[-1:]), default_flow_style=True, sort_keys=False, width=1000)
    return f"for example {written.strip()[1:-1]}"


def _tagged(annotation: Any, label: str) -> Any:
    """Return the branch of a union that pydantic calls `label`, by its tag or by a field with only that value."""
    arguments = typing.get_args(annotation)
    if any(isinstance(argument, Tag) and argument.tag == label for argument in arguments):
        return annotation
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        kinds = [typing.get_args(field.annotation) for field in annotation.model_fields.values()]
        return annotation if (label,) in kinds else None
    return next((found for argument in arguments if (found := _tagged(argument, label)) is not None), None)


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the models in an annotation, in its order."""
    if inspect.isclass(annotation) and typing.get_origin(annotation) is None and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for argument in typing.get_args(annotation) for m in models_in(argument)]
