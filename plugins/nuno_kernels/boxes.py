"""Boxes of whole numbers, sixteen side by side: what they hold, and which of them meet."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types

from nuno_kernels.lanes import INDICES, address, call, instruction, transposed

# A box is a row of int16: the lowest x, y, z at the beginning and at the end of a way, then the highest ones, turned in
# sign, and four numbers that mean nothing. Sixteen boxes also stand number by number, twelve vectors.
#
# All numbers are modulo 2**16: differences are right wherever the true ones are less than 2**15, wherever the boxes
# lie. Half as wide as float32, a box takes half the time and half the cache.

SIXTEEN = 16
"""boxes side by side, and numbers of a row"""
NUMBERS = 12
"""numbers of a box"""
SHORTS = types.Array(types.int16, 2, "C")

_I16, _I32, _I64 = ir.IntType(16), ir.IntType(32), ir.IntType(64)
_BOX, _SIXTEEN = ir.VectorType(_I16, SIXTEEN), ir.VectorType(_I32, SIXTEEN)
_NONE = ir.Constant(_BOX, [0] * SIXTEEN)


def _whole(builder: Any, view: Any, row: Any, column: int = 0, of: Any = _BOX) -> Any:
    """Return a pointer to sixteen numbers from [row, column] of a view on."""
    return builder.bitcast(address(builder, view, row, ir.Constant(_I64, column)), of.as_pointer())


def _read(builder: Any, view: Any, row: Any, column: int = 0) -> Any:
    return builder.load(_whole(builder, view, row, column), align=2)


def _everywhere(builder: Any, value: Any, of: Any) -> Any:
    first = builder.insert_element(ir.Constant(of, ir.Undefined), value, ir.Constant(_I32, 0))
    return builder.shuffle_vector(first, ir.Constant(of, ir.Undefined), ir.Constant(_SIXTEEN, [0] * SIXTEEN))


@instruction(types.void, SHORTS, types.int64, types.int64, types.int64, SHORTS, types.int64)
def unite(builder: Any, boxes: Any, i: Any, j: Any, k: Any, to: Any, row: Any) -> None:
    """Write into a row of `to` the box round three of `boxes`."""
    first, second, third = (_read(builder, boxes, one) for one in (i, j, k))
    below = call(builder, "llvm.smin.v16i16", _BOX, builder.sub(second, first), builder.sub(third, first))
    below = call(builder, "llvm.smin.v16i16", _BOX, below, _NONE)
    builder.store(builder.add(first, below), _whole(builder, to, row), align=2)


@instruction(types.void, SHORTS, types.int64, SHORTS, types.int64)
def stand_up(builder: Any, boxes: Any, row: Any, standing: Any, g: Any) -> None:
    """Write sixteen rows of boxes, from `row` on, number by number into row g of `standing` (g, 192)."""
    rows = [_read(builder, boxes, builder.add(row, ir.Constant(_I64, k))) for k in range(SIXTEEN)]
    for number, column in enumerate(transposed(builder, rows)[:NUMBERS]):
        builder.store(column, _whole(builder, standing, g, number * SIXTEEN), align=2)


@instruction(types.int64, SHORTS, types.int64, SHORTS, types.int64)
def meeting(builder: Any, boxes: Any, row: Any, standing: Any, g: Any) -> Any:
    """Return the bits of those of sixteen boxes that may meet the one in a row: along each axis, none stays beyond the
    other from the beginning of the way to its end.
    """

    def beyond(number: int) -> Any:
        own = builder.load(address(builder, boxes, row, ir.Constant(_I64, (number + 6) % NUMBERS)))
        return builder.add(_read(builder, standing, g, number * SIXTEEN), _everywhere(builder, own, _BOX))

    met = None
    for number in (0, 1, 2, 6, 7, 8):
        # Negative where it is not beyond, at the beginning or at the end.
        either = builder.or_(beyond(number), beyond(number + 3))
        met = either if met is None else builder.and_(met, either)
    bits = builder.bitcast(builder.icmp_signed("<", met, _NONE), _I16)
    return builder.zext(bits, _I64)


@instruction(types.int64, INDICES, types.int64, types.int32, types.int32)
def having(builder: Any, corners: Any, g: Any, i: Any, j: Any) -> Any:
    """Return the bits of those of sixteen primitives that have vertex i or j: corners[g] (g, 48) are the first of
    each, the second, the third.
    """
    has = ir.Constant(ir.VectorType(ir.IntType(1), SIXTEEN), [0] * SIXTEEN)
    for k in range(3):
        corner = builder.load(_whole(builder, corners, g, k * SIXTEEN, _SIXTEEN), align=4)
        for vertex in (i, j):
            has = builder.or_(has, builder.icmp_signed("==", corner, _everywhere(builder, vertex, _SIXTEEN)))
    return builder.zext(builder.bitcast(has, _I16), _I64)


@instruction(types.int64, types.int64, INDICES, types.int64, types.int32, INDICES, types.int64)
def write_chosen(builder: Any, bits: Any, numbers: Any, g: Any, first: Any, found: Any, column: Any) -> Any:
    """Write `first`, and those of numbers[g] (g, 16) whose bits are set, side by side into two rows of `found` from a
    column on; return the column after. Up to sixteen columns from there are overwritten.

    Without a branch on how many are set, since a wrong prediction takes longer.
    """
    mask = builder.bitcast(builder.trunc(bits, _I16), ir.VectorType(ir.IntType(1), SIXTEEN))
    row, none = builder.load(_whole(builder, numbers, g, 0, _SIXTEEN), align=4), ir.Constant(_SIXTEEN, None)
    chosen = call(builder, "llvm.experimental.vector.compress.v16i32", _SIXTEEN, row, mask, none)
    for k, value in enumerate((_everywhere(builder, first, _SIXTEEN), chosen)):
        pointer = address(builder, found, ir.Constant(_I64, k), column)
        builder.store(value, builder.bitcast(pointer, _SIXTEEN.as_pointer()), align=4)
    return builder.add(column, call(builder, "llvm.ctpop.i64", _I64, bits))
