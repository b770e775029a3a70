"""Whether the choice for dye keeps its promise: against closed forms of cells.

What is promised is the error in time, against the exact evolution of the cells, each a number that changes by what its
faces let through. So the closed forms are those of cells, not of the plane that they stand for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from nuno.dye.run import DyeRun
from nuno.scene import scene_file
from nuno.simulation.solver_selection.cloth import decide
from nuno_bench.problem import DyeProblem
from nuno_schemas.fabric import Float

CELL, D0, POROSITY = 5e-5, 5e-10, 0.5
"""[m], [m^2/s]: what passes a face between cells in a second is 0.1 of their difference."""
RATE = D0 * POROSITY / CELL**2
AMOUNT = POROSITY
"""Full cells."""
SIDE, RADIUS = 24, 6
"""Of the disc [cells]."""
ADSORPTION, SLOPE = 0.02, 2.0
"""Of the fibre: D_ab / D0, and k of the partition. It takes no more than half of the dye, which k = 2 would allow."""


def two_cells(t: float, start: Float) -> Float:
    """One over the other, the upper one full: their difference falls by exp(-2 w t)."""
    fading = math.exp(-2.0 * RATE * t)
    return np.array([[[0.5 * AMOUNT * (1.0 + fading)]], [[0.5 * AMOUNT * (1.0 - fading)]]])


def disc(t: float, start: Float) -> Float:
    """A disc in one of two layers: exp(w t L), L = Lx + Ly + Lz the second differences along each axis."""
    number = start.shape[-1]
    second = np.diag(np.full(number - 1, 1.0), 1) + np.diag(np.full(number - 1, 1.0), -1)
    values, vectors = np.linalg.eigh(second - np.diag(second.sum(axis=1)))
    spread = vectors @ np.diag(np.exp(RATE * t * values)) @ vectors.T
    both = spread @ start @ spread
    mean, half = both.mean(axis=0), 0.5 * (both[0] - both[1]) * math.exp(-2.0 * RATE * t)
    return np.stack([mean + half, mean - half])


def fibre(t: float, start: Float) -> Float:
    """What is left in a cell whose fibre takes D_ab / d^2 (phi - A): phi + A stays, phi - A falls by exp(-2 r t)."""
    return 0.5 * start * (1.0 + math.exp(-2.0 * ADSORPTION * D0 / CELL**2 * t))


CASES: dict[str, Callable[[float, Float], Float]] = {"two-cells": two_cells, "disc": disc, "fibre": fibre}
"""Mobile amounts (2, ny, nx) at a time [s], from those at the start. What is not mobile any more, fibre has taken."""


def write_case(name: str, frame: float, frames: int, folder: Path) -> Path:
    """The scene of a case, with frames of so many seconds."""
    shape = (2, SIDE, SIDE) if name == "disc" else (2, 1, 1)
    phi, none = np.zeros(shape), np.zeros(shape)
    y, x = np.ogrid[: shape[1], : shape[2]]
    middle = 0.5 * (shape[1] - 1)
    phi[0, (x - middle) ** 2 + (y - middle) ** 2 <= RADIUS**2] = AMOUNT
    path = folder / (f"{name}-{frame:g}".replace(".", "_") + ".yaml")
    np.savez(
        path.with_suffix(".npz"), fibre=none == 0.0, up=none != 0.0, porosity=none + POROSITY, tau1=none + 1.0,
        resist=none, phi=phi, fixed=none,
    )  # fmt: skip
    tau3 = dict.fromkeys(("I", "II", "III", "IV", "V"), 0.0 if name == "fibre" else 1.0)
    dye: dict[str, object] = {"name": "dye", "D0": D0}
    if name == "fibre":
        dye |= {"adsorption": ADSORPTION, "isotherm": {"plugin": "partition", "k": SLOPE}}
    cloth = {"plugin": "cells", "file": path.with_suffix(".npz").name, "cell_size": CELL, "tau3": tau3}
    scene = {"nuno": 1, "name": path.stem, "duration": frame * frames, "frame_rate": 1.0 / frame,
             "dye": {"cloth": cloth, "dyes": [dye]}}  # fmt: skip
    path.write_text(yaml.safe_dump(scene))
    return path


def promised_error(name: str, length: float, frames: int, level: str, folder: Path) -> float:
    """Largest distance of any amount after the start from the exact one, as a share of the largest there is.

    Of a case with so many frames of `length` [s], run by the solver and the step that are chosen for a level.
    """
    decided = decide(scene_file.read(write_case(name, length, frames, folder), [f"accuracy={level}"]))
    assert decided.dye is not None
    problem, solver = DyeProblem(decided, 1), decided.dye.solver
    run = problem.run(solver.plugin, solver.config, DyeRun(decided, 1).steps)
    assert run.status == "ok"
    start = problem.start.state.phi[0]
    mobile = np.stack([CASES[name](frame * length, start).ravel() for frame in range(frames + 1)])
    exact = np.stack([mobile, start.ravel() - mobile if name == "fibre" else 0.0 * mobile], axis=2)
    return float(np.abs(run.series.x - exact)[1:].max() / np.abs(exact[1:]).max())
