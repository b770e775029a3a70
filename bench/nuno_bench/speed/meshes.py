"""The cloth that is timed: a sheet, and the same as a net of arrays."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.cloth.yarns import structural_edges
from nuno_bench.machine import cores
from nuno_bench.problem.piles import DOWN, build_model, irregular_square, write_obj
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.system import System

DAMPING = 1e-5
FABRIC = {"density": 0.3, "structural": 8.0, "shear": 2.5, "bending": 0.4}
"""Soft cloth set by hand, [N s/m], [kg/m^2] and [N/m]: 12 springs a vertex, no hinges."""
ROUGHNESS = 0.01
"""Vertices start this part of an edge off their places, so that no difference is exactly 0."""


def sheet_scene(columns: int, rows: int, damping: float = 0.0, fabric: str | None = None) -> dict[str, Any]:
    """A hanging square metre of cloth by the hand-set constants, or of a preset fabric."""
    cloth = fabric or FABRIC | {"damping": damping}
    return scene_of({"plugin": "sheet", "resolution": [columns, rows], "pin": ["top-corners"], "fabric": cloth})


def scene_of(model: dict[str, Any]) -> dict[str, Any]:
    """One object in a scene whose single frame is a tenth of a millisecond."""
    scene = {"nuno": 1, "name": "bench", "duration": 1e-4, "frame_rate": 10_000}
    solver = {"plugin": "symplectic_euler", "dt": "auto"}
    return scene | {"solver": solver, "objects": [{"name": "cloth", "model": model}]}


def sheet(columns: int, rows: int, damping: float = 0.0) -> Fabric:
    """The fabric of sheet_scene."""
    model: dict[str, Any] = sheet_scene(columns, rows, damping)["objects"][0]["model"]
    return build_model(model.pop("plugin"), model)


def net(arrays: dict[str, NDArray[Any]]) -> Fabric:
    """The fabric that the net plugin reads from these arrays."""
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "net.npz", allow_pickle=False, **arrays)
        return build_model("net", {"file": "net.npz"}, Path(folder))


def mesh(side: int, tension: str, shuffled: bool = False) -> Fabric:
    """A square metre of denim as an irregular mesh of side x side vertices, numbered row by row or at random."""
    points, faces = irregular_square(side, 1.0, 4)
    if shuffled:
        order = np.random.default_rng(3).permutation(len(points))
        points, faces = points[order], np.argsort(order).astype(np.int32)[faces]
    with tempfile.TemporaryDirectory() as folder:
        write_obj(Path(folder) / "mesh.obj", points, faces)
        return build_model("mesh", {"file": "mesh.obj", "tension": tension}, Path(folder))


def system_of(fabric: Fabric) -> tuple[System, State]:
    """The fabric under gravity on all cores, and its start, slightly rough."""
    edge = float(np.median(structural_edges(fabric)[1]))
    x = fabric.position + np.random.default_rng(1).normal(scale=ROUGHNESS * edge, size=fabric.position.shape)
    return System(fabric, DOWN, threads=cores()), State(np.ascontiguousarray(x), fabric.velocity.copy())


def net_arrays(fabric: Fabric, varied: bool) -> dict[str, NDArray[Any]]:
    """The arrays of a `net` with a fabric's vertices and springs.

    With `varied`, k, rest and c of every spring differ by up to a tenth, as measured ones would;
    otherwise all springs of a class (structural, shear, bending) stay alike.
    """
    springs = fabric.springs
    assert springs is not None
    values = {"k": springs.k, "rest": springs.rest, "c": np.full(springs.k.shape, DAMPING)}
    rng = np.random.default_rng(2)
    each = {name: np.array(springs.per_spring(array)) for name, array in values.items()}
    if varied:
        each = {name: array * rng.uniform(0.9, 1.1, array.shape) for name, array in each.items()}
    own = {"x": fabric.position, "v": fabric.velocity, "m": fabric.mass, "pinned": fabric.pinned}
    return own | {"springs": springs.pairs().astype(np.int64)} | each


def renumbered(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The same net with its vertices numbered at random: nothing follows anything, and all is read by its index."""
    order = np.random.default_rng(3).permutation(len(arrays["x"]))
    moved = {name: arrays[name][order] for name in ("x", "v", "m", "pinned")}
    return arrays | moved | {"springs": np.argsort(order)[arrays["springs"]]}
