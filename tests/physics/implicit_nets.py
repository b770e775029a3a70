"""Sheets and dense matrices that tests of implicit methods share."""

from __future__ import annotations

import numpy as np
import pytest
from contact_world import G
from nets import make_fabric

from nuno_integrators.implicit.conjugate import multiply
from nuno_integrators.implicit.plugin import TRBDF2, ImplicitEuler
from nuno_schemas.fabric import Hinges, Springs

PLUGINS = pytest.mark.parametrize("plugin", [ImplicitEuler(), TRBDF2()], ids=lambda p: p.name)
DOWN = np.array([0.0, -G, 0.0])


def sheet(n, k=1000.0, ratio=0.02, bend=0.0, mass=2e-4, shuffle=False):
    """n x n vertices in the plane y = 0, top row's corners pinned; springs by pairs, hinges along the rows."""
    r, c = np.mgrid[0:n, 0:n]
    x = np.stack([c.ravel() / (n - 1), np.zeros(n * n), r.ravel() / (n - 1)], 1)
    at = r * n + c
    steps = [(0, 1), (1, 0), (1, 1), (1, -1)]
    pairs = np.concatenate(
        [
            np.stack(
                [at[: n - dr, max(0, -dc) : n - max(0, dc)].ravel(), at[dr:, max(0, dc) : n + min(0, dc)].ravel()], 1
            )
            for dr, dc in steps
        ]
    )
    quads = np.stack([at[1:-1, :-1], at[1:-1, 1:], at[:-2, :-1], at[2:, :-1]], -1).reshape(-1, 4).astype(np.int32)
    one = np.ones(len(quads), np.int32)
    hinges = Hinges(quads, one, one, np.full(len(quads), bend), np.full(len(quads), 0.2)) if bend else None
    if shuffle:
        new = np.random.default_rng(3).permutation(n * n)
        x, pairs = x[np.argsort(new)], new[pairs]
    pairs = pairs.astype(np.int32)
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    stiffness = np.full(len(pairs), k)
    springs = Springs.from_pairs(pairs, stiffness, rest, ratio * np.sqrt(2.0 * stiffness * mass))
    pinned = np.zeros(n * n, bool)
    pinned[[0, n - 1]] = True
    return make_fabric(x, springs, hinges, mass, pinned)


def dense(linear, n, threads=None):
    """The matrix A, column by column."""
    columns = []
    for i in range(3 * n):
        unit = np.zeros(3 * n)
        unit[i] = 1.0
        columns.append(multiply(linear, unit.reshape(3, n), threads).ravel())
    return np.array(columns).T
