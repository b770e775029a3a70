"""Meshes from files: what is read in four formats, what is refused and where, what can be mended; the leg."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from nuno_contact.body_shapes.leg import leg_mesh
from nuno_contact.colliders.mesh import MeshCollider, MeshConfig
from nuno_contact.sliding.plugin import check_meshes
from nuno_geometry.check import check_closed, check_crossings, volume
from nuno_geometry.mesh_files.mesh import load_mesh, read_closed
from nuno_geometry.sections import cut_mesh
from nuno_schemas.bodies import MESH
from nuno_schemas.errors import BadInput
from nuno_testing.bodies import Distance


class Anywhere:
    def resolve(self, name: str) -> Path:
        return Path(name)


def save(mesh, path: Path) -> Path:
    mesh.export(path)
    return path


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=2)


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "glb"])
def test_a_closed_mesh_is_read_from_every_format(tmp_path: Path, kind: str) -> None:
    x, faces = read_closed(save(ball(), tmp_path / f"ball.{kind}"), scale=0.1)
    assert (len(x), len(faces)) == (162, 320)
    assert volume(x, faces) == pytest.approx(ball().volume * 1e-3, rel=1e-5)


def test_a_hole_is_named_with_its_edge_and_place_and_can_be_mended(tmp_path: Path) -> None:
    mesh = ball()
    mesh.update_faces(np.arange(len(mesh.faces)) != 7)
    path = save(mesh, tmp_path / "hole.obj")
    with pytest.raises(BadInput, match=r"edge \d+-\d+: the mesh has a hole") as refusal:
        read_closed(path)
    assert "at [" in str(refusal.value) and str(path) in str(refusal.value)
    assert len(read_closed(path, mend=True)[1]) == 320


@pytest.mark.parametrize("scale", [1.0, 0.0254])
def test_a_hole_is_where_a_mesh_editor_shows_it(tmp_path: Path, scale: float) -> None:
    """Whatever the scene makes of the file's unit."""
    mesh = ball()
    mesh.update_faces(np.arange(len(mesh.faces)) != 7)
    with pytest.raises(BadInput, match="hole") as refusal:
        read_closed(save(mesh, tmp_path / "hole.obj"), scale)
    said = re.fullmatch(r"at \[(.*)\] in the file's own axes and unit", str(refusal.value.value))
    assert said
    place = np.array([float(one) for one in said[1].split(",")])
    edges = mesh.vertices[mesh.edges_sorted[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]]
    assert np.abs(edges.mean(axis=1) - place).max(axis=1).min() < 1e-4


TRIANGLE = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0.5 0\nendloop\nendfacet\n"
PLY = (
    "ply\nformat ascii 1.0\ncomment 0,5\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 0.5 0\n3 0 1 2\n"
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 0.5 0\nf 1 2 3\n"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 1\nf 1/1 2/1 3/1\n"),
        ("a.ply", PLY),
        ("a.stl", f"solid a\n{TRIANGLE}endsolid\n"),
    ],
)
def test_a_decimal_comma_in_a_mesh_is_refused_with_its_line(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    load_mesh(path)
    path.write_text(text.replace("0.5", "0,5"))
    with pytest.raises(BadInput) as refusal:
        load_mesh(path)
    error = refusal.value
    assert "0,5" in f"{error.problem} {error.value}" and error.remedy == "write 0.5: numbers have a decimal point"
    assert error.line == 1 + next(n for n, line in enumerate(text.splitlines()) if "0.5" in line)


@pytest.mark.parametrize(("name", "text"), [("a.ply", PLY), ("a.stl", f"solid a\n{TRIANGLE}endsolid\n")])
def test_thousands_behind_a_blank_are_no_numbers_of_their_own(tmp_path: Path, name: str, text: str) -> None:
    """An STL's 1 000 0 0 was the vertex (1, 0, 0)."""
    path = tmp_path / name
    path.write_text(text.replace("1 0 0", "1 000 0 0"))
    with pytest.raises(BadInput, match="cannot be read"):
        load_mesh(path)


def test_a_closed_body_whose_ends_are_cut_off_is_filled_whatever_its_rims(tmp_path: Path) -> None:
    """Along its triangles, so that the rims are jagged: what is lost is less than what was cut off."""
    mesh, notes = trimesh.creation.icosphere(subdivisions=3), list[str]()
    mesh.update_faces(np.abs(mesh.triangles_center[:, 1]) < 0.9)
    x, faces = read_closed(save(mesh, tmp_path / "open.obj"), 0.1, mend=True, notes=notes)
    least = np.abs(mesh.vertices[mesh.edges[trimesh.grouping.group_rows(mesh.edges_sorted, 1)], 1]).min()
    cap = np.pi / 3.0 * (1.0 - least) ** 2 * (2.0 + least)
    assert 0.0 < trimesh.creation.icosphere(subdivisions=3).volume - 1e3 * volume(x, faces) < 2.0 * cap
    assert len(x) == len(np.unique(mesh.faces)) and re.match(
        "mended: 2 holes filled, the largest, of [0-9]+ edges", notes[0]
    )


def test_holes_of_any_shape_are_filled_and_those_that_touch_each_on_its_own(tmp_path: Path) -> None:
    """The lid and the floor of an L; and random patches of a ball's triangles, which often share vertices."""
    plan = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 2], [0, 2]], float)
    x = np.concatenate([np.insert(plan, 2, z, axis=1) for z in (0.0, 1.0)])
    sides = [(k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6) for k in range(6)]
    faces = np.array([[a, b, c] for a, b, c, _ in sides] + [[a, c, d] for a, _, c, d in sides])
    tube = save(trimesh.Trimesh(x, faces, process=False), tmp_path / "tube.obj")
    assert volume(*read_closed(tube, mend=True)) == pytest.approx(4.0)
    rng = np.random.default_rng(0)
    for _ in range(20):
        mesh = ball()
        mesh.update_faces(rng.random(len(mesh.faces)) > 0.1)
        path = save(mesh, tmp_path / "torn.obj")
        assert 0.9 * ball().volume < volume(*read_closed(path, mend=True)) < 1.001 * ball().volume


def test_a_rim_that_crosses_itself_is_filled_from_its_middle_and_a_slit_is_refused(tmp_path: Path) -> None:
    """A star of eight points under one top; and a tetrahedron with a vertex in the middle of one triangle's side."""
    turns = 0.75 * np.pi * np.arange(8)
    x = np.concatenate([np.stack([np.cos(turns), 0.0 * turns, np.sin(turns)], axis=1), [[0.0, 1.0, 0.0]]])
    star = trimesh.Trimesh(x, [[k, 8, (k + 1) % 8] for k in range(8)], process=False)
    assert volume(*read_closed(save(star, tmp_path / "star.obj"), mend=True)) == pytest.approx(
        8 / 6 * np.sin(np.pi / 4)
    )
    slit = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 0.5 0 0\nf 1 3 5\nf 5 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    (tmp_path / "slit.obj").write_text(slit)
    with pytest.raises(BadInput, match="has a hole") as refusal:
        read_closed(tmp_path / "slit.obj", mend=True)
    assert refusal.value.remedy is not None and "mesh editor" in refusal.value.remedy


def test_triangles_that_face_the_wrong_way_are_named_and_can_be_turned(tmp_path: Path) -> None:
    mesh = ball()
    faces = np.array(mesh.faces)
    faces[11] = faces[11, ::-1]
    path = save(trimesh.Trimesh(mesh.vertices, faces, process=False), tmp_path / "turned.obj")
    with pytest.raises(BadInput, match="opposite ways"):
        read_closed(path)
    x, mended = read_closed(path, mend=True)
    assert volume(x, mended) == pytest.approx(mesh.volume, rel=1e-6)


def test_a_mesh_inside_out_is_refused_and_can_be_turned(tmp_path: Path) -> None:
    mesh = ball()
    path = save(trimesh.Trimesh(mesh.vertices, np.array(mesh.faces)[:, ::-1], process=False), tmp_path / "in.obj")
    with pytest.raises(BadInput, match="inside out"):
        read_closed(path)
    assert volume(*read_closed(path, mend=True)) > 0.0


def test_a_mesh_that_passes_through_itself_is_noted_with_both_faces_and_no_vertex_slides_on_it(tmp_path: Path) -> None:
    one, other = ball(), ball()
    other.apply_translation([1.5, 0.13, 0.07])
    both = trimesh.util.concatenate([one, other])
    save(both, tmp_path / "both.obj")
    shape = MeshCollider().build(MeshConfig(file=str(tmp_path / "both.obj")), None, Anywhere())
    assert re.fullmatch(r"the mesh passes through itself \(\d+ faces\): faces \d+ and \d+ at \[.*\] m", shape.notes[0])
    with pytest.raises(
        BadInput, match="sliding contact is with closed meshes, and the mesh passes through itself"
    ) as no:
        check_meshes(Distance(shape, exact=True).geometry)
    # The way out for cloth in the folds of a scan, which sliding, cloth contact, and penalty on a mesh refuse in turn.
    assert "collider: {plugin: sdf, ...}, contact: {plugin: penalty}" in str(no.value.remedy)
    other.apply_translation([1.0, 0.0, 0.0])
    save(trimesh.util.concatenate([one, other]), tmp_path / "apart.obj")
    shape = MeshCollider().build(MeshConfig(file=str(tmp_path / "apart.obj")), None, Anywhere())
    assert shape.faces is not None and len(shape.faces) == 640 and shape.notes == ()
    check_meshes(Distance(shape, exact=True).geometry)


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("a.txt", "x", "unknown kind"),
        ("a.obj", "", "no triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "not a finite|cannot be read"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangle of the mesh has an area"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "hole"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, name: str, text: str, problem: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(BadInput, match=problem):
        read_closed(path)


def test_a_collider_is_scaled_turned_and_moved(tmp_path: Path) -> None:
    path = save(trimesh.creation.box((2.0, 1.0, 1.0)), tmp_path / "box.stl")
    config = MeshConfig.model_validate(
        {"file": str(path), "scale": "10 mm", "rotate": {"axis": [0, 0, 1], "angle": "90 deg"}, "centre": [0, 1, 0]}
    )
    shape = MeshCollider().build(config, None, Anywhere())
    assert shape.kind.tolist() == [MESH] and shape.owner.tolist() == [0] * 12
    np.testing.assert_allclose(shape.a, [[-0.005, 0.99, -0.005]], atol=1e-12)
    np.testing.assert_allclose(shape.b, [[0.005, 1.01, 0.005]], atol=1e-12)
    assert np.isfinite(shape.vertices).all() and shape.vertices.shape == (8, 3)


def test_a_mesh_needs_a_source_and_takes_the_file_before_the_shape(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a file or a shape"):
        MeshConfig.model_validate({})
    with pytest.raises(ValueError, match="up is for files"):
        MeshConfig.model_validate({"shape": "leg", "up": "z"})
    config = MeshConfig.model_validate({"file": str(save(ball(), tmp_path / "ball.ply")), "shape": "leg"})
    assert len(MeshCollider().build(config, None, Anywhere()).vertices) == 162
    assert not MeshCollider().heights(config) and MeshCollider().heights(MeshConfig(shape="leg"))


def test_what_is_up_in_a_file_is_up_in_the_scene(tmp_path: Path) -> None:
    """A right-handed turn: x stays, z goes up, and what was y lies behind."""
    path = save(trimesh.creation.box((1.0, 2.0, 3.0)), tmp_path / "box.ply")
    shape = MeshCollider().build(MeshConfig.model_validate({"file": str(path), "up": "z"}), None, Anywhere())
    np.testing.assert_allclose(shape.b - shape.a, [[1.0, 3.0, 2.0]])
    assert volume(shape.vertices, shape.faces) == pytest.approx(6.0)


@pytest.mark.parametrize("around", [12, 48, 96])
def test_the_leg_is_closed_and_does_not_meet_itself_at_any_resolution(around: int) -> None:
    x, faces = leg_mesh(around)
    check_closed(x, faces)
    check_crossings(x, faces)
    assert volume(x, faces) == pytest.approx(9e-3, rel=0.15)


def test_the_leg_has_the_girths_it_was_made_from() -> None:
    """At thigh, knee, calf and ankle; between them girths are interpolated."""
    x, faces = leg_mesh(160)
    for height, girth in ((0.70, 0.572), (0.455, 0.353), (0.320, 0.350), (0.113, 0.212)):
        found = max(loop.girth for loop in cut_mesh(x, faces, x[:, 1] - height))
        assert found == pytest.approx(girth, rel=0.02), height
    assert np.ptp(x[x[:, 1] < 0.06, 2]) == pytest.approx(0.245, rel=0.02)
