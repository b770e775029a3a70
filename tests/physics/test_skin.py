"""A person's mesh that moves with joints: where these are, what carries each vertex, how it moves, rigs of files."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from closed_meshes import box, grid_faces, outward, sphere
from numpy.typing import NDArray
from persons import person, write_mesh
from scipy.spatial import cKDTree
from skin_files import WALK, Folder, bent

from nuno_contact.colliders.body_parts import carrier_of, find_roles
from nuno_contact.colliders.skin import SkinCollider, SkinConfig, bones_of
from nuno_contact.motions.bvh import BVH, BvhConfig
from nuno_contact.motions.hula import Hula, HulaConfig
from nuno_contact.motions.rotations import from_axis_angle, multiply
from nuno_contact.skinning.figure import find_figure
from nuno_contact.skinning.weights import HEAT, find_weights, see_bones
from nuno_geometry.check import volume
from nuno_geometry.skinning import bend_skin
from nuno_schemas.bodies import Skin, rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import BodyShape, Mover

SPACING = 0.025


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    root = tmp_path_factory.mktemp("person")
    (root / "person.obj").write_text(write_mesh(*person(SPACING)))
    return Folder(root)


@pytest.fixture(scope="module")
def walk(folder: Folder) -> Mover:
    return BVH().prepare(BvhConfig(file=str(WALK)), folder)


def build(folder: Folder, mover: Mover | None, name: str = "person.obj", **settings: Any) -> BodyShape:
    return SkinCollider().build(SkinConfig(file=name, **settings), mover, folder)


@pytest.fixture(scope="module")
def walker(folder: Folder, walk: Mover) -> BodyShape:
    return build(folder, walk, spread=0.0)


def edges_of(faces: Int) -> Int:
    return np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)


def test_weights_are_bounded_add_up_to_one_and_pass_smoothly(walker: BodyShape) -> None:
    """Exactly one, in any order; and along edges they change by no more than a half over the thinnest limb's radius."""
    skin, x = walker.skins[0], walker.vertices
    assert (skin.weight >= 0.0).all() and (skin.weight <= 1.0).all()
    assert (skin.weight.sum(axis=1) == 1.0).all() and (skin.weight[:, ::-1].sum(axis=1) == 1.0).all()
    dense = np.zeros((len(x), len(skin.place)))
    np.put_along_axis(dense, skin.joint, skin.weight, axis=1)
    a, b = edges_of(walker.faces).T
    slope = np.abs(dense[a] - dense[b]).max(axis=1) / np.linalg.norm(x[a] - x[b], axis=1)
    assert slope.max() < 0.5 / 0.02
    # Each carries something whole, but nothing that is far away.
    assert (dense.max(axis=0)[np.unique(skin.joint[:, 0])] > 0.4).all()
    hands = np.abs(x[:, 0]) > 0.6
    names = [walker.frames[j] for j in np.flatnonzero((dense[hands] > 0.01).any(axis=0))]
    assert set(names) <= {f"{side}{part}" for side in ("Left", "Right") for part in ("ForeArm", "Hand", "Arm")}


def test_a_vertex_goes_with_a_bone_that_it_sees_not_with_a_nearer_one() -> None:
    """A forearm beside a thigh, a centimetre apart: the bone of the other is nearer than its own at the end."""
    (x, faces), (other, _) = box((0.1, 1.0, 0.1)), box((0.02, 1.0, 0.02))
    both = np.concatenate([x, other + np.array([0.065, 0.0, 0.0])])
    ends = np.array([[[-0.04, -0.4, 0.0], [-0.04, 0.4, 0.0]], [[0.065, -0.4, 0.0], [0.065, 0.4, 0.0]]])
    bone, _ = see_bones(both, np.concatenate([faces, faces + np.int32(len(x))]), ends)
    assert (bone[: len(x)] == 0).all() and (bone[len(x) :] == 1).all()
    nearest = np.abs(both[:, :1] - np.array([-0.04, 0.065])).argmin(axis=1)
    assert (nearest[: len(x)] == 1).any()


def test_joints_that_move_as_one_move_the_skin_rigidly(walker: BodyShape) -> None:
    """To 1e-12 m, whatever the weights; and a body that stands is where its file has it."""
    skin, x = walker.skins[0], walker.vertices
    turn, shift = from_axis_angle(np.array([0.3, -1.0, 0.4]), 2.1), np.array([0.3, -4.0, 1.2])
    matrix = rotation_matrices(turn[None])[0]
    moved = skin.bend(x, np.tile(turn, (len(skin.place), 1)), skin.place @ matrix.T + shift)
    assert np.abs(moved - x @ matrix.T - shift).max() < 1e-12
    assert np.abs(bent(walker, 0.0) - x).max() < 1e-15


def test_the_kernel_bends_a_skin_to_the_same_bits(walker: BodyShape) -> None:
    """As the sums of NumPy do, in all poses of a walk: solvers and services have the body in the same place."""
    assert walker.pose is not None
    for t in np.linspace(0.0, 3.0, 7).tolist():
        moved = bend_skin(walker.skins[0], walker.vertices, *walker.pose(t))
        assert moved.tobytes() == bent(walker, t).tobytes()


def test_a_twisted_tube_keeps_its_girth() -> None:
    """Halfway between ends that are turned by 120 degrees about its axis: sums of matrices would halve its radius."""
    angle = np.linspace(0.0, 2.0 * np.pi, 13)[:-1]
    ring = np.stack([np.cos(angle), np.zeros(12), np.sin(angle)], axis=1)
    both, ends = np.tile(np.array([0, 1], np.int32), (12, 1)), np.array([[0.0, -1, 0], [0, 1, 0]])
    skin = Skin(ends, both, np.full((12, 2), 0.5))
    turns = np.stack([np.eye(4)[0], from_axis_angle(np.array([0.0, 1.0, 0.0]), math.radians(120.0))])
    moved = skin.bend(ring, turns, skin.place)
    assert np.abs(np.linalg.norm(moved, axis=1) - 1.0).max() < 1e-12
    half = rotation_matrices(from_axis_angle(np.array([0.0, 1.0, 0.0]), math.radians(60.0))[None])[0]
    assert np.abs(moved - ring @ half.T).max() < 1e-12
    # The negative of a quaternion is the same turn.
    assert np.abs(skin.bend(ring, turns * np.array([[1.0], [-1.0]]), skin.place) - moved).max() < 1e-15


@pytest.mark.parametrize("motion", ["bvh", pytest.param("hula", marks=pytest.mark.full)])
def test_limbs_point_where_the_motion_has_them(motion: str, folder: Folder, walk: Mover) -> None:
    """Though the body stands in an A-pose and the skeleton does not, to 1e-9, once it has begun as the body faces."""
    mover = walk if motion == "bvh" else Hula().prepare(HulaConfig(), folder)
    shape, roles = build(folder, mover, spread=0.0, blend=0.5), find_roles(mover)
    assert shape.pose is not None
    heading = None
    for t in (0.5, 0.9, 1.7):
        (_, theirs), (_, ours) = mover.pose(t), shape.pose(t)
        for side in ("left", "right"):
            for first, last in (("arm", "forearm"), ("forearm", "hand"), ("thigh", "shin"), ("shin", "foot")):
                j, k = roles[f"{side}_{first}"], roles[f"{side}_{last}"]
                a, b = (way / np.linalg.norm(way) for way in (theirs[k] - theirs[j], ours[k] - ours[j]))
                if heading is None:
                    heading = math.atan2(b[0], b[2]) - math.atan2(a[0], a[2])
                turned = rotation_matrices(from_axis_angle(np.array([0.0, 1.0, 0.0]), heading)[None])[0] @ a
                assert np.abs(turned - b).max() < 1e-6, (t, side, first)


def test_it_leaves_its_own_pose_smoothly(folder: Folder, walk: Mover) -> None:
    """It stands as long as asked; and speeds of its vertices have no jump as it begins to move, and as it has begun: of
    the hula, which has none of its own.
    """
    shape, step = build(folder, Hula().prepare(HulaConfig(), folder), stand=0.25, blend=0.5), 1e-3
    assert (bent(shape, 0.25) == bent(shape, 0.0)).all()
    assert np.abs(bent(shape, 0.3) - bent(shape, 0.0)).max() > 1e-4
    for t in (0.25, 0.75):
        bend = (bent(shape, t + step) - 2.0 * bent(shape, t) + bent(shape, t - step)) / step**2
        assert np.abs(bend).max() < 20.0  # a jump of 0.1 m/s: 100 m/s^2
    shape = build(folder, walk, stand=0.25, blend=0.5)
    late, soon = bent(shape, 1.25), bent(build(folder, walk, blend=0.5), 1.0)
    assert np.abs(late - soon).max() < 1e-12


def test_the_walker_keeps_its_volume_and_its_feet_near_the_floor(walker: BodyShape) -> None:
    """Within 5 % over a walk, and no edge is stretched to more than twice; soles within 5 cm of the floor."""
    check_walk(walker, 2.5, np.arange(0.0, 3.0, 0.25))


def check_walk(shape: BodyShape, stretch: float, times: Float) -> tuple[float, float]:
    a, b = edges_of(shape.faces).T
    whole, length = volume(shape.vertices, shape.faces), np.linalg.norm(shape.vertices[a] - shape.vertices[b], axis=1)
    least, most = 1.0, 1.0
    for t in times.tolist():
        x = bent(shape, t)
        least = min(least, volume(x, shape.faces) / whole)
        most = max(most, float((np.linalg.norm(x[a] - x[b], axis=1) / length).max()))
        assert abs(float(x[:, 1].min())) < 0.05
        assert volume(x, shape.faces) / whole < 1.05
    assert least > 0.95
    assert most < stretch
    return least, most


@pytest.mark.full
@pytest.mark.parametrize(("body", "spread"), [("body-mean", 0.0), ("body-mean", 10.0), ("body", 10.0)])
def test_measured_bodies_keep_their_volume_over_a_captured_walk(body: str, spread: float, shared_data: Path) -> None:
    """Within 5 %, and no edge is stretched to more than two and a half times."""
    folder = Folder(shared_data)
    mover = BVH().prepare(BvhConfig(file="cmu_12_01_walk.bvh"), folder)
    shape = build(folder, mover, f"{body}.obj", spread=math.radians(spread))
    check_walk(shape, 2.5, np.arange(0.0, 4.3, 0.05))


def test_the_same_bits_whatever_the_threads(walker: BodyShape, folder: Folder, walk: Mover) -> None:
    """Weights and places, built on one thread and on two."""
    import numba

    before = numba.get_num_threads()
    try:
        for threads in {1, min(2, before)}:
            numba.set_num_threads(threads)
            again = build(folder, walk, spread=0.0)
            assert again.skins[0].weight.tobytes() == walker.skins[0].weight.tobytes()
            assert bent(again, 1.3).tobytes() == bent(walker, 1.3).tobytes()
    finally:
        numba.set_num_threads(before)


def test_what_is_no_person_or_no_persons_motion_is_refused_by_name(folder: Folder, walk: Mover) -> None:
    with pytest.raises(BadInput, match="motion with joints"):
        build(folder, None)
    bones = Mover(("root", "tail", "tip"), np.array([-1, 0, 1], np.int32), np.eye(3), walk.pose)
    with pytest.raises(BadInput, match="head, left_arm"):
        build(folder, bones)
    (folder.root / "ball.obj").write_text(write_mesh(*sphere(12)))
    with pytest.raises(BadInput, match="no two legs"):
        build(folder, walk, "ball.obj")


def test_heat_is_that_of_the_equation() -> None:
    """On a long tube of radius r about a bone in each half, far from its ends: exp(-s / d) / 2 at s beyond the joint, d
    the decay length r / sqrt(HEAT); by finite differences within 3 %.
    """
    rows, around, radius, length = 240, 24, 0.05, 1.2
    angle = 2.0 * np.pi * np.arange(around) / around
    y = np.repeat(np.linspace(-0.5, 0.5, rows) * length, around)
    x = np.stack([radius * np.tile(np.cos(angle), rows), y, radius * np.tile(np.sin(angle), rows)], axis=1)
    n, here = len(x), np.arange(around)
    after = (here + 1) % around
    bottom = np.stack([0 * here + n, after, here], axis=1)
    top = np.stack([0 * here + n + 1, n - around + here, n - around + after], axis=1)
    x = np.concatenate([x, [[0.0, -0.5 * length, 0.0], [0.0, 0.5 * length, 0.0]]])
    tube, faces = outward(x, np.concatenate([grid_faces(rows, around, False), bottom, top]).astype(np.int32))
    bones = np.array([[[0.0, -0.6, 0.0], [0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.0, 0.6, 0.0]]])
    part, weight = find_weights(tube, faces, bones, np.array([0, 1], np.int32))
    upper = np.where(part == 1, weight, 0.0).sum(axis=1)
    beyond = (tube[:, 1] < 0.0) & (tube[:, 1] > -0.1)
    expected = 0.5 * np.exp(tube[beyond, 1] * math.sqrt(HEAT) / radius)
    assert np.abs(upper[beyond] / expected - 1.0).max() < 0.03


def test_the_spread_raises_arms_by_so_much(folder: Folder, walk: Mover) -> None:
    """In the plane across the chest, and no other part moves but the arms."""
    narrow, wide = (build(folder, walk, spread=angle, blend=0.0) for angle in (0.0, 0.2))
    assert narrow.pose is not None and wide.pose is not None
    roles = find_roles(walk)
    (one, _), (other, _) = narrow.pose(1.0), wide.pose(1.0)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        arm, chest = roles[f"{side}_arm"], one[roles["chest"]]
        turn = from_axis_angle(np.array([0.0, 0.0, 1.0]), 0.2 * sign)
        raised = multiply(multiply(chest, turn), chest * np.array([1.0, -1.0, -1.0, -1.0]))
        assert np.abs(multiply(raised, one[arm]) - other[arm]).max() < 1e-12
    trunk = [roles[name] for name in ("hips", "chest", "head", "left_foot")]
    assert (one[trunk] == other[trunk]).all()


RIG_SPACING = 0.03
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
def walk_mover() -> Mover:
    return BVH().prepare(BvhConfig(file=str(WALK)), Folder(WALK.parent))


@pytest.fixture(scope="module")
def parts(walk_mover: Mover) -> dict[str, Any]:
    """What the project finds for a person: joints are written the last first, and inverse matrices with them."""
    (x, faces), roles = person(RIG_SPACING), find_roles(walk_mover)
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


def build_rig(path: Path, walk_mover: Mover, **settings: Any) -> BodyShape:
    return SkinCollider().build(SkinConfig(file=path.name, spread=0.0, **settings), walk_mover, Folder(path.parent))


@pytest.fixture(scope="module")
def found(walk_mover: Mover, tmp_path_factory: pytest.TempPathFactory) -> BodyShape:
    """The same person without a rig."""
    from persons import write_mesh

    path = tmp_path_factory.mktemp("plain") / "person.obj"
    path.write_text(write_mesh(*person(RIG_SPACING)))
    return build_rig(path, walk_mover)


def off(one: BodyShape, other: BodyShape, t: float) -> float:
    """How far vertices are at most from those of the other that are at the same place as they stand [m]."""
    apart, same = cKDTree(other.vertices).query(one.vertices)
    assert apart.max() < 2e-6 and len(np.unique(same)) == len(other.vertices) == len(one.vertices)
    return float(np.abs(bent(one, t) - bent(other, t)[same]).max())


@pytest.mark.parametrize(("kind", "within"), [("f4", 2e-6), ("u2", 3e-5), ("u1", 8e-3)])
def test_it_moves_by_its_own_joints_and_weights(
    kind: str, within: float, parts: Parts, found: BodyShape, walk_mover: Mover, tmp_path: Path
) -> None:
    """As the same ones do that were found in the mesh, to what float32 and weights of 16 and 8 bits leave."""
    given = build_rig(write_glb(tmp_path / "rigged.glb", parts, kind), walk_mover)
    assert (given.skins[0].weight.sum(axis=1) == 1.0).all()
    for t in (0.0, 0.7, 1.6):
        assert off(given, found, t) < within


def test_other_weights_move_it_otherwise_unless_they_are_to_be_found(
    parts: Parts, found: BodyShape, walk_mover: Mover, tmp_path: Path
) -> None:
    rigid = {**parts, "weight": np.eye(4)[np.zeros(len(parts["x"]), int)]}
    path = write_glb(tmp_path / "rigid.glb", rigid)
    given, anyhow = build_rig(path, walk_mover), build_rig(path, walk_mover, weights="found")
    assert (given.skins[0].weight[:, 0] == 1.0).all()
    assert off(given, found, 1.6) > 5e-3 and off(anyhow, found, 1.6) < 1e-4


def test_it_stands_as_its_joints_have_it_at_rest(parts: Parts, walk_mover: Mover, tmp_path: Path) -> None:
    """The pose of a file's nodes need not be that in which the mesh was bound: a head that is turned and raised."""
    head, rigid = list(parts["names"]).index("rig_head"), {**parts, "weight": np.eye(4)[np.zeros(len(parts["x"]), int)]}
    below = (parts["place"][head] - parts["place"][parts["parents"][head]]) @ _upright()
    raised = {2 + head: {"translation": (100.0 * below + [0.0, 0.0, 10.0]).tolist(), "rotation": [0, 0, 1, 0]}}
    before, after = (
        build_rig(write_glb(tmp_path / f"{k}.glb", rigid, nodes=nodes), walk_mover)
        for k, nodes in enumerate(({}, raised))
    )
    mine = before.skins[0].joint[:, 0] == find_roles(walk_mover)["head"]
    about = parts["place"][head]
    expected = (before.vertices[mine] - about) * [-1.0, 1.0, -1.0] + about + [0.0, 0.1, 0.0]
    theirs = after.skins[0].joint[:, 0] == find_roles(walk_mover)["head"]
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
    changed: dict[str, Any], said: str, parts: Parts, walk_mover: Mover, tmp_path: Path
) -> None:
    ((name, value),) = changed.items()
    wrong = value[: len(parts["names"])] if name == "names" else parts[name] * value if name != "joint" else (
        0 * parts["joint"] + value
    )  # fmt: skip
    path = write_glb(tmp_path / "wrong.glb", {**parts, name: wrong})
    with pytest.raises(BadInput, match=said):
        build_rig(path, walk_mover)


def test_a_rig_that_is_cut_off_is_refused(parts: Parts, walk_mover: Mover, tmp_path: Path) -> None:
    path = write_glb(tmp_path / "cut.glb", parts)
    whole = path.read_bytes()
    for share in (0.05, 0.5, 0.95):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(BadInput, match="cannot be read") as told:
            build_rig(path, walk_mover)
        assert told.value.field == "file"
