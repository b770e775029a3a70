"""Every shipped scene runs: finite, held together, outside of its bodies, and the same twice."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from nuno.collision.bodies import build_bodies
from nuno.collision.distance import penetration
from nuno.scene import scene_file, shipped
from nuno.simulation.cloth import build
from nuno.simulation.run import Simulation

FRAMES = 5
SCENES = shipped.scenes("") | shipped.scenes("contact")
QUICK = ("hanging-sheet", "skirt-hula")
"""Scenes that have between them what shipped scenes are made of; each other one compiles its own kernels."""
STRETCH = 0.25
"""No shipped scene stretches a spring further than this in its first frames."""
DEPTH = 5e-3
"""No shipped scene lets cloth deeper into a body than this [m] in its first frames."""


def simulate(name: str) -> tuple[Simulation, list[float], list[float]]:
    """A few frames: the simulation, and the largest stretch and depth of each frame."""
    loaded = scene_file.read(SCENES[name])
    bodies = build_bodies(loaded) if loaded.scene.bodies else None
    start = bodies.poses(0.0) if bodies else None
    simulation = Simulation(loaded, bodies.geometry if bodies else None, start, 1)
    stretches, depths = [], []
    for frame in range(1, FRAMES + 1):
        end = bodies.poses(frame / loaded.scene.frame_rate) if bodies else None
        report = simulation.advance(start, end).report
        assert report.status == "ok"
        stretches.append(report.stretch)
        if bodies and end:
            depths.append(float(penetration(simulation.state.x, bodies.geometry, end).max()))
        start = end
    return simulation, stretches, depths


@pytest.mark.quick(name=QUICK)
@pytest.mark.parametrize("name", sorted(SCENES))
def test_scene_holds_together_and_runs_the_same_twice(name: str) -> None:
    first, stretches, depths = simulate(name)
    assert np.isfinite(first.state.x).all()
    assert max(stretches) < STRETCH
    assert max(depths, default=0.0) < DEPTH
    assert simulate(name)[0].digest() == first.digest()


@pytest.mark.quick(name=["skirt-hula"])
@pytest.mark.parametrize("name", ["skirt-hula", "skirt-walk", "skirt-paper"])
def test_waist_follows_its_frame(name: str) -> None:
    simulation, _, _ = simulate(name)
    bodies = build_bodies(simulation.loaded)
    binding = simulation.fabric.bindings[0]
    index = bodies.geometry.frames.index(f"{binding.body}/{binding.frame}")
    rate = simulation.loaded.scene.frame_rate
    place = [bodies.poses(frame / rate) for frame in (0, FRAMES)]
    waist = [simulation.fabric.position[binding.vertices], simulation.state.x[binding.vertices]]
    local = [
        (x - p.translation[index]) @ build.rotation_matrices(p.rotation[index])
        for x, p in zip(waist, place, strict=True)
    ]
    np.testing.assert_allclose(local[1], local[0], atol=1e-12)


FOLDER = shipped.scenes("")["skirt-walk"].parent
MESHES = tuple(f"contact/{name}.obj" for name in ("funnel", "knot-left", "knot-right", "scarf", "star", "table"))
SCRIPTS = {
    "make_walk.py": ("walk.bvh",), "make_pattern.py": ("seigaiha.png",), "make_net.py": ("pendulum.npz",),
    "contact/make_cards.py": ("contact/cards.yaml",), "contact/make_meshes.py": MESHES,
}  # fmt: skip
"""And what they make."""


@pytest.mark.quick(script=[script for script in SCRIPTS if script != "make_pattern.py"])
@pytest.mark.parametrize("script", SCRIPTS)
def test_files_are_what_their_scripts_make(script: str, tmp_path: Path) -> None:
    copy = tmp_path / script
    copy.parent.mkdir(exist_ok=True)
    copy.write_text((FOLDER / script).read_text())
    subprocess.run([sys.executable, str(copy)], check=True, cwd=tmp_path)
    for made in SCRIPTS[script]:
        if made.endswith(".png"):
            from PIL import Image

            new, old = (np.asarray(Image.open(path / made)) for path in (tmp_path, FOLDER))
            np.testing.assert_array_equal(new, old)
        elif made.endswith(".npz"):  # the arrays' own bytes: how they are packed is the zip library's matter
            with zipfile.ZipFile(tmp_path / made) as new_file, zipfile.ZipFile(FOLDER / made) as old_file:
                assert new_file.namelist() == old_file.namelist()
                for member in old_file.namelist():
                    assert new_file.read(member) == old_file.read(member), member
        else:
            assert (tmp_path / made).read_text() == (FOLDER / made).read_text()


def test_every_shipped_data_file_has_its_script() -> None:
    data = [path for path in FOLDER.iterdir() if path.suffix not in (".yaml", ".py") and path.is_file()]
    data += [path for path in (FOLDER / "contact").iterdir() if path.suffix not in (".yaml", ".py")]
    made = {name for names in SCRIPTS.values() for name in names if not name.endswith(".yaml")}
    assert {str(path.relative_to(FOLDER)) for path in data} == made
