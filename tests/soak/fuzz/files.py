"""Files that a scene names, each read by the plugin that a scene would give it to.

The results of a plugin are checked against the contract of its kind (`nuno.plugin_contract.guards`), as those of
foreign plugins are.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from nuno.plugin_contract import guards as results
from nuno.plugin_contract import registry
from nuno.scene.files import SceneFiles
from soak.fuzz.containers import ARRAYS, IMAGE, mutate_glb
from soak.fuzz.kind import TAU3, Kind, Read, require, require_finite
from soak.fuzz.mutate import mutate_bytes, mutate_text

SIDE = 8
"""Cells and pixels of a cloth to dye."""
WOVEN = {"cells": [SIDE, SIDE], "cell_size": 1e-4, "tau3": TAU3}
PHOTOGRAPH = {
    "file": "input.png", "pixels": 2, "tau3": {"I": 0.1, "II": 0.1},
    "colours": {"warp": "#204080", "weft": "#f0e0d0", "lightness": 0.5, "clean": 1},
}  # fmt: skip
Use = tuple[str, str, dict[str, Any]]
"""Group and name of a plugin, and the fields of its configuration."""


def made(group: str, plugin: Any, config: Any, files: Any) -> None:
    """Let a plugin read its file, and hold what it makes against what it owes. Raises BadInput, Wrong or Broken."""

    def call(method: str, *args: Any) -> Any:
        found = getattr(plugin, method)(*args)
        results.check(group, method, found, args)
        return found

    if group == "nuno.models":
        fabric = call("build", config, files, 0)
        if fabric.mass.sum() > 0.1:  # to read a file three times for each input would take three times as long
            require(call("count", config, files) == fabric.number, "as many vertices as were counted")
    elif group == "nuno.colliders":
        call("build", config, None, files)
    elif group == "nuno.motions":
        mover = call("prepare", config, files)
        for t in (0.0, 0.05, 7.0):
            rotation, translation = mover.pose(t)
            require(rotation.shape == (len(mover.joints), 4) == (len(translation), 4), "a pose of every joint")
            require_finite(rotation=rotation, translation=translation)
    elif group == "nuno.dye_cloths":
        cells, _ = call("build", config, files, 0, ["dye"])
        require(call("count", config, files) == cells.fibre.size, "as many cells as were counted")
        call("supplies", config, cells, ["dye"])
    else:
        for line in plugin.resolve(config, files).lines:
            require(len(line.points) >= 2, "two points at least")
            require_finite(points=np.array(line.points))


def _reader(suffix: str, uses: Sequence[Use], folder: Path) -> Read:
    path, files = folder / f"input{suffix}", SceneFiles(folder)
    chosen = [
        (group, plugin, plugin.Config.model_validate(fields))
        for group, plugin, fields in ((group, registry.load(group, name), fields) for group, name, fields in uses)
    ]

    def read(data: bytes) -> None:
        path.write_bytes(data)
        for group, plugin, config in chosen:
            made(group, plugin, config, files)

    return read


def _file(
    name: str,
    suffix: str,
    seeds: Callable[[], list[bytes]],
    mutate: Callable[[bytes, Random], bytes] | tuple[str, ...],
    follows: tuple[str, ...],
    *uses: Use,
) -> Kind:
    """A kind of file; `mutate` may be the words of a language."""
    change = (lambda data, random: mutate_text(data, random, mutate)) if isinstance(mutate, tuple) else mutate
    return Kind(name, lambda folder: seeds(), lambda folder: _reader(suffix, uses, folder), change, follows)


def _mesh(kind: str, *words: str) -> Kind:
    """A format of triangles, text or bytes, worn as cloth and met as a body."""

    def mutate(data: bytes, random: Random) -> bytes:
        if kind == "glb":
            return mutate_glb(data, random)
        head, mark, body = data.partition(b"end_header\n")
        if mark and random.random() < 0.5:
            return mutate_text(head, random, words) + mark + body
        textual = kind == "obj" or data[:5] == b"solid" or b"format ascii" in data[:40]
        return mutate_text(data, random, words) if textual and random.random() < 0.8 else mutate_bytes(data, random)

    name = {"file": f"input.{kind}"}
    cloth: list[Use] = [] if kind == "glb" else [("nuno.models", "mesh", name | {"merge": False})]
    readers = tuple(f"nuno_geometry.mesh_files.{name}" for name in ("mesh", "polygons", "obj", "ply", "stl", "glb"))
    follows = ("nuno_cloth.models.mesh", "nuno_cloth.models.membrane", *readers)
    return _file(kind.upper(), f".{kind}", lambda: mesh_seeds(kind), mutate, follows, *cloth,
                 ("nuno.colliders", "mesh", name))  # fmt: skip


def mesh_seeds(kind: str) -> list[bytes]:
    """A tetrahedron, as trimesh writes it, and a square of quads with all that an OBJ may say."""
    import trimesh

    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    solid = trimesh.Trimesh(x, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]), process=False)
    ways: dict[str, list[dict[str, Any]]] = {
        "ply": [{"encoding": "ascii"}, {"encoding": "binary"}], "stl": [{}, {"file_type": "stl_ascii"}],
    }  # fmt: skip
    found = [solid.export(**({"file_type": kind} | way)) for way in ways.get(kind, [{}])]
    plain = [data.encode() if isinstance(data, str) else bytes(data) for data in found]
    if kind != "obj":
        return plain
    quad = b"mtllib a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
    return [*plain, quad + b"f 1/1/1 2/2/1 3/3/1 4/4/1\n", quad + b"o a\ng b\ns 1\nf -4//-1 -3//-1 -2//-1\nf 1 3 4\n"]


def net_seeds() -> list[bytes]:
    plain: dict[str, Any] = {
        "x": np.arange(4)[:, None] * np.array([1.0, 0.0, 0.0]), "v": np.zeros((4, 3)), "m": np.ones(4),
        "pinned": np.arange(4) == 0, "springs": np.array([[0, 1], [1, 2], [2, 3]]), "k": np.ones(3),
        "rest": np.ones(3), "c": np.zeros(3),
    }  # fmt: skip
    yarns = {"yarn_links": np.arange(3), "yarn_ptr": np.array([0, 3]), "mu": np.array([0.1])}
    return [_npz(**plain), _npz(**plain, **yarns), _npz(**plain, lock=0.1 * np.ones(3), k_lock=2 * np.ones(3))]


def _cell_seeds() -> list[bytes]:
    shape = (2, 3, 4)
    values = dict.fromkeys(("fibre", "up"), np.ones(shape, bool)) | dict.fromkeys(
        ("porosity", "tau1"), np.full(shape, 0.5)
    )
    return [_npz(**values, **dict.fromkeys(("resist", "phi", "fixed"), np.zeros(shape)))]


def _npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def _image(mode: str, kind: str = "PNG") -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    values = (np.arange(SIDE * SIDE * 3).reshape(SIDE, SIDE, 3) * 5 % 256).astype(np.uint8)
    values[:, ::2] = (32, 64, 128)
    grey = Image.fromarray(values[..., 0].astype(np.uint16) * 257) if mode == "I;16" else None
    (grey or Image.fromarray(values).convert(mode)).save(stream, format=kind)
    return stream.getvalue()


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
  JOINT Spine
  {
    OFFSET 0 1 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 1 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.0333333
0 2 0 0 0 0 10 0 0 0 0 0
0 2 0.1 0 5 0 20 0 0 0 0 0
0.1 2 0.2 3 5 0 20 0 1 0 0 0
"""
WIF = b"""[WIF]\nVersion=1.1\n[CONTENTS]\nWEAVING=true\n[WEAVING]\nShafts=2\nTreadles=2\nRising Shed=true
[WARP]\nThreads=4\nColor=2\nUnits=Centimeters\nSpacing=0.05\nThickness=0.04
[WEFT]\nThreads=2\nColor=1\nUnits=Centimeters\nSpacing=0.1\nThickness=0.08
[COLOR PALETTE]\nRange=0,255\n[COLOR TABLE]\n1=255,255,255\n2=0,51,102  ; indigo\n[WARP COLORS]\n3=1
[WARP SPACING]\n2=0.06\n[THREADING]\n1=1\n2=2\n3=1\n4=2
"""
DRAFTS = [WIF + b"[TIEUP]\n1=1\n2=2\n[TREADLING]\n1=1\n2=2\n", WIF + b"[LIFTPLAN]\n1=1\n2=2\n"]
BVH_WORDS = ("JOINT a", "End Site", "CHANNELS 3 Zrotation Xrotation Yrotation", "Frames: 1000000", "OFFSET", "MOTION",
             "}", "{", "ROOT b", "Frame Time: 0")  # fmt: skip
WIF_WORDS = ("[WIF]", "[TIEUP]", "Threads=1000000", "Shafts=99999", "1=1,2,3,4", ";", "=", "[", "]", ",",
             "Units=Inches", "[WEFT SPACING]", "[WARP THICKNESS]", "0=0", "Rising Shed=false")  # fmt: skip
OBJ_WORDS = ("f ", "v ", "vt ", "vn ", "l ", "0", "-1", "99999999999", "//", "/", "nan", "\\\n", "g", "usemtl x")
PLY_WORDS = ("element vertex 999999999999", "element face -1", "property list uchar int vertex_indices", "list", "nan",
             "property float x", "property double q", "format ascii 1.0", "format binary_big_endian 1.0", "comment",
             "uint8", "int", "element face", "element vertex")  # fmt: skip
STL_WORDS = ("facet normal", "vertex", "endloop", "solid", "outer loop", "endfacet", "nan")
OUTLINE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nl 1 2 3\nl -1 -2\nl 1/1 2/2\n"
PNG_MODULES = ("PIL.PngImagePlugin", "PIL.JpegImagePlugin", "PIL.ImageFile", "PIL.TiffImagePlugin")
NPZ_MODULES = ("zipfile", "numpy.lib._format_impl")


def _weave(measured: bool) -> Use:
    return "nuno.dye_cloths", "woven", WOVEN | {"weave": {"plugin": "wif", "file": "input.wif", "measured": measured}}


def _stencil(fit: str) -> Use:
    return "nuno.dye_cloths", "woven", WOVEN | {"resist": [{"kind": "image", "file": "input.png", "fit": fit}]}


FILES = (
    _file("BVH", ".bvh", lambda: [BVH], BVH_WORDS, ("nuno_contact.motions.bvh", "pybvh"),
          ("nuno.motions", "bvh", {"file": "input.bvh", "end": "loop"})),
    _mesh("obj", *OBJ_WORDS), _mesh("ply", *PLY_WORDS), _mesh("stl", *STL_WORDS), _mesh("glb"),
    _file("WIF", ".wif", lambda: DRAFTS, WIF_WORDS, ("nuno_dye.weaving_drafts.wif", "nuno_dye.weaving_drafts.wif",
    "nuno_dye.weaving_drafts.wif"),
          _weave(False), _weave(True)),
    _file("PNG resist", ".png", lambda: [_image(mode) for mode in ("L", "LA", "1", "I;16")], IMAGE.mutate,
          ("nuno_dye.supplies.resist", *PNG_MODULES), _stencil("stretch"), _stencil("exact")),
    _file("photograph", ".png", lambda: [_image("RGB"), _image("RGBA"), _image("RGB", "JPEG")], IMAGE.mutate,
          ("nuno_dye.cloths.photograph_cloth", "nuno_dye.cloths.photograph_cloth", *PNG_MODULES),
          ("nuno.dye_cloths", "photograph", PHOTOGRAPH)),
    _file("npz of a net", ".npz", net_seeds, ARRAYS.mutate, ("nuno_cloth.models.net", "nuno_cloth.models.net",
    *NPZ_MODULES),
          ("nuno.models", "net", {"file": "input.npz"})),
    _file("npz of cells", ".npz", _cell_seeds, ARRAYS.mutate, ("nuno_dye.cloths.cells_file", "nuno_dye.cloths.cells",
    *NPZ_MODULES),
          ("nuno.dye_cloths", "cells", {"file": "input.npz", "cell_size": 1e-4, "tau3": TAU3})),
    _file("OBJ of lines", ".obj", lambda: [OUTLINE], OBJ_WORDS, ("nuno_wrinkle.lines",),
          ("nuno.operations", "wrinkle", {"lines": [{"file": "input.obj", "height": 0.01}]})),
)  # fmt: skip
