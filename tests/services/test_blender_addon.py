"""The add-on for Blender: its scene is one of nuno's, and a garment comes back where it was simulated."""

from __future__ import annotations

import importlib.util
import struct
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import nuno
from nuno.cli import main
from nuno.scene import scene_file


def load(folder: Path) -> ModuleType:
    """The add-on as the command writes it, imported as Blender does."""
    assert main(["blender-addon", str(folder / "addon.py")]) == 0
    spec = importlib.util.spec_from_file_location("nuno_addon", folder / "addon.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def addon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The add-on without Blender, for what it does by itself."""
    props = SimpleNamespace(**{f"{kind}Property": lambda **_: None for kind in ("Pointer", "String", "Int")})
    types = SimpleNamespace(Operator=object, Panel=object, PropertyGroup=object, Object=object)
    monkeypatch.setitem(sys.modules, "bpy", SimpleNamespace(props=props, types=types))  # type: ignore[arg-type]
    return load(tmp_path)


def test_the_scene_that_it_writes_is_one(addon: Any, tmp_path: Path) -> None:
    """With a frame for each of the shot's, after those of the pre-roll."""
    addon.write_scene(tmp_path, 25, 24.0, 12, "denim", "waist band")
    scene = scene_file.read(tmp_path / addon.SCENE).scene
    assert round(scene.duration * scene.frame_rate) == 12 + 24
    assert scene.objects[0].model.config["pin"] == ["waist band"]
    addon.write_scene(tmp_path, 25, 30000.0 / 1001.0, 0, "denim", "")
    assert "attach" not in scene_file.read(tmp_path / addon.SCENE).scene.objects[0].model.config


def test_points_come_back_into_the_garments_own_axes(addon: Any, tmp_path: Path) -> None:
    """The object's matrix takes them to where they are in nuno's world, its y up being Blender's z."""
    rng = np.random.default_rng(3)
    world, x = np.eye(4), rng.normal(size=(5 * 7, 3)).astype(np.float32)
    world[:3] += 0.3 * rng.normal(size=(3, 4))
    (tmp_path / "a.pc2").write_bytes(struct.pack("<12siiffi", b"POINTCACHE2\0", 1, 7, 0.0, 1.0, 5) + x.tobytes())
    assert addon.localise(tmp_path / "a.pc2", world) == 7
    local = np.frombuffer((tmp_path / "a.pc2").read_bytes(), "<f4", offset=32).reshape(-1, 3).astype(float)
    assert np.abs(local @ world[:3, :3].T + world[:3, 3] - np.stack([x[:, 0], -x[:, 2], x[:, 1]], axis=1)).max() < 1e-5
    assert np.array_equal(addon.to_nuno(addon.to_blender(x)), x)


@pytest.mark.full
def test_a_shot_goes_out_of_blender_and_its_garment_comes_back(tmp_path: Path) -> None:
    """A tube whose rim is held on a ball that moves and turns: in each frame it is where the recording has it."""
    bpy = pytest.importorskip("bpy", reason="needs Blender as a module: pip install bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon: Any = load(tmp_path)
    addon.register()
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 24, 3, 12
    bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=12, radius=0.15, location=(0.0, 0.0, 1.0))
    character = bpy.context.object
    for frame, at, turn in ((3, (0.0, 0.0, 1.0), 0.0), (12, (0.08, 0.04, 1.02), 0.3)):
        character.location, character.rotation_euler = at, (0.0, 0.0, turn)
        character.keyframe_insert("location", frame=frame)
        character.keyframe_insert("rotation_euler", frame=frame)
    bpy.ops.mesh.primitive_cylinder_add(
        vertices=24, radius=0.17, depth=0.3, end_fill_type="NOTHING", location=(0.0, 0.0, 0.9), rotation=(0.0, 0.0, 0.3)
    )
    garment = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=3)
    bpy.ops.object.mode_set(mode="OBJECT")
    rim = [vertex.index for vertex in garment.data.vertices if vertex.co.z > 0.149]
    garment.vertex_groups.new(name="waist").add(rim, 1.0, "REPLACE")
    bpy.context.view_layer.update()
    shot = scene.nuno
    shot.character, shot.garment, shot.pin, shot.preroll, shot.folder = character, garment, "waist", 4, str(tmp_path)
    shot.program = str(Path(sys.executable).with_name("nuno"))
    addon.send(bpy.context)
    command = [addon.program(bpy.context), "run", addon.SCENE, "--no-view", "--record", addon.RECORDING]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    addon.receive(bpy.context)
    frames = {frame.number: frame.x for frame in nuno.open(tmp_path / addon.RECORDING).frames()}
    assert len(frames) == 4 + 10
    for frame in range(3, 13):
        scene.frame_set(frame)
        drawn = garment.evaluated_get(bpy.context.evaluated_depsgraph_get())
        x = addon.vertices_of(drawn.to_mesh(), np.array(drawn.matrix_world))
        assert np.abs(x - frames[frame - 3 + 4]).max() < 1e-6
