"""Files of meshes are read as they are written: polygons, numbers, texture coordinates, poses; what is not is named."""

from __future__ import annotations

import json
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from model_files import Folder, build
from numpy.typing import NDArray

from nuno_cloth.models.mesh import Mesh
from nuno_contact.colliders.mesh import MeshCollider, MeshConfig
from nuno_contact.skinning.rig import Rig, weights_of
from nuno_geometry.check import volume
from nuno_geometry.mesh_files.mesh import clean_mesh, load_mesh, read_closed
from nuno_geometry.mesh_files.polygons import triangulate
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.vectors import face_areas
from nuno_wrinkle.lines import Line, read_lines

CUBE = trimesh.creation.box((1.0, 1.0, 1.0))
QUADS = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (2, 3, 7, 6), (1, 2, 6, 5), (0, 4, 7, 3))
CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
L = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)


def cases(shared_data: Path, name: str) -> Path:
    folder = shared_data / "cases" / name
    if not folder.is_dir():
        pytest.skip(f"shared data cases/{name} is not there")
    return folder


def one_polygon(x: Float) -> NDArray[np.int64]:
    return triangulate(x, np.arange(len(x)), np.array([len(x)]))


def random_turn(random: np.random.Generator) -> Float:
    return np.linalg.qr(random.normal(size=(3, 3)))[0]


def star(random: np.random.Generator, corners: int) -> Float:
    """A polygon (n, 2) that is seen whole from its middle, as ragged as can be."""
    angle = 2.0 * np.pi * (np.arange(corners) + 0.8 * random.random(corners)) / corners
    radius = random.uniform(0.1, 1.0, corners)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def shoelace(flat: Float) -> float:
    x, y = flat.T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


@pytest.mark.parametrize("corners", [4, 5, 9, 30])
def test_triangles_of_a_polygon_have_its_area_whichever_corner_is_first(corners: int) -> None:
    random = np.random.default_rng(corners)
    for _ in range(8):
        flat = star(random, corners)
        x = np.column_stack([flat, np.zeros(corners)]) @ random_turn(random) * 10.0 ** random.integers(-3, 4)
        x += random.normal(size=3)
        for first in range(0, corners, max(1, corners // 4)):
            faces = one_polygon(np.roll(x, first, axis=0))
            assert faces.shape == (corners - 2, 3)
            area = face_areas(np.roll(x, first, axis=0)[faces])
            whole = np.linalg.norm(np.cross(x, np.roll(x, -1, axis=0)).sum(axis=0)) / 2.0
            assert area.sum() == pytest.approx(whole, rel=1e-6)
        assert shoelace(flat) > 0.0


@pytest.mark.parametrize("corners", [4, 5, 8])
def test_a_polygon_that_is_not_flat_is_cut_the_same_whichever_corner_is_first(corners: int) -> None:
    random = np.random.default_rng(corners)
    for k in range(12):
        flat = star(random, corners) if k % 2 else np.stack(
            [np.cos(2 * np.pi * np.arange(corners) / corners), np.sin(2 * np.pi * np.arange(corners) / corners)], 1
        )  # fmt: skip
        x = np.column_stack([flat, 0.1 * random.normal(size=corners)]) @ random_turn(random)
        sets = set()
        for first in range(corners):
            turned = np.roll(np.arange(corners), first)
            sets.add(frozenset(frozenset(turned[face].tolist()) for face in one_polygon(x[turned])))
        assert len(sets) == 1


@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-7, 1e-5])
def test_corners_on_a_straight_side_stay_and_no_triangle_is_a_sliver(off: float) -> None:
    """Else the polygon beyond that side, which ends there, leaves a hole; files round corners off their side."""
    random = np.random.default_rng(2)
    for flat in (
        [[0, 0], [1, 0], [2, 0], [1, 2]],
        [[0, 0], [1, 0], [2, 0], [2, 2], [0, 2]],
        [[0, 0], [2, 0], [1, 1], [0, 2]],
    ):
        x = np.column_stack([np.array(flat, float), np.zeros(len(flat))]) + off * random.normal(size=(len(flat), 3))
        for first in range(len(flat)):
            turned = np.roll(x, first, axis=0)
            area = face_areas(turned[one_polygon(turned)])
            assert len(area) == len(flat) - 2 and area.min() > 0.3
    side = np.linspace(0.0, 1.0, 6)[:-1]
    around = np.concatenate([L[k] + side[:, None] * (np.roll(L, -1, 0)[k] - L[k]) for k in range(6)])
    x = np.column_stack([around, np.zeros(30)]) @ random_turn(random) + off * random.normal(size=(30, 3))
    for first in range(0, 30, 7):
        turned = np.roll(x, first, axis=0)
        faces = one_polygon(turned)
        assert len(faces) == 28 and face_areas(turned[faces]).min() > 0.01
        assert face_areas(turned[faces]).sum() == pytest.approx(3.0, rel=1e-9 + 10.0 * off)


def test_a_hole_that_a_slit_leads_to_stays_open() -> None:
    """As programs write a face with a hole: the slit's ends come twice."""
    outer, hole = [[0, 0], [3, 0], [3, 3], [0, 3]], [[1, 1], [1, 2], [2, 2], [2, 1]]
    flat = np.array([*outer, outer[0], *hole, hole[0]], float)
    faces = one_polygon(np.column_stack([flat, np.zeros(10)]))
    assert face_areas(np.column_stack([flat, np.zeros(10)])[faces]).sum() == pytest.approx(8.0)
    middle = flat[faces].mean(axis=1)
    assert not ((middle > 1.0) & (middle < 2.0)).all(axis=1).any()


FIFTH = 2.0 * np.pi * np.arange(0, 10, 2) / 5.0


@pytest.mark.parametrize(
    "flat",
    [[[0, 0], [1, 0], [0, 1], [1, 1]], [[0, 0], [2, 0], [0, 1], [1, 1]], np.stack([np.cos(FIFTH), np.sin(FIFTH)], 1),
     [[0, 0], [3, 0], [3, 2], [1, 2], [1, -1], [0, -1]]],
)  # fmt: skip
def test_a_polygon_that_passes_through_itself_is_refused_with_its_line(flat: Any, tmp_path: Path) -> None:
    flat = np.array(flat, float)
    lines = [f"v {x!r} {y!r} 0" for x, y in flat.tolist()]
    lines += ["# nothing", "f " + " ".join(str(k + 1) for k in range(len(flat)))]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    with pytest.raises(BadInput, match="a polygon passes through itself") as refused:
        load_mesh(tmp_path / "a.obj")
    assert refused.value.line == len(lines) and refused.value.field == "face 0"


def prism(flat: Float, height: float) -> tuple[list[list[float]], list[list[int]]]:
    n = len(flat)
    points = [[*at, z] for z in (0.0, height) for at in flat.tolist()]
    return points, [
        list(range(n))[::-1], list(range(n, 2 * n)), *([k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n))
    ]  # fmt: skip


def write_obj(path: Path, points: Any, polygons: Any) -> Path:
    lines = ["v {} {} {}".format(*row) for row in points]
    path.write_text("\n".join(lines + ["f " + " ".join(str(k + 1) for k in face) for face in polygons]))
    return path


def write_ply(path: Path, points: Any, polygons: Any, order: str) -> Path:
    head = f"ply\nformat {order} 1.0\ncomment none\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face {len(polygons)}\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n"
    if order == "ascii":
        rows = [" ".join(map(str, row)) for row in points] + [f"0 {len(f)} " + " ".join(map(str, f)) for f in polygons]
        path.write_text(head + "\n".join(rows) + "\n")
        return path
    mark = "<" if "little" in order else ">"
    body = b"".join(struct.pack(mark + "3f", *row) for row in points)
    body += b"".join(struct.pack(f"{mark}BB{len(f)}i", 0, len(f), *f) for f in polygons)
    path.write_bytes(head.encode() + body)
    return path


@pytest.mark.parametrize("kind", ["obj", "ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("first", [0, 1, 4])
def test_bodies_and_cloth_of_concave_polygons_have_their_volume_and_mass(kind: str, first: int, tmp_path: Path) -> None:
    def write(name: str, points: Any, polygons: Any) -> Path:
        path = tmp_path / f"{name}.{'obj' if kind == 'obj' else 'ply'}"
        return write_obj(path, points, polygons) if kind == "obj" else write_ply(path, points, polygons, kind)

    points, polygons = prism(np.roll(L, first, axis=0), 2.0)
    assert volume(*read_closed(write("body", points, polygons))) == pytest.approx(6.0)
    flat = write("flat", np.column_stack([np.roll(L, first, axis=0), np.zeros(6)]), [list(range(6))])
    fabric = build(Mesh(), {"file": flat.name, "fabric": "denim", "scale": 0.1}, Folder(tmp_path))
    square = write("square", [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]])
    one = build(Mesh(), {"file": square.name, "fabric": "denim", "scale": 0.1}, Folder(tmp_path))
    assert fabric.mass.sum() == pytest.approx(3.0 * one.mass.sum())


def test_shared_polygons_have_their_own_area(shared_data: Path) -> None:
    folder = cases(shared_data, "05-ngon")
    masses = [build(Mesh(), {"file": f"lflat_{k}.obj"}, Folder(folder)).mass.sum() for k in (0, 1)]
    assert masses[0] == pytest.approx(masses[1], rel=1e-12)
    dart = load_mesh(folder / "dart.obj")
    assert face_areas(dart.points[dart.faces]).sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("case", "size", "volumes"),
    [
        ("07-obj-relative/comment.obj", 8, 1.0), ("07-obj-relative/tabs.obj", 8, 1.0),
        ("07-obj-relative/cube2_negative.obj", 16, 2.0), ("07-obj-relative/neg_then_curve.obj", 8, 1.0),
        ("13-ply-mixed/mix_ascii.ply", 8, 1.0), ("13-ply-mixed/mix_le.ply", 8, 1.0),
        ("14-stl/asc_unclosed.stl", 8, 1.0), ("14-stl/bin_trailing.stl", 8, 1.0),
        ("03-touching-lips/touching.obj", 16, 2.0),
        ("06-glb/fan.glb", 8, 1.0), ("06-glb/quant_norm.glb", 8, 1.0), ("06-glb/skin_posed.glb", 8, 2.0),
        ("06-glb/skin_scaled_armature.glb", 8, 1.0),
    ],
)  # fmt: skip
def test_shared_solids_have_their_vertices_and_volume(case: str, size: int, volumes: float, shared_data: Path) -> None:
    folder, name = case.split("/")
    x, faces = read_closed(cases(shared_data, folder) / name)
    assert len(x) == size and volume(x, faces) == pytest.approx(volumes, rel=1e-4)


def test_what_shared_files_need_and_is_not_read_is_named(shared_data: Path) -> None:
    with pytest.raises(BadInput, match="compressed") as refused:
        read_closed(cases(shared_data, "06-glb") / "draco.glb")
    assert refused.value.value == "KHR_draco_mesh_compression" and refused.value.remedy is not None


TEXT = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "".join(
    f"f {' '.join(str(k + 1) for k in face)}\n" for face in QUADS
)


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbf" + TEXT.encode(), TEXT.encode("utf-16"), TEXT.replace("\n", "\r\n").encode(),
        TEXT.replace("\n", "\r").encode(), TEXT.replace(" ", "\t").encode(), TEXT.replace("\n", "\n \t").encode(),
        TEXT.replace("\n", " # a remark\n").encode(), TEXT.replace(" 1", " \\\n 1").encode(),
        ("# C:\\folder\\\n" + TEXT).encode(), TEXT.replace("\n", "\n\n").encode(), TEXT.rstrip("\n").encode(),
        TEXT.replace("f ", "usemtl one\nf ").replace("f 8", "usemtl other\nf 8").encode(),
    ],
)  # fmt: skip
def test_an_obj_is_read_however_its_lines_are_laid_out(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(data)
    mesh = load_mesh(tmp_path / "a.obj")
    np.testing.assert_array_equal(mesh.points, CORNERS)
    assert [set(face) for face in mesh.faces[::2].tolist()] == [set(face[:3]) for face in QUADS]
    assert volume(*read_closed(tmp_path / "a.obj")) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("line", "words"),
    [("v 0,5 0 0", "could not convert"), ("v 0 0", "numbers are missing"), ("f 1 2", "a face of 2 corners"),
     ("f 0 1 2", "not there"), ("f -9 1 2", "not there"), ("f 1 2 9", "not there"), ("f 1/1 2/1 3/1", "not there")],
)  # fmt: skip
def test_lines_that_cannot_be_meant_are_named(line: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(TEXT + "\\\n\n" + line + "\nf 1 2 3\n")
    with pytest.raises(BadInput, match=words) as refused:
        load_mesh(tmp_path / "a.obj")
    assert refused.value.line == 17


def test_lines_drawn_on_cloth_are_read_as_faces_are(tmp_path: Path) -> None:
    """A byte order mark, remarks, numbers that count back, and a line that goes on after a backslash."""
    text = "v 0 0 0 # one\nv 1 0 0\nl -2 -1\nv 1 1 0\nl 1/1 2 \\\n  -1 # all\n"
    (tmp_path / "a.obj").write_bytes(b"\xef\xbb\xbf" + text.encode())
    found = read_lines([Line(file="a.obj", height=0.01)], Folder(tmp_path))
    assert [line.points for line in found] == [((0, 0, 0), (1, 0, 0)), ((0, 0, 0), (1, 0, 0), (1, 1, 0))]


def test_rows_of_a_ply_as_they_come(tmp_path: Path) -> None:
    """Lists of several lengths, an element before the vertices, and texture coordinates of corners."""
    head = (
        "ply\nformat ascii 1.0\nobj_info x\nelement camera 1\nproperty float f\nelement vertex 5\nproperty double x\n"
    )
    head += "property double y\nproperty double z\nelement face 2\nproperty list uchar int vertex_index\n"
    head += "property list uchar float texcoord\nend_header\n"
    rows = "7\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 0 0\n4 0 1 2 3 8 0 0 .5 0 .5 1 0 1\n3 1 4 2 6 .5 0 1 0 .5 1\n"
    (tmp_path / "a.ply").write_text(head + rows)
    mesh = load_mesh(tmp_path / "a.ply")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]] and mesh.uv is not None
    np.testing.assert_array_equal(mesh.uv[:, :, 0] * 2.0, mesh.points[mesh.faces][:, :, 0])
    (tmp_path / "a.ply").write_text((head + rows)[:-20])
    with pytest.raises(BadInput, match="cannot be read as PLY"):
        load_mesh(tmp_path / "a.ply")


def test_an_stl_whose_count_is_wrong_is_refused_with_both_numbers(tmp_path: Path) -> None:
    whole = CUBE.export(file_type="stl")
    for count in (0, 11, 13, 2**32 - 1):
        (tmp_path / "a.stl").write_bytes(whole[:80] + struct.pack("<I", count) + whole[84:])
        with pytest.raises(BadInput, match=rf"{count} triangles, and there is room for 12"):
            load_mesh(tmp_path / "a.stl")
    (tmp_path / "a.stl").write_bytes(b"solid" + whole[5:])
    assert len(load_mesh(tmp_path / "a.stl").faces) == 12
    text = CUBE.export(file_type="stl_ascii")
    (tmp_path / "a.stl").write_text(text[: text.rindex("endloop")])
    with pytest.raises(BadInput, match="ends within a triangle"):
        load_mesh(tmp_path / "a.stl")


def glb(path: Path, arrays: list[tuple[NDArray[Any], dict[str, Any]]], said: dict[str, Any]) -> Path:
    kinds = {"f4": 5126, "u4": 5125, "u2": 5123, "u1": 5121, "i2": 5122, "i1": 5120}
    data, views, accessors = b"", [], []
    for values, more in arrays:
        kind = values.dtype.str[1:]
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": values.nbytes})
        shape = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[1 if values.ndim == 1 else values.shape[1]]
        accessors.append({"bufferView": len(views) - 1, "componentType": kinds[kind], "count": len(values),
                          "type": shape} | more)  # fmt: skip
        data += values.tobytes() + bytes(-values.nbytes % 4)
    said = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(data)}], "bufferViews": views,
            "accessors": accessors, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}]} | said  # fmt: skip
    text = json.dumps(said).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


X, FACES = np.array(CORNERS, "<f4"), np.array([(a, b, c) for q in QUADS for a, b, c in (q[:3], (q[0], *q[2:]))], "<u2")
BOX: list[tuple[NDArray[Any], dict[str, Any]]] = [(X, {}), (FACES.reshape(-1), {})]


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2"])
def test_normalised_integers_are_shares_of_one(kind: str, tmp_path: Path) -> None:
    most = np.iinfo(kind).max
    arrays = [((X * most).astype("<" + kind), {"normalized": True}), BOX[1]]
    assert volume(*read_closed(glb(tmp_path / "a.glb", arrays, {}))) == pytest.approx(1.0)


def test_sparse_rows_morph_weights_and_nodes_move_vertices(tmp_path: Path) -> None:
    """The upper side is raised by half of a morph target of 4 m, one corner's place is sparse, a node is a mirror."""
    up, top = np.array([4, 5, 6, 7], "<u2"), np.tile(np.array([[0.0, 0.0, 4.0]], "<f4"), (4, 1))
    wrong = X.copy()
    wrong[6] = 9.0
    arrays = [(wrong, {"sparse": {"count": 1, "indices": {"bufferView": 4, "componentType": 5123},
                                  "values": {"bufferView": 5}}}), BOX[1],
              (up, {}), (top, {}), (np.array([6], "<u2"), {}), (X[6:7], {})]  # fmt: skip
    shape = {"attributes": {"POSITION": 0}, "indices": 1, "targets": [{"POSITION": 6}]}
    morph = {"meshes": [{"primitives": [shape], "weights": [0.5]}], "nodes": [{"mesh": 0, "scale": [-1, 1, 1]}]}
    path = glb(tmp_path / "a.glb", arrays, morph)
    text = path.read_bytes()
    said = json.loads(text[20 : 20 + struct.unpack_from("<I", text, 12)[0]])
    said["accessors"].append({"componentType": 5126, "count": 8, "type": "VEC3", "sparse": {
        "count": 4, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}})  # fmt: skip
    x, faces = read_closed(glb(path, arrays, {key: said[key] for key in ("accessors", "meshes", "nodes")}))
    assert volume(x, faces) == pytest.approx(3.0) and x[:, 0].min() == -1.0 and x[:, 2].max() == 3.0


def test_strips_are_triangles_and_only_the_scene_that_is_shown_is_read(tmp_path: Path) -> None:
    strip = np.array([0, 1, 3, 2], "<u2")
    shape = {"attributes": {"POSITION": 0}, "indices": 1, "mode": 5}
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [0, 0, 9]}]
    said = {"meshes": [{"primitives": [shape]}], "nodes": nodes}
    mesh = load_mesh(glb(tmp_path / "a.glb", [(X, {}), (strip, {})], said))
    assert mesh.faces.tolist() == [[0, 1, 3], [1, 2, 3]]
    normal = np.cross(*(mesh.points[mesh.faces[:, k]] - mesh.points[mesh.faces[:, 0]] for k in (1, 2)))
    assert (normal[:, 2] > 0.0).all() and len(mesh.points) == 8


@pytest.mark.parametrize("scenes", [{}, {"scenes": []}])
@pytest.mark.parametrize("required", [True, False])
def test_nodes_that_are_not_visible_are_left_out_with_those_below(
    scenes: dict[str, Any], required: bool, tmp_path: Path
) -> None:
    hidden = {"children": [2], "extensions": {"KHR_node_visibility": {"visible": False}}}
    shown = {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": True}}}
    nodes = [{"children": [1, 3]}, hidden, {"mesh": 0, "translation": [5, 0, 0]}, shown]
    said = {"nodes": nodes, "extensionsUsed": ["KHR_node_visibility"]} | scenes
    said |= {"extensionsRequired": ["KHR_node_visibility"]} if required else {}
    x = load_mesh(glb(tmp_path / "a.glb", BOX, said)).points
    assert len(x) == 8 and x.max() == X.max()


@pytest.mark.parametrize(
    ("said", "name"),
    [
        ({"extensionsRequired": ["EXT_unheard_of"], "extensionsUsed": ["EXT_unheard_of"]}, "EXT_unheard_of"),
        ({"extensionsUsed": ["EXT_mesh_gpu_instancing"]}, "EXT_mesh_gpu_instancing"),
        ({"extensionsUsed": ["KHR_materials_unlit", "EXT_meshopt_compression"]}, "EXT_meshopt_compression"),
    ],
)  # fmt: skip
def test_extensions_that_move_vertices_are_refused_by_name(said: dict[str, Any], name: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput) as refused:
        load_mesh(glb(tmp_path / "a.glb", BOX, said))
    assert refused.value.value == name and refused.value.remedy is not None
    looks = {"extensionsRequired": ["KHR_materials_unlit", "KHR_texture_transform"]}
    assert len(load_mesh(glb(tmp_path / "a.glb", BOX, looks)).faces) == 12


def test_what_touches_stays_apart_where_the_files_own_numbers_are_closed(tmp_path: Path) -> None:
    """One of two boxes that touch has a hole: it is filled, and what touches is left as it is."""
    points = [*CORNERS, *(tuple(np.add(at, (1, 1, 0))) for at in CORNERS)]
    polygons = [*QUADS, *(tuple(k + 8 for k in face) for face in QUADS)]
    x, faces = read_closed(write_obj(tmp_path / "a.obj", points, polygons))
    assert len(x) == 16 and volume(x, faces) == pytest.approx(2.0)
    torn = write_obj(tmp_path / "torn.obj", points, polygons[1:])
    with pytest.raises(BadInput, match="has a hole"):
        read_closed(torn)
    assert volume(*read_closed(torn, mend=True)) == pytest.approx(2.0)


def test_cloth_that_touches_itself_gets_a_remedy_that_helps(tmp_path: Path) -> None:
    """Two closed boxes that touch cannot be merged, sides of one that have vertices of their own can."""
    points = [*CORNERS, *(tuple(np.add(at, (1, 1, 0))) for at in CORNERS)]
    write_obj(tmp_path / "a.obj", points, [*QUADS, *(tuple(k + 8 for k in face) for face in QUADS)])
    write_obj(tmp_path / "b.obj", [CORNERS[k] for face in QUADS for k in face], np.arange(24).reshape(6, 4).tolist())
    for merge in (False, True):
        with pytest.raises(BadInput, match="2 places hold several vertices") as refused:
            build(Mesh(), {"file": "a.obj", "merge": merge}, Folder(tmp_path))
        assert refused.value.remedy is not None and "apart" in refused.value.remedy
    with pytest.raises(BadInput, match="8 places hold several vertices") as refused:
        build(Mesh(), {"file": "b.obj"}, Folder(tmp_path))
    assert refused.value.remedy == "merge: true"
    assert build(Mesh(), {"file": "b.obj", "merge": True}, Folder(tmp_path)).number == 8


def test_vertices_are_joined_along_rims_and_edges_without_length(tmp_path: Path) -> None:
    """Each side of a box with vertices of its own, as where a texture is cut; and an edge between two at one place."""
    points = [CORNERS[k] for face in QUADS for k in face]
    apart = write_obj(tmp_path / "apart.obj", points, np.arange(24).reshape(6, 4).tolist())
    assert len(read_closed(apart)[0]) == 8
    doubled = [list(face) for face in QUADS]
    doubled[1].insert(doubled[1].index(6), 8)  # from 5 over 8, where 6 lies too, to 6
    doubled[4].insert(doubled[4].index(6) + 1, 8)
    x, faces = read_closed(write_obj(tmp_path / "doubled.obj", [*CORNERS, CORNERS[6]], doubled))
    assert len(x) == 8 and volume(x, faces) == pytest.approx(1.0)


@pytest.mark.parametrize("off", [5e-15, 1e-6])
def test_a_seam_that_a_program_has_rounded_is_closed_where_the_mesh_is_mended(off: float, tmp_path: Path) -> None:
    """A tube in mm whose last column of vertices is that of the first but for rounding, each triangle with its own."""
    angle = np.linspace(0.0, 2.0 * np.pi, 17)
    ring = np.stack([20.0 * np.cos(angle), 20.0 * np.sin(angle)], axis=1)
    ring[-1] = ring[0] + [0.0, off]
    corners = []
    for a, b in pairwise(ring):
        low, high, sides = [(*end, 0.0) for end in (a, b)], [(*end, 50.0) for end in (a, b)], (0.0, 50.0)
        corners += [[low[0], low[1], high[1]], [low[0], high[1], high[0]]]
        corners += [[(0.0, 0.0, sides[0]), low[1], low[0]], [(0.0, 0.0, sides[1]), high[0], high[1]]]
    points = np.array(corners).reshape(-1, 3)
    faces = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    with pytest.raises(BadInput, match="has a hole") as refused:
        read_closed(tmp_path / "tube.stl", load=lambda _: (points, faces))
    assert refused.value.remedy is not None and refused.value.remedy.startswith("mend: true")
    x, closed = read_closed(tmp_path / "tube.stl", 1e-3, mend=True, load=lambda _: (points, faces))
    assert len(x) == 34 and volume(x, closed) == pytest.approx(50e-3 * 8.0 * 20e-3**2 * np.sin(np.pi / 8.0), rel=1e-6)


def test_quads_and_materials_keep_texture_coordinates_and_their_order(shared_data: Path, tmp_path: Path) -> None:
    folder = cases(shared_data, "08-two-charts")
    plane = build(Mesh(), {"file": "bcube.obj", "texture": "halves.png"}, Folder(folder))
    assert plane.uv is not None and plane.corners is None
    np.testing.assert_allclose(plane.uv, [[0, 0], [1, 0], [0, 1], [1, 1]])
    text = (folder / "twocharts.obj").read_text().splitlines()
    first = next(k for k, line in enumerate(text) if line.startswith("f "))
    halves = [*text[:first], "usemtl a", *text[first : first + 60], "usemtl b", *text[first + 60 : first + 90],
              "usemtl a", *text[first + 90 :]]  # fmt: skip
    (tmp_path / "two.obj").write_text("\n".join(halves))
    one, two = load_mesh(folder / "twocharts.obj"), load_mesh(tmp_path / "two.obj")
    np.testing.assert_array_equal(one.faces, two.faces)
    np.testing.assert_array_equal(one.uv, two.uv)


@pytest.mark.parametrize(("name", "merge"), [("twocharts.obj", False), ("twocharts.obj", True),
                                             ("twocharts_tri.obj", False), ("twocharts_tri.obj", True)])  # fmt: skip
def test_vertices_on_a_prints_seam_have_a_place_on_each_side(name: str, merge: bool, shared_data: Path) -> None:
    folder = Folder(cases(shared_data, "08-two-charts"))
    fabric = build(Mesh(), {"file": name, "merge": merge, "texture": "halves.png"}, folder)
    corners = fabric.corners
    assert fabric.number == 153 and corners is not None and fabric.uv is None
    np.testing.assert_array_equal(corners.vertex[corners.faces], fabric.faces)
    assert (np.bincount(corners.vertex) == 2).sum() == 9
    raw = load_mesh(folder.root / name)
    np.testing.assert_array_equal(corners.points[corners.faces], raw.uv)


def test_a_print_on_cloth_without_texture_coordinates_is_refused(shared_data: Path, tmp_path: Path) -> None:
    picture = cases(shared_data, "08-two-charts") / "halves.png"
    (tmp_path / "halves.png").write_bytes(picture.read_bytes())
    write_obj(tmp_path / "a.obj", CORNERS[:4], QUADS[:1])
    (tmp_path / "b.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\nf 1 3 4\n"
    )
    for name, words in (("a.obj", "2 of 2 triangles"), ("b.obj", "1 of 2 triangles")):
        with pytest.raises(BadInput, match=words):
            build(Mesh(), {"file": name, "texture": "halves.png"}, Folder(tmp_path))
        assert build(Mesh(), {"file": name}, Folder(tmp_path)).uv is None


def test_a_rig_carries_each_side_of_what_touches_by_its_own_weights() -> None:
    points = np.array([*CORNERS, *np.add(CORNERS, (1, 1, 0))], float)
    faces = np.concatenate([FACES, FACES + 8]).astype(np.int32)
    weight = np.repeat(np.eye(2), 8, axis=0)
    rig = Rig(("one", "other"), np.array([-1, 0], np.int32), np.zeros((2, 3)), points, faces, weight)
    x, _ = clean_mesh(points, faces)
    part, share = weights_of(rig, np.arange(2, dtype=np.int32), x)
    assert part[np.arange(16), share.argmax(axis=1)].tolist() == [0] * 8 + [1] * 8


@pytest.mark.parametrize("shift", [(1, 1, 0), (1, 0, 0), (0.5, 1, 0.25), (1, 1, 1)])
def test_bodies_that_touch_along_edges_sides_and_corners_pass_through_nothing(
    shift: tuple[float, ...], tmp_path: Path
) -> None:
    points = [*CORNERS, *(tuple(np.add(at, shift)) for at in CORNERS)]
    path = write_obj(tmp_path / "a.obj", points, [*QUADS, *(tuple(k + 8 for k in face) for face in QUADS)])
    shape = MeshCollider().build(MeshConfig(file=path.name), None, Folder(tmp_path))
    assert shape.notes == () and shape.vertices is not None and len(shape.vertices) == 16
