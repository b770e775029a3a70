"""Files that a scene names, each read by the plugin that a scene would give it to."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from nuno import registry
from nuno_bench.soak.fuzz.kind import Kind, OneFile, Read, require, require_finite
from nuno_bench.soak.fuzz.mutate_containers import mutate_npz, mutate_png
from nuno_bench.soak.fuzz.mutate_text import mutate_bytes, mutate_text
from nuno_bench.soak.fuzz.seeds import (
    BVH,
    LIFT_PLAN,
    SIDE,
    TAU3,
    TIE_UP,
    WIF,
    cell_seeds,
    image_seed,
    mesh_seeds,
    net_seeds,
)


def _of_plugin(group: str, name: str, suffix: str, use: Callable[[Any, OneFile], None]) -> Callable[[Path], Read]:
    """A reader that writes its input to a file of `suffix` and lets a plugin use it."""

    def reader(folder: Path) -> Read:
        plugin, path = registry.load(group, name), folder / f"input{suffix}"
        files = OneFile(path)

        def read(data: bytes) -> None:
            path.write_bytes(data)
            use(plugin, files)

        return read

    return reader


def _move(plugin: Any, files: OneFile) -> None:
    mover = plugin.prepare(plugin.Config(file="x", end="loop"), files)
    number = len(mover.joints)
    require(bool((np.asarray(mover.parents) < np.arange(number)).all()), "parents come before their joints")
    for t in (0.0, 0.05, 7.0):
        rotation, translation = mover.pose(t)
        require(rotation.shape == (number, 4) and translation.shape == (number, 3), "a pose of every joint")
        require_finite(rotation=rotation, translation=translation)


def _wear(plugin: Any, files: OneFile, **fields: Any) -> None:
    config = plugin.Config(file="x", **fields)
    fabric = plugin.build(config, files, 0)
    number = len(fabric.position)
    if fabric.mass.sum() > 0.1:  # to read a file three times for each input would take three times as long
        require(number == plugin.count(config, files), "as many vertices as were counted")
    require_finite(position=fabric.position, velocity=fabric.velocity, mass=fabric.mass)
    require(bool((fabric.mass > 0).all()), "every mass is above 0")
    if fabric.faces.size:
        require(bool(fabric.faces.min() >= 0 and fabric.faces.max() < number), "faces of vertices that are there")
    if fabric.springs is not None:
        require_finite(k=fabric.springs.k, rest=fabric.springs.rest, c=fabric.springs.c)


def _collide(plugin: Any, files: OneFile) -> None:
    shape = plugin.build(plugin.Config(file="x"), None, files)
    require_finite(vertices=shape.vertices, a=shape.a, b=shape.b)
    require(
        bool(shape.faces.min() >= 0 and shape.faces.max() < len(shape.vertices)), "faces of vertices that are there"
    )


def _dye(plugin: Any, files: OneFile, **fields: Any) -> None:
    config = plugin.Config(tau3={name: TAU3[name] for name in plugin.Config.model_fields["tau3"].annotation.model_fields
                                 if name in TAU3}, **fields)  # fmt: skip
    number = plugin.count(config, files)
    cells, state = plugin.build(config, files, 0, 1)
    require(cells.fibre.size == number, "as many cells as were counted")
    for name in ("porosity", "twist", "resist"):
        values = getattr(cells, name)
        require(bool(((values >= 0) & (values <= 1)).all()), f"{name} from 0 to 1")
    require_finite(phi=state.phi, fixed=state.fixed)
    plugin.supplies(config, cells, ["dye"])


def _woven(plugin: Any, files: OneFile) -> None:
    for measured in (False, True):
        _dye(
            plugin,
            files,
            cells=[SIDE, SIDE],
            cell_size=1e-4,
            weave={"plugin": "wif", "file": "x", "measured": measured},
        )


def _stencil(plugin: Any, files: OneFile) -> None:
    for fit in ("stretch", "exact"):
        _dye(plugin, files, cells=[SIDE, SIDE], cell_size=1e-4, resist=[{"kind": "image", "file": "x", "fit": fit}])


def _photograph(plugin: Any, files: OneFile) -> None:
    _dye(
        plugin, files, file="x", pixels=2, colours={"warp": "#204080", "weft": "#f0e0d0", "lightness": 0.5, "clean": 1}
    )


def _lines(plugin: Any, files: OneFile) -> None:
    found = plugin.resolve(plugin.Config(lines=[{"file": "x", "height": 0.01}]), files)
    for line in found.lines:
        require(len(line.points) >= 2, "two points at least")
        require_finite(points=np.array(line.points))


def _mesh_mutate(kind: str, data: bytes, random: Random) -> bytes:
    if kind == "glb" and random.random() < 0.7 and data[:4] == b"glTF" and len(data) > 20:
        length = struct.unpack_from("<I", data, 12)[0]
        text, rest = mutate_text(data[20 : 20 + length], random, GLTF), data[20 + length :]
        text += b" " * (-len(text) % 4)
        return data[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest
    if kind == "ply" and b"end_header\n" in data and random.random() < 0.5:
        head, body = data.split(b"end_header\n", 1)
        return mutate_text(head, random, PLY) + b"end_header\n" + body
    textual = kind == "obj" or data[:5] == b"solid" or b"format ascii" in data[:40]
    return mutate_text(data, random, WORDS[kind]) if textual and random.random() < 0.8 else mutate_bytes(data, random)


PLY = ("element vertex 999999999999", "element face -1", "property list uchar int vertex_indices", "property float x",
       "property double q", "format ascii 1.0", "format binary_big_endian 1.0", "comment", "list", "uint8", "int",
       "nan", "element face", "element vertex")  # fmt: skip
GLTF = ('"count":999999999999', '"byteOffset":-1', '"byteLength":1e12', '"sparse":{}', '"uri":"file:///etc/passwd"',
        '"mode":1', "null", "[]", "{}", "-1", '"children":[0]', '"matrix":[0]', '"scale":[0,0,0]', '"type":"VEC4"',
        '"componentType":5121')  # fmt: skip
WORDS = {
    "obj": ("f ", "v ", "vt ", "vn ", "l ", "0", "-1", "99999999999", "//", "/", "nan", "\\\n", "g", "usemtl x"),
    "ply": PLY,
    "stl": ("facet normal", "vertex", "endloop", "solid", "outer loop", "endfacet", "nan"),
    "glb": GLTF,
}


def _text(name: str, seeds: list[bytes], words: tuple[str, ...], **more: Any) -> Kind:
    return Kind(name, lambda folder: seeds, mutate=lambda data, random: mutate_text(data, random, words), **more)


def _mesh(kind: str) -> Kind:
    wear = _of_plugin("nuno.models", "mesh", f".{kind}", partial(_wear, merge=False))
    collide = _of_plugin("nuno.colliders", "mesh", f".{kind}", _collide)
    field = () if kind == "glb" else ("nuno_cloth.models.mesh",)
    return Kind(
        kind.upper(), partial(mesh_seeds, kind), _either(wear, collide) if kind != "glb" else collide,
        partial(_mesh_mutate, kind), (*field, "nuno_kernels.meshes.file"), follows=("trimesh.exchange",),
    )  # fmt: skip


def _either(first: Callable[[Path], Read], second: Callable[[Path], Read]) -> Callable[[Path], Read]:
    """Two readers of one kind of file: each reads the half of the inputs."""

    def reader(folder: Path) -> Read:
        readers = first(folder), second(folder)

        def read(data: bytes) -> None:
            readers[zlib.crc32(data) & 1](data)

        return read

    return reader


FILES = (
    _text(
        "BVH", [BVH], ("JOINT a", "End Site", "CHANNELS 3 Zrotation Xrotation Yrotation", "Frames: 1000000", "OFFSET",
        "MOTION", "}", "{", "ROOT b", "Frame Time: 0"),
        reader=_of_plugin("nuno.motions", "bvh", ".bvh", _move),
        modules=("nuno_contact.motions.bvh",), follows=("pybvh",),
    ),
    *map(_mesh, ("obj", "ply", "stl", "glb")),
    _text(
        "WIF", [WIF + TIE_UP, WIF + LIFT_PLAN], ("[WIF]", "[TIEUP]", "Threads=1000000", "Shafts=99999", "1=1,2,3,4",
        ";", "=", "[", "]", ",", "Units=Inches", "[WEFT SPACING]", "[WARP THICKNESS]", "0=0", "Rising Shed=false"),
        reader=_of_plugin("nuno.dye_cloths", "woven", ".wif", _woven),
        modules=("nuno_dye.drafts.wif", "nuno_dye.drafts.text", "nuno_dye.drafts.yarns"),
    ),
    Kind(
        "PNG resist", lambda folder: [image_seed(mode) for mode in ("L", "LA", "1", "I;16")],
        _of_plugin("nuno.dye_cloths", "woven", ".png", _stencil), mutate_png, ("nuno_dye.supplies.resist",),
        follows=("PIL.PngImagePlugin", "PIL.ImageFile"),
    ),
    Kind(
        "photograph", lambda folder: [image_seed("RGB"), image_seed("RGBA"), image_seed("RGB", "JPEG")],
        _of_plugin("nuno.dye_cloths", "photograph", ".png", _photograph), mutate_png,
        ("nuno_dye.cloths.photograph", "nuno_dye.cloths.photograph_cloth"),
        follows=("PIL.PngImagePlugin", "PIL.JpegImagePlugin", "PIL.ImageFile", "PIL.TiffImagePlugin"),
    ),
    Kind(
        "npz of a net", net_seeds, _of_plugin("nuno.models", "net", ".npz", _wear), mutate_npz,
        ("nuno_cloth.models.net", "nuno_cloth.models.net_yarns"), follows=("zipfile", "numpy.lib._format_impl"),
    ),
    Kind(
        "npz of cells", cell_seeds,
        _of_plugin("nuno.dye_cloths", "cells", ".npz", partial(_dye, file="x", cell_size=1e-4)), mutate_npz,
        ("nuno_dye.cloths.cells_file", "nuno_dye.cloths.cells"), follows=("zipfile", "numpy.lib._format_impl"),
    ),
    _text(
        "OBJ of lines", [b"v 0 0 0\nv 1 0 0\nv 1 1 0\nl 1 2 3\nl -1 -2\nl 1/1 2/2\n"], WORDS["obj"],
        reader=_of_plugin("nuno.operations", "wrinkle", ".obj", _lines), modules=("nuno_wrinkle.lines",),
    ),
)  # fmt: skip
