"""Meshes of GLB files as their nodes pose them (glTF 2.0, sections 3.5 to 3.7).

Weighed: pygltflib, which reads the JSON but decodes no array; trimesh, which leaves skins and morph targets out.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.check import place_of
from nuno_geometry.mesh_files.polygons import RawMesh
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
HARMLESS = (
    "KHR_mesh_quantization", "KHR_node_visibility", "KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp",
    "EXT_texture_", "EXT_lights_", "MSFT_texture_",
)  # fmt: skip
"""prefixes of extensions that are read, or change nothing of where a surface is"""
PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
MOST_ROWS = 1 << 24
"""most rows of an array that is zero but for a sparse one's entries"""
REPEATED = "EXT_mesh_gpu_instancing"


@dataclass(frozen=True)
class Part:
    """A primitive of a node in the scene.

    node: its number; points (n, 3) [m], as posed, or as the file has them; faces (f, 3); joint (n, w) int64 the nodes
    that carry each point and weight (n, w) how much, summing to 1; None of a mesh without a skin. targets: (n, 3) each,
    the shifts of morph targets; morph: how much of each there is unless the node says; bind: the inverse bind matrix
    (4, 4) of each node that carries it
    """

    node: int
    points: Float
    faces: NDArray[np.int64]
    joint: NDArray[np.int64] | None
    weight: Float | None
    targets: tuple[Float, ...]
    morph: tuple[float, ...]
    bind: Mapping[int, Float]

    def place(self, world: Mapping[int, Float], nodes: Any) -> Float:
        """Return its points (n, 3) [m], which are the file's, as the weights of its node in the JSON morph them and the
        nodes at `world` (4, 4) each carry them: by the sum of their matrices.
        """
        points = self.points
        for amount, target in zip(nodes[self.node].get("weights", self.morph), self.targets, strict=False):
            if amount:
                points = points + amount * target
        if self.joint is None or self.weight is None:
            return np.asarray(points @ world[self.node][:3, :3].T + world[self.node][:3, 3])
        moved = np.zeros((max(self.bind) + 1, 3, 4))
        for node, bound in self.bind.items():
            moved[node] = (world[node] @ bound)[:3]
        placed = np.zeros_like(points)
        for share, of in zip(self.weight.T, self.joint.T, strict=True):
            turned = np.einsum("nab,nb->na", moved[of, :, :3], points) + moved[of, :, 3]
            placed += share[:, None] * turned
        return placed


def read_glb(data: bytes) -> RawMesh:
    """The surface of a GLB file: all of its scene's triangles, posed by nodes, skins and weights of morph targets.

    Raises as `open_glb` and `read_parts`.
    """
    return join_parts(list(read_parts(*open_glb(data))))


def join_parts(parts: Sequence[Part]) -> RawMesh:
    """Join all parts into one mesh, in order."""
    before = np.cumsum([0, *(len(part.points) for part in parts)])
    faces = [part.faces + at for part, at in zip(parts, before, strict=False)]
    return RawMesh(
        np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)]),
        np.concatenate([np.zeros((0, 3), np.int32), *faces]).astype(np.int32),
    )


def open_glb(data: bytes) -> tuple[Any, bytes]:
    """Return the JSON and the bytes of a GLB file.

    Raises BadInput for an extension that moves or packs what is in it and is not read here, LookupError, TypeError or
    ValueError for an inconsistent file.
    """
    found, at = {}, 12
    if data[:4] != b"glTF":
        raise ValueError("it is no GLB")
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, at)
        found[kind] = data[at + 8 : at + 8 + length]
        at += 8 + length
    document = json.loads(found[b"JSON"])
    for name in (*document.get("extensionsUsed", ()), *document.get("extensionsRequired", ())):
        if name in PACKED:
            problem, remedy = "the mesh is compressed, which is not read", "export it anew, uncompressed"
            raise BadInput(problem, field="file", value=name, remedy=remedy)
        if name == REPEATED or (name in document.get("extensionsRequired", ()) and not name.startswith(HARMLESS)):
            problem, remedy = "the file needs an extension of glTF that is not read", f"export it without {name}"
            raise BadInput(problem, field="file", value=name, remedy=remedy)
    return document, found.get(b"BIN\0", b"")


def read_parts(document: Any, data: bytes) -> Iterator[Part]:
    """Yield the parts of the nodes of the scene that is shown, in the order of nodes.

    Raises LookupError, TypeError or ValueError for what does not hold together.
    """
    nodes = document.get("nodes", [])
    world = find_places(nodes)
    for part in read_primitives(document, data):
        yield replace(part, points=part.place(world, nodes))


def read_primitives(document: Any, data: bytes) -> Iterator[Part]:
    """Yield the parts as the file has them, as `read_parts` does with those that are posed."""
    nodes = document.get("nodes", [])
    world, shown = find_places(nodes), _shown(document)
    for k in (k for k in shown if "mesh" in nodes[k]):
        mesh = document["meshes"][nodes[k]["mesh"]]
        for part in mesh["primitives"]:
            if part.get("mode", 4) not in (4, 5, 6):
                continue  # points and lines
            named = part["attributes"]
            points = read_array(document, data, named["POSITION"])
            targets = tuple(
                read_array(document, data, target["POSITION"]) if "POSITION" in target else 0.0 * points
                for target in part.get("targets", ())
            )
            own = np.arange(len(points))
            if "indices" in part:
                own = read_array(document, data, part["indices"]).astype(np.int64).ravel()
            if not 0 <= own.min(initial=0) <= own.max(initial=0) < len(points):
                raise ValueError("triangles of vertices that are not there")
            faces, morph = _faces(own, part.get("mode", 4)), tuple(mesh.get("weights", ()))
            if "skin" not in nodes[k]:
                faces = faces[:, ::-1] if np.linalg.det(world[k][:3, :3]) < 0.0 else faces  # a mirrored node
                yield Part(k, points, faces, None, None, targets, morph, {})
                continue
            skin = document["skins"][nodes[k]["skin"]]
            carriers = np.array(skin["joints"], np.int64)
            sets = range(sum(name.startswith("JOINTS_") for name in named))
            joint = np.concatenate([read_array(document, data, named[f"JOINTS_{j}"]) for j in sets], axis=1).astype(int)
            weight = np.concatenate([read_array(document, data, named[f"WEIGHTS_{j}"]) for j in sets], axis=1)
            total = weight.sum(axis=1, keepdims=True)
            if not (total > 0.0).all():
                raise ValueError(f"no joint carries the vertex {place_of(points[int(total.argmin())])}")
            bound = np.tile(np.eye(4), (len(carriers), 1, 1))
            if "inverseBindMatrices" in skin:
                # Matrices are stored column by column.
                bound = read_array(document, data, skin["inverseBindMatrices"]).reshape(-1, 4, 4)[: len(carriers)]
                bound = bound.transpose(0, 2, 1)
            binding = dict(zip(skin["joints"], bound, strict=True))
            yield Part(k, points, faces, carriers[joint], weight / total, targets, morph, binding)


def _shown(document: Any) -> list[int]:
    """Return the nodes of the scene that is shown, ascending; of all nodes if the file has none. A node that is not
    visible (KHR_node_visibility) hides those below it, too.
    """
    nodes, scenes = document.get("nodes", []), document.get("scenes")
    hidden = {k for k, node in enumerate(nodes)
              if not node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True)}  # fmt: skip
    below = {child for node in nodes for child in node.get("children", ())}
    roots = scenes[document.get("scene", 0)].get("nodes", ()) if scenes else set(range(len(nodes))) - below
    waiting, found = list(roots), set[int]()
    while waiting:
        node = waiting.pop()
        if node not in found and node not in hidden:
            found.add(node)
            waiting += nodes[node].get("children", ())
    return sorted(found)


def _faces(own: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return triangles (f, 3) of a list of triangles, a strip or a fan."""
    if mode == 4:
        return own.reshape(-1, 3)
    if mode == 6:
        return np.stack([own[1:-1], own[2:], np.full(max(len(own) - 2, 0), own[0])], axis=1)
    faces = np.stack([own[:-2], own[1:-1], own[2:]], axis=1)
    faces[1::2] = faces[1::2, [0, 2, 1]]
    return faces


def read_array(document: Any, data: bytes, number: int) -> Float:
    """Return the rows (n, w) of an accessor, as numbers."""
    accessor = document["accessors"][number]
    width, rows = WIDTHS[accessor["type"]], accessor["count"]
    if "bufferView" not in accessor and rows > MOST_ROWS:
        raise ValueError(f"an array of {rows} rows that are not in it")
    found = _rows(document, data, accessor, rows, width) if "bufferView" in accessor else np.zeros((rows, width))
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        place = _rows(document, data, sparse["indices"], sparse["count"], 1).astype(int)[:, 0]
        values = sparse["values"] | {"componentType": accessor["componentType"]}
        found[place] = _rows(document, data, values, sparse["count"], width)
    kind = np.dtype(TYPES[accessor["componentType"]])
    return np.maximum(found / np.iinfo(kind).max, -1.0) if accessor.get("normalized") and kind.kind in "iu" else found


def _rows(document: Any, data: bytes, array: Any, rows: int, width: int) -> Float:
    """Return rows (n, w) of an accessor, or of a part of one, from its buffer."""
    view = document["bufferViews"][array["bufferView"]]
    if view.get("buffer", 0) != 0 or "uri" in document["buffers"][0]:
        raise ValueError("it has arrays in other files, which are not read")
    kind = np.dtype("<" + TYPES[array["componentType"]])
    start = view.get("byteOffset", 0) + array.get("byteOffset", 0)
    step = view.get("byteStride", kind.itemsize * width)
    if start + step * (rows - 1) + kind.itemsize * width > len(data):
        raise ValueError("an array reaches beyond the file's end")
    values: NDArray[Any] = np.ndarray((rows, width), kind, data, start, (step, kind.itemsize))
    return values.astype(np.float64)


def find_places(nodes: Any) -> dict[int, Float]:
    """Return the matrix (4, 4) of each node in the scene. Raises ValueError for nodes in a cycle."""
    parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", ())}
    found: dict[int, Float] = {}
    for k in range(len(nodes)):
        for node in reversed(way_up(k, parents)):
            if node not in found:
                before = found[parents[node]] if node in parents else np.eye(4)
                found[node] = before @ _local(nodes[node])
    return found


def way_up(node: int, parents: dict[int, int]) -> list[int]:
    """Return a node, its parent, and so on. Raises ValueError for nodes in a cycle."""
    way = [node]
    while way[-1] in parents:
        way.append(parents[way[-1]])
        if len(way) > len(parents) + 1:
            raise ValueError("its nodes go round in a circle")
    return way


def _local(node: Any) -> Float:
    """Return the matrix (4, 4) of a node in its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    matrix, (x, y, z, w) = np.eye(4), node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = rotation_matrices(np.array([[w, x, y, z]], float))[0]
    matrix[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), float)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
