"""Checks of plugins' results against the layout that the schema gives them, before any compiled code sees them.

A kernel does not check an index: one out of range reads or writes other memory. Each function raises
ContractError with the field and the first wrong row. `check_layout` checks annotations; this module has the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.bodies import BOX, CAPSULE, FIELD, OF_TRIANGLES, PLANE, SKIN, DistanceField, Geometry
from nuno_schemas.dye import Cells, DyeReport, DyeState, Isotherm, Supply
from nuno_schemas.fabric import Fabric, Hinges, Memory, Springs, State, Yarns
from nuno_schemas.layout import Bounds
from nuno_schemas.operation import Arranged, Outcome
from nuno_schemas.plugin import BodyShape, Mover
from nuno_schemas.system import StepLimit, StepReport, Term, Touched

UNIT = 1e-6
"""Tolerance of the length of a unit vector or quaternion."""


def check_fabric(fabric: Fabric) -> None:
    """Check a fabric's arrays, and that springs, hinges, yarns and bindings refer to existing vertices and springs."""
    check_layout("", fabric)
    n, springs = fabric.number, fabric.springs
    if springs is not None:
        check_runs("springs", springs, n)
        if (springs.lock is None) != (springs.k_lock is None):
            raise ContractError("springs.lock and springs.k_lock are not both given, nor neither")
        if springs.k_lock is not None:
            k, k_lock = (springs.per_spring(values) for values in (springs.k, springs.k_lock))
            if (low := np.flatnonzero(k_lock < k)).size:
                raise ContractError(
                    f"springs.k_lock is {k_lock[low[0]]} at spring {low[0]}, less than its k {k[low[0]]}"
                )
    if fabric.hinges is not None:
        check_runs("hinges", fabric.hinges, n)
    if fabric.corners is not None:
        differ = (fabric.corners.vertex[fabric.corners.faces] != fabric.faces).any(axis=1)
        if differ.any():
            raise ContractError(f"corners.faces are of other vertices than faces at row {np.flatnonzero(differ)[0]}")
    if fabric.yarns is not None:
        check_yarns(fabric.yarns, springs.number if springs is not None else 0)
    for i, binding in enumerate(fabric.bindings):
        if not fabric.pinned[binding.vertices].all():
            raise ContractError(f"bindings[{i}].vertices has some that are not pinned")


def check_runs(what: str, runs: Springs | Hinges, n: int) -> None:
    """Check that runs end within n vertices, and that no element names a vertex twice."""
    reach = np.maximum(runs.count.astype(np.int64) - 1, 0) * runs.stride
    last = runs.first + reach[:, None]
    if (outside := np.argwhere((last < 0) | (last >= n))).size:
        row, column = outside[0]
        raise ContractError(f"{what} of run {row} go on to vertex {last[row, column]}, outside 0 to {n - 1}")
    corners = np.sort(runs.first, axis=1)
    if (repeated := np.flatnonzero((np.diff(corners, axis=1) == 0).any(axis=1))).size:
        raise ContractError(f"{what}.first names a vertex twice at row {repeated[0]}")


def check_yarns(yarns: Yarns, springs: int) -> None:
    """Check yarns of a fabric with this number of springs."""
    check_array("yarns.links", yarns.links, np.int32, (None,), Bounds(0, springs - 1))
    check_array("yarns.ptr", yarns.ptr, np.int32, (yarns.number + 1,))
    if (np.diff(yarns.ptr) < 0).any() or yarns.ptr[0] != 0 or yarns.ptr[-1] != len(yarns.links):
        raise ContractError("yarns.ptr does not rise from 0 to the number of links")
    check_array("yarns.kind", yarns.kind, np.int8, (None,), Bounds(0, len(yarns.names) - 1))


def check_body(shape: BodyShape, mover: Mover | None) -> None:
    """Check a body on the joints of its mover, or on the world."""
    check_layout("", shape)
    joints = 1 if mover is None else len(mover.joints)
    if len(shape.frames) != joints:
        raise ContractError(f"frames are {len(shape.frames)}, of a motion of {joints}")
    kinds = {
        "radius is not above 0": (CAPSULE, shape.radius > 0.0),
        "b is no unit normal": (PLANE, np.abs(np.linalg.norm(shape.b, axis=1) - 1.0) <= UNIT),
        "b has a half extent that is not above 0": (BOX, (shape.b > 0.0).all(axis=1)),
    }
    for problem, (kind, good) in kinds.items():
        if (bad := np.flatnonzero((shape.kind == kind) & ~good)).size:
            raise ContractError(f"{problem} at row {bad[0]}")
    if (bad_owners := np.flatnonzero(~np.isin(shape.kind[shape.owner], OF_TRIANGLES))).size:
        raise ContractError(f"owner is {shape.owner[bad_owners[0]]} at row {bad_owners[0]}, which has no triangles")
    if len(shape.fields) != int((shape.kind == FIELD).sum()):
        raise ContractError(
            f"fields are {len(shape.fields)}, of {int((shape.kind == FIELD).sum())} primitives that have one"
        )
    for i, field in enumerate(shape.fields):
        check_field(f"fields[{i}]", field)
    check_skins(shape)
    if shape.pose is not None and (mover is None or not callable(shape.pose)):
        raise ContractError("pose is no function" if mover is not None else "pose is one of a body without a motion")


def check_mover(mover: Mover) -> None:
    """Check a skeleton, and that the parent of each joint is an earlier one, or the world."""
    check_layout("", mover)
    if not mover.joints or not callable(mover.pose):
        raise ContractError("pose is no function" if mover.joints else "joints are none")
    if (late := np.flatnonzero(mover.parents >= np.arange(len(mover.joints)))).size:
        raise ContractError(f"parents is {mover.parents[late[0]]} at row {late[0]}, which does not come before it")


def check_turn(rotation: NDArray[Any]) -> None:
    """Check that rotations (j, 4) are unit quaternions."""
    length = np.linalg.norm(rotation, axis=1)
    if (bad := np.flatnonzero(~(np.abs(length - 1.0) <= UNIT))).size:
        raise ContractError(f"rotation has length {length[bad[0]]:g} at row {bad[0]}, not 1")


def check_memory(memory: Memory) -> None:
    """Check that the arrays of memory can be stored in a checkpoint."""
    for name, values in memory.arrays.items():
        if not isinstance(values, np.ndarray) or values.dtype.hasobject:
            raise ContractError(f"arrays[{name!r}] is {type(values).__name__}, no array of numbers")


def check_term(term: Term, fabric: Fabric) -> None:
    """Check a force on a fabric."""
    check_layout("", term)
    for name, value in term.facts.items():
        check_number(f"facts[{name!r}]", value)
    if callable(term.data):
        return
    if not (isinstance(term.data, tuple) and all(hasattr(part, "_fields") for part in term.data)):
        kind = type(term.data).__name__
        raise ContractError(f"data is {kind}, neither a tuple of named tuples nor a function f(x, v, t, out)")
    for i, part in enumerate(term.data):
        check_layout(f"data[{i}].", part, {"n": fabric.number})
        kernels = getattr(type(part), "kernels", None)
        roles = fields(kernels) if is_dataclass(kernels) else ()
        if all(getattr(kernels, role.name) is role.default for role in roles if role.name != "name"):
            kind = f"data[{i}] is of type {type(part).__name__}, which has no kernels"
            raise ContractError(f"{kind}, and so does nothing: nuno_kernels.terms.register gives a type its kernels")


def check_touched(touched: Touched, vertices: int) -> None:
    """Check forces of bodies on this number of vertices."""
    for name, values in (*((f"by[{name!r}]", values) for name, values in touched.by.items()), ("total", touched.total)):
        check_array(name, values, np.float64, (vertices, 3), Bounds(finite=False, strided=True))


def check_outcome(outcome: Outcome, vertices: int) -> None:
    """Check the outcome of an operation on a fabric with this number of vertices."""
    if (changed := outcome.changed) is None:
        return
    check_type("changed.fabric", changed.fabric, Fabric)
    check_fabric(changed.fabric)
    n = changed.fabric.number
    check_layout("changed.state.", changed.state, {"n": n})
    check_array("changed.source", changed.source, np.int32, (n,), Bounds(-1, vertices - 1))
    if (np.diff(changed.source[changed.source >= 0]) <= 0).any():
        raise ContractError("changed.source does not keep the order of the old vertices")


def check_cloth(result: Any, dyes: int) -> None:
    """Check cells, and their amounts of this number of dyes."""
    if len(result) != 2:
        raise ContractError(f"it is {len(result)} things, not cells and amounts")
    cells, state = result
    check_type("cells", cells, Cells)
    check_layout("cells.", cells)
    check_type("amounts", state, DyeState)
    check_layout("", state, _lengths(cells, dyes))


def check_supplies(supplies: Sequence[Supply], cells: Cells, dyes: int) -> None:
    """Check supplies of this number of dyes to the cells."""
    for i, supply in enumerate(supplies):
        check_type(f"[{i}]", supply, Supply)
        check_layout(f"[{i}].", supply, _lengths(cells, dyes))


def check_resists(resists: Sequence[Any], cells: Cells) -> None:
    """Check the shares of the cells' room that resists take."""
    for i, values in enumerate(resists):
        check_array(f"[{i}]", values, np.float64, cells.fibre.shape[1:], Bounds(0.0, 1.0))


def check_isotherm(isotherm: Isotherm) -> None:
    """Check an isotherm's numbers, or its function."""
    check_layout("", isotherm)
    if isotherm.kind == "python" and not callable(isotherm.function):
        raise ContractError("function is none, of kind 'python'")


def _lengths(cells: Cells, dyes: int) -> dict[str, int]:
    return {"dyes": dyes, "ny": cells.fibre.shape[1], "nx": cells.fibre.shape[2]}


def check_picture(picture: NDArray[Any]) -> None:
    """Check a picture in sRGB."""
    check_array("it", picture, np.uint8, (None, None, 3), Bounds(strided=True))


def _of(kind: type, args: Sequence[Any]) -> Any:
    return next((arg for arg in args if isinstance(arg, kind)), None)


CHECKS: Mapping[tuple[str, str], tuple[type, Callable[[Any, Sequence[Any]], None]]] = {
    ("nuno.models", "build"): (Fabric, lambda found, args: check_fabric(found)),
    ("nuno.models", "build_over"): (Fabric, lambda found, args: check_fabric(found)),
    ("nuno.models", "count"): (int, lambda found, args: check_number("it", found, Bounds(0))),
    ("nuno.forces", "prepare"): (Term, lambda found, args: check_term(found, _of(Fabric, args))),
    ("nuno.contacts", "prepare"): (Term, lambda found, args: check_term(found, _of(Fabric, args))),
    ("nuno.cloth_contacts", "prepare"): (Term, lambda found, args: check_term(found, _of(Fabric, args))),
    ("nuno.motions", "prepare"): (Mover, lambda found, args: check_mover(found)),
    ("nuno.colliders", "build"): (BodyShape, lambda found, args: check_body(found, _of(Mover, args))),
    ("nuno.integrators", "prepare"): (Memory, lambda found, args: check_memory(found)),
    ("nuno.integrators", "limit"): (StepLimit, lambda found, args: check_layout("", found)),
    ("nuno.integrators", "touched"): (Touched, lambda found, args: check_touched(found, len(_of(State, args).x))),
    ("nuno.integrators", "advance"): (StepReport, lambda found, args: check_layout("", found)),
    ("nuno.operations", "apply"): (Outcome, lambda found, args: check_outcome(found, len(_of(State, args).x))),
    ("nuno.operations", "apply_beside"): (Outcome, lambda found, args: check_outcome(found, len(_of(State, args).x))),
    ("nuno.operations", "arrange"): (
        Arranged, lambda found, args: check_layout("", found, {"n": _of(Fabric, args).number}),
    ),
    ("nuno.renderers", "render"): (np.ndarray, lambda found, args: check_picture(found)),
    ("nuno.dye_pictures", "draw"): (np.ndarray, lambda found, args: check_picture(found)),
    ("nuno.yarn_pictures", "draw"): (np.ndarray, lambda found, args: check_picture(found)),
    ("nuno.dye_solvers", "prepare"): (Memory, lambda found, args: check_memory(found)),
    ("nuno.dye_solvers", "advance"): (
        DyeReport, lambda found, args: check_layout("", found, {"dyes": len(_of(DyeState, args).phi)}),
    ),
    ("nuno.dye_cloths", "build"): (tuple, lambda found, args: check_cloth(found, len(args[3]))),
    ("nuno.dye_cloths", "count"): (int, lambda found, args: check_number("it", found, Bounds(0))),
    ("nuno.dye_cloths", "resists"): (tuple, lambda found, args: check_resists(found, args[1])),
    ("nuno.dye_cloths", "supplies"): (tuple, lambda found, args: check_supplies(found, args[1], len(args[2]))),
    ("nuno.isotherms", "prepare"): (Isotherm, lambda found, args: check_isotherm(found)),
}  # fmt: skip
"""Type of the result of each kind's methods, and its check."""


def check(group: str, method: str, result: Any, args: Sequence[Any]) -> None:
    """Raise ContractError for a result of a plugin's method, called with `args`, that violates its kind's contract."""
    if (group, method) in CHECKS:
        kind, check_result = CHECKS[group, method]
        check_type("it", result, kind)
        check_result(result, args)


SPAN, MASS, CELL = (1e-3, 1e2), (1e-6, 1e4), (1e-6, 1e-1)
"""Usual sizes of cloth and bodies [m], masses of cloth [kg] and sizes of dye cells [m]."""


def doubts(result: Any) -> list[str]:
    """Return warnings of values that are possible, but look as if they were in another unit."""
    sizes: list[tuple[str, float, tuple[float, float], str]] = []
    if isinstance(result, Fabric) and result.number > 1:
        sizes += [("position", _span(result.position), SPAN, "m"), ("mass", float(result.mass.sum()), MASS, "kg")]
    elif isinstance(result, BodyShape):
        sizes += [("radius", 2.0 * float(r), SPAN, "m") for r in result.radius[result.radius > 0.0]]
        sizes += [("vertices", _span(result.vertices), SPAN, "m")] if len(result.vertices) else []
    elif isinstance(result, tuple) and result and isinstance(result[0], Cells):
        sizes += [("cells.size", result[0].size, CELL, "m")]
    return [
        f"{what} comes to {size:.3g} {unit}, {low:g} to {high:g} {unit} being usual: is it in {unit}?"
        for what, size, (low, high), unit in sizes
        if not low <= size <= high
    ]


def _span(x: NDArray[Any]) -> float:
    return float(np.linalg.norm(np.ptp(x, axis=0)))


# Checks of values against their contract: arrays, numbers, annotated classes, distance fields, skins.

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
    annotated, sizes, bounds = _read(hint)
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


def _read(hint: Any) -> tuple[Any, list[Any], Bounds | None]:
    """Return the type of an annotation without None, its lengths, and its bounds."""
    if NoneType in get_args(hint):
        hint = next(kind for kind in get_args(hint) if kind is not NoneType)
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


def check_field(what: str, field: DistanceField) -> None:
    """Check a distance field, and that its cells refer to existing cells and leaves."""
    if math.prod(field.shape.tolist()) > len(field.child):
        raise ContractError(f"{what}.child has {len(field.child)} cells, fewer than its shape")
    cut = field.child >= 0
    # The eight parts of a divided cell come later in the list: otherwise a descent would never end.
    parts, leaves = field.child[cut], -1 - field.child[~cut].astype(np.int64)
    if (parts <= np.flatnonzero(cut)).any() or (parts > len(cut) - 8).any() or (leaves >= len(field.corners)).any():
        raise ContractError(f"{what}.child: cells lead nowhere")


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
