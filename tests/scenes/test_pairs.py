"""Every pair of models in one scene, also each twice: what joins them, and that neither feels the other."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations_with_replacement, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nuno.collision.bodies import build_bodies
from nuno.scene import scene_file
from nuno.scene.files import SceneFiles
from nuno.simulation import cloth
from nuno.simulation.run import Simulation
from nuno_schemas.fabric import Fabric, Float

BY_HAND = {"density": 0.2, "structural": 20.0, "shear": 4.0, "bending": 2.0}
MODELS: dict[str, dict[str, Any]] = {
    "sheet": {"plugin": "sheet", "resolution": [4, 5], "size": [0.3, 0.4], "plane": "xz", "pin": [0]},
    "sheet of triangles": {"plugin": "sheet", "resolution": [4, 3], "cells": "triangles", "fabric": BY_HAND},
    "skirt": {"plugin": "skirt", "columns": 6, "rows": 3, "fabric": BY_HAND | {"hinge": 1e-5}},
    "mesh": {"plugin": "mesh", "file": "mesh.obj", "fabric": "denim"},
    "one triangle": {"plugin": "mesh", "file": "triangle.obj", "fabric": BY_HAND},
    "net": {"plugin": "net", "file": "net.npz"},
    "net that locks": {"plugin": "net", "file": "lock.npz"},
    "net of yarns": {"plugin": "net", "file": "yarns.npz"},
    "net of yarns that lock": {"plugin": "net", "file": "both.npz"},
    "points": {"plugin": "net", "file": "points.npz"},
    "knit": {"plugin": "knit", "wales": 2, "courses": 3, "spacing": [0.02, 0.02], "yarns": ["elastane"]},
    "knit that locks": {"plugin": "knit", "wales": 3, "courses": 2, "spacing": [0.02, 0.02], "form": "tube"},
    "one course": {"plugin": "knit", "wales": 2, "courses": 1, "spacing": [0.02, 0.02]},
}
PLAIN = ("sheet", "sheet of triangles", "skirt", "mesh", "one triangle", "net", "points")
"""What xpbd takes: no springs that lock, and no yarns that share their tension."""
EVERYTHING = ("sheet", "mesh", "knit that locks")
"""Together they have all that springs, hinges and yarns can be stored as, so that one compiled kernel serves all."""
SOLVERS: dict[str, tuple[dict[str, Any], float]] = {
    "explicit": ({"plugin": "symplectic_euler", "dt": "10 us"}, 1e-13),
    "implicit": ({"plugin": "implicit_euler", "dt": "0.1 ms", "residual": 1e-12}, 1e-9),
    "xpbd": ({"plugin": "xpbd", "dt": "1 ms"}, 1e-13),
}
"""How far from each other the same object may be in two scenes [m]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("pairs")
    (root / "triangle.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (root / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0.2 1.1\nv 0.5 0 2\nf 1 3 2\nf 2 3 4\nf 4 3 5\n")
    x = np.array([[0.1 * i, 0.0, 0.02 * i * i] for i in range(5)])
    pairs = np.stack([np.arange(4), np.arange(1, 5)], axis=1)
    rest = 0.9 * np.linalg.norm(x[1:] - x[:-1], axis=1)
    chain = {"x": x, "v": np.zeros_like(x), "m": np.full(5, 0.01), "pinned": np.zeros(5, bool)}
    springs = {"springs": pairs, "k": np.full(4, 3.0), "rest": rest, "c": np.full(4, 0.01)}
    lock = {"lock": np.array([0.05, 0.05, 0.2, 0.0]), "k_lock": np.full(4, 9.0)}
    yarns = {"yarn_links": np.arange(4), "yarn_ptr": np.array([0, 4]), "mu": np.array([0.2])}
    none = {name: array[:0] for name, array in springs.items()}
    parts = {"net": springs, "lock": springs | lock, "yarns": springs | yarns, "both": springs | lock | yarns}
    for name, part in (parts | {"points": none}).items():
        np.savez(root / f"{name}.npz", **(chain | part))  # type: ignore[arg-type]
    return root


def load(folder: Path, names: tuple[str, ...], **fields: Any) -> scene_file.Loaded:
    objects = [{"name": f"part-{i}", "model": MODELS[name]} for i, name in enumerate(names)]
    scene = {"nuno": 1, "name": "pairs", "duration": "10 ms", "frame_rate": "100 Hz", "objects": objects} | fields
    return scene_file.load(scene, {}, "pairs", SceneFiles(folder))


def elements(fabric: Fabric) -> dict[str, Any]:
    """All that acts on its vertices, spring by spring and hinge by hinge."""
    found: dict[str, Any] = {"faces": fabric.faces, "pinned": fabric.pinned, "mass": fabric.mass}
    if fabric.springs is not None:
        springs = fabric.springs
        found |= {name: springs.per_spring(getattr(springs, name)) for name in ("k", "rest", "c")}
        locks = springs.lock is not None and springs.k_lock is not None
        found["lock"] = springs.per_spring(springs.lock) if springs.lock is not None else np.zeros(springs.number)
        found["k_lock"] = springs.per_spring(springs.k_lock) if springs.k_lock is not None and locks else found["k"]
        found |= {"pairs": springs.pairs(), "kind": np.repeat(springs.kind, springs.count)}
    if fabric.hinges is not None:
        hinges = fabric.hinges
        found |= {"quads": hinges.quads(), "fold": hinges.per_hinge(hinges.k), "flat": hinges.per_hinge(hinges.rest)}
    if fabric.yarns is not None:
        yarns = fabric.yarns
        found |= {"links": yarns.links, "mu": yarns.mu, "ends": np.diff(yarns.ptr)}
        found["yarn"] = np.array([yarns.names[kind] for kind in yarns.kind])
    return found | ({} if fabric.cells is None else {"cells": fabric.cells})


def is_quick(parameters: Mapping[str, Any]) -> bool:
    """Each model twice, and before and after the one that is next in the list."""
    one, other = (list(MODELS).index(name) for name in parameters["names"])
    return abs(one - other) <= 1


@pytest.mark.quick.with_args(is_quick)
@pytest.mark.parametrize("names", list(product(MODELS, repeat=2)), ids=" and ".join)
def test_what_two_objects_are_made_of_is_what_each_is_made_of(names: tuple[str, str], folder: Path) -> None:
    loaded = load(folder, names)
    first, second = cloth.build_fabrics(loaded)
    joined, pieces = cloth.build_fabric(loaded)
    assert [(piece.start, piece.stop) for piece in pieces] == [(0, first.number), (first.number, joined.number)]
    one, other, both = elements(first), elements(second), elements(joined)
    assert set(both) == set(one) | set(other)
    shifts = dict.fromkeys(("pairs", "faces", "quads", "cells"), first.number)
    shifts["links"] = first.springs.number if first.springs is not None else 0
    for name, values in both.items():
        parts = [part[name] for part in (one,) if name in part]
        parts += [other[name] + shifts[name] if name in shifts else other[name]] if name in other else []
        assert np.array_equal(values, np.concatenate(parts)), name


def motion(folder: Path, names: tuple[str, ...], solver: dict[str, Any]) -> list[Float]:
    """Where each object is after a frame of gravity, wind and a floor that it may touch."""
    floor = {"name": "floor", "collider": {"plugin": "plane", "point": [0, -0.01, 0]}, "friction": 0.3}
    wind = [{"plugin": "wind", "velocity": [3, 0, 1]}]
    loaded = load(folder, names, solver=solver, bodies=[floor], forces=wind)
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    simulation = Simulation(loaded, bodies.geometry, poses, 1)
    assert simulation.advance(poses, poses).report.status == "ok"
    return [simulation.state.x[piece.start : piece.stop].copy() for piece in simulation.pieces]


@pytest.mark.full
@pytest.mark.parametrize("solver", SOLVERS)
def test_an_object_moves_as_it_does_without_the_other(solver: str, folder: Path) -> None:
    chosen, tolerance = SOLVERS[solver]
    models = PLAIN if solver == "xpbd" else tuple(MODELS)
    everything = tuple(name for name in EVERYTHING if name in models)
    count = len(everything)
    alone = {name: motion(folder, (*everything, name), chosen)[count] for name in models}
    for names in combinations_with_replacement(models, 2):
        for name, x in zip(names, motion(folder, (*everything, *names), chosen)[count:], strict=True):
            assert np.abs(x - alone[name]).max() < tolerance, names
