"""A mesh that comes with joints and weights of its own: a GLB file with a skin (glTF 2.0, 3.6.2 to 3.7.3)."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nuno_contact.skin.figure import Figure
from nuno_contact.skin.gait import ALONG
from nuno_contact.skin.roles import find_roles
from nuno_contact.skin.weights import keep_largest
from nuno_kernels.meshes.check import place_of
from nuno_kernels.meshes.file import LARGEST_FILE
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Mover
from nuno_schemas.vectors import norm

TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
SAME = 1e-6
"""A vertex has the weights of the file's nearest, which is no farther from it than so much of the body's size."""


@dataclass(frozen=True)
class Rig:
    """The skin of a file as it stands there at rest.

    names, parents (j,) of joints, parents before their children; place (j, 3) where they are; points (n, 3), faces
    (f, 3) of the mesh; weight (n, j) how much each joint carries of each point
    """

    names: tuple[str, ...]
    parents: Int
    place: Float
    points: Float
    faces: Int
    weight: Float

    def surface(self, path: Path) -> tuple[Float, Int]:
        """Its mesh, as nuno_kernels.meshes.file.load_surface has that of a file."""
        return self.points, self.faces


def read_rig(path: Path) -> Rig | None:
    """That of a GLB file, None of one that has none, or of another kind. Raises BadInput for one that does not hold
    together.
    """
    if path.suffix.lower() != ".glb":
        return None
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ValueError(f"it has more than {LARGEST_FILE:,} bytes")
        return _read(*_chunks(path.read_bytes()))
    except (LookupError, TypeError, ValueError, AttributeError, OSError, RecursionError, struct.error) as error:
        raise BadInput(
            f"its joints cannot be read: {error}", str(path), field="file", value=path.name,
            remedy="export it anew, uncompressed",
        ) from None  # fmt: skip


def _chunks(data: bytes) -> tuple[Any, bytes]:
    """The JSON and the bytes of a GLB file."""
    found, at = {}, 12
    if data[:4] != b"glTF":
        raise ValueError("it is no GLB")
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, at)
        found[kind] = data[at + 8 : at + 8 + length]
        at += 8 + length
    return json.loads(found[b"JSON"]), found.get(b"BIN\0", b"")


def _read(said: Any, data: bytes) -> Rig | None:
    nodes = said.get("nodes", [])
    shown = [k for k, node in enumerate(nodes) if "mesh" in node]
    skins = {nodes[k]["skin"]: said["skins"][nodes[k]["skin"]] for k in shown if "skin" in nodes[k]}
    if not skins:
        return None
    for name in said.get("extensionsRequired", ()):
        if "draco" in name or "meshopt" in name:
            raise ValueError(f"it is written with {name}")
    world, above = _world(nodes), {child: k for k, node in enumerate(nodes) for child in node.get("children", ())}
    joints = _in_order([joint for skin in skins.values() for joint in skin["joints"]], above)
    matrices = np.stack([world[joint] for joint in joints])
    points, faces, weights, count = [], [], [], 0
    for k in shown:
        for part in said["meshes"][nodes[k]["mesh"]]["primitives"]:
            if part.get("mode", 4) not in (4, 5, 6):
                continue  # points and lines
            if part.get("mode", 4) != 4:
                raise ValueError("it has triangles in strips or fans")
            named = part["attributes"]
            bound = _array(said, data, named["POSITION"])
            own = np.arange(len(bound)) if "indices" not in part else _array(said, data, part["indices"]).ravel()
            if not 0 <= own.min(initial=0.0) <= own.max(initial=0.0) < len(bound):
                raise ValueError("triangles of vertices that are not there")
            weight, there = np.zeros((len(bound), len(joints))), world[k] @ np.column_stack([bound, _ones(bound)]).T
            if "skin" not in nodes[k]:
                weight[:, joints.index(_carrier(k, joints, above, nodes))] = 1.0
                points.append(there[:3].T)
            else:
                skin = skins[nodes[k]["skin"]]
                number = np.array([joints.index(joint) for joint in skin["joints"]])
                for j in range(sum(name.startswith("JOINTS_") for name in named)):
                    of = number[_array(said, data, named[f"JOINTS_{j}"]).astype(int)]
                    np.add.at(weight, (np.arange(len(bound))[:, None], of), _array(said, data, named[f"WEIGHTS_{j}"]))
                total = weight.sum(axis=1, keepdims=True)
                if not (total > 0.0).all():
                    raise ValueError(f"no joint carries the vertex {place_of(bound[int(total.argmin())])}")
                weight /= total
                inverse = np.tile(np.eye(4), (len(joints), 1, 1))
                if "inverseBindMatrices" in skin:
                    # Matrices are written column by column.
                    inverse[number] = (
                        _array(said, data, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
                    )
                blend = np.einsum("nj,jab->nab", weight, matrices @ inverse)
                points.append(np.einsum("nab,nb->na", blend[:, :3, :3], bound) + blend[:, :3, 3])
            faces.append(own.astype(np.int32).reshape(-1, 3) + np.int32(count))
            weights.append(weight)
            count += len(bound)
    names = tuple(str(nodes[joint].get("name", f"joint {joint}")) for joint in joints)
    parents = np.array([_parent(joint, joints, above) for joint in joints], np.int32)
    return Rig(
        names, parents, matrices[:, :3, 3], np.concatenate(points), np.concatenate(faces), np.concatenate(weights)
    )


def _ones(points: Float) -> Float:
    return np.ones(len(points))


def _array(said: Any, data: bytes, number: int) -> Float:
    """The rows (n, w) of an accessor, as numbers."""
    accessor = said["accessors"][number]
    view = said["bufferViews"][accessor["bufferView"]]
    if "sparse" in accessor or view.get("buffer", 0) != 0:
        raise ValueError("it has sparse or outer arrays, which are not read")
    kind, width = np.dtype("<" + TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    step, rows = view.get("byteStride", kind.itemsize * width), accessor["count"]
    if start + step * (rows - 1) + kind.itemsize * width > len(data):
        raise ValueError("an array reaches beyond the file's end")
    values: NDArray[Any] = np.ndarray((rows, width), kind, data, start, (step, kind.itemsize))
    found = values.astype(np.float64)
    return found / np.iinfo(kind).max if accessor.get("normalized") and kind.kind in "iu" else found


def _world(nodes: Any) -> dict[int, Float]:
    """(4, 4) of each node in the scene."""
    parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", ())}
    found: dict[int, Float] = {}
    for k in range(len(nodes)):
        way = [k]
        while way[-1] in parents and len(way) <= len(nodes):
            way.append(parents[way[-1]])
        if len(way) > len(nodes):
            raise ValueError("its nodes go round in a circle")
        for node in reversed(way):
            if node not in found:
                before = found[parents[node]] if node in parents else np.eye(4)
                found[node] = before @ _local(nodes[node])
    return found


def _local(node: Any) -> Float:
    """(4, 4) of a node in its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    matrix, (x, y, z, w) = np.eye(4), node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = rotation_matrices(np.array([[w, x, y, z]], float))[0]
    matrix[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), float)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _carrier(node: int, joints: list[int], above: dict[int, int], nodes: Any) -> int:
    """The joint that a mesh without a skin hangs on."""
    at = node
    while at not in joints:
        if at not in above:
            raise ValueError(f"no joint carries the mesh of {nodes[node].get('name', f'node {node}')!r}")
        at = above[at]
    return at


def _parent(joint: int, joints: list[int], above: dict[int, int]) -> int:
    """The number of the joint that one hangs on, through nodes between them, -1 where it hangs on none."""
    at = above.get(joint)
    while at is not None and at not in joints:
        at = above.get(at)
    return -1 if at is None else joints.index(at)


def _in_order(joints: list[int], above: dict[int, int]) -> list[int]:
    """Each once, in the file's order but for those that it hangs on, which come before it."""
    found: list[int] = []
    for joint in joints:
        way = [joint]
        while way[-1] in above:
            way.append(above[way[-1]])
        found += [at for at in reversed(way) if at in joints and at not in found]
    return found


def fit_rig(rig: Rig, roles: dict[str, int]) -> tuple[Figure, dict[str, int], Int]:
    """Where the joints of a body are that a motion moves, those of the motion's joints `roles` by part that the rig has
    as well, and the part (j,), among those, that each of the rig's joints goes with.

    Raises BadInput for a rig whose joints' names say of no body, or that does not stand upright and face +z.
    """
    offsets = rig.place - np.where(rig.parents[:, None] >= 0, rig.place[rig.parents], 0.0)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(rig.names), 1)), rig.place
    try:
        own = find_roles(Mover(rig.names, rig.parents, offsets, lambda t: still))
    except BadInput as error:
        raise BadInput(
            error.problem.replace("the motion's", "the file's"), field="file", value=error.value,
            limit=error.limit, remedy=error.remedy,
        ) from None  # fmt: skip
    both = {part: joint for part, joint in roles.items() if part in own}
    places = {part: rig.place[joint] for part, joint in own.items()}
    across, up = places["left_thigh"] - places["right_thigh"], places["head"] - places["hips"]
    if across[0] < 0.9 * float(norm(across)) or up[1] < 0.9 * float(norm(up)):
        raise BadInput(
            "the body does not stand upright and face +z: its left hip joint is to be at +x of the right one, its head "
            "above its hips", field="file", value=f"{place_of(across)}, {place_of(up)}",
            remedy="turn it by `up: z` or in the program that it comes from",
        )  # fmt: skip
    for side in ("left", "right"):
        for first, last in ALONG.items():
            if not float(norm(places[f"{side}_{last}"] - places[f"{side}_{first}"])) > 0.0:
                raise BadInput(f"the file's {side}_{first} has no length", field="file",
                               value=rig.names[own[f"{side}_{first}"]], remedy="take weights: found")  # fmt: skip
    places["hips"] = 0.5 * (places["left_thigh"] + places["right_thigh"])
    parts, goes = list(both), np.zeros(len(rig.names), np.int32)
    for j, parent in enumerate(rig.parents.tolist()):
        mine = [part for part, joint in own.items() if joint == j and part in both]
        goes[j] = parts.index(mine[0]) if mine else goes[parent] if parent >= 0 else 0
    return Figure(places, float(np.ptp(rig.points[:, 1]))), both, goes


def weights_of(rig: Rig, goes: Int, x: Float) -> tuple[Int, Float]:
    """The parts that carry vertices x (v, 3), which are among the rig's points, and their weights: as
    nuno_contact.skin.weights.find_weights has them. Raises BadInput for a vertex that is not.
    """
    distance, nearest = cKDTree(rig.points).query(x)
    if distance.max() > SAME * float(np.ptp(x, axis=0).max()):
        where = place_of(x[int(distance.argmax())])
        raise BadInput("the mended mesh has vertices that no joint carries", field="mend", value=where,
                       remedy="mend it in the program that it comes from, or take weights: found")  # fmt: skip
    dense = np.zeros((len(x), int(goes.max()) + 1))
    np.add.at(dense.T, goes, rig.weight[nearest].T)
    return keep_largest(dense)
