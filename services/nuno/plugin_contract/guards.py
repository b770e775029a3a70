"""Guards of plugins of other distributions: their errors name them, and their results are checked.

Tests check the contract of the project's own plugins, which have no guards at run time.
"""

from __future__ import annotations

import contextlib
import logging
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.plugin_contract import containment
from nuno.plugin_contract.values import (
    ContractError,
    check_array,
    check_fields,
    check_layout,
    check_number,
    check_numbers,
    check_skins,
    check_type,
    compiler_reason,
    compiling,
    evaluate_formula,
)
from nuno_schemas.bodies import BOX, CAPSULE, FIELD, OF_TRIANGLES, PLANE
from nuno_schemas.dye import Cells, DyeReport, DyeState, Isotherm, Supply
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float, Hinges, Memory, Springs, State, Yarns
from nuno_schemas.layout import Bounds
from nuno_schemas.operation import Arranged, Outcome
from nuno_schemas.plugin import BodyShape, Mover
from nuno_schemas.system import StepLimit, StepReport, Term, Touched

LOGGER = logging.getLogger("nuno.plugins")
ARRAYS: dict[type, tuple[str, ...]] = {State: ("x", "v"), DyeState: ("phi", "fixed")}
"""Arrays of a state, which a solver advances in place."""
ADVANCING = ("advance", "apply", "apply_beside")
"""Methods that may write into a state."""


FLOATS = "\nAll that nuno's kernels are given is float64: a method's own buffers, too, as `stages` are"
LENT = "\nWhat a plugin is lent it may only read: it makes a copy of what it changes"


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view that cannot be written into."""
    view = array.view()
    view.flags.writeable = False
    return view


def each_array(value: Any, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Any:
    """Return a dataclass in which each array, also of its parts, is changed."""
    if isinstance(value, np.ndarray):
        return change(value)
    if type(value) is tuple:
        return tuple(each_array(item, change) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        parts = {one.name: each_array(getattr(value, one.name), change) for one in fields(value) if one.init}
        return replace(value, **parts)
    return value


def _hint(error: BaseException) -> str:
    """Return an explanation for an error of the compiler, or of NumPy, "" for others."""
    if isinstance(error, ValueError) and "read-only" in str(error):
        return LENT
    return FLOATS if type(error).__name__ == "TypingError" and "float32" in str(error) else ""


def _place(error: BaseException) -> str:
    """Return the innermost line of an error in the plugin's own folder, "" if there is none."""
    skipped = (__file__, *containment.OWN_FRAMES)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename not in skipped]
    plugin_frames = [frame for frame in frames if Path(frame.filename).parent == Path(frames[0].filename).parent]
    return f" ({Path(plugin_frames[-1].filename).name}:{plugin_frames[-1].lineno})" if plugin_frames else ""


class Lacking(BadInput, AttributeError):
    """A plugin lacks an attribute of its kind; as an AttributeError, it makes `hasattr` false."""


class Foreign:
    """Wraps a plugin, and guards each of its methods.

    A method may raise BadInput and RunFailed; any other error, also KeyboardInterrupt without a signal, becomes
    RunFailed with the plugin's name; `nuno.plugin_contract.containment` has the other limits. Its results are checked
    against the contract of its kind (`nuno.plugin_contract.guards`), and so are the state after `advance` and the
    results of its functions.
    """

    def __init__(self, plugin: Any, group: str, name: str, package: str) -> None:
        self._plugin, self._group, self._label = plugin, group, f"the plugin {name!r} of {package} in {group}"
        self.name = name  # scenes and recordings name a plugin by its entry point

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # Python looks these up in an object that is being copied
            raise AttributeError(name)
        if not hasattr(self._plugin, name):
            raise Lacking(f"{self._label} has no {name}", remedy=containment.UNWRITTEN)
        value = getattr(self._plugin, name)
        return self._guarded(name, value) if callable(value) and not isinstance(value, type) else value

    def _guarded(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            states = [(state, {n: getattr(state, n).shape for n in ARRAYS[type(state)]})
                     for state in args if type(state) in ARRAYS]  # fmt: skip
            result = self._call(name, method, *(self._lent(name, arg) for arg in args), **kwargs)
            for state, shapes in states:
                for field, shape in shapes.items():
                    finite = getattr(result, "status", "ok") == "ok"
                    self._check(f"{name} leaves a state whose {field}", getattr(state, field), shape, finite, True)
            return self._checked(name, result, args)

        return call

    def _lent(self, name: str, value: Any) -> Any:
        """Return an argument as a method gets it: what it keeps of a fabric, or of a state that it does not advance, it
        cannot change later.
        """
        if isinstance(value, Fabric):
            return each_array(value, read_only)
        return each_array(value, np.copy) if type(value) in ARRAYS and name not in ADVANCING else value

    def _call(self, name: str, method: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        def fail(error: BaseException) -> BaseException:
            if isinstance(error, BadInput | RunFailed):
                return error
            reason = compiler_reason(error) if type(error).__module__.startswith("numba.") else error
            text = f"{type(error).__name__}: {reason}{_hint(error)}{_place(error)}"
            return RunFailed(f"{self._label} failed in {name}: {text}")

        return containment.call(fail, method, *args, **kwargs)

    def _checked(self, name: str, result: Any, args: Sequence[Any]) -> Any:
        """Check the result of a method, and guard the functions in it; cloth and bodies become nuno's own copies."""
        with self._naming(f"{name} gives {type(result).__name__}"):
            check(self._group, name, result, args)
        for doubt in doubts(result):
            LOGGER.warning("%s: %s gives %s: %s", self._label, name, type(result).__name__, doubt)
        if isinstance(result, Fabric | BodyShape):
            result = each_array(result, np.copy)
        if isinstance(result, Term) and callable(result.data):
            return replace(result, data=self._force(result.data))
        if isinstance(result, Mover):
            return replace(result, pose=lambda t: self._pose(result.pose, len(result.joints), t))
        if isinstance(result, BodyShape) and (pose := result.pose) is not None:
            return replace(result, pose=lambda t: self._pose(pose, len(result.frames), t))
        return result

    @contextlib.contextmanager
    def _naming(self, what: str) -> Iterator[None]:
        try:
            yield
        except ContractError as error:
            raise RunFailed(f"{self._label}: {what}: {error}") from None

    def _force(self, function: Callable[[Float, Float, float, Float], None]) -> Callable[..., None]:
        def add(x: Float, v: Float, t: float, out: Float) -> None:
            # What it keeps of its arguments is nobody's any more, and can change nothing later.
            alone = np.zeros_like(out)
            returned = self._call("its force", function, read_only(x), read_only(v), t, alone)
            if returned is not None and returned is not alone:
                problem = f"its force returns {type(returned).__name__}, which nothing uses"
                raise RunFailed(f"{self._label}: {problem}: add the force to `out` (n, 3) [N], in place")
            # The solver reports a state that is not finite already.
            finite = bool(np.isfinite(x).all() and np.isfinite(v).all())
            self._check(f"at {t:g} s its force", alone, out.shape, finite)
            out += alone

        return add

    def _pose(self, pose: Callable[..., Any], number: int, t: float) -> tuple[Float, Float]:
        rotation, translation = self._call("its pose", pose, t)
        self._check(f"at {t:g} s its rotation", rotation, (number, 4), strided=True)
        self._check(f"at {t:g} s its translation", translation, (number, 3), strided=True)
        length = np.linalg.norm(rotation, axis=1)
        with self._naming(f"at {t:g} s"):
            if (bad := np.flatnonzero(~(np.abs(length - 1.0) <= UNIT))).size:
                raise ContractError(f"rotation has length {length[bad[0]]:g} at row {bad[0]}, not 1")
        return rotation, translation

    def _check(
        self, what: str, values: Any, shape: tuple[int, ...], finite: bool = True, strided: bool = False
    ) -> None:
        """Raise RunFailed for another shape or dtype, and for values that are not finite."""
        try:
            check_array(what, values, np.float64, shape, Bounds(finite=finite, strided=strided))
        except ContractError as error:
            raise RunFailed(f"{self._label}: {error}") from None


# Checks of plugins' results against the layout that the schema gives them, before any compiled code sees them.
#
# A kernel does not check an index: one out of range reads or writes other memory. Each function raises
# ContractError with the field and the first wrong row. `check_layout` checks annotations; this module has the rest.

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
    if fabric.relief is not None and fabric.relief.hinges.sum() > (fabric.hinges.number if fabric.hinges else 0):
        raise ContractError("relief.hinges are more than the fabric has")
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
    check_fields(shape)
    check_skins(shape)
    if shape.drawn is not None:
        check_skins(shape.shown)
    if shape.pose is not None and (mover is None or not callable(shape.pose)):
        raise ContractError("pose is no function" if mover is not None else "pose is one of a body without a motion")


def check_mover(mover: Mover) -> None:
    """Check a skeleton, and that the parent of each joint is an earlier one, or the world."""
    check_layout("", mover)
    if not mover.joints or not callable(mover.pose):
        raise ContractError("pose is no function" if mover.joints else "joints are none")
    if (late := np.flatnonzero(mover.parents >= np.arange(len(mover.joints)))).size:
        raise ContractError(f"parents is {mover.parents[late[0]]} at row {late[0]}, which does not come before it")


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
        if not getattr(getattr(type(part), "kernels", None), "roles", None):
            kind = f"data[{i}] is of type {type(part).__qualname__}, which has no kernels"
            raise ContractError(f"{kind}, and so does nothing: nuno_kernels.terms.register gives a type its kernels")
        if fabric.number and not type(part).__module__.startswith("nuno_kernels."):
            check_kernels(f"data[{i}]", part, fabric)


def check_kernels(what: str, part: Any, fabric: Fabric) -> None:
    """Check that a force's kernels can be compiled, and what those of one vertex give: a step would not name them."""
    import numba  # the plugin has, and others do without

    kernels, rows = type(part).kernels, numba.float64[:, ::1]
    given = {"x": tuple(fabric.position[0].tolist()), "v": tuple(fabric.velocity[0].tolist()), "t": 0.0}
    for role, name, count in (("at_vertex", "force", 3), ("energy_at_vertex", "energy", 1)):
        if (method := kernels.find(role)) is not None:
            taken = [given[one] for one in list(signature(method.py_func).parameters)[1:]]
            check_numbers(f"{what}.{name}", count, method, part, *taken)
    for role, types in (("block", (numba.int64, numba.int64, rows, rows, rows, numba.float64)), ("energy", (rows,))):
        if hasattr(method := kernels.find(role), "py_func") and "at_vertex" not in kernels:
            parameters = (numba.typeof(part), *types)[: len(signature(method.py_func).parameters)]
            with compiling(f"{what} {role}"):
                getattr(method, "by_address", lambda: method)().compile(parameters)  # as a step calls it


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


AMOUNTS = np.linspace(0.0, 1.0, 101)
"""Mobile amounts at which an isotherm is checked."""


def check_isotherm(isotherm: Isotherm) -> None:
    """Check an isotherm's numbers, and the values of its law: 0 without dye, and none that falls as phi grows."""
    check_layout("", isotherm)
    if isotherm.law is None:
        return
    for room in (0.1, 1.0):
        limit = evaluate_formula("law", isotherm.law, "limit", AMOUNTS, room)
        if limit[0] != 0.0:
            raise ContractError(f"law.limit is {limit[0]:g} at (0, {room:g}), not 0: fibre would hold dye without any")
        if (falls := np.flatnonzero(np.diff(limit) < 0.0)).size:
            raise ContractError(f"law.limit falls beyond ({AMOUNTS[falls[0]]:g}, {room:g})")


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
