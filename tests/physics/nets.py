"""Nets and systems that the tests of springs, hinges and integrators share."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_integrators.packing import pack, to_rows
from nuno_kernels.step.acceleration import evaluate
from nuno_kernels.step.blocks import BLOCK, PADDING, block_count
from nuno_kernels.terms import kernels_of
from nuno_schemas.fabric import Bool, Fabric, Float, Hinges, Int, Springs, State
from nuno_schemas.system import Carried, System, Term

NO_GRAVITY = np.zeros(3)


def make_fabric(
    position: Float,
    springs: Springs | None = None,
    hinges: Hinges | None = None,
    mass: Float | float = 1e-3,
    pinned: Bool | None = None,
    velocity: Float | None = None,
    faces: Int | None = None,
) -> Fabric:
    n = position.shape[0]
    return Fabric(
        "net",
        np.ascontiguousarray(position, np.float64),
        np.zeros((n, 3)) if velocity is None else velocity,
        np.full(n, 1.0) * mass,
        np.zeros(n, bool) if pinned is None else pinned,
        np.zeros((0, 3), np.int32) if faces is None else faces,
        springs,
        hinges,
    )


def make_system(
    fabric: Fabric,
    gravity: Float = NO_GRAVITY,
    damping: float = 0.0,
    terms: tuple[Term, ...] = (),
    threads: int = 1,
    carried: tuple[Carried, ...] = (),
) -> System:
    return System(fabric, np.asarray(gravity, float), damping, terms, threads, carried)


def start(system: System) -> State:
    return State(system.fabric.position.copy(), system.fabric.velocity.copy())


def wind_force(wind: Any, x: Float, v: Float, *t: float) -> Float:
    """(n, 3) force [N] of prepared wind at x, v (n, 3), of gusts at the time t [s], block by block."""
    rows, moving, out = to_rows(x), to_rows(v), np.zeros((3, x.shape[0]))
    for block in range(block_count(x.shape[0])):
        own = slice(block * BLOCK, min((block + 1) * BLOCK, x.shape[0]))
        force = np.zeros((3, own.stop - own.start + PADDING))
        for part in wind:
            add = kernels_of(part).find("block")
            add(part, block, own.start, rows, moving, force, *t)
        out[:, own] = force[:, :-PADDING]
    return np.ascontiguousarray(out.T)


def accelerations(system: System, x: Float, v: Float) -> Float:
    """(n, 3) accelerations at x, v (n, 3)."""
    rows, out = to_rows(x), np.zeros((3, x.shape[0]))
    evaluate(rows, to_rows(v), 0.0, out, pack(system))
    return np.ascontiguousarray(out.T)


def run(plugin: Any, system: System, state: State, steps: int, dt: float, frames: int = 1) -> Any:
    """Advance `state` by whole frames and return the last report."""
    memory = plugin.prepare(plugin.Config(), system, state)
    report = None
    for _ in range(frames):
        report = plugin.advance(system, state, memory, None, steps, dt)
    return report


def grid_springs(rows: int, columns: int, spacing: float, k: float = 100.0, c: float = 0.0) -> tuple[Float, Springs]:
    """Positions and runs of a flat quad grid: structural, shear and bending springs, 12 a vertex."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    position = np.stack([column * spacing, row * spacing, np.zeros(rows * columns)], axis=1)
    first, count, rest, kind = [], [], [], []
    for dr, dc, which in ((0, 1, 0), (1, 0, 0), (1, 1, 1), (1, -1, 1), (0, 2, 2), (2, 0, 2)):
        low, high = max(0, -dc), min(columns, columns - dc)
        for r in range(rows - dr):
            if high > low:
                first.append((r * columns + low, (r + dr) * columns + low + dc))
                count.append(high - low)
                rest.append(spacing * np.hypot(dr, dc))
                kind.append(which)
    m = len(count)
    springs = Springs(
        np.array(first, np.int32), np.array(count, np.int32), np.ones(m, np.int32),
        np.full(m, k), np.array(rest), np.full(m, c), np.array(kind, np.int8),
    )  # fmt: skip
    return position, springs


def random_net(n: int, springs: int, seed: int, c: float = 0.0) -> tuple[Float, Springs]:
    """Vertices in a box of 1 m, distinct random springs of random stiffness near their rest length."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.0, 1.0, (n, 3))
    every = np.array([(i, j) for i in range(n) for j in range(i + 1, n)], np.int32)
    pairs = every[rng.permutation(every.shape[0])[:springs]]
    length = np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1)
    s = pairs.shape[0]
    rest = length * rng.uniform(0.8, 1.1, s)
    return position, Springs.from_pairs(pairs, rng.uniform(1.0, 100.0, s), rest, c * rng.uniform(0.5, 1.0, s))


def reference_forces(x: Float, v: Float, springs: Springs) -> Float:
    """(n, 3) spring forces by the formula of the definition, one spring after another."""
    force = np.zeros_like(x)
    k, rest, c = (springs.per_spring(a) for a in (springs.k, springs.rest, springs.c))
    for s, (i, j) in enumerate(springs.pairs()):
        d = x[j] - x[i]
        length = np.linalg.norm(d)
        if length > 0.0:
            pull = (k[s] * (length - rest[s]) + c[s] * (v[j] - v[i]) @ d / length) * d / length
            force[i] += pull
            force[j] -= pull
    return force


def triangulate(rows: int, columns: int) -> Int:
    """(f, 3) triangles of a grid whose diagonals alternate, counter-clockwise from +z."""
    faces = []
    for r in range(rows - 1):
        for c in range(columns - 1):
            p = r * columns + c
            q = p + columns
            if (r + c) % 2:
                faces += [(p, p + 1, q), (p + 1, q + 1, q)]
            else:
                faces += [(p, p + 1, q + 1), (p, q + 1, q)]
    return np.array(faces, np.int32)


def find_hinges(faces: Int) -> Int:
    """(h, 4) hinges: edge start and end, opposite vertex left and right."""
    opposite = {}
    for a, b, c in faces.tolist():
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            opposite[i, j] = k
    shared = [(i, j, k, opposite[j, i]) for (i, j), k in opposite.items() if i < j and (j, i) in opposite]
    return np.array(shared, np.int32)


def make_hinges(quads: Int, k: Float, rest: Float) -> Hinges:
    one = np.ones(quads.shape[0], np.int32)
    return Hinges(np.ascontiguousarray(quads, np.int32), one, one, np.asarray(k, float), np.asarray(rest, float))
