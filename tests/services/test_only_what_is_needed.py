"""A scene pays only for what it has: modules, arrays and compiled terms."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from nuno.scene import scene_file
from nuno.simulation.run import Simulation

SCENE = """
nuno: 1
name: one
duration: 0.1 s
solver: {plugin: rk4, dt: auto}
objects: [{name: cloth, model: {plugin: net, file: one.npz}}]
"""
PROGRAM = """
import json, os, sys
from nuno.cli import main
code = main(["run", "scene.yaml", "--no-view", "--record", "one.mcap"])
print(json.dumps([code, sorted(sys.modules)]))
sys.stdout.flush()
os._exit(0)
"""
UNNEEDED = (
    "nuno_contact", "nuno_cloth.wind", "nuno_geometry.poses", "nuno_integrators.bindings", "nuno_kernels.forces.yarns",
    "nuno.collision.service", "nuno.viewer.service", "nuno.viewer.bridge", "nuno_render", "dye", "trimesh", "rerun",
    "matplotlib", "nuno_bench",
)  # fmt: skip


def one_mass(folder: Path) -> Path:
    np.savez(
        folder / "one.npz", x=np.zeros((1, 3)), v=np.zeros((1, 3)), m=np.ones(1), pinned=np.zeros(1, bool),
        springs=np.zeros((0, 2), int), k=np.zeros(0), rest=np.zeros(0), c=np.zeros(0),
    )  # fmt: skip
    path = folder / "scene.yaml"
    path.write_text(SCENE)
    return path


def test_one_mass_loads_no_module_of_what_it_lacks(tmp_path: Path) -> None:
    """With kernels of its own: numba's index of a shared cache names the types of other scenes' terms."""
    one_mass(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=tmp_path,
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    code, modules = json.loads(done.stdout.splitlines()[-1])
    assert code == 0
    assert "nuno_integrators.explicit.fixed_step" in modules and "nuno_cloth.models.net" in modules, (
        "the run did not happen here"
    )
    loaded = set(modules) - {"nuno_schemas.dyeing"}  # what a scene may say of dye
    assert [name for name in loaded if any(word in name for word in UNNEEDED)] == []


def test_one_mass_has_no_array_of_what_it_lacks(tmp_path: Path) -> None:
    simulation = Simulation(scene_file.read(one_mass(tmp_path)), None, None, 1)
    packed = simulation.memory.work.packed  # type: ignore[attr-defined]
    assert packed.forces == packed.bodies == ()
    assert simulation.system.terms == ()
    assert simulation.memory.arrays == {}
