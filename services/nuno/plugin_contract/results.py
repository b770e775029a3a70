"""Checks of plugins' results against the layout that the schema gives them, before any compiled code sees them.

A kernel does not check an index: one out of range reads or writes whatever lies there. Each function raises
ContractError with the field and the first wrong row. `check_layout` checks what annotations say; here is the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.plugin_contract.values import (
    ContractError,
    check_array,
    check_field,
    check_layout,
    check_number,
    check_skins,
    check_type,
)
from nuno_schemas.bodies import BOX, CAPSULE, FIELD, OF_TRIANGLES, PLANE
from nuno_schemas.dye import Cells, DyeReport, DyeState, Isotherm, Supply
from nuno_schemas.fabric import Fabric, Hinges, Memory, Springs, State
from nuno_schemas.layout import Bounds
from nuno_schemas.operation import Arranged, Outcome
from nuno_schemas.plugin import BodyShape, Mover
from nuno_schemas.system import StepLimit, StepReport, Term, Touched
from nuno_schemas.yarns import Yarns

UNIT = 1e-6
"""How far the length of a unit vector or quaternion may be from 1."""


def check_fabric(fabric: Fabric) -> None:
    """A fabric's arrays, and that springs, hinges, yarns and bindings name vertices and springs that there are."""
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
    """Runs that end within n vertices, of elements that name none twice."""
    reach = np.maximum(runs.count.astype(np.int64) - 1, 0) * runs.stride
    last = runs.first + reach[:, None]
    if (out := np.argwhere((last < 0) | (last >= n))).size:
        row, column = out[0]
        raise ContractError(f"{what} of run {row} go on to vertex {last[row, column]}, outside 0 to {n - 1}")
    corners = np.sort(runs.first, axis=1)
    if (same := np.flatnonzero((np.diff(corners, axis=1) == 0).any(axis=1))).size:
        raise ContractError(f"{what}.first names a vertex twice at row {same[0]}")


def check_yarns(yarns: Yarns, springs: int) -> None:
    """Yarns of so many springs."""
    check_array("yarns.links", yarns.links, np.int32, (None,), Bounds(0, springs - 1))
    check_array("yarns.ptr", yarns.ptr, np.int32, (yarns.number + 1,))
    if (np.diff(yarns.ptr) < 0).any() or yarns.ptr[0] != 0 or yarns.ptr[-1] != len(yarns.links):
        raise ContractError("yarns.ptr does not rise from 0 to the number of links")
    check_array("yarns.kind", yarns.kind, np.int8, (None,), Bounds(0, len(yarns.names) - 1))


def check_body(shape: BodyShape, mover: Mover | None) -> None:
    """A body on the joints of its mover, or on the world."""
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
    if (wrong := np.flatnonzero(~np.isin(shape.kind[shape.owner], OF_TRIANGLES))).size:
        raise ContractError(f"owner is {shape.owner[wrong[0]]} at row {wrong[0]}, which has no triangles")
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
    """A skeleton whose joints hang on earlier ones, or on the world."""
    check_layout("", mover)
    if not mover.joints or not callable(mover.pose):
        raise ContractError("pose is no function" if mover.joints else "joints are none")
    if (late := np.flatnonzero(mover.parents >= np.arange(len(mover.joints)))).size:
        raise ContractError(f"parents is {mover.parents[late[0]]} at row {late[0]}, which does not come before it")


def check_turn(rotation: NDArray[Any]) -> None:
    """Rotations (j, 4) that are unit quaternions."""
    length = np.linalg.norm(rotation, axis=1)
    if (bad := np.flatnonzero(~(np.abs(length - 1.0) <= UNIT))).size:
        raise ContractError(f"rotation has length {length[bad[0]]:g} at row {bad[0]}, not 1")


def check_memory(memory: Memory) -> None:
    """Memory whose arrays can be kept in a checkpoint."""
    for name, values in memory.arrays.items():
        if not isinstance(values, np.ndarray) or values.dtype.hasobject:
            raise ContractError(f"arrays[{name!r}] is {type(values).__name__}, no array of numbers")


def check_term(term: Term, fabric: Fabric) -> None:
    """A force on a fabric."""
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


def check_touched(found: Touched, vertices: int) -> None:
    """Forces on so many vertices."""
    for name, values in (*((f"by[{name!r}]", values) for name, values in found.by.items()), ("total", found.total)):
        check_array(name, values, np.float64, (vertices, 3), Bounds(finite=False, strided=True))


def check_outcome(outcome: Outcome, vertices: int) -> None:
    """What an operation made of a fabric of so many vertices."""
    if (changed := outcome.changed) is None:
        return
    check_type("changed.fabric", changed.fabric, Fabric)
    check_fabric(changed.fabric)
    n = changed.fabric.number
    check_layout("changed.state.", changed.state, {"n": n})
    check_array("changed.source", changed.source, np.int32, (n,), Bounds(-1, vertices - 1))
    if (np.diff(changed.source[changed.source >= 0]) <= 0).any():
        raise ContractError("changed.source does not keep the order of the old vertices")


def check_cloth(found: Any, dyes: int) -> None:
    """Cells and the amounts of so many dyes that they hold."""
    if len(found) != 2:
        raise ContractError(f"it is {len(found)} things, not cells and amounts")
    cells, state = found
    check_type("cells", cells, Cells)
    check_layout("cells.", cells)
    check_type("amounts", state, DyeState)
    check_layout("", state, _lengths(cells, dyes))


def check_supplies(found: Sequence[Supply], cells: Cells, dyes: int) -> None:
    """Supplies of so many dyes to these cells."""
    for i, supply in enumerate(found):
        check_type(f"[{i}]", supply, Supply)
        check_layout(f"[{i}].", supply, _lengths(cells, dyes))


def check_resists(found: Sequence[Any], cells: Cells) -> None:
    """What resists take of the room of these cells."""
    for i, values in enumerate(found):
        check_array(f"[{i}]", values, np.float64, cells.fibre.shape[1:], Bounds(0.0, 1.0))


def check_isotherm(isotherm: Isotherm) -> None:
    """An isotherm's numbers, or its function."""
    check_layout("", isotherm)
    if isotherm.kind == "python" and not callable(isotherm.function):
        raise ContractError("function is none, of kind 'python'")


def _lengths(cells: Cells, dyes: int) -> dict[str, int]:
    return {"dyes": dyes, "ny": cells.fibre.shape[1], "nx": cells.fibre.shape[2]}


def check_picture(picture: NDArray[Any]) -> None:
    """A picture in sRGB."""
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
"""What a method of a kind gives, and what it is held against."""


def check(group: str, method: str, found: Any, args: Sequence[Any]) -> None:
    """Raises ContractError for a result of a plugin's method, called with `args`, that is not what its kind owes."""
    if (group, method) in CHECKS:
        kind, look = CHECKS[group, method]
        check_type("it", found, kind)
        look(found, args)


SPAN, MASS, CELL = (1e-3, 1e2), (1e-6, 1e4), (1e-6, 1e-1)
"""Sizes of cloth and bodies [m], masses of cloth [kg] and sizes of dye cells [m] that are nothing out of the common."""


def doubts(found: Any) -> list[str]:
    """What is possible, but looks as if it were in another unit, in words."""
    sizes: list[tuple[str, float, tuple[float, float], str]] = []
    if isinstance(found, Fabric) and found.number > 1:
        sizes += [("position", _span(found.position), SPAN, "m"), ("mass", float(found.mass.sum()), MASS, "kg")]
    elif isinstance(found, BodyShape):
        sizes += [("radius", 2.0 * float(r), SPAN, "m") for r in found.radius[found.radius > 0.0]]
        sizes += [("vertices", _span(found.vertices), SPAN, "m")] if len(found.vertices) else []
    elif isinstance(found, tuple) and found and isinstance(found[0], Cells):
        sizes += [("cells.size", found[0].size, CELL, "m")]
    return [
        f"{what} comes to {size:.3g} {unit}, {low:g} to {high:g} {unit} being usual: is it in {unit}?"
        for what, size, (low, high), unit in sizes
        if not low <= size <= high
    ]


def _span(x: NDArray[Any]) -> float:
    return float(np.linalg.norm(np.ptp(x, axis=0)))
