"""Make pendulum.npz, a chain for scenes/net.yaml: python scenes/make_net.py

Nine masses of 50 g in a row 1 m long along +x, the first held, joined by eight undamped springs of
2 kN/m at their rest length. Let go from level it swings as a many-jointed pendulum, and without
damping its energy must stay. Hung straight, the chain stretches by 1 + 2 + ... + 8 weights over k,
8.8 mm: stiff enough to look like a chain, soft enough for steps of 1 ms (the stiffest mode has
omega < 2 sqrt(k / m) = 400 / s, and rk4 allows 2.8 / omega = 7 ms).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PATH = Path(__file__).with_name("pendulum.npz")
NUMBER, LENGTH = 9, 1.0
"""Masses, and the whole length [m]."""
MASS, STIFFNESS = 0.05, 2000.0
"""Of each mass [kg] and of each spring [N/m]."""


def make_net() -> dict[str, NDArray[Any]]:
    """The arrays that a net is made of, under their names in the file."""
    x = np.zeros((NUMBER, 3))
    x[:, 0] = np.linspace(0.0, LENGTH, NUMBER)
    start = np.arange(NUMBER - 1, dtype=np.int32)
    springs = len(start)
    return {
        "x": x,
        "v": np.zeros((NUMBER, 3)),
        "m": np.full(NUMBER, MASS),
        "pinned": np.arange(NUMBER) == 0,
        "springs": np.stack([start, start + 1], axis=1),
        "k": np.full(springs, STIFFNESS),
        "rest": np.full(springs, LENGTH / springs),
        "c": np.zeros(springs),
    }


if __name__ == "__main__":
    np.savez(PATH, **make_net())  # type: ignore[arg-type]
