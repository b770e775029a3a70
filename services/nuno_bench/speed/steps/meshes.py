"""The meshes that are timed: a grid, the same as a raw net, and one without order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno import registry
from nuno.scene.files import SceneFiles
from nuno_bench.machine import cores
from nuno_schemas.fabric import Fabric, Int, State
from nuno_schemas.system import System

GRAVITY = np.array([0.0, -9.81, 0.0])
DENSITY, STRUCTURAL, SHEAR, BENDING, DAMPING = 0.3, 8.0, 2.5, 0.4, 1e-5
"""Soft cloth set by hand, [kg/m^2], [N/m] and [N s/m]: 12 springs a vertex, no hinges."""
ROUGHNESS = 0.01
"""Vertices start this part of an edge off their places, so that no difference is exactly 0."""


def sheet_scene(columns: int, rows: int, damping: float = 0.0, fabric: str | None = None) -> dict[str, Any]:
    """A hanging square metre of cloth by the hand-set constants, or of a preset fabric."""
    by_hand = {"density": DENSITY, "structural": STRUCTURAL, "shear": SHEAR, "bending": BENDING, "damping": damping}
    model = {"plugin": "sheet", "resolution": [columns, rows], "pin": ["top-corners"], "fabric": fabric or by_hand}
    return scene_of(model)


def scene_of(model: dict[str, Any]) -> dict[str, Any]:
    """One object in a scene whose single frame is a tenth of a millisecond."""
    return {
        "nuno": 1,
        "name": "bench",
        "duration": 1e-4,
        "frame_rate": 10_000,
        "solver": {"plugin": "symplectic_euler", "dt": "auto"},
        "objects": [{"name": "cloth", "model": model}],
    }


def build_model(model: dict[str, Any], folder: Path) -> Fabric:
    """The fabric of a model plugin."""
    plugin = registry.load("nuno.models", model["plugin"])
    config = plugin.Config.model_validate({key: value for key, value in model.items() if key != "plugin"})
    fabric: Fabric = plugin.build(config, SceneFiles(folder, ()), 0)
    return fabric


def system_of(fabric: Fabric) -> tuple[System, State]:
    """The fabric under gravity on all cores, and its start, slightly rough."""
    assert fabric.springs is not None
    edge = float(np.median(fabric.springs.rest))
    x = fabric.position + np.random.default_rng(1).normal(scale=ROUGHNESS * edge, size=fabric.position.shape)
    return System(fabric, GRAVITY, threads=cores()), State(np.ascontiguousarray(x), fabric.velocity.copy())


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
    pairs = springs.pairs().astype(np.int64)
    return {
        "x": fabric.position,
        "v": fabric.velocity,
        "m": fabric.mass,
        "pinned": fabric.pinned,
        "springs": pairs,
        **each,
    }


def irregular_arrays(side: int, patch: int | None) -> dict[str, NDArray[Any]]:
    """A triangle mesh of side^2 jittered points, springs on its edges and across each of them.

    Every cell's diagonal is drawn at random, so vertices have 4 to 8 edges. Vertices are numbered
    at random within patches of `patch` x `patch` (what mesh files are like), or all over (None).
    """
    rng = np.random.default_rng(3)
    number = _numbering(side, patch, rng)
    x = np.zeros((side * side, 3))
    places = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="xy"), -1).reshape(-1, 2)
    x[number.reshape(-1), :2] = (places + rng.uniform(-0.2, 0.2, places.shape)) / (side - 1)
    pairs = _edges_and_across(number, rng.random((side - 1, side - 1)) < 0.5)
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    springs = len(pairs)
    return {
        "x": x,
        "v": np.zeros_like(x),
        "m": np.full(side * side, DENSITY / side**2),
        "pinned": np.arange(side * side) == 0,
        "springs": pairs.astype(np.int64),
        "k": STRUCTURAL * rng.uniform(0.9, 1.1, springs),
        "rest": rest,
        "c": DAMPING * rng.uniform(0.9, 1.1, springs),
    }


def _numbering(side: int, patch: int | None, rng: np.random.Generator) -> Int:
    """(side, side) number of the vertex at each place."""
    rows, columns = np.indices((side, side)).reshape(2, -1)
    size = side if patch is None else patch
    order = np.lexsort((rng.random(side * side), columns // size, rows // size))
    number = np.empty(side * side, np.int32)
    number[order] = np.arange(side * side, dtype=np.int32)
    return number.reshape(side, side)


def _edges_and_across(number: Int, falling: NDArray[np.bool_]) -> Int:
    """(s, 2) pairs: edges of the triangulated grid, then the vertices opposite each inner edge."""
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    # Cell a b / c d: its diagonal is a-d (falling) or b-c, its triangles lie on either side.
    first = np.where(falling[..., None], np.stack([a, b, d], -1), np.stack([a, b, c], -1)).reshape(-1, 3)
    second = np.where(falling[..., None], np.stack([a, d, c], -1), np.stack([b, d, c], -1)).reshape(-1, 3)
    faces = np.concatenate([first, second])
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    sides, opposite = sides[order], opposite[order]
    new = np.concatenate([[True], (sides[1:] != sides[:-1]).any(axis=1)])
    edges = sides[new]
    across = np.sort(np.column_stack([opposite[:-1], opposite[1:]])[~new[1:]], axis=1)
    return np.unique(np.concatenate([edges, across]), axis=0)
