"""Make the nets and the meshes of these scenes: python scenes/extreme/make_extreme.py

What each scene must do is its description, and tests/scenes/test_extreme.py holds every solver to it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).parent
Arrays = dict[str, NDArray[Any]]


def net(
    x: Any, mass: Any = 1.0, pinned: Any = (), springs: Any = (), k: Any = 1.0, rest: Any = None, v: Any = None
) -> Arrays:
    """The arrays of a net: x (n, 3) [m], one mass [kg] or (n,), indices of pinned vertices, pairs of springs."""
    x = np.array(x, float).reshape(-1, 3)
    pairs = np.array(springs, np.int32).reshape(-1, 2)
    length = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    return {
        "x": x,
        "v": np.zeros_like(x) if v is None else np.array(v, float),
        "m": np.full(len(x), 1.0) * mass,
        "pinned": np.isin(np.arange(len(x)), pinned),
        "springs": pairs,
        "k": np.full(len(pairs), 1.0) * k,
        "rest": length if rest is None else np.full(len(pairs), 1.0) * rest,
        "c": np.zeros(len(pairs)),
    }


def chain(n: int) -> NDArray[Any]:
    """(n - 1, 2) pairs of neighbours."""
    return np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)


def mass_ratio() -> Arrays:
    """1 kg below eight links of 10 kN/m, joined by masses of 1 mg: K = k / 8 = 1250 N/m."""
    x = np.zeros((9, 3))
    x[:, 1] = -0.125 * np.arange(9)
    mass = np.full(9, 1e-6)
    mass[-1] = 1.0
    return net(x, mass, [0], chain(9), 1e4)


def stiffness() -> Arrays:
    """Five rods of 0.2 m of 1e8 N/m, joined by 50 g, held at one end, level."""
    x = np.zeros((6, 3))
    x[:, 0] = 0.2 * np.arange(6)
    return net(x, 0.05, [0], chain(6), 1e8)


def zero_length() -> Arrays:
    """Three vertices at one place, joined by springs that want to be 0.1 m long and 0 m long; a fourth beside."""
    x = [[0, 0, 0], [0, 0, 0], [0, 0, 0], [1, 0, 0]]
    return net(x, 0.1, [], [[0, 1], [1, 2]], 50.0, [0.1, 0.0])


def coincident() -> Arrays:
    """Vertices along a line, every pair joined: ten springs lie upon each other. The middle one is pulled aside."""
    x = np.zeros((5, 3))
    x[:, 0] = 0.25 * np.arange(5)
    pairs = [[i, j] for i in range(5) for j in range(i + 1, 5)]
    made = net(x, 0.1, [0, 4], pairs, 50.0)
    made["x"][2, 1] = 0.05
    return made


def grid() -> Arrays:
    """8 x 8 vertices an eighth of a metre apart: lengths and rest lengths are exact numbers."""
    row, column = np.divmod(np.arange(64), 8)
    at = np.arange(64).reshape(8, 8)
    pairs = [[at[:, :-1], at[:, 1:]], [at[:-1], at[1:]], [at[:, :-2], at[:, 2:]], [at[:-2], at[2:]]]
    springs = np.concatenate([np.stack(pair, -1).reshape(-1, 2) for pair in pairs])
    return net(np.stack([0.125 * column, 0.125 * row, 0.0 * row], 1), 0.01, [], springs, 100.0)


def soft_grid() -> Arrays:
    """The grid, held at two corners."""
    return grid() | {"pinned": np.isin(np.arange(64), [0, 7])}


def swarm() -> Arrays:
    """Nine vertices 0.1 m above the floor, without a spring."""
    row, column = np.divmod(np.arange(9), 3)
    return net(np.stack([0.2 * column, 0.0 * row + 0.1, 0.2 * row], 1), 0.01)


NETS = {
    "mass-ratio": mass_ratio,
    "stiffness": stiffness,
    "zero-length": zero_length,
    "coincident": coincident,
    "weightless": grid,
    "step-too-long": soft_grid,
    "one-particle": lambda: net([[0.0, 0.0, 0.0]], 1.0, v=[[1.0, 2.0, 0.0]]),
    "no-springs": lambda: net([[0, 0, 0], [1, 0, 0], [0, 0, 1]], [1e-3, 1.0, 1e3]),
    "fast-floor": swarm,
}

DEGENERATE = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0.05 0.05 0\nf 1 2 3\nf 2 4 3\n"
"""The second triangle's corners lie on a line."""
SLIVERS = "".join(
    [f"v {0.05 * i:g} {y:g} 0\n" for i in range(5) for y in (0, 5e-5)]
    + [f"f {2 * i + 1} {2 * i + 3} {2 * i + 2}\nf {2 * i + 2} {2 * i + 3} {2 * i + 4}\n" for i in range(4)]
)
"""A strip 0.2 m long and 50 um wide, of triangles a thousand times as long as they are high."""
MESHES = {"degenerate-triangles": DEGENERATE, "slivers": SLIVERS}

if __name__ == "__main__":
    for name, make in NETS.items():
        np.savez(FOLDER / f"{name}.npz", **make())  # type: ignore[arg-type]
    for name, text in MESHES.items():
        (FOLDER / f"{name}.obj").write_text(text)
