"""Checks of values against their contract: arrays, numbers, annotated classes, distance fields, skins."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import takewhile
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from nuno_schemas.bodies import FIELD, SKIN, DistanceField, Geometry
from nuno_schemas.fabric import Float
from nuno_schemas.layout import Bounds
from nuno_schemas.plugin import BodyShape

UNBOUNDED = Bounds()
WEIGHT_TOLERANCE = 1e-9
"""Tolerance of the sum of weights, which is 1."""


class ContractError(Exception):
    """A plugin returned something that its protocol does not allow; the text begins with the field."""


def check_layout(what: str, value: Any, lengths: Mapping[str, int] | None = None) -> None:
    """Raise ContractError for the first field of a dataclass or named tuple that violates its annotation.

    `what` is the prefix of a field's name; `lengths` are those that are known beforehand. `nuno_schemas.layout` defines
    the annotations. A named tuple, which is passed to compiled code, has only arrays, finite numbers, named tuples and
    None; its arrays without lengths may have any, and hold NaN: they may be scratch memory.
    """
    known_lengths = dict(lengths or {})
    for name, hint in _hints(value.__class__).items():
        _check_one(what + name, getattr(value, name), hint, value, known_lengths)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Return the annotation of each field of a dataclass or named tuple."""
    hints = get_type_hints(kind, include_extras=True)
    names = (field.name for field in fields(kind)) if is_dataclass(kind) else kind._fields
    return {name: hints[name] for name in names}


def _check_one(what: str, value: Any, hint: Any, owner: Any, lengths: dict[str, int]) -> None:
    """Raise ContractError for one bad field of `owner`; add lengths that occur first in it."""
    annotated, sizes, bounds = _read(hint, value)
    args: tuple[Any, ...] = get_args(annotated)
    kind: Any = get_origin(annotated) or annotated
    if value is None and NoneType in get_args(hint):
        return
    if bounds is not None and bounds.below:
        bounds = bounds._replace(high=lengths.get(bounds.below, math.inf) - 1)
    if kind is np.ndarray or isinstance(value, np.ndarray):
        if not sizes and not isinstance(owner, tuple):
            return
        element = get_args(args[1])[0] if kind is np.ndarray else Any
        dtype: Any = np.asarray(value).dtype.type if element is Any else element
        shape = tuple(_length(size, owner, lengths) for size in sizes) if sizes else (None,) * np.ndim(value)
        check_array(what, value, dtype, shape, bounds or Bounds(finite=bool(sizes)))
        lengths |= {size: length for size, length in zip(sizes, np.shape(value), strict=False) if type(size) is str}
    elif is_dataclass(kind) or (isinstance(owner, tuple) and hasattr(kind, "_fields")):
        check_type(what, value, annotated)
        check_layout(f"{what}.", value, lengths)
    elif kind is Literal:
        if value not in args:
            raise ContractError(f"{what} is {value!r}, not {', '.join(args[:-1])} or {args[-1]}")
    elif kind is tuple and not isinstance(owner, tuple):
        if sizes and len(value) != lengths.setdefault(sizes[0], len(value)):
            raise ContractError(f"{what} are {len(value)}, not {lengths[sizes[0]]}")
        hints = args[:1] * len(value) if args[-1] is Ellipsis else args
        for i, (item, item_hint) in enumerate(zip(value, hints, strict=True)):
            _check_one(f"{what}[{i}]", item, item_hint, None, lengths)
    elif bounds is not None or (isinstance(owner, tuple) and not isinstance(value, bool | None)):
        check_number(what, value, bounds or UNBOUNDED)


def _read(hint: Any, value: Any) -> tuple[Any, list[Any], Bounds | None]:
    """Return the type of an annotation without None, of several that of the value, its lengths, and its bounds."""
    if NoneType in get_args(hint):
        kinds = [kind for kind in get_args(hint) if kind is not NoneType]
        hint = next((kind for kind in kinds if isinstance(kind, type) and isinstance(value, kind)), kinds[0])
    kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    return (
        kind,
        [mark for mark in marks if not isinstance(mark, Bounds)],
        next((mark for mark in marks if isinstance(mark, Bounds)), None),
    )


def _length(size: Any, owner: Any, lengths: Mapping[str, int]) -> int | tuple[int, ...] | None:
    """Return the value of a length in an annotation, None if it is open."""
    if isinstance(size, tuple):
        return tuple(lengths[name] if name in lengths else int(getattr(owner, name)) for name in size)
    return lengths.get(size) if isinstance(size, str) else int(size)


def check_type(what: str, value: object, kind: type) -> None:
    """Raise ContractError for a value of another type."""
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ContractError(f"{what} is {type(value).__name__}, not {kind.__name__}")


def check_array(
    what: str,
    values: Any,
    dtype: type[np.generic],
    shape: tuple[int | tuple[int, ...] | None, ...],
    bounds: Bounds = UNBOUNDED,
) -> None:
    """Raise ContractError for another dtype or shape, an array that is not C-contiguous unless `bounds` allow it, and
    the first value out of bounds. In `shape`, None leaves a length open, and a tuple allows several.
    """
    name = np.dtype(dtype).name
    if not isinstance(values, np.ndarray) or values.dtype != dtype or not _fits(values.shape, shape):
        actual = f"{values.dtype} {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
        raise ContractError(f"{what} is {actual}, not {name} {_written(shape)}")
    if not bounds.strided and not values.flags.c_contiguous:
        raise ContractError(f"{what} is not C-contiguous: give numpy.ascontiguousarray of it")
    if not bounds.finite or dtype is np.bool_:
        return
    good = np.isfinite(values) & (values >= bounds.low) & (values <= bounds.high)
    if bounds.above > -np.inf:
        good &= values > bounds.above
    if not good.all():
        index = tuple(int(i) for i in np.argwhere(~good)[0])
        raise ContractError(f"{what} is {values[index]} at row {index[0]}{_limit(values[index], bounds)}")


def check_number(what: str, value: Any, bounds: Bounds = UNBOUNDED) -> None:
    """Raise ContractError for a value that is no number, NaN, or out of bounds; infinity only if it is not allowed."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise ContractError(f"{what} is {type(value).__name__}, no number")
    if (
        math.isnan(value)
        or (bounds.finite and math.isinf(value))
        or not bounds.low <= value <= bounds.high
        or (bounds.above > -np.inf and value <= bounds.above)
    ):
        raise ContractError(f"{what} is {value}{_limit(value, bounds)}")


def check_fields(shape: Geometry | BodyShape) -> None:
    """Check the distance fields of primitives that have one, closed forms at a few places."""
    primitives = np.flatnonzero(shape.kind == FIELD).tolist()
    for i, (field, primitive) in enumerate(zip(shape.fields, primitives, strict=False)):
        if isinstance(field, DistanceField):
            check_field(f"fields[{i}]", field)
        elif field is not None:
            places = np.array([shape.a[primitive], shape.b[primitive], 0.5 * (shape.a + shape.b)[primitive]])
            evaluate_formula(f"fields[{i}]", field, "distance", *places.T)
            if (gradient := getattr(field, "gradient", None)) is not None:
                outside = (1.5 * places[0] - 0.5 * places[1]).tolist()
                slope = check_numbers(f"fields[{i}].gradient", 3, gradient, *outside)
                if not math.isclose(length := math.hypot(*slope), 1.0, rel_tol=1e-6):
                    raise ContractError(f"fields[{i}].gradient has length {length:g} at {outside}, not 1")


def check_field(what: str, field: DistanceField) -> None:
    """Check a distance field, and that its cells refer to existing cells and leaves."""
    check_layout(f"{what}.", field)
    if math.prod(field.shape.tolist()) > len(field.child):
        raise ContractError(f"{what}.child has {len(field.child)} cells, fewer than its shape")
    cut = field.child >= 0
    # The eight parts of a divided cell come later in the list: otherwise a descent would never end.
    parts, leaves = field.child[cut], -1 - field.child[~cut].astype(np.int64)
    if (parts <= np.flatnonzero(cut)).any() or (parts > len(cut) - 8).any() or (leaves >= len(field.corners)).any():
        raise ContractError(f"{what}.child: cells lead nowhere")


def evaluate_formula(what: str, formula: Any, method: str, *arguments: Any) -> Float:
    """Return the values of a formula's compiled method (nuno_kernels.formula). Raises ContractError for what is no
    named tuple of numbers with that method, and for values that are not finite.
    """
    kind, methods = type(formula), getattr(formula, "kernels", None)
    if not isinstance(methods, Mapping) or method not in methods:
        needed = f"a named tuple with a compiled {method}: nuno_kernels.formula"
        raise ContractError(f"{what} is {kind.__qualname__}, not {needed}")
    for name, value in zip(kind._fields, formula, strict=True):
        check_type(f"{what}.{name}", value, float)
        check_number(f"{what}.{name}", value)
    with compiling(f"{what}.{method}"):
        values: Float = getattr(formula, method)(*arguments)
    if (bad := np.flatnonzero(~np.isfinite(values))).size:
        place = ", ".join(f"{np.broadcast_to(one, values.shape).flat[bad[0]]:g}" for one in arguments)
        raise ContractError(f"{what}.{method} is {values.flat[bad[0]]} at ({place})")
    return values


@contextlib.contextmanager
def compiling(what: str) -> Iterator[None]:
    """Raise ContractError with the compiler's reason."""
    try:
        yield
    except Exception as error:
        raise ContractError(f"{what} cannot be compiled: {compiler_reason(error)}") from None


def check_numbers(what: str, count: int, method: Callable[..., Any], *arguments: Any) -> Float:
    """Return what a compiled method gives. Raises ContractError for other than `count` numbers."""
    with compiling(what):
        given = method(*arguments)
    values = np.ravel(given) if isinstance(given, np.ndarray | tuple | float | int) else np.empty(0, object)
    if values.shape != (count,) or values.dtype.kind not in "fiu":
        raise ContractError(f"{what} returns {given!r}, not {'a number' if count == 1 else f'{count} numbers'}")
    return np.asarray(values, np.float64)


def compiler_reason(error: BaseException) -> str:
    """Return why a function cannot be compiled, and its file and line: the innermost of the errors that numba nests."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    ends = ("There are ", "File ", "During: ", "raised from ")  # what follows the reason
    begins = max((i + 1 for i, line in enumerate(lines) if "Failed in nopython" in line), default=0)
    reason = " ".join(takewhile(lambda line: not line.startswith(ends), lines[begins:]))
    place = re.search(r'File "([^"]+)", line (\d+)', "\n".join(lines[begins:]))
    return f"{reason} ({Path(place[1]).name}:{place[2]})" if place else reason


def check_skins(shape: Geometry | BodyShape) -> None:
    """Check skins: vertices as in their primitives, existing frames, weights with the sum 1."""
    primitives = np.flatnonzero(shape.kind == SKIN).tolist()
    if len(shape.skins) != len(primitives):
        raise ContractError(f"skins are {len(shape.skins)}, of {len(primitives)} primitives that have one")
    for number, (primitive, skin) in enumerate(zip(primitives, shape.skins, strict=True)):
        check_layout(f"skins[{number}].", skin)
        vertices = len(np.unique(shape.faces[shape.owner == primitive]))
        if len(skin.joint) != vertices or not skin.joint.shape[1]:
            raise ContractError(f"skins[{number}] is of {skin.joint.shape} joints, and has {vertices} vertices")
        if (bad := np.flatnonzero(np.abs(skin.weight.sum(axis=1) - 1.0) > WEIGHT_TOLERANCE)).size:
            raise ContractError(
                f"skins[{number}].weight adds up to {skin.weight[bad[0]].sum():g} at row {bad[0]}, not 1"
            )
        if int(shape.frame[primitive]) + len(skin.place) > len(shape.frames):
            raise ContractError(f"skins[{number}] is on {len(skin.place)} frames, of {len(shape.frames)}")


def _fits(shape: tuple[int, ...], allowed: tuple[int | tuple[int, ...] | None, ...]) -> bool:
    return len(shape) == len(allowed) and all(
        one is None or (size in one if isinstance(one, tuple) else size == one)
        for size, one in zip(shape, allowed, strict=True)
    )


def _written(shape: tuple[int | tuple[int, ...] | None, ...]) -> str:
    """Write a shape as (6, 3), (n, 3) with an open length, (4 or 9,) with several."""
    sizes = [
        "n" if w is None else " or ".join(map(str, sorted(set(w)))) if isinstance(w, tuple) else str(w) for w in shape
    ]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"


def _limit(value: Any, bounds: Bounds) -> str:
    """Return the bound that a value violates, in words; "" for one that is not finite."""
    if not np.isfinite(value):
        return ""
    if bounds.above > -np.inf:
        return f", not above {bounds.above:g}"
    return (
        f", outside {bounds.low:.12g} to {bounds.high:.12g}" if bounds.high < np.inf else f", less than {bounds.low:g}"
    )
