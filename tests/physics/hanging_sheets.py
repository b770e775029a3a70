"""A sheet that hangs by its top row under its weight, by Newton's method: how far it sinks."""

from __future__ import annotations

import functools

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from nuno_cloth.fabrics.kes import spring_energy
from nuno_cloth.models.sheet import Sheet, SheetConfig
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
