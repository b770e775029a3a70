"""A scene of one wave of dye whose decay has a closed form."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from dye_scene import D0, write_scene

N, MODE = 12, 2


def write_wave(folder: Path, **fields: Any) -> Path:
    """A cosine over even cells of both layers, which keeps its shape and decays; nothing is fixed, no limit binds."""
    shape = (2, N, N)
    up = np.zeros(shape, bool)
    up[1] = True
    wave = np.cos(math.pi * MODE * (np.arange(N) + 0.5) / N)
    data = {
        "fibre": np.ones(shape, bool),
        "up": up,
        "porosity": np.full(shape, 0.5),
        "tau1": np.ones(shape),
        "resist": np.zeros(shape),
        "phi": np.broadcast_to(0.25 + 0.1 * np.outer(wave, wave), shape).copy(),
        "fixed": np.zeros(shape),
    }
    dyes = [{"name": "blue", "D0": D0}]
    return write_scene(folder, data=data, dyes=dyes, name="wave", duration=80.0, frame_rate=0.1, **fields)
