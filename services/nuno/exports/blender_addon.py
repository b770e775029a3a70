"""Cloth by nuno in Blender: an animated character and a garment go out as a scene, and the garment comes back moving.

`nuno blender-addon` writes this file, which Blender installs (Edit, Preferences, Add-ons, Install from Disk). It needs
nothing but Blender's own Python, and runs nuno as a program of its own.
"""

# mypy: ignore-errors
# Blender's properties stand where types would.

import json
import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

bl_info = {
    "name": "nuno: cloth", "description": "Simulate a garment on an animated character", "category": "Physics",
    "location": "3D view, sidebar, nuno", "version": (0, 2, 0), "blender": (4, 0, 0),
}  # fmt: skip
CACHE = "nuno"
"""name of the modifier that moves a garment"""
CHARACTER, GARMENT, GROUPS, SCENE, RECORDING, MOTION = (
    "character.npz", "garment.obj", "groups.json", "scene.yaml", "shot.mcap", "garment.pc2",
)  # fmt: skip
HEAD = "<12siiffi"
"""of a PC2 file: its mark, version, points, first frame, frames a sample, samples"""


class Failed(Exception):
    """What stands against it, in a sentence for the person who asked."""


def to_nuno(x: np.ndarray) -> np.ndarray:
    """Return points (..., 3), z up as in Blender, with y up."""
    return np.stack([x[..., 0], x[..., 2], -x[..., 1]], axis=-1)


def to_blender(x: np.ndarray) -> np.ndarray:
    """Return points (..., 3), y up, with z up."""
    return np.stack([x[..., 0], -x[..., 2], x[..., 1]], axis=-1)


def write_scene(folder: Path, frames: int, rate: float, preroll: int, fabric: str, pin: str) -> None:
    """Write the scene of a garment on a character, whose files are in the folder; pin: a vertex group, or empty."""
    held = f", pin: [{json.dumps(pin)}], groups: {GROUPS}, attach: {{body: character}}" if pin else ""
    (folder / SCENE).write_text(
        f"nuno: 1\nname: shot\nduration: {(frames - 1 + preroll) / rate:.9g} s\nframe_rate: {rate:.9g} Hz\n"
        "accuracy: preview\nobjects:\n  - name: garment\n"
        f"    model: {{plugin: mesh, file: {GARMENT}, fabric: {json.dumps(fabric)}{held}}}\n"
        "bodies:\n  - name: character\n    collider: {plugin: surface}\n"
        f"    motion: {{plugin: animation, file: {CHARACTER}, preroll: {preroll / rate:.9g} s}}\n    friction: 0.4\n"
        "cloth_contact: {plugin: offset, thickness: 2 mm, bodies: auto}\n",
        encoding="utf-8",
    )


def localise(path: Path, world: np.ndarray) -> int:
    """Turn the points of a PC2 file, in nuno's world, into those of an object with this matrix (4, 4), in place; return
    their number.
    """
    data = path.read_bytes()
    _, _, points, _, _, samples = struct.unpack_from(HEAD, data)
    x = to_blender(np.frombuffer(data, "<f4", 3 * points * samples, struct.calcsize(HEAD)).reshape(-1, 3))
    inverse = np.linalg.inv(world)
    local = x @ inverse[:3, :3].T + inverse[:3, 3]
    path.write_bytes(data[: struct.calcsize(HEAD)] + local.astype("<f4").tobytes())
    return int(points)


def vertices_of(mesh: Any, world: np.ndarray) -> np.ndarray:
    """Return the vertices (n, 3) of a mesh in nuno's world."""
    x = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", x)
    return to_nuno(x.reshape(-1, 3).astype(float) @ world[:3, :3].T + world[:3, 3])


def write_character(context: Any, character: Any, folder: Path) -> int:
    """Write what is drawn of the character in each frame of the shot, and return the number of frames. Raises Failed if
    modifiers change its vertices from frame to frame.
    """
    scene, before, positions, faces = context.scene, context.scene.frame_current, [], None
    try:
        for frame in range(scene.frame_start, scene.frame_end + 1):
            scene.frame_set(frame)
            drawn = character.evaluated_get(context.evaluated_depsgraph_get())
            mesh = drawn.to_mesh()
            positions.append(vertices_of(mesh, np.array(drawn.matrix_world)).astype(np.float32))
            if faces is None:
                mesh.calc_loop_triangles()
                faces = np.empty(3 * len(mesh.loop_triangles), np.int32)
                mesh.loop_triangles.foreach_get("vertices", faces)
            drawn.to_mesh_clear()
            if positions[-1].shape != positions[0].shape:
                raise Failed(f"frame {frame}: a modifier of {character.name} changes the number of its vertices")
    finally:
        scene.frame_set(before)
    times = np.arange(len(positions)) * scene.render.fps_base / scene.render.fps
    np.savez(folder / CHARACTER, positions=np.stack(positions), faces=faces.reshape(-1, 3), times=times)
    return len(positions)


def write_garment(garment: Any, folder: Path) -> None:
    """Write a garment's mesh, without modifiers, its texture coordinates, and its vertex groups."""
    mesh, layer = garment.data, garment.data.uv_layers.active
    lines = ["v {!r} {!r} {!r}".format(*row) for row in vertices_of(mesh, np.array(garment.matrix_world)).tolist()]
    lines += [f"vt {one.uv[0]!r} {one.uv[1]!r}" for one in layer.data] if layer else []
    for face in mesh.polygons:
        corners = [(mesh.loops[k].vertex_index + 1, k + 1) for k in face.loop_indices]
        lines.append("f " + " ".join(f"{i}/{k}" if layer else str(i) for i, k in corners))
    (folder / GARMENT).write_text("\n".join(lines) + "\n", encoding="utf-8")
    groups: dict[str, dict[int, float]] = {group.name: {} for group in garment.vertex_groups}
    for vertex in mesh.vertices:
        for one in vertex.groups:
            groups[garment.vertex_groups[one.group].name][vertex.index] = one.weight
    (folder / GROUPS).write_text(json.dumps(groups), encoding="utf-8")


def send(context: Any) -> Path:
    """Write the shot into its folder, and return the scene. Raises Failed."""
    shot = context.scene.nuno
    if shot.character is None or shot.garment is None:
        raise Failed("choose a character and a garment")
    if shot.pin and shot.pin not in shot.garment.vertex_groups:
        raise Failed(f"{shot.garment.name} has no vertex group {shot.pin}")
    folder = folder_of(context)
    folder.mkdir(parents=True, exist_ok=True)
    frames = write_character(context, shot.character, folder)
    write_garment(shot.garment, folder)
    render = context.scene.render
    write_scene(folder, frames, render.fps / render.fps_base, shot.preroll, shot.fabric, shot.pin)
    return folder / SCENE


def receive(context: Any) -> str:
    """Let the garment move as it was simulated, by a modifier, and say so. Raises Failed."""
    shot, folder = context.scene.nuno, folder_of(context)
    done = subprocess.run(
        [program(context), "export", RECORDING, "--pc2", MOTION],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise Failed(done.stderr.strip() or "nuno could not export the recording")
    points = localise(folder / MOTION, np.array(shot.garment.matrix_world))
    if points != len(shot.garment.data.vertices):
        raise Failed(f"{shot.garment.name} has other vertices than the garment that was simulated: send it again")
    found = shot.garment.modifiers.get(CACHE) or shot.garment.modifiers.new(CACHE, "MESH_CACHE")
    found.cache_format, found.filepath = "PC2", str(folder / MOTION)
    found.frame_start = context.scene.frame_start - shot.preroll
    return f"{shot.garment.name} moves by the modifier {CACHE}"


def folder_of(context: Any) -> Path:
    """Return the folder of the shot."""
    return Path(bpy.path.abspath(context.scene.nuno.folder)).resolve()


def program(context: Any) -> str:
    """Return nuno's path. Raises Failed."""
    found = shutil.which(bpy.path.abspath(context.scene.nuno.program))
    if found is None:
        raise Failed("nuno is not there: give the path of the program nuno, of a virtual environment perhaps")
    return found


def attempt(operator: Any, task: Callable[[], str]) -> set[str]:
    """Do what a button stands for, and report how it went."""
    try:
        operator.report({"INFO"}, task())
    except Failed as failed:
        operator.report({"ERROR"}, str(failed))
        return {"CANCELLED"}
    return {"FINISHED"}


class NUNO_OT_send(bpy.types.Operator):  # noqa: N801
    """Write the shot as a scene of nuno"""

    bl_idname, bl_label = "nuno.send", "Send"

    def execute(self, context: Any) -> set[str]:
        return attempt(self, lambda: f"wrote {send(context)}")


class NUNO_OT_run(bpy.types.Operator):  # noqa: N801
    """Simulate the shot; escape stops it"""

    bl_idname, bl_label = "nuno.run", "Run"

    def invoke(self, context: Any, event: Any) -> set[str]:
        try:
            command = [program(context), "run", SCENE, "--no-view", "--record", RECORDING]
        except Failed as failed:
            self.report({"ERROR"}, str(failed))
            return {"CANCELLED"}
        self.said = (folder_of(context) / "nuno.log").open("w+", encoding="utf-8")
        self.process = subprocess.Popen(command, cwd=folder_of(context), stdout=self.said, stderr=subprocess.STDOUT)
        self.timer = context.window_manager.event_timer_add(0.5, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type == "ESC":
            self.process.terminate()
        if event.type != "TIMER" or (code := self.process.poll()) is None:
            self.said.seek(0)
            context.workspace.status_text_set((["nuno", *self.said.read().split("\n")])[-2])
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        context.workspace.status_text_set(None)
        self.said.seek(0)
        self.report({"INFO"} if code == 0 else {"ERROR"}, self.said.read()[-600:])
        self.said.close()
        return {"FINISHED"}


class NUNO_OT_receive(bpy.types.Operator):  # noqa: N801
    """Let the garment move as it was simulated"""

    bl_idname, bl_label = "nuno.receive", "Bring back"

    def execute(self, context: Any) -> set[str]:
        return attempt(self, lambda: receive(context))


class NUNO_PT_panel(bpy.types.Panel):  # noqa: N801
    """The shot, and what is done with it"""

    bl_idname, bl_label = "NUNO_PT_panel", "nuno"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "nuno"

    def draw(self, context: Any) -> None:
        shot = context.scene.nuno
        for name in ("character", "garment", "fabric", "pin", "preroll", "folder", "program"):
            self.layout.prop(shot, name)
        for operator in OPERATORS:
            self.layout.operator(operator.bl_idname)


def is_mesh(shot: Any, found: Any) -> bool:
    """Return whether an object may be chosen."""
    return bool(found.type == "MESH")


class NUNO_shot(bpy.types.PropertyGroup):  # noqa: N801
    """What a shot is made of"""

    character: bpy.props.PointerProperty(name="Character", type=bpy.types.Object, poll=is_mesh)
    garment: bpy.props.PointerProperty(name="Garment", type=bpy.types.Object, poll=is_mesh)
    fabric: bpy.props.StringProperty(name="Fabric", default="interlock", description="as nuno fabrics lists them")
    pin: bpy.props.StringProperty(name="Pin", description="vertex group of the garment that stays on the character")
    preroll: bpy.props.IntProperty(name="Pre-roll", default=12, min=0, description="frames for the garment to settle")
    folder: bpy.props.StringProperty(name="Folder", default="//nuno", subtype="DIR_PATH")
    program: bpy.props.StringProperty(name="Program", default="nuno", subtype="FILE_PATH")


OPERATORS = (NUNO_OT_send, NUNO_OT_run, NUNO_OT_receive)


def register() -> None:
    """Add the panel to Blender."""
    for one in (NUNO_shot, *OPERATORS, NUNO_PT_panel):
        bpy.utils.register_class(one)
    bpy.types.Scene.nuno = bpy.props.PointerProperty(type=NUNO_shot)


def unregister() -> None:
    """Take it away again."""
    del bpy.types.Scene.nuno
    for one in (NUNO_PT_panel, *OPERATORS, NUNO_shot):
        bpy.utils.unregister_class(one)
