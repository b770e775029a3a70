"""Renumbering of the cloth's vertices, so that neighbours have near numbers.

Kernels work on blocks of consecutive vertices, and a spring between two blocks is computed by both: on a mesh with
random numbers that is almost every spring, from two places in memory. Only the stepped fabric is renumbered: input,
output, and all services except the solver have the numbers of the user's file.

The order is by strips across the cloth, as wide as its shorter edges: neighbours in a strip are consecutive, so that
their springs form runs, and a net of rows gets them back. Rejected: reverse Cuthill-McKee and the curves of Hilbert and
Morton, with fewer consecutive neighbours. With springs they are slower on meshes of 10,000 vertices, and only Hilbert's
is as fast on 65,000; with a membrane all are alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.scene.scene_file import Loaded
from nuno.simulation.cloth import Piece
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Hinges, Int, Springs, State
from nuno_schemas.system import Forces, Touched

FEWEST = 2048
"""Objects of fewer vertices are not renumbered: they fit into a block and a core's cache."""
WORTH = 4
"""An object is renumbered if the ends of its edges come nearer by this factor: a step is then certainly faster. Grids,
rings and triangulated patches are not renumbered, and keep their bits."""
NARROW = 0.2
"""Share of the edges that are shorter than the width of a strip."""


def takes_any_numbering(loaded: Loaded) -> bool:
    """Return whether no force of a scene depends on vertex numbers, as `any_numbering` of nuno_schemas.plugin.Force."""
    chosen = [*loaded.forces, *loaded.contacts, *([loaded.cloth_contact] if loaded.cloth_contact else [])]
    return all(getattr(plugin.plugin, "any_numbering", False) for plugin in chosen)


def require_any_numbering(numbers: Int | None, loaded: Loaded, item: str) -> None:
    """Raise BadInput if cloth is renumbered and forces, set by `item` during the run, need the user's numbers."""
    if numbers is not None and not takes_any_numbering(loaded):
        problem = "a force knows vertices by number, and this run's are renumbered, which steps them faster"
        raise BadInput(problem, field="forces", value=item, remedy="stop, and run again with it by --set")


def find_numbers(fabric: Fabric, pieces: Sequence[Piece]) -> Int | None:
    """Return the vertex (n,) for each position, object by object; None if renumbering gains nothing.

    The result is the same on every machine: only integers are summed.
    """
    pairs = _edges(fabric)
    numbers, moved = np.arange(fabric.number, dtype=np.int32), False
    for piece in pieces:
        if piece.stop - piece.start < FEWEST:
            continue
        edges = pairs[(pairs[:, 0] >= piece.start) & (pairs[:, 0] < piece.stop)].astype(np.int64) - piece.start
        order = _sort_into_strips(fabric.position[piece.start : piece.stop], edges)
        if order is not None and WORTH * _spread(invert(order)[edges]) < _spread(edges):
            numbers[piece.start : piece.stop], moved = order + piece.start, True
    return numbers if moved else None


def keep_numbers(numbers: Int, source: Int, pieces: Sequence[Piece]) -> Int:
    """Return the numbers of changed cloth, whose vertices (m,) were `source` before, -1 for new ones: old vertices keep
    their order, and new ones are last in their object.
    """
    new = source < 0
    rank = np.where(new, np.arange(len(source)), invert(numbers)[source])
    object_of = np.repeat(np.arange(len(pieces)), [piece.stop - piece.start for piece in pieces])
    return np.lexsort((rank, new, object_of)).astype(np.int32)


def invert(numbers: Int) -> Int:
    """Return the position (n,) of each vertex."""
    place = np.empty(len(numbers), np.int32)
    place[numbers] = np.arange(len(numbers), dtype=np.int32)
    return place


def renumber(fabric: Fabric, numbers: Int | None) -> Fabric:
    """Return the fabric with vertex numbers[i] at position i; springs and all other parts keep their order."""
    if numbers is None:
        return fabric
    place = invert(numbers)
    parts: dict[str, Any] = {}
    for name in ("position", "velocity", "mass", "pinned", "uv", "merged", "cells"):
        if (values := getattr(fabric, name)) is not None:
            parts[name] = place[values] if name in ("merged", "cells") else values[numbers]
    for name, vertices in (("corners", "vertex"), ("membrane", "faces"), ("friction", "vertices")):
        if (part := getattr(fabric, name)) is not None:
            parts[name] = replace(part, **{vertices: place[getattr(part, vertices)]})
    if fabric.springs is not None:
        parts["springs"] = _renumber_springs(fabric.springs, place)
    if fabric.hinges is not None:
        parts["hinges"] = _renumber_hinges(fabric.hinges, place)
    if fabric.bending is not None:
        parts["bending"] = replace(fabric.bending, pairs=np.sort(place[fabric.bending.pairs], axis=1))
    bindings = tuple(replace(binding, vertices=place[binding.vertices]) for binding in fabric.bindings)
    return replace(fabric, faces=place[fabric.faces], bindings=bindings, numbers=numbers, **parts)


def _renumber_springs(springs: Springs, place: Int) -> Springs:
    pairs, moved = place[springs.pairs()], replace(springs, first=place[springs.first])
    if np.array_equal(moved.pairs(), pairs):  # runs of objects that are not renumbered, and single springs
        return moved
    names = ("k", "rest", "c", "lock", "k_lock")
    arrays = {name: getattr(springs, name) for name in names}
    constants = {name: None if values is None else springs.per_spring(values) for name, values in arrays.items()}
    one, kind = _ones(springs.number), np.repeat(springs.kind, springs.count)
    return Springs(pairs, one, one, kind=kind, **constants)  # type: ignore[arg-type]


def _renumber_hinges(hinges: Hinges, place: Int) -> Hinges:
    quads, moved = place[hinges.quads()], replace(hinges, first=place[hinges.first])
    if np.array_equal(moved.quads(), quads):
        return moved
    one = _ones(hinges.number)
    return Hinges(quads, one, one, hinges.per_hinge(hinges.k), hinges.per_hinge(hinges.rest))


def _ones(number: int) -> Int:
    return np.broadcast_to(np.int32(1), number)


def _edges(fabric: Fabric) -> Int:
    """Return edges (e, 2): sides of triangles, once for each triangle, or springs where there are none."""
    if len(fabric.faces):
        return np.concatenate([fabric.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    return np.zeros((0, 2), np.int32) if fabric.springs is None else fabric.springs.pairs()


def _spread(pairs: NDArray[Any]) -> int:
    """Return the sum of the differences of numbers."""
    return int(np.abs(pairs[:, 0].astype(np.int64) - pairs[:, 1]).sum())


def _sort_into_strips(x: Float, pairs: NDArray[np.int64]) -> Int | None:
    """Return vertices (n,) by strips of cloth at x (n, 3) [m], across its longest side: each strip from one end to the
    other, or around the centre, as of a tube, whichever has more consecutive neighbours. None for cloth whose edges
    have length 0, and strips no width.
    """
    d = x[pairs[:, 1]] - x[pairs[:, 0]]
    square = d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2]
    at = int(NARROW * len(pairs))
    width = float(np.sqrt(np.partition(square, at)[at])) if len(pairs) else 0.0
    if width == 0.0:
        return None
    low, high = x.min(axis=0), x.max(axis=0)
    across, along, through = np.argsort(low - high, kind="stable")
    strip = np.floor((x[:, across] - low[across]) / width + 0.5)
    u, v = (x[:, axis] - 0.5 * (low[axis] + high[axis]) for axis in (along, through))
    orders = [np.lexsort((coordinate, strip)).astype(np.int32) for coordinate in (u, _pseudo_angle(u, v))]
    return max(orders, key=lambda numbers: int((np.abs(np.diff(invert(numbers)[pairs])) == 1).sum()))


def _pseudo_angle(u: Float, v: Float) -> Float:
    """Return a measure (n,) of the angle of (u, v), 0 to 4, without functions whose last bits differ by machine."""
    size = np.abs(u) + np.abs(v)
    share = np.divide(u, size, out=np.zeros_like(u), where=size > 0.0)
    return np.asarray(np.where(v < 0.0, 3.0 + share, 1.0 - share))


# A solver of renumbered cloth, which takes and returns vertex arrays in the user's order.


class RenumberedSolver:
    """Wraps an integrator (nuno_schemas.plugin.Integrator): it takes systems whose fabric is renumbered by `numbers`
    (n,), and states that are not.

    Memory is the integrator's own, in the renumbered order. Springs, and so their tensions, keep their order.
    """

    def __init__(self, plugin: Any, numbers: Int) -> None:
        self._plugin, self._numbers = plugin, numbers

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # a copy is asked for these before it has a plugin
            raise AttributeError(name)
        method = getattr(self._plugin, name)

        def call(*args: Any) -> Any:
            numbers = self._numbers
            renumbered_args = [State(a.x[numbers], a.v[numbers], a.t) if isinstance(a, State) else a for a in args]
            result = method(*renumbered_args)
            for state, stepped in zip(args, renumbered_args, strict=True):
                if isinstance(state, State):
                    state.x[numbers], state.v[numbers], state.t = stepped.x, stepped.v, stepped.t
            return self._restore(result)

        return call if callable(method) else method

    def _restore(self, result: Any) -> Any:
        """Return the integrator's result with arrays (n, ...) of vertices in the user's order."""
        if isinstance(result, Forces):
            parts = {name: self._restore(part) for name, part in result.parts.items()}
            return Forces(parts, self._restore(result.acceleration), result.tension)
        if isinstance(result, Touched):
            return Touched({name: self._restore(part) for name, part in result.by.items()}, self._restore(result.total))
        if isinstance(result, np.ndarray):
            out = np.empty_like(result)
            out[self._numbers] = result
            return out
        return result
