"""The collider `sdf`: what it builds, keeps on disk, sends, tells and refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from nuno.collision.bodies import build_bodies
from nuno.collision.distance import signed_distance
from nuno.collision.messages import decode_geometry, encode_geometry
from nuno.scene.scene_file import read
from nuno_contact.colliders import sdf as field_cache
from nuno_contact.colliders.sdf import SdfCollider, SdfConfig
from nuno_contact.distance_fields.sample import sample_field
from nuno_contact.penalty.plugin import check
from nuno_schemas.bodies import FIELD, MESH, Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import BodyShape

ALL = ("low", "shape", "child", "corners")


class Folder:
    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def resolve(self, name: str) -> Path:
        path = self.folder / name
        if not path.exists():
            raise BadInput("no such file", field="file", value=name)
        return path


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Folder:
    """A ball, one with a hole, a sheet and an empty file; the cache is a folder beside them."""
    monkeypatch.setattr(field_cache, "cache_folder", lambda: tmp_path / "fields")
    ball = trimesh.creation.icosphere(3, 0.3)
    ball.export(tmp_path / "ball.obj")
    holed = trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0.28], process=False)
    holed.export(tmp_path / "holed.ply")
    trimesh.Trimesh(ball.vertices, ball.faces[:, ::-1], process=False).export(tmp_path / "inwards.ply")
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]]).export(tmp_path / "flat.ply")
    trimesh.creation.box((0.06, 0.001, 0.06)).export(tmp_path / "plate.ply")
    fin = trimesh.creation.box((0.1, 4e-4, 0.1), trimesh.transformations.translation_matrix([1, 0, 0]))
    trimesh.util.concatenate([ball, fin]).export(tmp_path / "finned.ply")
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    (tmp_path / "nan.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    return Folder(tmp_path)


def build(files: Folder, **config: object) -> BodyShape:
    return SdfCollider().build(SdfConfig.model_validate({"tolerance": "5 mm"} | config), None, files)


def geometry_of(shape: BodyShape) -> Geometry:
    one, zero = np.ones(1), np.zeros(1, np.int32)
    parts = (shape.kind, shape.frame, zero, shape.a, shape.b, shape.radius, one, one, one)
    return Geometry(("ball",), ("ball/world",), *parts, shape.vertices, shape.faces, shape.owner, shape.fields)


def test_a_body_is_sampled_once_and_then_read_with_the_same_bits(
    files: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = build(files, file="ball.obj").fields[0]
    (kept,) = (files.folder / "fields").iterdir()
    monkeypatch.setattr(field_cache, "build_field", lambda *args: pytest.fail("built again"))
    again = build(files, file="ball.obj").fields[0]
    assert all(getattr(first, name).tobytes() == getattr(again, name).tobytes() for name in ALL)
    assert (first.size, first.tolerance, first.band) == (again.size, again.tolerance, again.band)
    monkeypatch.undo()
    monkeypatch.setattr(field_cache, "cache_folder", lambda: files.folder / "fields")
    good = kept.read_bytes()
    spoilt = bytearray(good)
    spoilt[len(good) // 2] ^= 1
    for broken in (b"", b"PK\x03\x04", good[: len(good) // 2], bytes(spoilt)):
        kept.write_bytes(broken)
        assert build(files, file="ball.obj").fields[0].corners.tobytes() == first.corners.tobytes()
        assert field_cache.load_field(kept).child.tobytes() == first.child.tobytes()
    for changed in ({"tolerance": "6 mm"}, {"band": "1 cm"}, {"scale": 1.1}, {"centre": [0, 1, 0]}):
        build(files, **({"file": "ball.obj"} | changed))
    assert len(list((files.folder / "fields").iterdir())) == 5


def test_a_run_goes_on_where_nothing_can_be_kept(files: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    (files.folder / "file").write_text("")
    monkeypatch.setattr(field_cache, "cache_folder", lambda: files.folder / "file" / "fields")
    assert len(build(files, file="ball.obj").fields) == 1


def test_distances_are_those_of_the_field_and_it_is_left_out_of_what_is_drawn(files: Folder) -> None:
    geometry = geometry_of(build(files, file="ball.obj"))
    drawn = decode_geometry(encode_geometry(geometry))
    assert drawn.fields == () and drawn.faces.tobytes() == geometry.faces.tobytes()
    poses = Poses(0.0, np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3)))
    points = np.random.default_rng(0).normal(size=(500, 3)) * 0.4
    measured = signed_distance(points, geometry, poses)
    np.testing.assert_allclose(measured, sample_field(geometry.fields[0], points)[:, 0], atol=1e-8)


def test_a_field_that_contact_does_not_read_is_not_measured_by(files: Folder) -> None:
    scene = {
        "nuno": 1, "name": "ball", "duration": "0.1 s", "solver": {"plugin": "leapfrog", "dt": "1 ms"},
        "objects": [{"name": "cloth", "model": {"plugin": "sheet", "size": [1, 1], "resolution": [4, 4]}}],
        "bodies": [{"name": "ball", "collider": {"plugin": "sdf", "file": "ball.obj", "tolerance": "5 mm"}}],
    }  # fmt: skip
    fields = []
    for contact in ("penalty", "sliding"):
        path = files.folder / f"{contact}.yaml"
        path.write_text(yaml.safe_dump(scene | {"contact": {"plugin": contact}}))
        bodies = build_bodies(read(path))
        fields.append(sum(field is not None for field in bodies.geometry.fields))
        points = 0.2999 * np.eye(3)
        depth = -signed_distance(points, bodies.geometry, bodies.poses(0.0))
        exact = -signed_distance(points, replace(bodies.geometry, kind=np.array([MESH], np.int8)), bodies.poses(0.0))
        assert (depth.tobytes() == exact.tobytes()) == (contact == "sliding")
    assert fields == [1, 0]


def test_a_hole_is_told_with_its_place_and_the_inside_stays_inside(files: Folder) -> None:
    shape = build(files, file="holed.ply", centre=[0, 1, 0])
    assert shape.kind.tolist() == [FIELD]
    assert len(shape.notes) == 1 and "the mesh has a hole: edges with one triangle (" in shape.notes[0]
    assert "0.2" in shape.notes[0].split("at [")[1] and "winding number" in shape.notes[0]
    value = sample_field(shape.fields[0], np.array([[0.0, 1.0, 0.0], [0.0, 1.0, -0.28], [0.0, 1.0, 0.5]]))[:, 0]
    assert value[0] < -0.2 and value[1] < 0.0 < value[2]
    assert build(files, file="ball.obj").notes == ()


def test_parts_thinner_than_the_tolerance_are_told(files: Folder) -> None:
    assert build(files, file="plate.ply", tolerance="0.2 mm").notes == ()
    (note,) = build(files, file="finned.ply").notes
    assert "% of the surface is thinner than a tolerance of 0.005 m can tell, first at [" in note


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        ({"file": "missing.obj"}, "no such file"),
        ({"file": "empty.obj"}, "no triangles"),
        ({"file": "nan.obj"}, "not a finite position"),
        (
            {"file": "flat.ply", "tolerance": "2 cm", "rotate": {"axis": [1, 1, 0], "angle": "40 deg"}},
            "encloses nothing",
        ),
        ({"file": "inwards.ply"}, "inside out"),
        ({"file": "ball.obj", "tolerance": 0.3}, "larger than the body"),
        ({"file": "ball.obj", "tolerance": "1 um"}, "finer than a field can be"),
        ({"shape": "leg", "resolution": 24, "tolerance": "20 um"}, "too large"),
    ],
)
def test_what_makes_no_field_is_refused(
    files: Folder, monkeypatch: pytest.MonkeyPatch, config: dict[str, object], problem: str
) -> None:
    if problem == "too large":
        monkeypatch.setattr("nuno_contact.colliders.sdf.LARGEST", 1 << 22)
    with pytest.raises(BadInput, match=problem):
        build(files, **config)
    assert problem == "encloses nothing" or not (files.folder / "fields").exists()


@pytest.mark.parametrize("tolerance", [0, "-1 mm", float("nan"), "1 kg"])
def test_a_tolerance_that_is_no_length_is_refused_by_its_name(tolerance: object) -> None:
    with pytest.raises(ValueError, match="tolerance"):
        SdfConfig.model_validate({"shape": "leg", "tolerance": tolerance})


def test_penalty_takes_a_scan_that_passes_through_itself_as_a_field(files: Folder) -> None:
    """What sliding and cloth contact advise for cloth that starts in its folds."""
    ball = trimesh.creation.icosphere(3, 0.3)
    other = ball.copy()
    other.apply_translation([0.4, 0.04, 0.02])
    trimesh.util.concatenate([ball, other]).export(files.folder / "both.obj")
    shape = build(files, file="both.obj", tolerance="2 cm")
    check(geometry_of(shape))
    folds, world = np.array([[0.2, 0.0, 0.0], [0.2, 0.4, 0.0]]), Poses(0.0, np.eye(4)[:1], np.zeros((1, 3)))
    inside = signed_distance(folds, geometry_of(shape), world) < 0.0
    assert inside.tolist() == [True, False]
