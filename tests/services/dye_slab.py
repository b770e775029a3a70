"""A row of cells along which dye spreads, and what is given to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from dye_scene import CELL, D0, write_scene

from nuno.dye.run import DyeRun
from nuno.scene import scene_file

CLOTH = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": {"I": 0.5, "II": 0.5, "III": 0.1}}
SPREAD = {"I": 0, "II": 1, "III": 1, "IV": 1, "V": 1}
RED = {"name": "red", "D0": D0}
LEFT = {"shape": "rectangle", "low": [0, 0], "high": [CELL, 1]}
"""The first column of cells."""
WHOLE = {"kind": "bath", "maintained": True}
DROP = {"kind": "drop", "place": [3 * CELL, 4 * CELL], "diameter": 4 * CELL}


def slab(folder: Path, cells: int, supply: list[dict[str, Any]], side: float = CELL, **fields: Any) -> DyeRun:
    """A row of cells without dye, D = D0 / 2 along it, and a hundred steps of d^2 / (4 D0) a frame."""
    shape = (2, 1, cells)
    data = {name: np.ones(shape, np.bool_) for name in ("fibre", "up")}
    data |= {"porosity": np.full(shape, 0.5), "tau1": np.ones(shape), "resist": np.zeros(shape)}
    data |= {"phi": np.zeros(shape), "fixed": np.zeros(shape)}
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": side, "tau3": SPREAD, "supply": supply}
    dt = side**2 / (4.0 * D0)
    solver = {"plugin": "explicit", "dt": dt}
    scene = {"cloth": cloth, "solver": solver, "dyes": [RED], "duration": 1e4 * dt, "frame_rate": 0.01 / dt} | fields
    return DyeRun(scene_file.read(write_scene(folder, data=data, **scene)), 1)
