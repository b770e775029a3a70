"""Logarithms of eight lanes at once, by fused operations in a fixed order: the same bits on every machine.

    x = 2^e m with m in [sqrt(1/2), sqrt(2)),  s = (m - 1) / (m + 1)
    ln x = e ln 2 + 2 (s + s^3 / 3 + s^5 / 5 + ...)

The series is that of nuno_dye.laws.power, cut where a term is below 1e-18 of the sum.
"""

from __future__ import annotations

from typing import Any

from nuno_dye.laws.power import exponent, series_log, shift_exponent
from nuno_kernels import kernel
from nuno_kernels.lanes.simd import fused, splat

LN2_HIGH = 0.6931471805598903
"""ln 2 to 42 bits: a whole number of less than 2^11 times it is exact."""
LN2_LOW = 5.497923018708371e-14
"""What LN2_HIGH lacks of it."""


@kernel
def log(value: Any) -> Any:
    """ln of every lane within 2 ulp, of positive normal numbers."""
    e = exponent(value)
    m = shift_exponent(value, splat(0.0) - e)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    rest = fused(s * z * 2.0, series_log(z), e * LN2_LOW)
    return fused(e, splat(LN2_HIGH), s * 2.0 + rest)
