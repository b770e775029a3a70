"""Forces written in Python, which a step calls by their address as one term among the others."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from nuno_kernels import kernel
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import register
from nuno_schemas.fabric import Float

CALLED = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_size_t, ctypes.c_size_t, ctypes.c_size_t)


class Address(int):
    """The address of a function that calls forces, f(s, x, v, out): fraction of the interval, and where arrays (n, 3)
    lie. An error waits in it until the compiled code is left.
    """

    called: Any
    error: BaseException | None = None


class PythonForces(NamedTuple):
    """All forces of a system in Python."""

    address: int


def make_forces(
    calls: Sequence[Callable[[Float, Float, float, Float], None]], number: int, time: Float, leave: Long
) -> PythonForces:
    """Return the term of functions f(x, v, t, out), of which x and v (n, 3) are copies and `out` takes newtons, on so
    many vertices. time (2,) is the interval's start and length [s]. An error writes `leave`, which ends steps.
    """

    def call(s: float, *places: int) -> None:
        if address.error is not None:
            return
        try:
            arrays = (np.ctypeslib.as_array((ctypes.c_double * (3 * number)).from_address(place)) for place in places)
            x, v, out = (array.reshape(number, 3) for array in arrays)
            for force in calls:
                force(x, v, float(time[0] + s * time[1]), out)
        except BaseException as error:
            address.error, leave[0] = error, leave[0] or ERROR

    called = CALLED(call)
    address = Address(ctypes.cast(called, ctypes.c_void_p).value or 0)
    address.called = called
    return PythonForces(address)


ERROR = -1
"""what an error writes into `leave`"""


def raise_error(terms: Sequence[Any], leave: Long) -> None:
    """Raise the error that a force in Python has met since the last call."""
    for term in terms:
        address: Any = getattr(term, "address", None)
        if isinstance(address, Address) and address.error is not None:
            error, address.error = address.error, None
            leave[0] = 0 if leave[0] == ERROR else leave[0]
            raise error


@intrinsic  # type: ignore[untyped-decorator]
def call_at(typing: Any, address: Any, s: Any, x: Any, v: Any, out: Any) -> Any:
    """Call a C function by its address."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        number = ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [ir.DoubleType(), number, number, number])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.float64, types.uintp, types.uintp, types.uintp), build


@kernel
def add_python(term: PythonForces, x: Float, v: Float, s: float, a: Float, threads: int | None) -> None:
    """Add the forces [N] to a (3, n)."""
    place, speed, force = np.empty((x.shape[1], 3)), np.empty((x.shape[1], 3)), np.zeros((x.shape[1], 3))
    for i in range(x.shape[1]):
        for row in range(3):
            place[i, row], speed[i, row] = x[row, i], v[row, i]
    call_at(term.address, s, place.ctypes.data, speed.ctypes.data, force.ctypes.data)
    for i in range(x.shape[1]):
        for row in range(3):
            a[row, i] += force[i, row]


register(PythonForces, "python", reads_velocity=lambda term: True, after=add_python)
