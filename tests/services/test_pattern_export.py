"""Sewn garments' flat patterns and prints, from recordings into files."""

from __future__ import annotations

import json
import re
import shutil
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sewing_patterns as patterns
import trimesh
from PIL import Image
from scenes import write_scene
from sewing_patterns import read_pattern

import nuno
from nuno.cli import main
from nuno.exports.cloth import cut_pieces, paint_stretch, read_frame, read_pieces
from nuno.exports.meshes import export_mesh
from nuno.exports.pattern import export_pattern, strains
from nuno.plugin_contract.guards import check_fabric
from nuno.plugin_contract.values import ContractError
from nuno.python_api.fit import measure
from nuno.recording.reader import open_recording
from nuno.scene.files import SceneFiles
from nuno.scene.scene_file import read
from nuno.simulation.cloth import build_fabric, join_fabrics
from nuno.simulation.operations import fabric_arrays, fabric_from, frames_bound
from nuno.simulation.renumbering import renumber
from nuno_cloth.models.pattern import Pattern as PatternModel
from nuno_cloth.models.pattern import PatternConfig
from nuno_cloth.sewing.sew import sew
from nuno_geometry.mesh_files.mesh import load_mesh
from nuno_schemas.colour import to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

PATTERN = Path(__file__).parents[2] / "scenes" / "sewn" / "patterns" / "top.yaml"
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sheet between two tops that no body wears."""
    folder = tmp_path_factory.mktemp("flat")
    shutil.copy(PATTERN, folder)
    top = {"plugin": "pattern", "file": "top.yaml", "edge": 0.1}
    sheet = {"plugin": "sheet", "resolution": [4, 4], "pin": ["top-row"]}
    models = {"one": top, "sheet": sheet, "two": top}
    objects = [{"name": name, "model": model} for name, model in models.items()]
    nuno.run(write_scene(folder, objects=objects, duration=0.04), record=folder / "run.mcap")
    return folder / "run.mcap"


def numbers(text: str) -> Float:
    """(n, 2) points of a path or polygon."""
    return np.array([point.split(",") for point in text.strip("MZ").split()], float)


def drawn(path: Path) -> list[ElementTree.Element]:
    """The garments of a drawing."""
    return ElementTree.parse(path).getroot().findall(f".//{SVG}g[@class='garment']")


def test_outlines_are_as_long_and_large_as_the_pattern(recording: Path, tmp_path: Path) -> None:
    path = export_pattern(recording, tmp_path / "flat.svg")
    root, pattern = ElementTree.parse(path).getroot(), read_pattern(SceneFiles(recording.parent), "top.yaml")
    box = [float(value) for value in root.attrib["viewBox"].split()]
    assert [root.attrib["width"], root.attrib["height"]] == [f"{value:.3f}mm" for value in box[2:]]
    garments = drawn(path)
    assert len(garments) == 2
    for garment in garments:
        panels = garment.findall(f"{SVG}g[@class='panel']")
        assert [panel.attrib["data-name"] for panel in panels] == list(pattern.panels)
        for panel, cut in zip(panels, pattern.panels.values(), strict=True):
            outline = panel.find(f"{SVG}path[@class='outline']")
            assert outline is not None
            x, y = (points := numbers(outline.attrib["d"])).T
            sides = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
            assert sides.sum() == pytest.approx(1e3 * sum(edge.length for edge in cut.edges), rel=1e-3)
            area = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
            assert area == pytest.approx(1e6 * abs(cut.area), rel=1e-3)


def test_a_seam_has_its_letters_on_two_edges_of_its_own_length(recording: Path, tmp_path: Path) -> None:
    pattern = read_pattern(SceneFiles(recording.parent), "top.yaml")
    for garment in drawn(export_pattern(recording, tmp_path / "flat.svg")):
        edges: dict[str, list[Float]] = {}
        for seam in garment.findall(f"{SVG}polyline[@class='seam']"):
            edges.setdefault(seam.attrib["data-seam"], []).append(numbers(seam.attrib["points"]))
        assert list(edges) == ["A", "B", "C", "D"]
        for (one, other), sewn in zip(edges.values(), pattern.seams, strict=True):
            assert len(one) == len(other)
            found = [np.linalg.norm(np.diff(run, axis=0), axis=1).sum() for run in (one, other)]
            assert found == pytest.approx([1e3 * pattern.edge(side).length for side in sewn.sides], rel=1e-3)


@pytest.mark.parametrize("colour", ["warp", "weft"])
def test_triangles_are_painted_by_the_strain_that_fit_reports(recording: Path, tmp_path: Path, colour: str) -> None:
    garment = drawn(export_pattern(recording, tmp_path / "flat.svg", 1, colour))[0]
    with open_recording(recording) as opened:
        piece, x = read_pieces(opened)[0], read_frame(opened, 1).x
    config = PatternConfig.model_validate({"file": "top.yaml", "edge": 0.1})
    single = PatternModel().build(config, SceneFiles(recording.parent), 0).membrane
    assert single is not None
    own = x[piece.start : piece.stop].copy()
    own *= 1.0 + 0.1 * own[:, 1:2]  # farther from rest than two frames bring it
    found, area = strains(piece, own)[colour], single.area
    spread = measure("one", own, single, (own, single.faces), {}).strains[colour]
    assert found.max() == pytest.approx(spread.most, abs=1e-5) and spread.most > 0.01
    order = np.argsort(found)
    median = found[order][np.searchsorted(np.cumsum(area[order]) / area.sum(), 0.5)]
    assert median == pytest.approx(spread.median, abs=1e-5)
    fills = [polygon.attrib["fill"] for polygon in garment.iter(f"{SVG}polygon")]
    shown = np.array([list(bytes.fromhex(fill[1:])) for fill in fills])
    expected = 255.0 * to_srgb(paint_stretch(strains(piece, x[piece.start : piece.stop])[colour]))
    assert np.abs(shown - expected).max() <= 0.5 + 1e-9


def test_panels_follow_joined_cloth_and_come_back_from_a_recording(recording: Path) -> None:
    fabric = build_fabric(read(recording.parent / "scene.yaml"))[0]
    twice = join_fabrics([fabric, fabric], "twice")
    check_fabric(twice)
    assert twice.corners is not None and twice.corners.panels is not None
    panels, corners = twice.corners.panels, twice.corners
    assert panels.names == ("front", "back") * 4 and panels.seam.max() == 15
    resumed = fabric_from(fabric_arrays(fabric), fabric, {}, frames_bound(fabric)).corners
    assert resumed is not None and fabric.corners is not None and resumed.panels is fabric.corners.panels
    assert (np.diff(corners.vertex[panels.pairs]) == 0).all()
    with open_recording(recording) as opened:
        one, sheet, two = (piece.corners for piece in read_pieces(opened))
    assert one is not None and two is not None and sheet is not None and sheet.panels is None
    for own in (one, two):
        assert own.panels is not None and own.panels.names == ("front", "back")
        assert (np.diff(own.vertex[own.panels.pairs]) == 0).all() and own.panels.seam.max() == 3


def test_meshes_name_panels(recording: Path, tmp_path: Path) -> None:
    lines = export_mesh(recording, tmp_path / "out.obj").read_text().splitlines()
    assert [line for line in lines if line[:2] in ("o ", "g ")] == [
        "o one", "g front", "g back", "o sheet", "o two", "g front", "g back",
    ]  # fmt: skip
    data = export_mesh(recording, tmp_path / "out.glb").read_bytes()
    meshes = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])["meshes"]
    runs = next(mesh for mesh in meshes if mesh["name"] == "one")["extras"]["panels"]
    assert [run[0] for run in runs] == ["front", "back"] and runs[0][1] == 0 and runs[0][2] == runs[1][1]


def test_what_has_no_pattern_or_another_ending_is_refused(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(BadInput, match=r"must end in \.svg"):
        export_pattern(recording, tmp_path / "flat.png")
    sheet = [{"name": "sheet", "model": {"plugin": "sheet", "resolution": [4, 4], "pin": ["top-row"]}}]
    nuno.run(write_scene(tmp_path, objects=sheet, duration=0.02), record=tmp_path / "sheet.mcap")
    with pytest.raises(BadInput, match="no garment is sewn from a pattern"):
        export_pattern(tmp_path / "sheet.mcap", tmp_path / "flat.svg")
    assert not (tmp_path / "flat.svg").exists()
    assert main(["export", str(recording), "--png", str(tmp_path / "out.png"), "--colour", "warp"]) == 2
    assert "for --pattern alone" in capsys.readouterr().err


def test_a_short_edge_that_is_closed_leaves_no_slit_in_the_drawing(tmp_path: Path) -> None:
    """0.5 mm beside a seam, whose vertices become one: the panel is drawn as it is cut, and its seam in full."""
    notched = patterns.panel((0, 0), (30, 0), (30, 20), (0.05, 20), (0, 20), translation=[-15, 100, 15])
    seams = patterns.stitch("front[1]", "back[2]"), patterns.stitch("front[4]", "back[0]")
    (tmp_path / "tube.json").write_text(
        json.dumps(patterns.pattern({"front": notched, "back": patterns.back()}, *seams))
    )
    model = {"plugin": "pattern", "file": "tube.json", "edge": 0.05}
    scene = write_scene(tmp_path, objects=[{"name": "tube", "model": model}], duration=0.02)
    nuno.run(scene, record=tmp_path / "run.mcap")
    (garment,) = drawn(export_pattern(tmp_path / "run.mcap", tmp_path / "flat.svg"))
    outline = garment.find(f"{SVG}g[@data-name='front']/{SVG}path[@class='outline']")
    assert outline is not None
    points = numbers(outline.attrib["d"])
    assert np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum() == pytest.approx(1000.0, rel=2e-3)
    lengths = [
        float(np.linalg.norm(np.diff(numbers(seam.attrib["points"]), axis=0), axis=1).sum())
        for seam in garment.findall(f"{SVG}polyline[@class='seam']")
    ]
    assert lengths == pytest.approx([200.0] * 4, rel=2e-3)


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A top whose panels are cut of an image, and one in a colour."""
    folder = tmp_path_factory.mktemp("printed")
    shutil.copy(PATTERN, folder)
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(folder / "print.png")
    top = {"plugin": "pattern", "file": "top.yaml", "edge": 0.1}
    objects = [
        {"name": "print", "model": top | {"texture": "print.png"}},
        {"name": "plain", "model": top, "colour": "#204060"},
    ]
    nuno.run(write_scene(folder, objects=objects, duration=0.02), record=folder / "run.mcap")
    return folder / "run.mcap"


def test_the_print_lies_on_each_panel_as_it_is_cut(printed: Path, tmp_path: Path) -> None:
    """Every point of an outline is where the image has the texture coordinates of a corner of that panel."""
    garment, plain = drawn(export_pattern(printed, tmp_path / "flat.svg", None, "cloth"))
    with open_recording(printed) as opened:
        corners = read_pieces(opened)[0].corners
    assert corners is not None and corners.panels is not None
    for k, panel in enumerate(garment.findall(f"{SVG}g[@class='panel']")):
        image = panel.find(f".//{SVG}image")
        outline, clip = panel.find(f"{SVG}path[@class='outline']"), panel.find(f"{SVG}clipPath/{SVG}path")
        assert image is not None and outline is not None and clip is not None
        assert clip.attrib["d"] == outline.attrib["d"]
        x, y, wide, high = (float(image.attrib[name]) for name in ("x", "y", "width", "height"))
        assert wide == high == pytest.approx(1e3 * corners.panels.unit[k], abs=1e-3)
        points = numbers(outline.attrib["d"])
        found = np.stack([(points[:, 0] - x) / wide, 1.0 - (points[:, 1] - y) / high], axis=1)
        own = corners.points[np.unique(corners.faces[corners.panels.of == k])]
        assert np.linalg.norm(found[:, None] - own[None], axis=2).min(axis=1).max() < 1e-5
    for panel in plain.findall(f"{SVG}g[@class='panel']"):
        fill, outline = panel.find(f"{SVG}path[@class='cloth']"), panel.find(f"{SVG}path[@class='outline']")
        assert fill is not None and outline is not None
        assert (fill.attrib["fill"], fill.attrib["d"]) == ("#204060", outline.attrib["d"])
    assert len({clip.attrib["id"] for clip in garment.iter(f"{SVG}clipPath")}) == 2
    assert not list(plain.iter(f"{SVG}clipPath"))


def test_a_print_is_refused_as_a_pdf(printed: Path, tmp_path: Path) -> None:
    pytest.importorskip("fpdf")
    with pytest.raises(BadInput, match=r"PDF cannot show a print[\s\S]*\.svg"):
        export_pattern(printed, tmp_path / "flat.pdf", None, "cloth")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("colour", ["auto", "stretch"])
def test_a_pdf_is_one_page_as_large_as_the_drawing(printed: Path, tmp_path: Path, colour: str) -> None:
    pytest.importorskip("fpdf")
    root = ElementTree.parse(export_pattern(printed, tmp_path / "flat.svg", None, colour)).getroot()
    data = export_pattern(printed, tmp_path / "flat.pdf", None, colour).read_bytes()
    wide, high = (float(root.attrib[name].removesuffix("mm")) / 25.4 * 72.0 for name in ("width", "height"))
    boxes = re.findall(rb"/MediaBox \[([0-9. ]+)\]", data)
    assert data.startswith(b"%PDF") and boxes
    assert [float(value) for value in boxes[-1].split()[-2:]] == pytest.approx([wide, high], abs=0.02)
    assert len(re.findall(rb"/Type /Page\b", data)) == 1


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
def recorded_prints(scene: Path) -> Path:
    nuno.run(scene, record=scene.parent / "run.mcap")
    return scene.parent / "run.mcap"


@pytest.fixture(scope="module")
def fabric(scene: Path) -> Fabric:
    return build_fabric(read(scene))[0]


def sides(points: Float, faces: np.ndarray) -> Float:
    """(f, 3) lengths of triangles' sides."""
    return np.asarray(np.linalg.norm(points[np.roll(faces, -1, axis=1)] - points[faces], axis=2))


@pytest.mark.full
def test_a_glb_has_each_triangle_in_the_image_as_it_is_cut(recorded_prints: Path, scene: Path, tmp_path: Path) -> None:
    """Sides in the image are those of the panel at one scale; parts of a split vertex share place and normal."""
    written = trimesh.load(export_mesh(recorded_prints, tmp_path / "out.glb"), process=False, force="scene")
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
def test_an_obj_keeps_seams_closed_and_each_panels_coordinates(
    recorded_prints: Path, fabric: Fabric, tmp_path: Path
) -> None:
    lines = [line.split() for line in export_mesh(recorded_prints, tmp_path / "out.obj").read_text().splitlines()]
    uv = np.array([line[1:] for line in lines if line[0] == "vt"], np.float32)
    corners = np.array([[c.split("/") for c in line[1:]] for line in lines if line[0] == "f"], int) - 1
    assert fabric.corners is not None and sum(line[0] == "v" for line in lines) == fabric.number
    assert np.array_equal(corners[..., 0], fabric.faces)
    assert np.array_equal(uv[corners[..., 1]], fabric.corners.points[fabric.corners.faces])


@pytest.mark.full
def test_a_recording_gives_corners_back(recorded_prints: Path, fabric: Fabric) -> None:
    with open_recording(recorded_prints) as opened:
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
def test_what_is_written_with_seams_is_read_with_them(suffix: str, recorded_prints: Path, tmp_path: Path) -> None:
    """The sheet has a coordinate for each vertex, the top several along its seams."""
    with open_recording(recorded_prints) as opened:
        pieces = read_pieces(opened)
    mesh = load_mesh(export_mesh(recorded_prints, tmp_path / f"a{suffix}", 0))
    assert mesh.uv is not None and any(piece.seamed for piece in pieces)
    written = [piece.laid_out.points[piece.laid_out.faces] for piece in pieces if piece.laid_out is not None]
    np.testing.assert_allclose(mesh.uv, np.concatenate(written), atol=1e-7)
    assert mesh.faces.tolist() == np.concatenate([piece.faces + piece.start for piece in pieces]).tolist()
