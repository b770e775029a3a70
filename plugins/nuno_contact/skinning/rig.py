"""A mesh with joints and weights of its own: a GLB file with a skin (glTF 2.0, 3.6.2 to 3.7.3)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from nuno_contact.colliders.body_parts import find_roles
from nuno_contact.skinning.figure import Figure
from nuno_contact.skinning.gait import ALONG
from nuno_contact.skinning.weights import keep_largest
from nuno_geometry.check import place_of
from nuno_geometry.mesh_files.glb import find_places, join_parts, open_glb, read_parts, way_up
from nuno_geometry.mesh_files.mesh import LARGEST_FILE, find_vertices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Mover
from nuno_schemas.reading import read_as
from nuno_schemas.vectors import norm

SAME = 1e-6
"""A vertex is one of the file's if it is no farther from it than this share of the body's size."""


@dataclass(frozen=True)
class Rig:
    """The skin of a file at rest.

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
        """Return its mesh, as nuno_geometry.mesh_files.mesh.load_surface does for a file."""
        return self.points, self.faces


def read_rig(path: Path) -> Rig | None:
    """Read a GLB file's rig; None if it has none, or is of another kind. Raises BadInput for an inconsistent one."""
    return read_as(path, "GLB", _read, LARGEST_FILE) if path.suffix.lower() == ".glb" else None


def _read(file: bytes) -> Rig | None:
    gltf, data = open_glb(file)
    nodes = gltf.get("nodes", [])
    parts = list(read_parts(gltf, data))
    carriers = [
        joint for part in parts if part.joint is not None for joint in gltf["skins"][nodes[part.node]["skin"]]["joints"]
    ]
    if not carriers:
        return None
    above = {child: k for k, node in enumerate(nodes) for child in node.get("children", ())}
    joints: list[int] = []  # in the file's order, but parents before their children
    for joint in carriers:
        joints += [at for at in reversed(way_up(joint, above)) if at in carriers and at not in joints]
    number = np.full(len(nodes), -1)
    number[joints] = np.arange(len(joints))
    weights = []
    for part in parts:
        weight = np.zeros((len(part.points), len(joints)))
        if part.joint is None or part.weight is None:
            weight[:, number[_carrier(part.node, joints, above, nodes)]] = 1.0
        else:
            np.add.at(weight, (np.arange(len(weight))[:, None], number[part.joint]), part.weight)
        weights.append(weight)
    names = tuple(str(nodes[joint].get("name", f"joint {joint}")) for joint in joints)
    # A joint hangs on the next one above it, through nodes between them.
    upwards = ([joints.index(at) for at in way_up(joint, above)[1:] if at in joints] for joint in joints)
    parents = np.array([next(iter(way), -1) for way in upwards], np.int32)
    world = find_places(nodes)
    whole = join_parts(parts)
    return Rig(
        names, parents, np.stack([world[joint][:3, 3] for joint in joints]), whole.points, whole.faces,
        np.concatenate(weights),
    )  # fmt: skip


def _carrier(node: int, joints: list[int], above: dict[int, int], nodes: Any) -> int:
    """Return the joint that a mesh without a skin hangs on."""
    for at in way_up(node, above):
        if at in joints:
            return at
    raise ValueError(f"no joint carries the mesh of {nodes[node].get('name', f'node {node}')!r}")


def fit_rig(rig: Rig, roles: dict[str, int]) -> tuple[Figure, dict[str, int], Int]:
    """Return the joints of a body that a motion moves, those of the motion's joints `roles` by part that the rig has as
    well, and the part (j,), among those, that each of the rig's joints goes with.

    Raises BadInput for a rig whose joints' names are not of a body, or that does not stand upright and face +z.
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
    """Return the parts that carry vertices x (v, 3), which are among the rig's points, and their weights, as
    nuno_contact.skinning.weights.find_weights does. Raises BadInput for a vertex that is not among them.
    """
    nearest, _ = find_vertices(rig.points, rig.faces)
    size = SAME * float(np.ptp(x, axis=0).max())
    if len(nearest) != len(x) or np.abs(rig.points[nearest] - x).max() > size:  # a mended mesh
        distance, nearest = cKDTree(rig.points).query(x)
        if distance.max() > size:
            where = place_of(x[int(distance.argmax())])
            raise BadInput("the mended mesh has vertices that no joint carries", field="mend", value=where,
                           remedy="mend it in the program that it comes from, or take weights: found")  # fmt: skip
    dense = np.zeros((len(x), int(goes.max()) + 1))
    np.add.at(dense.T, goes, rig.weight[nearest].T)
    return keep_largest(dense)
