"""Formulas of other packages within kernels: a named tuple of numbers, its parameters, with a compiled method.

    @formula
    class Ball(NamedTuple):
        radius: float

        def distance(self, x, y, z):
            return math.sqrt(x * x + y * y + z * z) - self.radius

A kernel that calls `distance_of(ball, x, y, z)` or `limit_at(law, phi, room)` is compiled for the tuple's type, and the
method becomes a part of it, like nuno's own functions. From Python a method takes numbers, or arrays that broadcast.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba.extending import overload

from nuno_kernels import FLAGS, forced_inline, kernel
from nuno_kernels.compilation.internals import NumbaError
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.lanes import WIDTH, lane, splat, vector, with_lane
from nuno_schemas.fabric import Float

T = TypeVar("T", bound=type)
INLINE = FLAGS | {"forceinline": True}


class Methods(dict[str, Any]):
    """Compiled methods by name."""

    def all(self) -> list[Any]:
        """Return the methods, on which a kept kernel depends (nuno_kernels.compilation.internals)."""
        return list(self.values())


def formula(kind: T) -> T:
    """Compile a named tuple's method `distance(self, x, y, z)`, also `gradient` of that if it has one, or `limit(self,
    phi, room)`, also `least(self, phi)`, a lower bound in eight cells, and `root(self, total, ways, room)`, the x >= 0
    with ways x + limit = total > 0, if it has them. Raises TypeError for a class without distance and limit.
    """
    methods = Methods({name: forced_inline(method) for name, method in vars(kind).items() if callable(method)
                       and name in (*EVALUATED, "gradient", "least", "root")})  # fmt: skip
    if not methods.keys() & EVALUATED.keys():
        raise TypeError(f"{kind.__qualname__} has no {' and no '.join(EVALUATED)}, and so is no formula")
    by_reference(kind)
    kind.kernels = methods  # type: ignore[attr-defined]
    kind.registered_by = kind.__module__  # type: ignore[attr-defined]
    for name, method in methods.items():
        setattr(kind, name, _on_arrays(EVALUATED[name]) if name in EVALUATED else method)
    return kind


def method_or(name: str, other: Any) -> Any:
    """Return a function for kernels whose first argument is a formula: its method of this name, or else `other`."""

    def called(form: Any, *rest: Any) -> Any:
        return other(form, *rest)

    @overload(called, jit_options=INLINE, strict=False)  # type: ignore[untyped-decorator]
    def typed(form: Any, *rest: Any) -> Any:
        chosen = form.instance_class.kernels.get(name, other)
        return lambda form, *rest: chosen(form, *rest)

    return called


def distance_of(form: Any, x: float, y: float, z: float) -> float:
    """Return a form's signed distance [m] at a point; kernels call it."""
    return float(form.distance(x, y, z))


@overload(distance_of, jit_options=INLINE, strict=False)  # type: ignore[untyped-decorator]
def _distance_of(form: Any, x: Any, y: Any, z: Any) -> Any:
    distance = form.instance_class.kernels["distance"]
    return lambda form, x, y, z: distance(form, x, y, z)


def limit_at(law: Any, phi: Any, room: Any) -> Any:
    """Return a law's limit at mobile dye phi >= 0 and capacity `room`, numbers or eight lanes; kernels call it."""
    return law.limit(phi, room)


@overload(limit_at, jit_options=INLINE, strict=False)  # type: ignore[untyped-decorator]
def _limit_at(law: Any, phi: Any, room: Any) -> Any:
    limit = law.instance_class.kernels["limit"]
    try:
        limit.get_call_template((law, phi, room), {})
    except NumbaError:
        if phi != vector:
            raise
        # What is more than arithmetic takes one lane after the other.
        return lambda law, phi, room: _each_lane(law, phi, room)
    return lambda law, phi, room: limit(law, phi, room)


@forced_inline
def _each_lane(law: Any, phi: Any, room: Any) -> Any:
    found = splat(0.0)
    for j in range(WIDTH):
        found = with_lane(found, j, limit_at(law, lane(phi, j), lane(room, j)))
    return found


@kernel
def _distances(form: Any, x: Float, y: Float, z: Float, out: Float) -> None:
    for i in range(out.shape[0]):
        out[i] = distance_of(form, x[i], y[i], z[i])


@kernel
def _limits(law: Any, phi: Float, room: Float, out: Float) -> None:
    for i in range(out.shape[0]):
        out[i] = limit_at(law, phi[i], room[i])


EVALUATED = {"distance": _distances, "limit": _limits}
"""The methods that a formula may have, and what evaluates them at many places."""


def _on_arrays(evaluate: Any) -> Callable[..., Float]:
    """Return a method for Python, which takes numbers or arrays that broadcast."""

    def method(self: Any, *arguments: Any) -> Float:
        columns = np.broadcast_arrays(*(np.asarray(one, np.float64) for one in arguments))
        out = np.empty(columns[0].shape)
        evaluate(self, *(np.ascontiguousarray(one).reshape(-1) for one in columns), out.reshape(-1))
        return out

    return method
