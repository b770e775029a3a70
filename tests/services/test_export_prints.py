"""Prints on a garment sewn from a pattern, beside a sheet: recorded, read back, and written to files."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scenes import write_scene
from sewing_patterns import read_pattern

import nuno
from nuno.exports.cloth import cut_pieces, read_pieces
from nuno.exports.meshes import export_mesh
from nuno.plugin_contract.results import check_fabric
from nuno.plugin_contract.values import ContractError
from nuno.recording.reader import open_recording
from nuno.scene.files import SceneFiles
from nuno.scene.scene_file import read
from nuno.simulation.cloth.build import build_fabric
from nuno.simulation.cloth.join import join_fabrics
from nuno.simulation.cloth.numbering import renumber
from nuno_cloth.sewing.sew import sew
from nuno_geometry.files.mesh import load_mesh
from nuno_schemas.fabric import Fabric, Float

PATTERN = Path(__file__).parents[2] / "scenes" / "sewn" / "patterns" / "top.yaml"
EDGE = 0.1


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sheet, and a top that no body wears, both with an image."""
    folder = tmp_path_factory.mktemp("prints")
    shutil.copy(PATTERN, folder)
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(folder / "print.png")
    top = {"plugin": "pattern", "file": "top.yaml", "edge": EDGE, "texture": "print.png"}
    sheet = {"plugin": "sheet", "resolution": [4, 4], "texture": "print.png", "pin": ["top-row"]}
    objects = [{"name": "sheet", "model": sheet}, {"name": "top", "model": top}]
    return write_scene(folder, objects=objects, duration=0.02)


@pytest.fixture(scope="module")
def recording(scene: Path) -> Path:
    nuno.run(scene, record=scene.parent / "run.mcap")
    return scene.parent / "run.mcap"


@pytest.fixture(scope="module")
def fabric(scene: Path) -> Fabric:
    return build_fabric(read(scene))[0]


def sides(points: Float, faces: np.ndarray) -> Float:
    """(f, 3) lengths of triangles' sides."""
    return np.asarray(np.linalg.norm(points[np.roll(faces, -1, axis=1)] - points[faces], axis=2))


@pytest.mark.full
def test_a_glb_has_each_triangle_in_the_image_as_it_is_cut(recording: Path, scene: Path, tmp_path: Path) -> None:
    """Sides in the image are those of the panel at one scale; parts of a split vertex share place and normal."""
    written = trimesh.load(export_mesh(recording, tmp_path / "out.glb"), process=False, force="scene")
    top, sheet = written.geometry["top"], written.geometry["sheet"]
    sewn = sew(read_pattern(SceneFiles(scene.parent), "top.yaml"), EDGE)
    cut, shown = sides(sewn.flat, sewn.faces), sides(top.visual.uv, top.faces)
    assert shown / cut == pytest.approx(np.full(cut.shape, shown.sum() / cut.sum()), rel=1e-4)
    assert len(top.vertices) == len(sewn.merged) > sewn.number
    first = np.unique(sewn.merged, return_index=True)[1][sewn.merged]
    assert np.array_equal(top.vertices, top.vertices[first])
    assert np.array_equal(top.vertex_normals, top.vertex_normals[first])
    assert len(sheet.vertices) == 16 and np.ptp(sheet.visual.uv, axis=0) == pytest.approx([1.0, 1.0])


@pytest.mark.full
def test_an_obj_keeps_seams_closed_and_each_panels_coordinates(recording: Path, fabric: Fabric, tmp_path: Path) -> None:
    lines = [line.split() for line in export_mesh(recording, tmp_path / "out.obj").read_text().splitlines()]
    uv = np.array([line[1:] for line in lines if line[0] == "vt"], np.float32)
    corners = np.array([[c.split("/") for c in line[1:]] for line in lines if line[0] == "f"], int) - 1
    assert fabric.corners is not None and sum(line[0] == "v" for line in lines) == fabric.number
    assert np.array_equal(corners[..., 0], fabric.faces)
    assert np.array_equal(uv[corners[..., 1]], fabric.corners.points[fabric.corners.faces])


@pytest.mark.full
def test_a_recording_gives_corners_back(recording: Path, fabric: Fabric) -> None:
    with open_recording(recording) as opened:
        sheet, top = read_pieces(opened)
        arrays, text = opened.fabric()
    corners = fabric.corners
    assert corners is not None and top.corners is not None and sheet.corners is not None and top.image is not None
    assert (top.seamed, sheet.seamed) == (True, False)
    shown = np.concatenate([piece.corners.points[piece.corners.faces] for piece in (sheet, top) if piece.corners])
    assert np.array_equal(shown, corners.points[corners.faces])
    assert np.array_equal(top.corners.vertex[top.corners.faces], top.faces)
    older = {name: array for name, array in arrays.items() if not name.startswith("corner_")}
    assert [piece.corners for piece in cut_pieces(older, text)] == [None, None]
    with pytest.raises(ValueError, match="corners that are not those of the faces"):
        cut_pieces({**arrays, "corner_faces": np.roll(arrays["corner_faces"], 1, axis=0)}, text)


def test_corners_follow_renumbered_and_joined_cloth(fabric: Fabric) -> None:
    numbers = np.random.default_rng(0).permutation(fabric.number).astype(np.int32)
    for changed in (renumber(fabric, numbers), join_fabrics([fabric, fabric], "two")):
        check_fabric(changed)
        assert fabric.corners is not None and changed.corners is not None
        mine = changed.corners.points[changed.corners.faces[-len(fabric.faces) :]]
        assert np.array_equal(mine, fabric.corners.points[fabric.corners.faces])


def test_corners_of_other_vertices_are_wrong(fabric: Fabric) -> None:
    assert fabric.corners is not None
    other = replace(fabric.corners, vertex=np.roll(fabric.corners.vertex, 1))
    with pytest.raises(ContractError, match=r"corners\.faces are of other vertices than faces at row 0"):
        check_fabric(replace(fabric, corners=other))
    with pytest.raises(ContractError, match=r"corners\.faces is \d+ at row 0"):
        check_fabric(replace(fabric, corners=replace(fabric.corners, faces=fabric.corners.faces + np.int32(9999))))


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_what_is_written_with_seams_is_read_with_them(suffix: str, recording: Path, tmp_path: Path) -> None:
    """The sheet has a coordinate for each vertex, the top several along its seams."""
    with open_recording(recording) as opened:
        pieces = read_pieces(opened)
    mesh = load_mesh(export_mesh(recording, tmp_path / f"a{suffix}", 0))
    assert mesh.uv is not None and any(piece.seamed for piece in pieces)
    written = [piece.laid_out.points[piece.laid_out.faces] for piece in pieces if piece.laid_out is not None]
    np.testing.assert_allclose(mesh.uv, np.concatenate(written), atol=1e-7)
    assert mesh.faces.tolist() == np.concatenate([piece.faces + piece.start for piece in pieces]).tolist()
