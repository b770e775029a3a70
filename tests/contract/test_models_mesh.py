"""A mesh keeps the fabric's measures where triangles allow it, and refuses bad files by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_files import Folder, build, files, write_obj

from nuno_cloth.fabrics.presets import PRESETS
from nuno_cloth.models.mesh import Mesh, MeshConfig
from nuno_cloth.models.sheet import Sheet
from nuno_cloth.models.triangles import face_areas
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

__all__ = ["files"]


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
    """A membrane does on any triangles: tests/physics/test_fabric_meshes.py."""
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
