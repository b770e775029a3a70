"""What plugins of forces and contacts hand over, held against its layout."""

from __future__ import annotations

from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from nuno.wrong import Wrong, check_array, check_number
from nuno_schemas.fabric import Fabric
from nuno_schemas.system import Term


def check_term(term: Term, fabric: Fabric) -> None:
    """A force on a fabric."""
    for name in ("omega_squared", "damping_rate"):
        check_number(name, getattr(term, name), 0.0)
    for name, value in term.facts.items():
        check_number(f"facts[{name!r}]", value, finite=False)
    if not callable(term.data) and not (isinstance(term.data, tuple) and all(map(_is_typed, term.data))):
        raise Wrong(
            f"data is {type(term.data).__name__}, neither a tuple of named tuples nor a function f(x, v, t, out)"
        )
    if not callable(term.data):
        for i, part in enumerate(term.data):
            check_typed(f"data[{i}]", part, fabric.number)


def _is_typed(part: object) -> bool:
    return isinstance(part, tuple) and hasattr(part, "_fields")


def check_typed(what: str, part: Any, vertices: int) -> None:
    """A typed term: each field is as its annotation says, a number finite.

    `Annotated[Float, 3, "p"]` says that an array is (3, p): a name stands for one length in all of a term's fields, and
    "n" for the number of vertices. An array without lengths may have any, and hold NaN: it may be scratch.
    """
    known, lengths = get_type_hints(type(part), include_extras=True), {"n": vertices}
    for name, value in part._asdict().items():
        dtype, sizes = _layout(known[name])
        if isinstance(value, np.ndarray) or (dtype is not None and value is not None):
            rank = sizes or [None] * np.ndim(value)
            shape = tuple(lengths.get(size) if isinstance(size, str) else size for size in rank)
            check_array(f"{what}.{name}", value, dtype or value.dtype.type, shape, finite=bool(sizes))
            lengths |= {size: length for size, length in zip(sizes, value.shape, strict=False) if isinstance(size, str)}
        elif value is not None and not isinstance(value, bool):
            check_number(f"{what}.{name}", value)


def _layout(hint: Any) -> tuple[type[np.generic] | None, list[Any]]:
    """The dtype that an annotation NDArray[...] names, None where it names none, and the lengths that go with it."""
    if NoneType in get_args(hint):
        hint = next(kind for kind in get_args(hint) if kind is not NoneType)
    kind, *sizes = get_args(hint) if hasattr(hint, "__metadata__") else (hint,)
    dtype = get_args(get_args(kind)[1])[0] if get_origin(kind) is np.ndarray else None
    return (dtype if isinstance(dtype, type) else None), sizes
