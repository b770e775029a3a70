"""What plugins hand over, held against the layout that the schema gives it, before any compiled code sees it.

A kernel does not check an index: one out of range reads or writes whatever lies there. Each function raises Wrong
with the field and the first row that is amiss.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.handed_dye import DYE_CHECKS
from nuno.handed_terms import check_term
from nuno.wrong import Wrong, check_array, check_field, check_number, check_type
from nuno_schemas.bodies import BOX, CAPSULE, FIELD, OF_TRIANGLES, PLANE
from nuno_schemas.dye import Cells
from nuno_schemas.fabric import Binding, Fabric, Hinges, Memory, Springs, State
from nuno_schemas.operation import Outcome
from nuno_schemas.plugin import BodyShape, Mover
from nuno_schemas.system import StepLimit, StepReport, Term
from nuno_schemas.yarns import Yarns

UNIT = 1e-6
"""How far the length of a unit vector or quaternion may be from 1."""


def check_fabric(fabric: Fabric) -> None:
    """A fabric's arrays, and that springs, hinges, yarns and bindings name vertices and springs that there are."""
    n = len(fabric.mass) if isinstance(fabric.mass, np.ndarray) and fabric.mass.ndim else 0
    check_array("mass", fabric.mass, np.float64, (None,), above=0.0)
    for name in ("position", "velocity"):
        check_array(name, getattr(fabric, name), np.float64, (n, 3))
    check_array("pinned", fabric.pinned, np.bool_, (n,))
    check_array("faces", fabric.faces, np.int32, (None, 3), 0, n - 1)
    if fabric.cells is not None:
        check_array("cells", fabric.cells, np.int32, (None, 4), 0, n - 1)
    if fabric.uv is not None:
        check_array("uv", fabric.uv, np.float32, (n, 2))
    if fabric.springs is not None:
        check_springs(fabric.springs, n)
    if fabric.hinges is not None:
        check_hinges(fabric.hinges, n)
    if fabric.yarns is not None:
        check_yarns(fabric.yarns, fabric.springs.number if fabric.springs is not None else 0)
    for i, binding in enumerate(fabric.bindings):
        check_type(f"bindings[{i}]", binding, Binding)
        check_array(f"bindings[{i}].vertices", binding.vertices, np.int32, (None,), 0, n - 1)
        if not fabric.pinned[binding.vertices].all():
            raise Wrong(f"bindings[{i}].vertices has some that are not pinned")


def check_springs(springs: Springs, n: int) -> None:
    """Springs between n vertices."""
    check_type("springs", springs, Springs)
    each = _check_runs("springs", springs, 2, n)
    for name in ("k", "rest", "c"):
        check_array(f"springs.{name}", getattr(springs, name), np.float64, (each,), 0.0)
    check_array("springs.kind", springs.kind, np.int8, springs.count.shape, 0, strided=True)
    if (springs.lock is None) != (springs.k_lock is None):
        raise Wrong("springs.lock and springs.k_lock are not both given, nor neither")
    if springs.lock is not None and springs.k_lock is not None:
        check_array("springs.lock", springs.lock, np.float64, (each,), 0.0)
        check_array("springs.k_lock", springs.k_lock, np.float64, (each,), 0.0)
        k, k_lock = (springs.per_spring(values) for values in (springs.k, springs.k_lock))
        if (low := np.flatnonzero(k_lock < k)).size:
            raise Wrong(f"springs.k_lock is {k_lock[low[0]]} at spring {low[0]}, less than its k {k[low[0]]}")


def check_hinges(hinges: Hinges, n: int) -> None:
    """Hinges between n vertices."""
    check_type("hinges", hinges, Hinges)
    each = _check_runs("hinges", hinges, 4, n)
    check_array("hinges.k", hinges.k, np.float64, (each,), 0.0)
    check_array("hinges.rest", hinges.rest, np.float64, (each,))


def _check_runs(what: str, runs: Springs | Hinges, width: int, n: int) -> tuple[int, int]:
    """Lengths that arrays of constants may have: one per run, or one per element."""
    check_array(f"{what}.first", runs.first, np.int32, (None, width), 0, n - 1)
    m = len(runs.first)
    check_array(f"{what}.count", runs.count, np.int32, (m,), 0, strided=True)
    check_array(f"{what}.stride", runs.stride, np.int32, (m,), strided=True)
    reach = np.maximum(runs.count.astype(np.int64) - 1, 0) * runs.stride
    last = runs.first + reach[:, None]
    if (out := np.argwhere((last < 0) | (last >= n))).size:
        row, column = out[0]
        raise Wrong(f"{what} of run {row} go on to vertex {last[row, column]}, outside 0 to {n - 1}")
    corners = np.sort(runs.first, axis=1)
    if (same := np.flatnonzero((np.diff(corners, axis=1) == 0).any(axis=1))).size:
        raise Wrong(f"{what}.first names a vertex twice at row {same[0]}")
    return m, int(runs.count.sum(dtype=np.int64))


def check_yarns(yarns: Yarns, springs: int) -> None:
    """Yarns of so many springs."""
    check_type("yarns", yarns, Yarns)
    check_array("yarns.mu", yarns.mu, np.float64, (None,), 0.0, np.nextafter(0.5, 0.0))
    y = len(yarns.mu)
    check_array("yarns.links", yarns.links, np.int32, (None,), 0, springs - 1)
    check_array("yarns.ptr", yarns.ptr, np.int32, (y + 1,), 0, len(yarns.links))
    if (np.diff(yarns.ptr) < 0).any() or yarns.ptr[0] != 0 or yarns.ptr[-1] != len(yarns.links):
        raise Wrong("yarns.ptr does not rise from 0 to the number of links")
    check_array("yarns.kind", yarns.kind, np.int8, (y,), 0, len(yarns.names) - 1)
    if yarns.density is not None:
        check_array("yarns.density", yarns.density, np.float64, (y,), above=0.0)


def check_body(shape: BodyShape, mover: Mover | None) -> None:
    """A body on the joints of its mover, or on the world."""
    joints = 1 if mover is None else len(mover.joints)
    if len(shape.frames) != joints:
        raise Wrong(f"frames are {len(shape.frames)}, of a motion of {joints}")
    p = len(shape.kind) if isinstance(shape.kind, np.ndarray) and shape.kind.ndim else 0
    check_array("kind", shape.kind, np.int8, (None,), CAPSULE, FIELD)
    check_array("frame", shape.frame, np.int32, (p,), 0, joints - 1)
    for name in ("a", "b"):
        check_array(name, getattr(shape, name), np.float64, (p, 3))
    check_array("radius", shape.radius, np.float64, (p,), 0.0)
    check_array("vertices", shape.vertices, np.float64, (None, 3))
    check_array("faces", shape.faces, np.int32, (None, 3), 0, len(shape.vertices) - 1)
    check_array("owner", shape.owner, np.int32, (len(shape.faces),), 0, p - 1)
    kinds = {
        "radius is not above 0": (CAPSULE, shape.radius > 0.0),
        "b is no unit normal": (PLANE, np.abs(np.linalg.norm(shape.b, axis=1) - 1.0) <= UNIT),
        "b has a half extent that is not above 0": (BOX, (shape.b > 0.0).all(axis=1)),
    }
    for problem, (kind, good) in kinds.items():
        if (bad := np.flatnonzero((shape.kind == kind) & ~good)).size:
            raise Wrong(f"{problem} at row {bad[0]}")
    if (wrong := np.flatnonzero(~np.isin(shape.kind[shape.owner], OF_TRIANGLES))).size:
        raise Wrong(f"owner is {shape.owner[wrong[0]]} at row {wrong[0]}, which has no triangles")
    if len(shape.fields) != int((shape.kind == FIELD).sum()):
        raise Wrong(f"fields are {len(shape.fields)}, of {int((shape.kind == FIELD).sum())} primitives that have one")
    for i, field in enumerate(shape.fields):
        check_field(f"fields[{i}]", field)


def check_mover(mover: Mover) -> None:
    """A skeleton whose joints hang on earlier ones, or on the world."""
    j = len(mover.joints)
    if j == 0 or not callable(mover.pose):
        raise Wrong("joints are none" if j == 0 else "pose is no function")
    check_array("parents", mover.parents, np.int32, (j,), -1, j - 1)
    if (late := np.flatnonzero(mover.parents >= np.arange(j))).size:
        raise Wrong(f"parents is {mover.parents[late[0]]} at row {late[0]}, which does not come before it")
    check_array("offsets", mover.offsets, np.float64, (j, 3))


def check_turn(rotation: NDArray[Any]) -> None:
    """Rotations (j, 4) that are unit quaternions."""
    length = np.linalg.norm(rotation, axis=1)
    if (bad := np.flatnonzero(~(np.abs(length - 1.0) <= UNIT))).size:
        raise Wrong(f"rotation has length {length[bad[0]]:g} at row {bad[0]}, not 1")


def check_memory(memory: Memory) -> None:
    """Memory whose arrays can be kept in a checkpoint."""
    for name, values in memory.arrays.items():
        if not isinstance(values, np.ndarray) or values.dtype.hasobject:
            raise Wrong(f"arrays[{name!r}] is {type(values).__name__}, no array of numbers")


def check_limit(limit: StepLimit) -> None:
    """A step limit; dt may be inf."""
    check_number("dt", limit.dt, above=0.0, finite=False)
    for name in ("omega", "damping", "resolved"):
        check_number(name, getattr(limit, name), 0.0, finite=False)


def check_report(report: StepReport) -> None:
    """What an integrator says of a frame."""
    if report.status not in ("ok", "diverged", "unconverged"):
        raise Wrong(f"status is {report.status!r}, not ok, diverged or unconverged")
    check_number("steps", report.steps, 0)


def check_outcome(outcome: Outcome, vertices: int) -> None:
    """What an operation made of a fabric of so many vertices."""
    if (changed := outcome.changed) is None:
        return
    check_type("changed.fabric", changed.fabric, Fabric)
    check_fabric(changed.fabric)
    n = changed.fabric.number
    check_array("changed.state.x", changed.state.x, np.float64, (n, 3))
    check_array("changed.state.v", changed.state.v, np.float64, (n, 3))
    check_array("changed.source", changed.source, np.int32, (n,), -1, vertices - 1)
    if (np.diff(changed.source[changed.source >= 0]) <= 0).any():
        raise Wrong("changed.source does not keep the order of the old vertices")


def check_picture(picture: NDArray[Any]) -> None:
    """A picture in sRGB."""
    check_array("it", picture, np.uint8, (None, None, 3), strided=True)


def _of(kind: type, args: Sequence[Any]) -> Any:
    return next((arg for arg in args if isinstance(arg, kind)), None)


CHECKS: Mapping[tuple[str, str], tuple[type, Callable[[Any, Sequence[Any]], None]]] = {
    ("nuno.models", "build"): (Fabric, lambda found, args: check_fabric(found)),
    ("nuno.models", "build_over"): (Fabric, lambda found, args: check_fabric(found)),
    ("nuno.models", "count"): (int, lambda found, args: check_number("it", found, 0)),
    ("nuno.forces", "prepare"): (Term, lambda found, args: check_term(found, _of(Fabric, args))),
    ("nuno.contacts", "prepare"): (Term, lambda found, args: check_term(found, _of(Fabric, args))),
    ("nuno.motions", "prepare"): (Mover, lambda found, args: check_mover(found)),
    ("nuno.colliders", "build"): (BodyShape, lambda found, args: check_body(found, _of(Mover, args))),
    ("nuno.integrators", "prepare"): (Memory, lambda found, args: check_memory(found)),
    ("nuno.integrators", "limit"): (StepLimit, lambda found, args: check_limit(found)),
    ("nuno.integrators", "advance"): (StepReport, lambda found, args: check_report(found)),
    ("nuno.operations", "apply"): (Outcome, lambda found, args: check_outcome(found, len(_of(State, args).x))),
    ("nuno.renderers", "render"): (np.ndarray, lambda found, args: check_picture(found)),
    ("nuno.dye_pictures", "draw"): (np.ndarray, lambda found, args: check_picture(found)),
    ("nuno.yarn_pictures", "draw"): (np.ndarray, lambda found, args: check_picture(found)),
    ("nuno.dye_solvers", "prepare"): (Memory, lambda found, args: check_memory(found)),
    **DYE_CHECKS,
}
"""What a method of a kind gives, and what it is held against."""


def check(group: str, method: str, found: Any, args: Sequence[Any]) -> None:
    """Raises Wrong for a result of a plugin's method, called with `args`, that is not what its kind owes."""
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
