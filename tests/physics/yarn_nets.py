"""Yarns that the tests of them share."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from nets import make_fabric, make_system

from nuno_schemas.fabric import Fabric, Float, Springs, Yarns
from nuno_schemas.system import System


def chains(points: int, yarns: int, seed: int, length: int = 12, c: float = 0.0, uniform: bool = False) -> Fabric:
    """Random walks over vertices in a box of 1 m: every walk is a yarn, every second one a ring."""
    rng = np.random.default_rng(seed)
    used: set[tuple[int, int]] = set()
    pairs: list[tuple[int, int]] = []
    links, ptr = [], [0]
    for y in range(yarns):
        walk = rng.permutation(points)[: length + 1].tolist()
        steps = list(zip(walk, walk[1:] + walk[:1], strict=True))[: length + y % 2]
        own: list[int] = []
        for i, j in steps:
            if (min(i, j), max(i, j)) in used:
                break
            used.add((min(i, j), max(i, j)))
            own.append(len(pairs))
            pairs.append((i, j) if rng.random() < 0.5 else (j, i))
        links += own + (own[:1] if len(own) == length + 1 else [])
        ptr.append(len(links))
    position = rng.uniform(0.0, 1.0, (points, 3))
    both = np.array(pairs, np.int32)
    rest = np.linalg.norm(position[both[:, 1]] - position[both[:, 0]], axis=1) * rng.uniform(0.6, 1.2, len(both))
    k = np.full(len(both), 7.0) if uniform else rng.uniform(1.0, 100.0, len(both))
    springs = Springs.from_pairs(both, k, rest, c * rng.uniform(0.5, 1.0, len(both)))
    mu = rng.uniform(0.05, 0.45, yarns)
    kind = np.zeros(yarns, np.int8)
    found = Yarns(np.array(links, np.int32), np.array(ptr, np.int32), mu, kind)
    return replace(make_fabric(position, springs, mass=1.0), yarns=found)


def locking(fabric: Fabric, seed: int = 0) -> Fabric:
    """With locks from 5 to 30 % on, three times as stiff at most."""
    assert fabric.springs is not None
    rng, n = np.random.default_rng(seed), fabric.springs.number
    k = fabric.springs.per_spring(fabric.springs.k)
    springs = replace(fabric.springs, lock=rng.uniform(0.05, 0.3, n), k_lock=k * rng.uniform(1.0, 3.0, n))
    return replace(fabric, springs=springs)


def reference(fabric: Fabric, x: Float, v: Float) -> Float:
    """(n, 3) forces by the definition: every link by its own tension and its neighbours'."""
    assert fabric.springs is not None and fabric.yarns is not None
    s, yarns, pairs = fabric.springs, fabric.yarns, fabric.springs.pairs()
    d = x[pairs[:, 1]] - x[pairs[:, 0]]
    length = np.linalg.norm(d, axis=1)
    unit = d / length[:, None]
    tension = s.k * (length - s.rest)
    if s.lock is not None and s.k_lock is not None:
        tension = np.where(length > (1.0 + s.lock) * s.rest, s.rest * s.lock * s.k, tension)
        tension += s.k_lock * np.maximum(length - (1.0 + s.lock) * s.rest, 0.0)
    tension = tension + s.c * ((v[pairs[:, 1]] - v[pairs[:, 0]]) * unit).sum(axis=1)
    whole = tension.copy()
    for y in range(yarns.number):
        links = yarns.links[yarns.ptr[y] : yarns.ptr[y + 1]].tolist()
        for here, after in pairwise(links):
            whole[here] += yarns.mu[y] * tension[after]
            whole[after] += yarns.mu[y] * tension[here]
    force = np.zeros_like(x)
    np.add.at(force, pairs[:, 0], whole[:, None] * unit)
    np.add.at(force, pairs[:, 1], -whole[:, None] * unit)
    return force


STRETCH = 0.25
"""Of the line below, between its held ends."""


def line(k: float = 40.0, mu: float = 0.2, c: float = 0.0, parts: int = 4) -> System:
    """A yarn of unequal links along x, held at both ends, with two links before it that share a vertex with it."""
    rest = np.array([0.5, 1.0, 0.8, 1.2])[:parts]
    x = np.zeros((parts + 1, 3))
    x[1:, 0] = (1.0 + STRETCH) * rest.sum() * np.arange(1, parts + 1) / parts
    index = np.arange(parts, dtype=np.int32)
    springs = Springs.from_pairs(np.stack([index, index + 1], 1), np.full(parts, k), rest, np.full(parts, c))
    yarns = Yarns(index, np.array([0, parts], np.int32), np.array([mu]), np.zeros(1, np.int8))
    pinned = np.zeros(parts + 1, bool)
    pinned[[0, -1]] = True
    return make_system(replace(make_fabric(x, springs, mass=0.5, pinned=pinned), yarns=yarns), damping=6.0)


def balance(system: System, mu: float = 0.2) -> Float:
    """Places along x where (1 + mu A) e is the same on all links and sum(e) is what the ends give."""
    assert system.fabric.springs is not None
    rest = system.fabric.springs.rest
    n = len(rest)
    e = np.linalg.solve(np.eye(n) + mu * (np.eye(n, k=1) + np.eye(n, k=-1)), np.ones(n))
    return np.concatenate([[0.0], np.cumsum(rest + e * STRETCH * rest.sum() / e.sum())])
