"""Cloth that starts a little uneven leaves its plane where it must, and only there."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes import write_chain

import nuno
from nuno.scene import scene_file, shipped
from nuno.simulation.cloth import build
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

HEIGHT = 1e-4
SHEET = {
    "plugin": "sheet",
    "size": [0.5, 0.4],
    "resolution": [17, 13],
    "pin": ["top-corners"],
    "rotate": {"angle": 0.5},
}
SKIRT = {"plugin": "skirt", "columns": 32, "rows": 12}
MESH = {"plugin": "mesh", "file": "cloth.obj"}
MODELS = {"sheet": SHEET, "triangles": SHEET | {"cells": "triangles"}, "skirt": SKIRT, "mesh": MESH}


def made(folder: Path, model: dict[str, Any], height: float, seed: int = 0) -> Fabric:
    """The cloth of a scene with one object so rough [m]; cloth.obj is two triangles with a fold between them."""
    (folder / "cloth.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nf 1 2 3\nf 1 3 4\n")
    write_chain(folder)
    cloth = {"name": "cloth", "model": model} | ({"roughness": height} if height else {})
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump({"nuno": 1, "name": "rough", "duration": 1, "seed": seed, "objects": [cloth]}))
    return build.build_fabric(scene_file.read(path))[0]


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_only_the_start_is_rough_and_along_the_normals(model: dict[str, Any], tmp_path: Path) -> None:
    flat, rough = (made(tmp_path, model, height) for height in (0.0, HEIGHT))
    parts = [part for part in ("springs", "hinges", "membrane", "bending") if getattr(flat, part) is not None]
    assert len(parts) == 2
    for part in parts:
        for field in fields(getattr(flat, part)):
            np.testing.assert_array_equal(
                getattr(getattr(flat, part), field.name), getattr(getattr(rough, part), field.name)
            )
    np.testing.assert_array_equal(flat.mass, rough.mass)
    moved = rough.position - flat.position
    assert not moved[flat.pinned].any() and moved[~flat.pinned].any(axis=1).all()
    a, b, c = (flat.position[flat.faces[:, k]] for k in range(3))
    normal = np.zeros_like(moved)
    np.add.at(normal, flat.faces, np.cross(b - a, c - a)[:, None])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = (moved * normal).sum(axis=1)
    np.testing.assert_allclose(moved, along[:, None] * normal, atol=1e-15)


def test_the_height_is_the_root_mean_square_and_the_seed_chooses(tmp_path: Path) -> None:
    flat = made(tmp_path, SHEET, 0.0).position
    moved = [made(tmp_path, SHEET, HEIGHT, seed).position - flat for seed in range(40)]
    assert np.sqrt(np.mean([np.square(one).sum(axis=1).mean() for one in moved])) == pytest.approx(HEIGHT, rel=0.1)
    np.testing.assert_array_equal(moved[3], made(tmp_path, SHEET, HEIGHT, 3).position - flat)
    assert min(np.abs(one - moved[0]).max() for one in moved[1:]) > 0.5 * HEIGHT


def test_a_finer_mesh_is_rough_in_the_same_places(tmp_path: Path) -> None:
    coarse, fine = (made(tmp_path, SHEET | {"resolution": n}, HEIGHT).position for n in ([9, 7], [17, 13]))
    shared = fine.reshape(13, 17, 3)[::2, ::2].reshape(-1, 3)
    np.testing.assert_allclose(coarse, shared, atol=1e-12)


def test_a_net_without_faces_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="only cloth with triangles") as error:
        made(tmp_path, {"plugin": "net", "file": "chain.npz"}, HEIGHT)
    assert error.value.field == "objects[0].roughness" and error.value.line is not None


CRITICAL = 12.8538 * math.sqrt(2.0)
"""w L^3 / B at which a strip clamped at one end, its width vertical, tips over (Michell; Poisson's ratio 0)."""


def strip(gamma: float, roughness: float) -> Float:
    """Distances from its plane (n,) [m] that such a strip ends with."""
    columns, rows, length, density, gravity = 17, 3, 0.2, 0.05, 9.81
    step = length / (columns - 1.5)  # the clamp holds the direction of the first step
    rigidity = density * gravity * length**3 / gamma
    fabric = {"density": density, "warp": 400, "weft": 400, "shear": 100, "bend_warp": rigidity, "bend_weft": rigidity}
    pins = [row * columns + column for row in range(rows) for column in (0, 1)]
    model = {"plugin": "sheet", "size": [step * (columns - 1), step * (rows - 1)], "resolution": [columns, rows]}
    cloth = {"name": "strip", "roughness": roughness, "model": model | {"pin": pins, "fabric": fabric}}
    scene = {"nuno": 1, "name": "strip", "duration": 5, "frame_rate": 20, "damping": 3, "objects": [cloth]}
    result = nuno.run(scene | {"solver": "symplectic_euler"})
    return np.abs(result.x[:, 2])


def test_a_strip_on_its_edge_tips_over_where_it_must() -> None:
    assert strip(1.3 * CRITICAL, 0.0).max() == 0.0  # in a plane nothing pushes it over
    assert strip(1.3 * CRITICAL, HEIGHT).max() > 0.02  # of a length of 0.2 m
    assert strip(0.9 * CRITICAL, HEIGHT).max() < 0.1 * HEIGHT


@pytest.mark.parametrize("name", ["hanging-sheet", "hung-cloth-wrinkle"])
def test_shipped_cloth_that_hangs_leaves_its_plane(name: str) -> None:
    loaded = scene_file.read(shipped.find(name))
    assert loaded.scene.objects[0].roughness > 0.0
    start = build.build_fabric(loaded)[0].position[:, 2]
    assert 0.0 < np.abs(start).max() < 5.0 * loaded.scene.objects[0].roughness
    if name == "hanging-sheet":
        assert np.abs(nuno.run(name, "duration=0.5").x[:, 2]).max() > 10.0 * np.abs(start).max()
