"""Sheets and chains for tests of XPBD, and how they are run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from contact_world import G
from nets import find_hinges as hinge_corners
from nets import grid_springs, make_fabric, make_hinges, start, triangulate

from nuno_integrators.xpbd import XPBD
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Springs

DOWN = np.array([0.0, -G, 0.0])
STILL = Poses(0.0, np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)))
POSES = STILL, replace(STILL, t=1.0)


def advance(system, steps, dt, poses=None, plugin=None, **config):
    """The state after `steps` steps from the fabric's start."""
    plugin, state = plugin or XPBD(), start(system)
    memory = plugin.prepare(plugin.Config(**config), system, state)
    report = plugin.advance(system, state, memory, poses, steps, dt)
    assert report.status == "ok"
    assert plugin.adaptive or report.steps == steps, "no step was halved"
    return state


def sheet(n, k=50.0, c=0.02, bend=1e-4, shuffle=0.0, mass=1e-3):
    """n x n vertices in the plane z = 0 with all kinds of springs and hinges, two corners pinned.

    The last of them, a share of `shuffle`, are numbered at random.
    """
    x, springs = grid_springs(n, n, 0.02, k, c)
    quads = hinge_corners(triangulate(n, n))
    pinned = np.zeros(n * n, bool)
    pinned[[0, n - 1]] = True
    if shuffle:
        still = round((1.0 - shuffle) * n * n)
        new = np.append(np.arange(still), still + np.random.default_rng(3).permutation(n * n - still))
        pairs = new[springs.pairs()].astype(np.int32)
        springs = Springs.from_pairs(pairs, *(springs.per_spring(a) for a in (springs.k, springs.rest, springs.c)))
        x, pinned, quads = x[np.argsort(new)], pinned[np.argsort(new)], new[quads].astype(np.int32)
    hinges = make_hinges(quads, np.full(len(quads), bend), np.full(len(quads), 0.3)) if bend else None
    return make_fabric(x, springs, hinges, mass, pinned)


def chain(n, k, mass, rest=0.1):
    x = np.zeros((n + 1, 3))
    x[:, 1] = -rest * np.arange(n + 1)
    first = np.arange(n, dtype=np.int32)
    one = np.ones(n)
    springs = Springs.from_pairs(np.stack([first, first + 1], 1), k * one, rest * one, 0.0 * one)
    return make_fabric(x, springs, None, mass, np.arange(n + 1) == 0)
