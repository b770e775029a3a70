"""Small valid files of every kind, from which changed ones are made."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

BVH = b"""HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Leg
  {
    OFFSET 0 -1 0.1
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -1 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.0333333
0 2 0 0 0 0 10 0 0
0 2 0.1 0 5 0 20 0 0
0.1 2 0.2 3 5 0 20 0 1
"""
WIF = b"""[WIF]
Version=1.1
[CONTENTS]
WEAVING=true
[WEAVING]
Shafts=2
Treadles=2
Rising Shed=true
[WARP]
Threads=4
Color=2
Units=Centimeters
Spacing=0.05
Thickness=0.04
[WEFT]
Threads=2
Color=1
Units=Centimeters
Spacing=0.1
Thickness=0.08
[COLOR PALETTE]
Range=0,255
[COLOR TABLE]
1=255,255,255
2=0,51,102  ; indigo
[WARP COLORS]
3=1
[WARP SPACING]
2=0.06
[THREADING]
1=1
2=2
3=1
4=2
"""
TIE_UP = b"[TIEUP]\n1=1\n2=2\n[TREADLING]\n1=1\n2=2\n"
LIFT_PLAN = b"[LIFTPLAN]\n1=1\n2=2\n"
TAU3 = {"I": 0.1, "II": 0.1, "III": 0.1}
SIDE = 8
"""Cells and pixels of a cloth to dye."""


def _tetrahedron() -> Any:
    import trimesh

    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    return trimesh.Trimesh(x, faces, process=False)


def mesh_seeds(kind: str, folder: Path) -> list[bytes]:
    mesh = _tetrahedron()
    if kind == "ply":
        return [mesh.export(file_type="ply", encoding=encoding) for encoding in ("ascii", "binary")]
    if kind == "stl":
        return [mesh.export(file_type="stl"), mesh.export(file_type="stl_ascii").encode()]
    if kind == "glb":
        return [mesh.export(file_type="glb")]
    plain = mesh.export(file_type="obj").encode()
    quad = b"mtllib a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
    return [plain, quad + b"f 1/1/1 2/2/1 3/3/1 4/4/1\n", quad + b"o a\ng b\ns 1\nf -4//-1 -3//-1 -2//-1\nf 1 3 4\n"]


def net_seeds(folder: Path) -> list[bytes]:
    plain: dict[str, Any] = {
        "x": np.arange(4)[:, None] * np.array([1.0, 0.0, 0.0]), "v": np.zeros((4, 3)), "m": np.ones(4),
        "pinned": np.arange(4) == 0, "springs": np.array([[0, 1], [1, 2], [2, 3]]), "k": np.ones(3),
        "rest": np.ones(3), "c": np.zeros(3),
    }  # fmt: skip
    yarns = {"yarn_links": np.arange(3), "yarn_ptr": np.array([0, 3]), "mu": np.array([0.1])}
    locks = {"lock": 0.1 * np.ones(3), "k_lock": 2 * np.ones(3)}
    return [_npz(**plain), _npz(**plain, **yarns), _npz(**plain, **locks)]


def cell_seeds(folder: Path) -> list[bytes]:
    shape = (2, 3, 4)
    flags = {name: np.ones(shape, bool) for name in ("fibre", "up")}
    numbers = {name: np.full(shape, 0.5) for name in ("porosity", "tau1")}
    return [_npz(**flags, **numbers, **{name: np.zeros(shape) for name in ("resist", "phi", "fixed")})]


def _npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def image_seed(mode: str, kind: str = "PNG") -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    values = (np.arange(SIDE * SIDE * 3).reshape(SIDE, SIDE, 3) * 5 % 256).astype(np.uint8)
    values[:, ::2] = (32, 64, 128)
    grey = Image.fromarray(values[..., 0].astype(np.uint16) * 257) if mode == "I;16" else None
    (grey or Image.fromarray(values).convert(mode)).save(stream, format=kind)
    return stream.getvalue()
