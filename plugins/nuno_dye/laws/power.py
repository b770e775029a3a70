"""Powers and logarithms of eight lanes at once, by fused operations in a fixed order: the same bits on every machine.

    x = 2^e m with m in [sqrt(1/2), sqrt(2)),  s = (m - 1) / (m + 1)
    log2 x = e + 2 / ln 2 (s + s^3 / 3 + s^5 / 5 + ...)
    x^b = 2^n 2^r,  n + r = b log2 x with n whole and |r| <= 1/2
    ln x = e ln 2 + 2 (s + s^3 / 3 + s^5 / 5 + ...)

b log2 x is a sum of two numbers, since an error d in it is a relative error d ln 2 of the power. The series of
logarithms ends where a term is below 1e-18 of the sum (|s| <= 0.1716), that of 2^r below 5e-18 of 1. Rejected: LLVM's
power, which calls the scalar one eight times and takes about ten times as long; formulas' `phi ** b` of other exponents
than from 0 to 1 do so.
"""

from __future__ import annotations

import math
import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import overload

from nuno_kernels import forced_inline, kernel
from nuno_kernels.formula import INLINE
from nuno_kernels.lanes import LANES, WIDTH, fused, instruction, lane, splat, spread, vector, where_greater, with_lane

SMALLEST = 2.0**-1022
"""The least normal number; powers of smaller ones are 0."""
_LESSER = SMALLEST - 2.0**-1074
_WHOLE = 1.5 * 2.0**52
"""The last bit of a number of this size is 1."""
_WHOLE_BITS = 0x4338000000000000
_HALF_ROOT_BITS = 0x3FE6A09E667F3BCD
"""Bits of sqrt(1/2) as a float64."""
_BITS = ir.VectorType(ir.IntType(64), WIDTH)
LOG2_E2 = 2.0 / math.log(2.0)
LOG2_E2_REST = 4.0710547481862066e-17
"""2 / ln 2 less LOG2_E2."""
LN2 = math.log(2.0)
LN2_HIGH = 0.6931471805598903
"""The first 42 bits of ln 2, whose product with a whole number below 2^11 is exact."""
LN2_LOW = 5.497923018708371e-14
"""ln 2 less LN2_HIGH."""


def _constant(number: int) -> Any:
    return ir.Constant(_BITS, [number] * WIDTH)


@instruction(vector, vector)
def exponent(builder: Any, value: Any) -> Any:
    """Return the whole number e with value / 2^e in [sqrt(1/2), sqrt(2)), for positive normal numbers."""
    bits = builder.sub(builder.bitcast(value, _BITS), _constant(_HALF_ROOT_BITS))
    whole = builder.add(builder.ashr(bits, _constant(52)), _constant(_WHOLE_BITS))
    return builder.fsub(builder.bitcast(whole, LANES), ir.Constant(LANES, [_WHOLE] * WIDTH))


@instruction(vector, vector)
def nearest_whole(builder: Any, value: Any) -> Any:
    """Return every lane, below 2^51, rounded to a whole number."""
    whole = spread(builder, ir.Constant(ir.DoubleType(), _WHOLE))
    return builder.fsub(builder.fadd(value, whole), whole)


@instruction(vector, vector, vector)
def shift_exponent(builder: Any, value: Any, by: Any) -> Any:
    """Return value 2^by for whole numbers `by`, exact if the result is normal."""
    whole = builder.fadd(by, spread(builder, ir.Constant(ir.DoubleType(), _WHOLE)))
    shift = builder.shl(builder.bitcast(whole, _BITS), _constant(52))
    return builder.bitcast(builder.add(builder.bitcast(value, _BITS), shift), LANES)


@kernel
def series_log(z: Any) -> Any:
    """Return 1/3 + z/5 + z^2/7 + ... + z^9/21."""
    total = splat(1.0 / 21.0)
    for odd in (19.0, 17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0):
        total = fused(total, z, splat(1.0 / odd))
    return total


@kernel
def series_exp(u: Any) -> Any:
    """Return 1 + u + u^2/2! + ... + u^13/13!."""
    total = splat(1.0 / 6227020800.0)
    for factorial in (
        479001600.0, 39916800.0, 3628800.0, 362880.0, 40320.0, 5040.0, 720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0,
    ):  # fmt: skip
        total = fused(total, u, splat(1.0 / factorial))
    return total


@kernel
def power(base: Any, b: float) -> Any:
    """Return base^b of every lane, 0 < b <= 1, within 2 ulp; base itself for b = 1, 0 if base is below SMALLEST."""
    if b == 1.0:
        return base
    e = exponent(base)
    m = shift_exponent(base, splat(0.0) - e)
    f, d = m - 1.0, m + 1.0
    s = f / d
    # (m - 1) / (m + 1) less s: the rounding of d and of the quotient.
    s_rest = (fused(splat(0.0) - s, d, f) - s * (m - (d - 1.0))) / d
    z = s * s
    high = s * LOG2_E2
    low = fused(s, splat(LOG2_E2), splat(0.0) - high) + (s * LOG2_E2_REST + s_rest * LOG2_E2)
    low = fused(s * z * LOG2_E2, series_log(z), low)
    log = e + high
    # |e| >= 1 > |high|, or e is 0: the sum's rounding is known exactly.
    low = low + (high - (log - e))
    y = log * b
    y_rest = fused(log, splat(b), splat(0.0) - y) + low * b
    n = nearest_whole(y)
    result = shift_exponent(series_exp(((y - n) + y_rest) * LN2), n)
    # Keep NaN, which the bits alone would turn into a number.
    return where_greater(base, splat(_LESSER), result + (base - base))


@forced_inline
def _each_power(base: Any, b: float) -> Any:
    found = splat(0.0)
    for j in range(WIDTH):
        found = with_lane(found, j, lane(base, j) ** b)
    return found


@overload(operator.pow, jit_options=INLINE, strict=False)  # type: ignore[untyped-decorator]
def _power(base: Any, b: Any) -> Any:
    if base == vector and isinstance(b, types.Float):
        return lambda base, b: power(base, b) if 0.0 < b <= 1.0 else _each_power(base, b)
    return None


@kernel
def log(value: Any) -> Any:
    """Return the natural logarithm of every lane within 2 ulp, for positive normal numbers."""
    e = exponent(value)
    m = shift_exponent(value, splat(0.0) - e)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    rest = fused(s * z * 2.0, series_log(z), e * LN2_LOW)
    return fused(e, splat(LN2_HIGH), s * 2.0 + rest)
