"""A finer mesh of the same fabric hangs the same."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg

from nuno_cloth.energy import spring_energy
from nuno_cloth.presets import PRESETS
from nuno_cloth.sheet import Sheet, SheetConfig
from nuno_cloth.skirt import Skirt, SkirtConfig
from nuno_schemas.fabric import Fabric, Float

GRAVITY = 9.81


def spring_hessian(fabric: Fabric, x: Float) -> scipy.sparse.csc_matrix:
    """(2 n, 2 n) second derivatives in x and y, compressed springs' indefinite part left out."""
    assert fabric.springs is not None
    pairs = fabric.springs.pairs()
    k, rest = fabric.springs.per_spring(fabric.springs.k), fabric.springs.per_spring(fabric.springs.rest)
    d = (x[pairs[:, 1]] - x[pairs[:, 0]])[:, :2]
    length = np.linalg.norm(d, axis=1)
    along = d[:, :, None] * d[:, None, :] / (length**2)[:, None, None]
    side = np.maximum(1 - rest / length, 0)[:, None, None]
    block = k[:, None, None] * (side * (np.eye(2) - along) + along)
    rows, cols, values = [], [], []
    for i, j, sign in ((0, 0, 1), (1, 1, 1), (0, 1, -1), (1, 0, -1)):
        for p in range(2):
            for q in range(2):
                rows.append(2 * pairs[:, i] + p)
                cols.append(2 * pairs[:, j] + q)
                values.append(sign * block[:, p, q])
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))
    return scipy.sparse.coo_matrix(entries, shape=(2 * len(x), 2 * len(x))).tocsc()


def hanging_drop(preset: str, n: int, size: float = 1.0) -> float:
    """How far the centre of mass of a square sheet of n x n vertices sinks [m], top row pinned.

    It hangs in its plane, so that only springs are strained: Newton's method on their energy and
    that of gravity, to a residual of 1e-7 of the weight.
    """
    config = SheetConfig(size=(size, size), resolution=(n, n), pin=("top-row",), fabric=preset)
    fabric = Sheet().build(config, None, 0)  # type: ignore[arg-type]
    free = np.flatnonzero(np.repeat(~fabric.pinned, 2))
    x = fabric.position.copy()
    weight = np.zeros((fabric.number, 2))
    weight[:, 1] = fabric.mass * GRAVITY
    for _ in range(40):
        residual = (spring_energy(fabric, x)[1][:, :2] + weight).reshape(-1)[free]
        if np.abs(residual).sum() < 1e-7 * weight.sum():
            drop = fabric.mass @ (fabric.position[:, 1] - x[:, 1]) / fabric.mass.sum()
            return float(drop)
        step = np.zeros(2 * fabric.number)
        step[free] = scipy.sparse.linalg.spsolve(spring_hessian(fabric, x)[free][:, free], -residual)
        x[:, :2] += step.reshape(-1, 2)
    raise AssertionError(f"{preset} at {n} x {n} did not come to rest")


def compare_resolutions(numbers: tuple[int, ...] = (24, 32, 96, 128)) -> dict[str, list[float]]:
    """The drop of every preset at every resolution [m]."""
    return {preset: [hanging_drop(preset, n) for n in numbers] for preset in PRESETS}


@pytest.mark.parametrize("preset", PRESETS)
def test_a_finer_sheet_hangs_the_same(preset: str) -> None:
    coarse, fine = hanging_drop(preset, 24), hanging_drop(preset, 48)
    assert fine == pytest.approx(coarse, rel=0.01)


def test_the_drop_is_that_of_a_hanging_sheet() -> None:
    """Between rho g L^2 / (3 C) with the width held and with free sides."""
    material = PRESETS["swimwear"]
    free = material.warp - material.shear**2 / material.weft
    load = material.density * GRAVITY / 3
    assert load / material.warp < hanging_drop("swimwear", 32) < load / free * 1.02


@pytest.mark.parametrize("fullness", [1.0, 1.4])
def test_a_finer_skirt_is_the_same_cloth(fullness: float) -> None:
    """Mass, area and the stiffness of whole rows do not depend on the mesh."""

    def sums(rows: int, columns: int) -> list[float]:
        fabric = Skirt().build(SkirtConfig(rows=rows, columns=columns, fullness=fullness, pleats=8), None, 0)  # type: ignore[arg-type]
        assert fabric.springs is not None and fabric.hinges is not None
        pairs = fabric.springs.pairs()
        across = fabric.springs.per_spring(fabric.springs.rest)[pairs[:, 0] // columns == pairs[:, 1] // columns]
        hem = across.reshape(rows, columns)[-1].sum()
        k, rest = fabric.springs.per_spring(fabric.springs.k), fabric.springs.per_spring(fabric.springs.rest)
        return [float(fabric.mass.sum()), float(hem), float((k * rest**2).sum())]

    assert sums(49, 192) == pytest.approx(sums(25, 96), rel=5e-3)
