"""A person's GLB file with joints and weights of its own: they are what carries its skin."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from persons import person
from scipy.spatial import cKDTree
from skin_files import WALK, Folder, bent

from nuno_contact.colliders.skin import SkinCollider, SkinConfig, bones_of
from nuno_contact.motions.bvh import BVH, BvhConfig
from nuno_contact.skin.figure import find_figure
from nuno_contact.skin.roles import carrier_of, find_roles
from nuno_contact.skin.weights import find_weights
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape, Mover

SPACING = 0.03
TURN = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
"""By which what has z up in a file stands upright, x y z w."""
KINDS = {"f4": 5126, "u4": 5125, "u2": 5123, "u1": 5121}
Parts = Mapping[str, Any]


def write_glb(path: Path, parts: Parts, kind: str = "f4", nodes: Mapping[int, Any] | None = None) -> Path:
    """A person in centimetres with z up, as programs with an armature write it, whose mesh node is moved, which counts
    for nothing (glTF 3.7.3.3). `parts`: x, faces, names, parents, place, joint, weight; `nodes` are changed by number.
    """
    turn = rotation_matrices(np.array([[TURN[3], *TURN[:3]]]))[0]
    x, place = (100.0 * at @ turn for at in (parts["x"], parts["place"]))
    inverse = np.tile(np.eye(4), (len(place), 1, 1))
    inverse[:, :3, 3] = -place[::-1]
    weight = parts["weight"]
    if kind != "f4":
        weight = np.round(weight * np.iinfo(kind).max)
    arrays: list[tuple[NDArray[Any], str, bool]] = [
        (x.astype("<f4"), "VEC3", False), (parts["faces"].reshape(-1, 1).astype("<u4"), "SCALAR", False),
        (parts["joint"].astype("<u1"), "VEC4", False), (weight.astype("<" + kind), "VEC4", kind != "f4"),
        (inverse.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"), "MAT4", False),
    ]  # fmt: skip
    data, views, accessors = b"", [], []
    for k, (values, shape, normalized) in enumerate(arrays):
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": values.nbytes})
        accessors.append({"bufferView": k, "componentType": KINDS[values.dtype.str[1:]], "count": len(values),
                          "type": shape, "normalized": normalized})  # fmt: skip
        data += values.tobytes() + bytes(-values.nbytes % 4)
    count, parents = len(parts["names"]), list(parts["parents"])
    joints = [
        {"name": name, "translation": (place[j] - (place[p] if p >= 0 else 0.0)).tolist(),
         "children": [2 + k for k in range(count) if parents[k] == j]}
        for j, (name, p) in enumerate(zip(parts["names"], parents, strict=True))
    ]  # fmt: skip
    armature = {
        "rotation": list(TURN),
        "scale": [0.01] * 3,
        "children": [2 + j for j in range(count) if parents[j] < 0],
    }
    said = {
        "asset": {"version": "2.0"}, "buffers": [{"byteLength": len(data)}], "bufferViews": views,
        "accessors": accessors, "scene": 0, "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "skin": 0, "translation": [5.0, 0.0, 0.0]}, armature, *joints],
        "skins": [{"joints": [2 + j for j in reversed(range(count))], "inverseBindMatrices": 4}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}, "indices": 1}]}],
    }  # fmt: skip
    for number, change in (nodes or {}).items():
        said["nodes"][number] |= change
    text = json.dumps(said).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


@pytest.fixture(scope="module")
def walk() -> Mover:
    return BVH().prepare(BvhConfig(file=str(WALK)), Folder(WALK.parent))


@pytest.fixture(scope="module")
def parts(walk: Mover) -> dict[str, Any]:
    """What the project finds for a person: joints are written the last first, and inverse matrices with them."""
    (x, faces), roles = person(SPACING), find_roles(walk)
    figure, names = find_figure(x, faces), list(roles)
    part, weight = find_weights(x, faces, *bones_of(figure, names))
    carriers = [carrier_of(name, roles) for name in names]
    # A vertex that comes twice, as along a seam of a texture.
    twice, seam = np.concatenate([x, x[faces[0]]]), faces.copy()
    seam[0] = len(x) + np.arange(3)
    return {
        "x": twice, "faces": seam, "names": [f"rig_{name}" for name in names],
        "parents": [names.index(name) if name else -1 for name in carriers],
        "place": np.stack([figure[name] for name in names]),
        "joint": len(names) - 1 - np.concatenate([part, part[faces[0]]]),
        "weight": np.concatenate([weight, weight[faces[0]]]),
    }  # fmt: skip


def build(path: Path, walk: Mover, **settings: Any) -> BodyShape:
    return SkinCollider().build(SkinConfig(file=path.name, spread=0.0, **settings), walk, Folder(path.parent))


@pytest.fixture(scope="module")
def found(walk: Mover, tmp_path_factory: pytest.TempPathFactory) -> BodyShape:
    """The same person without a rig."""
    from persons import write_mesh

    path = tmp_path_factory.mktemp("plain") / "person.obj"
    path.write_text(write_mesh(*person(SPACING)))
    return build(path, walk)


def off(one: BodyShape, other: BodyShape, t: float) -> float:
    """How far vertices are at most from those of the other that are at the same place as they stand [m]."""
    apart, same = cKDTree(other.vertices).query(one.vertices)
    assert apart.max() < 2e-6 and len(np.unique(same)) == len(other.vertices) == len(one.vertices)
    return float(np.abs(bent(one, t) - bent(other, t)[same]).max())


@pytest.mark.parametrize(("kind", "within"), [("f4", 2e-6), ("u2", 3e-5), ("u1", 8e-3)])
def test_it_moves_by_its_own_joints_and_weights(
    kind: str, within: float, parts: Parts, found: BodyShape, walk: Mover, tmp_path: Path
) -> None:
    """As the same ones do that were found in the mesh, to what float32 and weights of 16 and 8 bits leave."""
    given = build(write_glb(tmp_path / "rigged.glb", parts, kind), walk)
    assert (given.skins[0].weight.sum(axis=1) == 1.0).all()
    for t in (0.0, 0.7, 1.6):
        assert off(given, found, t) < within


def test_other_weights_move_it_otherwise_unless_they_are_to_be_found(
    parts: Parts, found: BodyShape, walk: Mover, tmp_path: Path
) -> None:
    rigid = {**parts, "weight": np.eye(4)[np.zeros(len(parts["x"]), int)]}
    path = write_glb(tmp_path / "rigid.glb", rigid)
    given, anyhow = build(path, walk), build(path, walk, weights="found")
    assert (given.skins[0].weight[:, 0] == 1.0).all()
    assert off(given, found, 1.6) > 5e-3 and off(anyhow, found, 1.6) < 1e-4


def test_it_stands_as_its_joints_have_it_at_rest(parts: Parts, walk: Mover, tmp_path: Path) -> None:
    """The pose of a file's nodes need not be that in which the mesh was bound: a head that is turned and raised."""
    head, rigid = list(parts["names"]).index("rig_head"), {**parts, "weight": np.eye(4)[np.zeros(len(parts["x"]), int)]}
    below = (parts["place"][head] - parts["place"][parts["parents"][head]]) @ _upright()
    raised = {2 + head: {"translation": (100.0 * below + [0.0, 0.0, 10.0]).tolist(), "rotation": [0, 0, 1, 0]}}
    before, after = (
        build(write_glb(tmp_path / f"{k}.glb", rigid, nodes=nodes), walk) for k, nodes in enumerate(({}, raised))
    )
    mine = before.skins[0].joint[:, 0] == find_roles(walk)["head"]
    about = parts["place"][head]
    expected = (before.vertices[mine] - about) * [-1.0, 1.0, -1.0] + about + [0.0, 0.1, 0.0]
    theirs = after.skins[0].joint[:, 0] == find_roles(walk)["head"]
    assert mine.sum() == theirs.sum() > 10
    assert np.sort(after.vertices[theirs], axis=0) == pytest.approx(np.sort(expected, axis=0), abs=1e-5)
    assert np.sort(after.vertices[~theirs], axis=0) == pytest.approx(np.sort(before.vertices[~mine], axis=0), abs=1e-5)


def _upright() -> Float:
    return rotation_matrices(np.array([[TURN[3], *TURN[:3]]]))[0]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"names": [f"bone{k}" for k in range(30)]}, "the file's skeleton is not that of a body"),
        ({"weight": 0.0}, "no joint carries the vertex"),
        ({"place": np.array([-1.0, 1.0, -1.0])}, "does not stand upright and face"),
        ({"joint": 250}, "out of bounds"),
    ],
)
def test_a_rig_that_says_of_no_body_is_refused(
    changed: dict[str, Any], said: str, parts: Parts, walk: Mover, tmp_path: Path
) -> None:
    ((name, value),) = changed.items()
    wrong = value[: len(parts["names"])] if name == "names" else parts[name] * value if name != "joint" else (
        0 * parts["joint"] + value
    )  # fmt: skip
    path = write_glb(tmp_path / "wrong.glb", {**parts, name: wrong})
    with pytest.raises(BadInput, match=said):
        build(path, walk)


def test_a_rig_that_is_cut_off_is_refused(parts: Parts, walk: Mover, tmp_path: Path) -> None:
    path = write_glb(tmp_path / "cut.glb", parts)
    whole = path.read_bytes()
    for share in (0.05, 0.5, 0.95):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(BadInput, match="cannot be read") as told:
            build(path, walk)
        assert told.value.field == "file"
