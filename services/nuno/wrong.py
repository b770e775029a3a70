"""One array, number or distance field held against what it has to be."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno_schemas.field import DistanceField


class Wrong(Exception):
    """What a plugin handed over is not what its kind owes; the text begins with the field."""


def check_type(what: str, value: object, kind: type) -> None:
    """Raises Wrong for a value of another type."""
    if not isinstance(value, kind) or isinstance(value, bool):
        raise Wrong(f"{what} is {type(value).__name__}, not {kind.__name__}")


def check_array(
    what: str,
    values: Any,
    dtype: type[np.generic],
    shape: tuple[int | tuple[int, ...] | None, ...],
    low: float = -np.inf,
    high: float = np.inf,
    above: float = -np.inf,
    strided: bool = False,
    finite: bool = True,
) -> None:
    """Raises Wrong for another dtype or shape, an array that is not C-contiguous unless it may be `strided`, and the
    first value that is not finite, below `low`, over `high` or not `above`.

    `shape` may leave a length open by None, and allow several by a tuple.
    """
    name = np.dtype(dtype).name
    if not isinstance(values, np.ndarray) or values.dtype != dtype or not _fits(values.shape, shape):
        given = f"{values.dtype} {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
        raise Wrong(f"{what} is {given}, not {name} {_written(shape)}")
    if not strided and not values.flags.c_contiguous:
        raise Wrong(f"{what} is not C-contiguous: give numpy.ascontiguousarray of it")
    if not finite or dtype is np.bool_:
        return
    good = np.isfinite(values) & (values >= low) & (values <= high)
    if above > -np.inf:
        good &= values > above
    if not good.all():
        place = tuple(int(i) for i in np.argwhere(~good)[0])
        limit = _limit(low, high, above) if np.isfinite(values[place]) else ""
        raise Wrong(f"{what} is {values[place]} at row {place[0]}{limit}")


def check_number(what: str, value: Any, low: float = -np.inf, above: float = -np.inf, finite: bool = True) -> None:
    """Raises Wrong for what is no number, NaN, below `low` or not `above`; and for infinity unless that is allowed."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise Wrong(f"{what} is {type(value).__name__}, no number")
    if math.isnan(value) or (finite and math.isinf(value)):
        raise Wrong(f"{what} is {value}")
    if value < low or (above > -np.inf and value <= above):
        raise Wrong(f"{what} is {value}{_limit(low, np.inf, above)}")


def check_field(what: str, field: DistanceField) -> None:
    """A distance field whose cells lead to cells and leaves that there are."""
    check_type(what, field, DistanceField)
    check_array(f"{what}.low", field.low, np.float64, (3,))
    check_array(f"{what}.shape", field.shape, np.int32, (3,), 1)
    check_array(f"{what}.corners", field.corners, np.float32, (None, 32))
    check_array(f"{what}.child", field.child, np.int32, (None,))
    if math.prod(field.shape.tolist()) > len(field.child):
        raise Wrong(f"{what}.child has {len(field.child)} cells, fewer than its shape")
    cut = field.child >= 0
    # Eight parts begin at every cell that is cut, later in the list: else whoever follows them would never arrive.
    parts, leaves = field.child[cut], -1 - field.child[~cut].astype(np.int64)
    if (parts <= np.flatnonzero(cut)).any() or (parts > len(cut) - 8).any() or (leaves >= len(field.corners)).any():
        raise Wrong(f"{what}.child: cells lead nowhere")
    for name in ("size", "tolerance"):
        check_number(f"{what}.{name}", getattr(field, name), above=0.0)


def _fits(shape: tuple[int, ...], wanted: tuple[int | tuple[int, ...] | None, ...]) -> bool:
    return len(shape) == len(wanted) and all(
        want is None or (size in want if isinstance(want, tuple) else size == want)
        for size, want in zip(shape, wanted, strict=True)
    )


def _written(shape: tuple[int | tuple[int, ...] | None, ...]) -> str:
    """(6, 3), (n, 3) where a length is open, (4 or 9,) where there are several."""
    sizes = [
        "n" if w is None else " or ".join(map(str, sorted(set(w)))) if isinstance(w, tuple) else str(w) for w in shape
    ]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"


def _limit(low: float, high: float, above: float) -> str:
    if above > -np.inf:
        return f", not above {above:g}"
    return f", outside {low:.12g} to {high:.12g}" if high < np.inf else f", less than {low:g}"
