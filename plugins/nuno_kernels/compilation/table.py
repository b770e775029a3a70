"""Terms as a table that compiled steps walk: where each term lies in memory, and the addresses of its kernels.

A step is compiled once for each method, whatever terms a system holds: their types are no part of its own. Not chosen:
a tuple of the terms' types, which compiles every step anew for every combination, a third of all that tests and a
user's second scene compile; and the public face of numba alone (see nuno_kernels.compilation.internals).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.extending import lower_builtin, models, register_model, type_callable, unbox
from numpy.typing import NDArray

from nuno_kernels.compilation.reference import Reference

Words = NDArray[np.int64]
_I64 = ir.IntType(64)
NOTHING, UNKNOWN = 0, -1
"""in the place of an address: of a kernel that a term does not have, and of one that the table was not made for"""
BEFORE = 2
"""numbers of a term in a table before its addresses: where it lies, and where the rows of its matrix do"""


class TableType(types.Type):  # type: ignore[misc]
    """The type of a table of any terms."""

    def __init__(self) -> None:
        super().__init__("Table")


TABLE = TableType()


@register_model(TableType)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: TableType) -> None:
        super().__init__(manager, kind, _I64.as_pointer())


@unbox(TableType)  # type: ignore[untyped-decorator]
def _unbox(kind: TableType, value: Any, c: Any) -> Any:
    """Read the address from an attribute, which may raise."""
    number = c.pyapi.object_getattr_string(value, "address")
    failed = c.builder.icmp_unsigned("==", number, number.type(None))
    with c.builder.goto_entry_block():
        place = c.builder.alloca(_I64)
    c.builder.store(_I64(0), place)
    with c.builder.if_then(c.builder.not_(failed)):
        c.builder.store(c.pyapi.number_as_ssize_t(number), place)
        c.pyapi.decref(number)
    return extending.NativeValue(c.builder.inttoptr(c.builder.load(place), _I64.as_pointer()), is_error=failed)


# Terms in memory, as kernels that take them by reference find them (nuno_kernels.compilation.reference).


def memory_of(kind: Reference, value: Any) -> list[Words]:
    """Return a tuple that is passed by reference in memory, the first of these arrays, and those that it leads to. Its
    own arrays must outlive it. Raises TypeError for a field of a type that kernels do not read in it.
    """
    size, _ = _extent(kind.held)
    memory = np.zeros(-(-size // 8), np.int64)
    parts = [memory]
    _write(kind.held, value, memory, 0, parts)
    return parts


@functools.cache
def _extent(kind: Any) -> tuple[int, int]:
    """Return the bytes of a type in memory, and what its address is a multiple of, as LLVM lays out structs."""
    if isinstance(kind, types.BaseTuple):
        _, size, align = _offsets(kind)
        return size, align
    if isinstance(kind, types.Array):
        return 8 * (5 + 2 * kind.ndim), 8
    if isinstance(kind, types.Boolean):
        return 1, 1
    if isinstance(kind, types.Integer | types.Float):
        return kind.bitwidth // 8, kind.bitwidth // 8
    if isinstance(kind, types.NoneType | Reference):
        return 8, 8
    raise TypeError(f"a term has a field of type {kind}: arrays, numbers, None and tuples of them are read by kernels")


@functools.cache
def _offsets(kind: Any) -> tuple[list[int], int, int]:
    """Return where the items of a tuple begin, its bytes, and what its address is a multiple of."""
    offsets, end, widest = [], 0, 1
    for size, align in map(_extent, kind.types):
        end = -(-end // align) * align
        offsets.append(end)
        end, widest = end + size, max(widest, align)
    return offsets, -(-end // widest) * widest, widest


def _write(kind: Any, value: Any, memory: Words, at: int, parts: list[Words]) -> None:
    if isinstance(kind, types.BaseTuple):
        for one, item, offset in zip(kind.types, value, _offsets(kind)[0], strict=True):
            _write(one, item, memory, at + offset, parts)
    elif isinstance(kind, types.Array):
        # No reference is counted: the term holds the array.
        words = (0, 0, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides)
        memory[at // 8 : at // 8 + len(words)] = words
    elif isinstance(kind, Reference):
        found = memory_of(kind, value)
        parts += found
        memory[at // 8] = found[0].ctypes.data
    elif not isinstance(kind, types.NoneType):
        dtype = np.dtype("bool" if isinstance(kind, types.Boolean) else str(kind))
        memory.view(np.uint8)[at : at + dtype.itemsize].view(dtype)[0] = value


# Tables.


def table_of(terms: Sequence[Sequence[tuple[Reference, Any]]], addresses: Sequence[Sequence[int]]) -> list[Words]:
    """Return a table, the first of these arrays, and what it leads to: the number of terms, and for each where it and
    the rows of its matrix lie, 0 for none, and the addresses of as many kernels for every term.
    """
    parts, table = list[Words](), [len(terms)]
    for own, places in zip(terms, addresses, strict=True):
        found = [memory_of(kind, value) for kind, value in own]
        parts += itertools.chain(*found)
        table += [*(memory[0].ctypes.data for memory in found), *[0] * (BEFORE - len(found)), *places]
    return [np.array(table, np.int64), *parts]


@lower_builtin(len, TableType)  # type: ignore[untyped-decorator]
def _length(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Return the number of terms."""
    return builder.load(args[0])


@type_callable(len)  # type: ignore[untyped-decorator]
def _typed_length(context: Any) -> Any:
    return lambda table: types.int64 if isinstance(table, TableType) else None


def call_by_table(kinds: Callable[[Sequence[Any]], tuple[int, Sequence[Any]]], slots: int, linear: bool) -> Any:
    """Return what types and builds a call f(table, k, ...) in kernels, of a kernel of term k, if it has that one, with
    the term, with the rows of its matrix if `linear`, and with the other arguments: see numba.extending.intrinsic.

    kinds(types) returns, for types of these arguments, the kernel's place, one of so many slots, and the types that it
    takes. In compiled code RuntimeError is raised if the table was not made for that.
    """

    def typed(*given: Any) -> Any:
        slot, taken = kinds(given)
        pointers = (types.voidptr,) * (2 if linear else 1)

        def build(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            table, k, *own = values

            def item(at: int) -> Any:
                place = builder.mul(k, ir.Constant(_I64, BEFORE + slots))
                return builder.load(builder.gep(table, [builder.add(place, ir.Constant(_I64, 1 + at))]))

            address = item(BEFORE + slot)
            with builder.if_then(builder.icmp_signed("==", address, ir.Constant(_I64, UNKNOWN)), likely=False):
                context.call_conv.return_user_exc(builder, RuntimeError, ("terms lack a role that a step calls",))
            with builder.if_then(builder.icmp_signed("!=", address, ir.Constant(_I64, NOTHING))):
                kind = context.call_conv.get_function_type(types.none, (*pointers, *taken))
                kernel = builder.inttoptr(address, kind.as_pointer())
                term = [builder.inttoptr(item(at), ir.IntType(8).as_pointer()) for at in range(len(pointers))]
                status, _ = context.call_conv.call_function(
                    builder, kernel, types.none, (*pointers, *taken), (*term, *own)
                )
                with builder.if_then(status.is_error, likely=False):
                    context.call_conv.return_status_propagate(builder, status)
            return context.get_dummy_value()

        return types.void(TABLE, types.int64, *taken), build

    return typed
