"""Nets and meshes from files hold the file's numbers and yarns, and bad ones are refused by name."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from model_files import Folder, build, files, net_arrays, write_obj

from nuno_cloth.fabrics.presets import PRESETS
from nuno_cloth.models.mesh import Mesh, MeshConfig
from nuno_cloth.models.net import Net, NetConfig
from nuno_cloth.models.sheet import Sheet
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric
from nuno_schemas.vectors import face_areas

__all__ = ["files"]

NET_FAULTS: dict[str, tuple[dict[str, Any], str, object]] = {
    "missing key": ({"k": None}, "k", None),
    "unknown key": ({"stiffness": np.zeros(2)}, "stiffness", None),
    "shape of x": ({"x": np.zeros((3, 2))}, "x", (3, 2)),
    "lengths differ": ({"m": np.ones(2)}, "m", (2,)),
    "spring lengths differ": ({"rest": np.ones(3)}, "rest", (3,)),
    "dtype of springs": ({"springs": np.array([[0.0, 1], [1, 2]])}, "springs", "float64"),
    "dtype of pinned": ({"pinned": np.array([0.0, 1, 0])}, "pinned", "float64"),
    "text": ({"m": np.array(["a", "b", "c"])}, "m", "<U1"),
    "infinite position": ({"x": np.array([[0.0, 0, 0], [1, np.inf, 0], [0, 1, 0]])}, "x[1, 1]", np.inf),
    "zero mass": ({"m": np.array([1.0, 0, 1])}, "m[1]", 0.0),
    "negative mass where pinned": ({"m": np.array([-1.0, 1, 1])}, "m[0]", -1.0),
    "spring to itself": ({"springs": np.array([[0, 1], [2, 2]])}, "springs[1]", [2, 2]),
    "negative index": ({"springs": np.array([[0, 1], [-1, 2]])}, "springs[1, 0]", -1),
    "index too large": ({"springs": np.array([[0, 3], [1, 2]])}, "springs[0, 1]", 3),
    "index that wraps": ({"springs": np.array([[0, 1], [1, 2**32]])}, "springs[1, 1]", 2**32),
    "duplicate, other order": ({"springs": np.array([[0, 1], [1, 0]])}, "springs[1]", [1, 0]),
    "negative k": ({"k": np.array([1.0, -2])}, "k[1]", -2.0),
    "negative rest": ({"rest": np.array([-1.0, 2])}, "rest[0]", -1.0),
    "negative c": ({"c": np.array([0.0, -2])}, "c[1]", -2.0),
}


@pytest.mark.parametrize("fault", NET_FAULTS)
def test_bad_nets_are_refused_by_name(fault: str, files: Folder) -> None:
    change, field, value = NET_FAULTS[fault]
    arrays = {name: array for name, array in (net_arrays() | change).items() if array is not None}
    np.savez(files.root / "bad.npz", **arrays)
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert caught.value.field == field
    assert caught.value.value == value
    assert str(files.root / "bad.npz") in str(caught.value)


@pytest.mark.parametrize("key", ["x", "v", "m", "k", "rest", "c"])
def test_nan_in_a_net_is_refused(key: str, files: Folder) -> None:
    arrays = net_arrays()
    arrays[key].flat[1] = np.nan
    np.savez(files.root / "bad.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert caught.value.field is not None and caught.value.field.startswith(f"{key}[")


def test_files_that_are_no_nets(files: Folder) -> None:
    (files.root / "text.npz").write_text("not a zip")
    np.savez(files.root / "pickle.npz", **(net_arrays() | {"m": np.array([1, "x", None], object)}))
    for name in ("text.npz", "pickle.npz"):
        with pytest.raises(BadInput, match=r"read|dtype"):
            build(Net(), {"file": name}, files)
    with pytest.raises(BadInput):
        Net().count(NetConfig(file="text.npz"), files)


def test_a_header_that_lies_is_refused_before_anything_is_allocated(files: Folder) -> None:
    with zipfile.ZipFile(files.root / "net.npz") as good, zipfile.ZipFile(files.root / "lie.npz", "w") as bad:
        for name in good.namelist():
            data = good.read(name)
            bad.writestr(name, data.replace(b"(3, 3)", b"(9" + b"0" * 12 + b", 3)") if name == "x.npy" else data)
    for work in (Net().count, lambda config, files: Net().build(config, files, 0)):
        with pytest.raises(BadInput) as caught:
            work(NetConfig(file="lie.npz"), files)
        assert caught.value.field == "x"


@pytest.mark.parametrize("points", [0, 2])
def test_nets_without_springs_or_points_are_legal(points: int, files: Folder) -> None:
    kept = {"x": points, "v": points, "m": points, "pinned": points}
    arrays = {name: array[: kept.get(name, 0)] for name, array in net_arrays().items()}
    np.savez(files.root / "bare.npz", **arrays)  # type: ignore[arg-type]
    fabric = build(Net(), {"file": "bare.npz"}, files)
    assert fabric.number == points == Net().count(NetConfig(file="bare.npz"), files)
    assert fabric.springs is None and fabric.hinges is None


def test_a_net_holds_the_files_numbers(files: Folder) -> None:
    fabric, arrays = build(Net(), {"file": "net.npz"}, files), net_arrays()
    assert fabric.springs is not None
    assert np.array_equal(fabric.position, arrays["x"]) and np.array_equal(fabric.pinned, arrays["pinned"])
    assert np.array_equal(fabric.springs.pairs(), arrays["springs"])
    for name in ("k", "rest", "c"):
        assert np.array_equal(getattr(fabric.springs, name), arrays[name])


def arrays() -> dict[str, np.ndarray[Any, Any]]:
    """A square of four springs and its diagonal: a ring around it, and the diagonal by itself."""
    return {
        "x": np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
        "v": np.zeros((4, 3)),
        "m": np.ones(4),
        "pinned": np.zeros(4, bool),
        "springs": np.array([[0, 1], [2, 1], [2, 3], [3, 0], [0, 2]]),
        "k": np.ones(5),
        "rest": np.ones(5),
        "c": np.zeros(5),
        "yarn_links": np.array([0, 1, 2, 3, 0, 4]),
        "yarn_ptr": np.array([0, 5, 6]),
        "mu": np.array([0.2, 0.0]),
    }


FAULTS: dict[str, tuple[dict[str, Any], str, object]] = {
    "missing key": ({"yarn_ptr": None}, "yarn_ptr", None),
    "unknown key": ({"yarn_kind": np.zeros(2)}, "yarn_kind", None),
    "dtype": ({"yarn_links": np.zeros(6)}, "yarn_links", "float64"),
    "shape": ({"mu": np.zeros((2, 1))}, "mu", (2, 1)),
    "one mu too few": ({"mu": np.array([0.2])}, "yarn_ptr", (3,)),
    "no such spring": ({"yarn_links": np.array([0, 1, 2, 3, 0, 5])}, "yarn_links[5]", 5),
    "negative link": ({"yarn_links": np.array([0, 1, 2, -3, 0, 4])}, "yarn_links[3]", -3),
    "link that wraps": ({"yarn_links": np.array([0, 1, 2, 2**32 + 3, 0, 4])}, "yarn_links[3]", 2**32 + 3),
    "first not 0": ({"yarn_ptr": np.array([1, 5, 6])}, "yarn_ptr[0]", 1),
    "last not all": ({"yarn_ptr": np.array([0, 4, 5])}, "yarn_ptr[2]", 5),
    "falling": ({"yarn_ptr": np.array([0, 5, 3, 6]), "mu": np.zeros(3)}, "yarn_ptr[2]", 3),
    "empty yarn": ({"yarn_ptr": np.array([0, 5, 5, 6]), "mu": np.zeros(3)}, "yarn_ptr[2]", 5),
    "links apart": ({"yarn_links": np.array([0, 2]), "yarn_ptr": np.array([0, 2]), "mu": np.ones(1) / 4},
                    "yarn_links[1]", 2),
    "turns back": ({"yarn_links": np.array([0, 3, 4]), "yarn_ptr": np.array([0, 3]), "mu": np.ones(1) / 4},
                   "yarn_links[2]", 4),
    "used twice": ({"yarn_links": np.array([0, 1, 2, 3, 0, 3])}, "yarn_links[5]", 3),
    "ring of two": ({"yarn_links": np.array([0, 1, 0]), "yarn_ptr": np.array([0, 3]), "mu": np.ones(1) / 4},
                    "yarn_links[2]", 0),
    "one half": ({"mu": np.array([0.2, 0.5])}, "mu[1]", 0.5),
    "locks without stiffness": ({"lock": np.ones(5)}, "k_lock", None),
    "locks below rest": ({"lock": np.array([1, 1, -0.1, 1, 1]), "k_lock": np.ones(5)}, "lock[2]", -0.1),
    "locks and softens": ({"lock": np.ones(5), "k_lock": np.array([1, 1, 1, 0.5, 1])}, "k_lock[3]", 0.5),
    "negative": ({"mu": np.array([-0.1, 0.2])}, "mu[0]", -0.1),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_yarn_is_refused_by_name(fault: str, files: Folder) -> None:
    change, field, value = FAULTS[fault]
    np.savez(files.root / "bad.npz", **{name: a for name, a in (arrays() | change).items() if a is not None})
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert caught.value.field == field
    assert caught.value.value == value


def test_not_a_number_is_refused(files: Folder) -> None:
    np.savez(files.root / "bad.npz", **(arrays() | {"mu": np.array([0.2, np.nan])}))  # type: ignore[arg-type]
    with pytest.raises(BadInput) as caught:
        build(Net(), {"file": "bad.npz"}, files)
    assert caught.value.field == "mu[1]"


def test_a_net_holds_the_files_yarns(files: Folder) -> None:
    np.savez(files.root / "yarns.npz", **arrays())  # type: ignore[arg-type]
    fabric = build(Net(), {"file": "yarns.npz"}, files)
    assert fabric.yarns is not None
    for name, key in (("links", "yarn_links"), ("ptr", "yarn_ptr"), ("mu", "mu")):
        assert np.array_equal(getattr(fabric.yarns, name), arrays()[key])
    neighbours, yarn = fabric.yarns.neighbours()
    assert neighbours.tolist() == [[0, 1], [1, 2], [2, 3], [3, 0]]
    assert yarn.tolist() == [0, 0, 0, 0]


def test_a_net_without_the_keys_has_no_yarns(files: Folder) -> None:
    np.savez(files.root / "plain.npz", **net_arrays())  # type: ignore[arg-type]
    assert build(Net(), {"file": "plain.npz"}, files).yarns is None


def test_locks_are_the_files(files: Folder) -> None:
    lock, k_lock = np.linspace(0.0, 1.0, 5), np.linspace(1.0, 3.0, 5)
    np.savez(files.root / "net.npz", **(arrays() | {"lock": lock, "k_lock": k_lock}))  # type: ignore[arg-type]
    springs = build(Net(), {"file": "net.npz"}, files).springs
    assert springs is not None
    assert np.array_equal(springs.lock, lock) and np.array_equal(springs.k_lock, k_lock)  # type: ignore[arg-type]


def uniform_stiffness(fabric: Fabric) -> tuple[float, float, float]:
    """What the springs of a flat piece in the plane xy give under uniform strain: warp (y), weft (x), shear [N/m]."""
    assert fabric.springs is not None
    pairs = fabric.springs.pairs()
    d = fabric.position[pairs[:, 1]] - fabric.position[pairs[:, 0]]
    square = (d * d).sum(axis=1)
    energy = fabric.springs.per_spring(fabric.springs.k) * square / face_areas(fabric.position[fabric.faces]).sum()
    w, f = d[:, 1] ** 2 / square, d[:, 0] ** 2 / square
    return float((energy * w * w).sum()), float((energy * f * f).sum()), float((energy * w * f).sum())


@pytest.mark.parametrize("preset", PRESETS)
def test_springs_on_right_triangles_keep_the_measures(preset: str, files: Folder) -> None:
    """A membrane does on any triangles: tests/physics/test_fabric_measures.py."""
    config = {"file": "sheet.obj", "fabric": preset, "tension": "springs"}
    fabric, material = build(Mesh(), config, files), PRESETS[preset]
    assert uniform_stiffness(fabric) == pytest.approx((material.warp, material.weft, material.shear), rel=1e-6)
    assert fabric.mass.sum() == pytest.approx(material.density * 0.2, rel=1e-12)


def test_meshes_keep_their_texture_coordinates(files: Folder) -> None:
    text = (files.root / "sheet.obj").read_text().replace("f ", "# ")
    lines = [line for line in text.splitlines() if line.startswith("v ")]
    lines += [f"vt {0.1 + 0.2 * float(line.split()[1])!r} {0.5 + float(line.split()[2])!r}" for line in lines]
    faces = build(Sheet(), {"resolution": (5, 6), "size": (0.4, 0.5)}, files).faces + 1
    lines += ["f " + " ".join(f"{i}/{i}" for i in face) for face in faces]
    (files.root / "uv.obj").write_text("\n".join(lines))
    fabric = build(Mesh(), {"file": "uv.obj"}, files)
    assert fabric.uv is not None and fabric.uv.dtype == np.float32
    expected = np.stack([0.1 + 0.2 * fabric.position[:, 0], 0.5 + fabric.position[:, 1]], 1)
    assert fabric.uv == pytest.approx(expected, abs=1e-6)


def test_mesh_placement_and_pins(files: Folder) -> None:
    box = {"low": (-10, 1.2, -10), "high": (10, 10, 10)}
    config = {"file": "sheet.obj", "scale": 2, "centre": (0, 1, 0), "pin": [box, 3]}
    fabric = build(Mesh(), config, files)
    assert np.ptp(fabric.position, axis=0) == pytest.approx([0.8, 1.0, 0.0])
    assert fabric.pinned.sum() == (fabric.position[:, 1] >= 1.2).sum()
    with pytest.raises(BadInput, match="no vertex"):
        build(Mesh(), config | {"pin": [{"low": (5, 5, 5), "high": (6, 6, 6)}]}, files)


def test_wrinkle_papers_bending_springs(files: Folder) -> None:
    """One spring for each edge that is not on the rim: 4 x 5 cells, two triangles each."""
    by_hand = {"density": 0.1, "structural": 50, "bending": 5}
    fabric = build(Mesh(), {"file": "sheet.obj", "fabric": by_hand}, files)
    assert fabric.springs is not None and fabric.hinges is None
    assert int((fabric.springs.kind == 2).sum()) == 4 * 5 + 3 * 5 + 4 * 4


def test_bad_meshes_are_refused_by_name(files: Folder) -> None:
    good = build(Sheet(), {"resolution": (3, 3)}, files)
    flat = replace(good, faces=np.concatenate([good.faces, [[0, 1, 2]]]).astype(np.int32))
    flipped = replace(good, faces=np.concatenate([good.faces[:1, ::-1], good.faces[1:]]))
    lonely = replace(good, position=np.concatenate([good.position, [[9.0, 9, 9]]]))
    torn = np.concatenate([np.where(good.faces[:1] == 0, 9, good.faces[:1]), good.faces[1:]]).astype(np.int32)
    double = replace(good, position=np.concatenate([good.position, good.position[:1]]), faces=torn)
    finned = np.concatenate([good.faces, [[0, 4, 9]]]).astype(np.int32)
    fin = replace(good, position=np.concatenate([good.position, [[0.0, 0, 1]]]), faces=finned)
    cases = {"without area": flat, "opposite ways": flipped, "no triangle": lonely, "several vertices": double}
    for text, fabric in (cases | {"more than two": fin}).items():
        write_obj(files.root / "bad.obj", fabric)
        with pytest.raises(BadInput, match=text):
            build(Mesh(), {"file": "bad.obj"}, files)
    (files.root / "empty.obj").write_text("# nothing\n")
    (files.root / "bad.stl").write_bytes(b"solid nonsense")
    for name in ("empty.obj", "bad.stl", "image.png"):
        with pytest.raises(BadInput):
            build(Mesh(), {"file": name}, files)


def write_halves(path: Path) -> np.ndarray:
    """Write a sheet of 4 x 4 vertices in two halves, which share a row; return its points (20, 3), as in the file."""
    points = np.array([[x, y, 0] for half in ((0, 1), (1, 2, 3)) for y in half for x in range(4)], np.float64)
    quads = [[4 * row + k, 4 * row + k + 1, 4 * row + k + 5, 4 * row + k + 4] for row in (0, 2, 3) for k in range(3)]
    number = np.random.default_rng(5).permutation(20)
    points[number] = points.copy()
    lines = ["v {} {} {}".format(*point) for point in points.tolist()]
    lines += ["f " + " ".join(str(number[k] + 1) for k in quad) for quad in quads]
    path.write_text("\n".join(lines) + "\n")
    return points


def test_pins_of_a_merged_mesh_are_the_files_numbers(files: Folder) -> None:
    """Two of them may be one vertex; those beyond the file's are refused, though there may be as many vertices."""
    points = write_halves(files.root / "halves.obj")
    for number, point in enumerate(points):
        fabric = build(Mesh(), {"file": "halves.obj", "merge": True, "pin": [number]}, files)
        assert fabric.number == 16 and np.array_equal(fabric.position[fabric.pinned], [point])
        assert np.array_equal(fabric.position[fabric.named()], points)
    for number in (-1, 20):
        with pytest.raises(BadInput) as caught:
            build(Mesh(), {"file": "halves.obj", "merge": True, "pin": [3, number]}, files)
        refused = caught.value
        assert (refused.field, refused.value, refused.limit) == ("pin[1]", number, "0 to 19")
        assert refused.remedy is not None and "columns" not in refused.remedy


def test_faults_of_a_merged_mesh_are_named_by_the_files_numbers(files: Folder) -> None:
    write_halves(files.root / "halves.obj")
    path = files.root / "spare.obj"
    path.write_text((files.root / "halves.obj").read_text() + "v 9 9 9\n")
    with pytest.raises(BadInput, match="belong to no triangle") as caught:
        build(Mesh(), {"file": "spare.obj", "merge": True}, files)
    assert caught.value.field == "vertex 20"


def test_vertices_of_an_stl_are_counted_as_their_places_appear(files: Folder) -> None:
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    facets = ["facet normal 0 0 1\nouter loop\n" + "".join("vertex {} {} {}\n".format(*c) for c in three)
              + "endloop\nendfacet\n" for three in (corners[:3], corners[3:])]  # fmt: skip
    (files.root / "two.stl").write_text("solid two\n" + "".join(facets) + "endsolid two\n")
    fabric = build(Mesh(), {"file": "two.stl", "pin": [3]}, files)
    assert fabric.position[fabric.pinned].tolist() == [[1.0, 1.0, 0.0]]


def test_merging_joins_vertices_at_one_place(files: Folder) -> None:
    import trimesh

    good = build(Sheet(), {"resolution": (4, 5)}, files)
    apart = np.arange(good.faces.size, dtype=np.int32).reshape(-1, 3)
    soup = replace(good, position=good.position[good.faces.ravel()], faces=apart)
    write_obj(files.root / "soup.obj", soup)
    trimesh.Trimesh(good.position, good.faces, process=False).export(files.root / "sheet.stl")
    for config in ({"file": "soup.obj", "merge": True}, {"file": "sheet.stl"}):
        fabric = build(Mesh(), config, files)
        assert fabric.number == 20 == Mesh().count(MeshConfig.model_validate(config), files)
        assert fabric.membrane is not None and fabric.membrane.number == 2 * 3 * 4
    with pytest.raises(BadInput, match="several vertices") as caught:
        build(Mesh(), {"file": "soup.obj"}, files)
    assert caught.value.remedy == "merge: true"
