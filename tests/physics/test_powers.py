"""Powers of eight lanes: within 2 ulp of exact ones, exact where they must be, not a number where they are not."""

from __future__ import annotations

import numpy as np
import pytest

from nuno_dye.laws.power import SMALLEST, power
from nuno_kernels import kernel
from nuno_kernels.lanes import WIDTH, load, store
from nuno_schemas.fabric import Float


@kernel
def find_powers(base: Float, b: float, out: Float) -> None:
    for c in range(0, base.shape[1], WIDTH):
        store(out, 0, c, power(load(base, 0, c), b))


def powers(base: Float, b: float) -> Float:
    out = np.empty((1, base.size))
    find_powers(base[None].copy(), b, out)
    return out[0]


@pytest.mark.parametrize("b", [0.1, 0.35, 0.5, 1.0 / 3.0, 0.77, 1.0 - 2.0**-53])
@pytest.mark.parametrize("decades", [(-307.0, 308.0), (-12.0, 0.0), (-0.2, 0.2), (-1e-9, 1e-9)])
def test_they_are_within_two_units_in_the_last_place(b: float, decades: tuple[float, float]) -> None:
    """Against 64 digits of mantissa where the platform has them; else numpy's own error is allowed for."""
    base = 10.0 ** np.random.default_rng(1).uniform(*decades, 80_000)
    exact = np.power(base.astype(np.longdouble), np.longdouble(b))
    allowed = 2.0 if np.finfo(np.longdouble).nmant > 52 else 3.0
    error = np.abs(powers(base, b).astype(np.longdouble) - exact) / np.spacing(exact.astype(np.float64))
    assert float(error.max()) <= allowed


def test_they_are_exact_where_they_must_be() -> None:
    base = np.array([0.0, -0.0, -1e-20, SMALLEST, 1.0, 4.0, 2.0**-40, 2.0**500])
    found = powers(base, 0.5)
    assert found.tolist() == [0.0, 0.0, 0.0, 2.0**-511, 1.0, 2.0, 2.0**-20, 2.0**250]
    base = np.random.default_rng(2).random(800)
    assert np.array_equal(powers(base, 1.0), base)
    assert np.isnan(powers(np.full(WIDTH, np.nan), 0.3)).all()
