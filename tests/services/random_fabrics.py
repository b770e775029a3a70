"""Small scenes at random, of wide ratios of stiffness, undamped: measured fabrics on grids and on triangles, springs
with hinges, and nets.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

Random = np.random.Generator


def pick(rng: Random, low: float, high: float) -> float:
    """A number between two others, whose logarithm is uniform; of three digits."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


def make_net(rng: Random, path: Path) -> None:
    """4 to 13 masses in a chain with some springs across it, pinned at the first."""
    n = int(rng.integers(4, 14))
    x = rng.uniform(-0.2, 0.2, (n, 3))
    across = np.array([(i, j) for i in range(n) for j in range(i)], np.int32)
    chain = np.array([(i + 1, i) for i in range(n - 1)], np.int32)
    across = across[rng.permutation(len(across))[: int(rng.integers(0, 2 * n))]]
    pairs = np.unique(np.concatenate([chain, across]), axis=0)
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1) * rng.uniform(0.8, 1.1, len(pairs))
    k = np.exp(rng.uniform(0.0, np.log(10.0 ** rng.uniform(0, 4)), len(pairs)))
    m = 1e-3 * np.exp(rng.uniform(0.0, np.log(10 ** rng.uniform(0, 2)), n))
    pinned = np.arange(n) == 0
    v = 0.1 * rng.standard_normal((n, 3)) * ~pinned[:, None]
    np.savez(path, x=x, v=v, m=m, pinned=pinned, springs=pairs, k=k, rest=rest, c=np.zeros(len(pairs)))


def measured_fabric(rng: Random) -> dict[str, float]:
    """Tension of 1 to 2,000 N/m, and bending from 0.1 uN m to 1 mN m."""
    warp = pick(rng, 1, 2000)
    weft = warp * pick(rng, 0.2, 1)
    bending = {"bend_warp": pick(rng, 1e-7, 1e-3), "bend_weft": pick(rng, 1e-7, 1e-3), "damping_ratio": 0.0}
    return {"density": pick(rng, 0.05, 0.5), "warp": warp, "weft": weft, "shear": weft * pick(rng, 0.01, 0.3)} | bending


def make_mesh(rng: Random, path: Path) -> dict[str, Any]:
    """A grid of 3 to 8 vertices each way, moved by up to a fifth of a cell, whose quads are cut either way."""
    columns, rows = (int(value) for value in rng.integers(3, 9, 2))
    x = np.stack(np.meshgrid(np.arange(columns), -np.arange(rows)), axis=2).reshape(-1, 2).astype(float)
    x = pick(rng, 0.01, 0.06) * (x + rng.uniform(-0.2, 0.2, x.shape))
    lines = [f"v {a:.17g} {b:.17g} 0" for a, b in x.tolist()]
    for row in range(rows - 1):
        for column in range(columns - 1):
            a = row * columns + column + 1
            b, c, d = a + 1, a + columns, a + columns + 1
            halves = ((a, c, b), (b, c, d)) if rng.integers(2) else ((a, c, d), (a, d, b))
            lines += [f"f {i} {j} {k}" for i, j, k in halves]
    path.write_text("\n".join(lines) + "\n")
    pin = ([*range(columns)], [0, columns - 1], [0])[int(rng.integers(3))]
    return {"plugin": "mesh", "file": path.name, "warp": [0, 1, 0], "pin": pin, "fabric": measured_fabric(rng)}


def make_sheet(rng: Random, measured: bool) -> dict[str, Any]:
    """3 to 8 vertices each way, of cells nearly square, pinned at its upper edge or corners."""
    columns, rows = (int(value) for value in rng.integers(3, 9, 2))
    cell = pick(rng, 0.01, 0.06)
    size = [cell * (columns - 1), cell * (rows - 1) * float(rng.uniform(0.8, 1.25))]
    fabric: dict[str, Any]
    if measured:
        fabric = measured_fabric(rng)
    else:
        w = pick(rng, 1, 2000)
        fabric = {"density": pick(rng, 0.05, 0.5), "structural": [w, w * pick(rng, 0.03, 1)]}
        fabric |= {"shear": w * pick(rng, 0.01, 1)}
        fabric |= {"bending": w * pick(rng, 1e-3, 0.3), "hinge": pick(rng, 1e-7, 1e-2)}
    pin = ([*range(columns)], [0, columns - 1], [0])[int(rng.integers(3))]
    plane, cells = ("xy", "xz")[int(rng.integers(2))], ("quads", "triangles")[int(rng.integers(2))]
    placed = {"size": size, "resolution": [columns, rows], "plane": plane, "cells": cells, "pin": pin}
    return {"plugin": "sheet", "fabric": fabric} | placed


def write_random(seed: int, folder: Path, solver: str) -> Path:
    """The scene of a seed."""
    rng, kind = np.random.default_rng(seed), ("measured", "springs", "net", "mesh")[seed % 4]
    if kind == "net":
        make_net(rng, folder / "net.npz")
    model = {
        "net": lambda: {"plugin": "net", "file": "net.npz"}, "mesh": lambda: make_mesh(rng, folder / "mesh.obj"),
        "measured": lambda: make_sheet(rng, True), "springs": lambda: make_sheet(rng, False),
    }[kind]()  # fmt: skip
    data = {"nuno": 1, "name": f"random-{seed}", "duration": "20 s", "frame_rate": 20, "solver": {"plugin": solver}}
    path = folder / "scene.yaml"
    path.write_text(json.dumps(data | {"objects": [{"name": "cloth", "model": model}]}))
    return path
