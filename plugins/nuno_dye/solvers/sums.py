"""Sums that keep what rounding loses."""

from __future__ import annotations

from nuno_kernels import kernel
from nuno_schemas.fabric import Float


@kernel
def sum_compensated(values: Float) -> float:
    """Sum of a flat array after Neumaier (1974): off by rounding of the result, and n eps^2 sum |value|."""
    total, lost = 0.0, 0.0
    for i in range(values.shape[0]):
        value = values[i]
        larger = total + value
        lost += (total - larger) + value if abs(total) >= abs(value) else (value - larger) + total
        total = larger
    return total + lost
