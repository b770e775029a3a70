"""Choices between vectors of eight lanes: comparisons, selection, extremes."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types

from nuno_kernels.lanes.simd import LANES, WIDTH, instruction, spread, vector


@instruction
def alternate(typing: Any, even: Any, odd: Any, first: Any) -> Any:
    """Return `even` in the lanes whose number `first` + lane is even, `odd` in the others."""
    if even != vector or odd != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        index = ir.VectorType(ir.IntType(64), WIDTH)
        number = builder.add(spread(builder, args[2], index), ir.Constant(index, list(range(WIDTH))))
        parity = builder.and_(number, ir.Constant(index, [1] * WIDTH))
        return builder.select(builder.icmp_signed("==", parity, ir.Constant(index, [0] * WIDTH)), args[0], args[1])

    return vector(vector, vector, types.int64), build


@instruction
def lower(typing: Any, a: Any, b: Any) -> Any:
    """Return the lesser of `a` and `b` in every lane; `b` if either is NaN."""
    return _extreme("<", a, b)


@instruction
def higher(typing: Any, a: Any, b: Any) -> Any:
    """Return the greater of `a` and `b` in every lane; `b` if either is NaN."""
    return _extreme(">", a, b)


def _extreme(order: str, a: Any, b: Any) -> Any:
    if a != vector or b != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(order, *args), *args)

    return vector(vector, vector), build


@instruction
def lane(typing: Any, value: Any, which: Any) -> Any:
    """Return one of the eight numbers."""
    if value != vector:
        return None
    return types.float64(vector, types.int64), lambda context, builder, sig, args: builder.extract_element(*args)


@instruction
def any_below(typing: Any, value: Any, limit: Any) -> Any:
    """Whether any lane is less than the number `limit`; NaN is not."""
    if value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        below = builder.fcmp_ordered("<", args[0], spread(builder, args[1]))
        bits = builder.bitcast(below, ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(WIDTH), 0))

    return types.boolean(vector, types.float64), build


@instruction
def where_not_zero(typing: Any, test: Any, value: Any) -> Any:
    """Return `value` where `test` is not 0, NaN included, and 0 elsewhere."""
    if test != vector or value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(LANES, [0.0] * WIDTH)
        return builder.select(builder.fcmp_unordered("!=", args[0], zero), args[1], zero)

    return vector(vector, vector), build


@instruction
def where_greater(typing: Any, test: Any, limit: Any, value: Any) -> Any:
    """Return 0 where `test` <= `limit`, `value` elsewhere (also where either is NaN)."""
    if test != vector or limit != vector or value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(LANES, [0.0] * WIDTH)
        return builder.select(builder.fcmp_unordered(">", args[0], args[1]), args[2], zero)

    return vector(vector, vector, vector), build


@instruction
def where_not_negative(typing: Any, test: Any, value: Any, other: Any) -> Any:
    """Return `value` where `test` >= 0, `other` elsewhere (also where `test` is NaN)."""
    if not test == value == other == vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(LANES, [0.0] * WIDTH)
        return builder.select(builder.fcmp_ordered(">=", args[0], zero), args[1], args[2])

    return vector(vector, vector, vector), build


EVERY = (1 << WIDTH) - 1
"""bits of all lanes"""


@instruction
def lanes_up_to(typing: Any, value: Any, limit: Any) -> Any:
    """Return the bits of lanes that are no more than the number `limit`: bit j for lane j; NaN is not."""
    if value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        below = builder.fcmp_ordered("<=", args[0], spread(builder, args[1]))
        return builder.zext(builder.bitcast(below, ir.IntType(WIDTH)), ir.IntType(64))

    return types.int64(vector, types.float64), build


@instruction
def first_lane(typing: Any, bits: Any) -> Any:
    """Return the number of the lowest bit that is set, of bits that are not 0."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), build
