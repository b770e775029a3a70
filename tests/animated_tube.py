"""An animated tube of two bones, in every format, and where its vertices are by a formula: linear blend skinning of a
bone that bends about its end, and a morph target that swells it.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from nuno_schemas.fabric import Float, Int

RATE = 24.0
LENGTH, RADIUS = 0.4, 0.05


def tube(rows: int = 13, around: int = 12, closed: bool = True) -> tuple[Float, Int]:
    """A tube along y from -LENGTH to LENGTH, closed at both ends or open."""
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = RADIUS * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
    heights = np.linspace(-LENGTH, LENGTH, rows)
    x = (ring[None] + heights[:, None, None] * np.array([0.0, 1.0, 0.0])).reshape(-1, 3)
    at = np.arange((rows - 1) * around)
    row, k = np.divmod(at, around)
    a, b = at, row * around + (k + 1) % around
    faces = np.concatenate([np.stack([a, a + around, b], axis=1), np.stack([b, a + around, b + around], axis=1)])
    if closed:
        k, after, n = np.arange(around), (np.arange(around) + 1) % around, len(x)
        x = np.concatenate([x, [[0.0, -LENGTH, 0.0], [0.0, LENGTH, 0.0]]])
        top = n - around
        bottom = np.stack([np.full(around, n), k, after], axis=1)
        faces = np.concatenate([faces, bottom, np.stack([np.full(around, n + 1), top + after, top + k], axis=1)])
    return x, faces.astype(np.int32)


def weights(x: Float) -> Float:
    """(n, 2) how much the lower and the upper bone carry of each vertex."""
    upper = np.clip(0.5 + x[:, 1] / 0.3, 0.0, 1.0)
    return np.stack([1.0 - upper, upper], axis=1)


def bend_at(t: float) -> float:
    """Angle of the upper bone about z at time t [s]."""
    return float(0.9 * np.sin(2.0 * np.pi * t))


def swell_at(t: float) -> float:
    """Amount of the morph target."""
    return float(0.5 - 0.5 * np.cos(2.0 * np.pi * t))


def shift_at(t: float) -> Float:
    """Place of the lower bone, and so of everything [m]."""
    return np.array([0.3 * t, 0.1 * np.sin(4.0 * t), 0.0])


def swelling(x: Float) -> Float:
    """(n, 3) the morph target's shifts."""
    return 0.3 * x * np.array([1.0, 0.0, 1.0])


def posed(x: Float, t: float) -> Float:
    """(n, 3) where the vertices are at time t: each goes with the mean of where the bones would put it."""
    c, s = np.cos(bend_at(t)), np.sin(bend_at(t))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    y = x + swell_at(t) * swelling(x)
    lower, upper = weights(x).T
    return np.asarray(lower[:, None] * y + upper[:, None] * (y @ turn.T) + shift_at(t))


def times(frames: int) -> Float:
    return np.arange(frames) / RATE


class Glb:
    """A GLB file that is put together array by array."""

    def __init__(self) -> None:
        self.data, self.views, self.accessors = b"", list[Any](), list[Any]()

    def add(self, values: Any, kind: str, component: int = 5126) -> int:
        array = np.ascontiguousarray(values, {5126: "<f4", 5125: "<u4", 5121: "u1"}[component])
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes})
        self.data += array.tobytes() + b"\0" * (-array.nbytes % 4)
        count = array.size // {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[kind]
        view = len(self.views) - 1
        self.accessors.append({"bufferView": view, "componentType": component, "type": kind, "count": count})
        return len(self.accessors) - 1

    def write(self, path: Path, document: dict[str, Any]) -> None:
        document = {"asset": {"version": "2.0"}, "bufferViews": self.views, "accessors": self.accessors,
                    "buffers": [{"byteLength": len(self.data)}]} | document  # fmt: skip
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.data), b"BIN\0") + self.data
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def write_glb(path: Path, x: Float, faces: Int, at: Float, split: bool = False) -> None:
    """As a GLB file with the clips Walk and Rest, which does nothing; or split, with the morph target's as Keys."""
    glb = Glb()
    half = 0.5 * np.array([bend_at(t) for t in at])
    turns = np.stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)], axis=1)
    keys = glb.add(at, "SCALAR")
    bind = np.tile(np.eye(4), (2, 1, 1))
    share, joint = np.pad(weights(x), ((0, 0), (0, 2))), np.tile([0, 1, 0, 0], (len(x), 1))
    attributes = {
        "POSITION": glb.add(x, "VEC3"), "WEIGHTS_0": glb.add(share, "VEC4"), "JOINTS_0": glb.add(joint, "VEC4", 5121),
    }  # fmt: skip
    targets = [{"POSITION": glb.add(swelling(x), "VEC3")}]
    part = {"attributes": attributes, "indices": glb.add(faces, "SCALAR", 5125), "targets": targets}
    samplers = [{"input": keys, "output": glb.add(values, kind)} for values, kind in (
        (turns, "VEC4"), ([shift_at(t) for t in at], "VEC3"), ([swell_at(t) for t in at], "SCALAR"))]  # fmt: skip
    channels = [{"sampler": k, "target": {"node": node, "path": what}}
                for k, (node, what) in enumerate([(2, "rotation"), (1, "translation"), (0, "weights")])]  # fmt: skip
    nodes = [{"name": "Body", "mesh": 0, "skin": 0}, {"name": "lower", "children": [2]}, {"name": "upper"}]
    skins = [{"joints": [1, 2], "inverseBindMatrices": glb.add(bind, "MAT4")}]
    parts = [("Walk", channels[:2]), ("Keys", channels[2:])] if split else [("Walk", channels), ("Rest", [])]
    clips = [{"name": name, "samplers": samplers, "channels": own} for name, own in parts]
    document = {"nodes": nodes, "meshes": [{"name": "tube", "primitives": [part]}], "skins": skins, "animations": clips,
                "scenes": [{"nodes": [0, 1]}], "scene": 0}  # fmt: skip
    glb.write(path, document)


def write_npz(path: Path, frames: Float, faces: Int, **more: Any) -> None:
    np.savez(path, positions=frames, faces=faces, **more)


def write_pc2(path: Path, frames: Float) -> None:
    m, n, _ = frames.shape
    path.write_bytes(struct.pack("<12siiffi", b"POINTCACHE2\0", 1, n, 1.0, 1.0, m) + frames.astype("<f4").tobytes())


def write_mdd(path: Path, frames: Float) -> None:
    m, n, _ = frames.shape
    head = struct.pack(">ii", m, n) + times(m).astype(">f4").tobytes()
    path.write_bytes(head + frames.astype(">f4").tobytes())


def write_sequence(folder: Path, frames: Float, faces: Int, first: int = 95) -> str:
    """As OBJ files from that number on; the name of the first."""
    triangles = "".join(f"f {a} {b} {c}\n" for a, b, c in (faces + 1).tolist())
    for k, x in enumerate(frames):
        vertices = "".join(f"v {a:.9g} {b:.9g} {c:.9g}\n" for a, b, c in x.tolist())
        (folder / f"tube_{first + k}.obj").write_text(vertices + triangles)
    return f"tube_{first}.obj"


def write_usd(path: Path, x: Float, faces: Int, frames: int) -> None:
    """As a USD stage, z up, in centimetres, with a skeleton and a blend shape."""
    from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

    back = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y up to z up
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(RATE)
    stage.SetStartTimeCode(101)
    stage.SetEndTimeCode(100 + frames)
    UsdSkel.Root.Define(stage, "/Hero")
    mesh = UsdGeom.Mesh.Define(stage, "/Hero/Body")
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy((100.0 * x @ back.T).astype(np.float32)))
    mesh.GetFaceVertexCountsAttr().Set([3] * len(faces))
    mesh.GetFaceVertexIndicesAttr().Set(faces.ravel().tolist())
    shape = UsdSkel.BlendShape.Define(stage, "/Hero/Body/swell")
    shape.GetOffsetsAttr().Set(Vt.Vec3fArray.FromNumpy((100.0 * swelling(x) @ back.T).astype(np.float32)))
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateBlendShapesAttr(["swell"])
    binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * len(x))
    binding.CreateJointWeightsPrimvar(False, 2).Set(weights(x).ravel().tolist())
    skeleton = UsdSkel.Skeleton.Define(stage, "/Hero/Bones")
    skeleton.GetJointsAttr().Set(["lower", "lower/upper"])
    skeleton.GetBindTransformsAttr().Set([Gf.Matrix4d(1.0)] * 2)
    skeleton.GetRestTransformsAttr().Set([Gf.Matrix4d(1.0)] * 2)
    motion = UsdSkel.Animation.Define(stage, "/Hero/Motion")
    motion.GetJointsAttr().Set(["lower", "lower/upper"])
    motion.GetBlendShapesAttr().Set(["swell"])
    motion.GetScalesAttr().Set([Gf.Vec3h(1.0)] * 2)
    for k, t in enumerate(times(frames).tolist()):
        code, half = Usd.TimeCode(101 + k), 0.5 * bend_at(t)
        motion.GetRotationsAttr().Set([Gf.Quatf(1.0), Gf.Quatf(np.cos(half), 0.0, -np.sin(half), 0.0)], code)
        shift = (100.0 * back @ shift_at(t)).tolist()
        motion.GetTranslationsAttr().Set([Gf.Vec3f(*shift), Gf.Vec3f(0.0)], code)
        motion.GetBlendShapeWeightsAttr().Set([swell_at(t)], code)
    for prim in (mesh.GetPrim(), skeleton.GetPrim()):
        bound = UsdSkel.BindingAPI.Apply(prim)
        bound.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        bound.CreateAnimationSourceRel().SetTargets([motion.GetPath()])
    stage.Save()
