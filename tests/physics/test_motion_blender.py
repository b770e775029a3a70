"""A character that Blender animates and exports in each format moves as Blender itself evaluates it (needs bpy)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree
from skin_files import Folder

from nuno_contact.motions.animation import Animation, AnimationConfig
from nuno_schemas.fabric import Float

FRAMES = 25
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "GLB, a clip of each action": ("hero.glb", {"clip": ["Walk", "Swell"]}),
    "GLB, the scene": ("merged.glb", {"clip": ["Rig", "Body"]}),
    "GLB, an object": ("hero.glb", {"clip": "Walk", "mesh": "Eye"}),
    "USD, a skeleton": ("hero.usdc", {}),
    "USD, a cache": ("cache.usdc", {}),
    "USD, an object": ("hero.usdc", {"mesh": "Eye"}),
    "OBJ": ("hero0001.obj", {"frame_rate": 24.0}),
}


def evaluated(bpy: Any, found: Any) -> Float:
    """(m, n, 3) vertices of an object in all frames, y up."""
    rows = []
    for frame in range(1, FRAMES + 1):
        bpy.context.scene.frame_set(frame)
        drawn = found.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh, place = drawn.to_mesh(), np.array(drawn.matrix_world)
        x = np.empty(3 * len(mesh.vertices))
        mesh.vertices.foreach_get("co", x)
        x = x.reshape(-1, 3) @ place[:3, :3].T + place[:3, 3]
        rows.append(np.stack([x[:, 0], x[:, 2], -x[:, 1]], axis=1))
    return np.stack(rows)


def animate(bpy: Any) -> tuple[Any, Any]:
    """A tube of two bones with a shape key and charts, and an eye on the upper bone; the rig is turned."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 24, 1, FRAMES
    bpy.ops.mesh.primitive_cylinder_add(vertices=24, radius=0.15, depth=1.0, location=(0, 0, 0.6), end_fill_type="NGON")
    body = bpy.context.object
    body.name = "Body"
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=4)
    bpy.ops.uv.smart_project()
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.transform_apply(location=True)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=6, radius=0.03, location=(0.0, -0.15, 1.0))
    eye = bpy.context.object
    eye.name = "Eye"
    bpy.ops.object.armature_add(location=(0, 0, 0.1))
    rig = bpy.context.object
    rig.name = "Rig"
    bpy.ops.object.mode_set(mode="EDIT")
    bones = rig.data.edit_bones
    bones[0].name, bones[0].head, bones[0].tail = "lower", (0, 0, 0), (0, 0, 0.5)
    upper = bones.new("upper")
    upper.head, upper.tail, upper.parent, upper.use_connect = (0, 0, 0.5), (0, 0, 1.0), bones["lower"], True
    bpy.ops.object.mode_set(mode="OBJECT")
    body.shape_key_add(name="Basis")
    key = body.shape_key_add(name="Swell")
    for moved, vertex in zip(key.data, body.data.vertices, strict=True):
        moved.co = (1.3 * vertex.co.x, 1.3 * vertex.co.y, vertex.co.z)
    lower, higher = (body.vertex_groups.new(name=name) for name in ("lower", "upper"))
    for vertex in body.data.vertices:
        weight = min(max((vertex.co.z - 0.45) / 0.3, 0.0), 1.0)
        lower.add([vertex.index], 1.0 - weight, "REPLACE")
        higher.add([vertex.index], weight, "REPLACE")
    body.modifiers.new("Armature", "ARMATURE").object = rig
    body.parent, body.matrix_parent_inverse = rig, rig.matrix_world.inverted()
    eye.parent, eye.parent_type, eye.parent_bone = rig, "BONE", "upper"
    bpy.context.view_layer.update()
    eye.matrix_world.translation = (0.0, -0.15, 1.0)
    rig.rotation_euler = (0, 0, 0.4)
    for bone in rig.pose.bones:
        bone.rotation_mode = "XYZ"
    for frame in range(1, FRAMES + 1, 4):
        t = (frame - 1) / 24
        rig.pose.bones["upper"].rotation_euler = (0.9 * math.sin(2 * math.pi * t), 0.3 * t, 0.2)
        rig.pose.bones["upper"].keyframe_insert("rotation_euler", frame=frame)
        rig.pose.bones["lower"].location = (0.3 * t, 0.05 * math.sin(6 * t), 0.1 * t)
        rig.pose.bones["lower"].keyframe_insert("location", frame=frame)
        key.value = 0.5 - 0.5 * math.cos(2 * math.pi * t)
        key.keyframe_insert("value", frame=frame)
    rig.animation_data.action.name, body.data.shape_keys.animation_data.action.name = "Walk", "Swell"
    return body, eye


@pytest.mark.full
def test_a_character_moves_as_blender_evaluates_it(tmp_path: Path) -> None:
    """Each vertex of either is within a thousandth of a millimetre of one of the other, at every frame."""
    bpy = pytest.importorskip("bpy", reason="needs Blender as a module: pip install bpy")
    pytest.importorskip("pxr", reason="needs nuno[usd]")
    body, eye = animate(bpy)
    shown = evaluated(bpy, body), evaluated(bpy, eye)
    bpy.context.scene.frame_set(1)
    bpy.ops.object.select_all(action="SELECT")
    gltf, usd = bpy.ops.export_scene.gltf, bpy.ops.wm.usd_export
    gltf(filepath=str(tmp_path / "hero.glb"))
    gltf(filepath=str(tmp_path / "merged.glb"), export_animation_mode="SCENE")
    usd(filepath=str(tmp_path / "hero.usdc"), export_animation=True, export_armatures=True)
    still = {"export_armatures": False, "export_shapekeys": False}
    usd(filepath=str(tmp_path / "cache.usdc"), export_animation=True, **still)
    bpy.ops.wm.obj_export(filepath=str(tmp_path / "hero.obj"), export_animation=True, start_frame=1, end_frame=FRAMES)
    for name, (file, settings) in CASES.items():
        mover = Animation().prepare(AnimationConfig(file=file, **settings), Folder(tmp_path))
        true = shown[1] if settings.get("mesh") == "Eye" else np.concatenate(shown, axis=1)
        for k, x in enumerate(true):
            found = mover.pose(k / 24.0)[1]
            worst = max(float(KDTree(a).query(b)[0].max()) for a, b in ((x, found), (found, x)))
            assert worst < 1e-6, (name, k, worst)
