"""A small cloth to dye, and its scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nuno_schemas.fabric import Float

CELL, TAU2, TAU3 = 5e-5, 0.47, {"I": 0.5, "II": 0.05, "III": 0.1, "IV": 1, "V": 0.9}
D0 = 1.93e-6 / 3600.0
"""[m^2/s], 1.93 mm^2/h."""


def arrays(ny: int = 9, nx: int = 11) -> dict[str, Any]:
    """Fibre and gaps at random; full, half full and empty cells, some resisted."""
    rng, shape = np.random.default_rng(3), (2, ny, nx)
    porosity = rng.uniform(0.2, 0.8, shape)
    resist = rng.random(shape) * (rng.random(shape) > 0.5)
    return {
        "fibre": rng.random(shape) > 0.3,
        "up": rng.random(shape) > 0.5,
        "porosity": porosity,
        "tau1": rng.uniform(0.5, 1.0, shape),
        "resist": resist,
        "phi": porosity * (1.0 - resist) * rng.choice([0.0, 0.0, 0.5, 1.0], shape),
        "fixed": np.zeros(shape),
    }


def write_scene(folder: Path, *, data: dict[str, Any] | None = None, **fields: Any) -> Path:
    """The exact scene; fields of `dye` are replaced by name, all others are the scene's."""
    np.savez(folder / "cells.npz", allow_pickle=False, **(arrays() if data is None else data))
    blue = {"name": "blue", "D0": "1.93 mm^2/h", "adsorption": 0.5, "isotherm": {"plugin": "langmuir", "K": 2.0}}
    dye = {
        "cloth": {"plugin": "cells", "file": "cells.npz", "cell_size": "0.05 mm", "tau2": TAU2, "tau3": TAU3},
        "solver": {"plugin": "explicit", "dt": "1.8 s"},
        "dyes": [blue],
    }
    inside = {name: fields.pop(name) for name in list(fields) if name in (*dye, "picture", "speed", "object")}
    scene = {"nuno": 1, "name": "exact", "duration": "18 s", "frame_rate": 1 / 1.8, "dye": dye | inside, **fields}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    return path


Place = tuple[int, int, int]


def _face(data: dict[str, Any], here: Place, there: Place) -> float:
    """P T between two cells, from the text of the method."""
    p, q = data["porosity"][here], data["porosity"][there]
    harmonic = 0.0 if p == 0.0 or q == 0.0 else 2.0 / (1.0 / p + 1.0 / q)
    straight = 0.5 * (data["tau1"][here] + data["tau1"][there])
    if here[0] != there[0]:
        return float(harmonic * straight * TAU3["I"])
    fibres = int(data["fibre"][here]) + int(data["fibre"][there])
    if fibres == 2:
        along = (here[2] != there[2]) if here[0] == 0 else (here[1] != there[1])
        bent = TAU2 if data["up"][here] != data["up"][there] else 1.0
        return float(harmonic * straight * TAU3["V" if along else "II"] * bent)
    return float(harmonic * straight * TAU3["IV" if fibres == 0 else "III"])


def _neighbours(shape: tuple[int, ...], here: Place) -> list[Place]:
    layer, j, i = here
    near = [(layer, j, i + 1), (layer, j, i - 1), (layer, j + 1, i), (layer, j - 1, i), (1 - layer, j, i)]
    return [there for there in near if 0 <= there[1] < shape[1] and 0 <= there[2] < shape[2]]


def step_plainly(data: dict[str, Any], phi: Float, fixed: Float, dt: float, adsorption: float, K: float) -> None:
    """One step in place, cell by cell and face by face: Langmuir's adsorption, then diffusion within capacity."""
    scale, P = D0 * dt / CELL**2, data["porosity"]
    for c in np.ndindex(*phi.shape):
        room = 1.0 - P[c] if data["fibre"][c] else 0.0
        most = min(room, room * K * phi[c] / (1.0 + K * phi[c])) - fixed[c]
        taken = max(0.0, min(adsorption * scale * (phi[c] - fixed[c]), most, phi[c]))
        phi[c], fixed[c] = phi[c] - taken, fixed[c] + taken
    before, came, went = phi.copy(), np.zeros(phi.shape), np.zeros(phi.shape)
    flows = {}
    for here in np.ndindex(*phi.shape):
        for there in _neighbours(phi.shape, here):
            flow = scale * _face(data, here, there) * (before[there] - before[here])
            if flow > 0.0:
                flows[there, here] = flow
                came[here] += flow
                went[there] += flow
    room = P * (1.0 - data["resist"]) - before
    for (donor, receiver), flow in flows.items():
        into = min(1.0, room[receiver] / came[receiver])
        moved = flow * max(0.0, min(into, before[donor] / went[donor], 1.0))
        phi[donor] -= moved
        phi[receiver] += moved
