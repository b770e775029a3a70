"""A finer mesh of the same fabric hangs the same."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg

from nuno_cloth.fabrics.kes import spring_energy
from nuno_cloth.fabrics.presets import PRESETS
from nuno_cloth.models.sheet import Sheet, SheetConfig
from nuno_cloth.models.skirt import Skirt, SkirtConfig
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System

GRAVITY = 9.81
NUMBERS = (24, 32, 128)
"""Vertices along each side of the sheets that are compared."""


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


def hanging_sheet(preset: str, n: int) -> Fabric:
    """1 m x 1 m of n x n vertices, top row pinned."""
    config = SheetConfig(size=(1.0, 1.0), resolution=(n, n), pin=("top-row",), fabric=preset)
    return Sheet().build(config, None, 0)  # type: ignore[arg-type]


def sunk(fabric: Fabric, x: Float) -> float:
    """How far the centre of mass lies below its start [m]."""
    return float(fabric.mass @ (fabric.position[:, 1] - x[:, 1]) / fabric.mass.sum())


@functools.cache
def hanging_drop(preset: str, n: int) -> float:
    """How far the centre of mass of a hanging sheet sinks [m].

    It hangs in its plane, so that only springs are strained: Newton's method on their energy and
    that of gravity, to a residual of 1e-7 of the weight.
    """
    fabric = hanging_sheet(preset, n)
    free = np.flatnonzero(np.repeat(~fabric.pinned, 2))
    x = fabric.position.copy()
    weight = np.zeros((fabric.number, 2))
    weight[:, 1] = fabric.mass * GRAVITY
    for _ in range(40):
        residual = (spring_energy(fabric, x)[1][:, :2] + weight).reshape(-1)[free]
        if np.abs(residual).sum() < 1e-7 * weight.sum():
            return sunk(fabric, x)
        step = np.zeros(2 * fabric.number)
        hessian = spring_hessian(fabric, x)[free][:, free]
        step[free] = scipy.sparse.linalg.spsolve(hessian, -residual, permc_spec="MMD_AT_PLUS_A")
        x[:, :2] += step.reshape(-1, 2)
    raise AssertionError(f"{preset} at {n} x {n} did not come to rest")


@pytest.mark.quick(preset=["denim"])
@pytest.mark.parametrize("preset", PRESETS)
def test_a_finer_sheet_hangs_the_same(preset: str) -> None:
    """The bar is 5 % from 24 x 24 to 128 x 128; what is left is 0.2 %, the sheet's border."""
    drops = np.array([hanging_drop(preset, n) for n in NUMBERS])
    assert np.ptp(drops) < 0.003 * drops.min()


@pytest.mark.quick(n=[24])
@pytest.mark.parametrize("n", [24, 96])
def test_a_simulation_settles_where_statics_say(n: int) -> None:
    """Started unstretched and damped near critically, the sheet comes to rest at the static drop.

    Lengthwise its slowest motion is a quarter wave of speed sqrt(C / rho): omega = (pi / 2 L) sqrt(C / rho).
    """
    fabric, material = hanging_sheet("interlock", n), PRESETS["interlock"]
    slowest = 0.5 * np.pi * np.sqrt(material.warp / material.density)
    system = System(fabric, np.array([0.0, -GRAVITY, 0.0]), 2 * slowest)
    solver, state = SymplecticEuler(), State(fabric.position.copy(), np.zeros_like(fabric.position))
    dt = 0.7 * solver.limit(solver.Config(), system, state).dt
    memory = solver.prepare(solver.Config(), system, state)
    report = solver.advance(system, state, memory, None, int(20 / slowest / dt), dt)
    assert report.status == "ok"
    assert sunk(fabric, state.x) == pytest.approx(hanging_drop("interlock", n), rel=1e-4)


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
