"""Cloth far from the world's origin is exported with the digits that its recording has."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from recorded_sheet import RATE, Sheet, items, metadata, write

from nuno.exports.cloth import cut_pieces
from nuno.exports.meshes import export_mesh, export_meshes
from nuno.exports.pictures import export_picture
from nuno.exports.tables import export_csv, export_npz
from nuno.recording.reader import open_recording
from nuno.recording.writer import RecordingWriter
from nuno_schemas.fabric import Float
from nuno_schemas.messages import BODIES, GEOMETRY

FAR = np.array([1e6, -1e6, 1e6 + 0.25])
FRAMES = 5


class Moved(Sheet):
    """The same sheet, somewhere else."""

    def __init__(self, shift: Float) -> None:
        super().__init__()
        self.shift = shift

    def x(self, t: float) -> Float:
        return super().x(t) + self.shift


@pytest.fixture(scope="module")
def sheet() -> Sheet:
    return Moved(FAR)


@pytest.fixture(scope="module")
def path(sheet: Sheet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("far") / "run.mcap"
    write(path, sheet, FRAMES)
    return path


def placed(path: Path) -> Float:
    """Positions of the cloth in a mesh file, wherever its nodes are."""
    scene = trimesh.load(path, process=False, maintain_order=True, force="scene")
    name = "cloth" if "cloth" in scene.geometry else next(iter(scene.geometry))
    node = next(node for node in scene.graph.nodes_geometry if scene.graph[node][1] == name)
    return np.asarray(scene.geometry[name].vertices + scene.graph[node][0][:3, 3], np.float64)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
def test_mesh_files_hold_what_was_recorded(path: Path, sheet: Sheet, tmp_path: Path, suffix: str) -> None:
    """To the last bit; and the recording is within float32 of the cloth's size, not of its distance."""
    with open_recording(path) as recording:
        frames = list(recording.frames())
    each = export_meshes(path, tmp_path / "frames", suffix)
    for frame, out in zip(frames, [*each[:-1], export_mesh(path, tmp_path / f"out{suffix}")], strict=True):
        found = placed(out)
        assert np.array_equal(found, frame.x)
        assert np.abs(found - sheet.x(frame.t)).max() < 2e-7


def test_bodies_stand_with_the_cloth(path: Path, tmp_path: Path) -> None:
    """The capsule is a million metres away from this cloth, and exactly where it is."""
    scene = trimesh.load(export_mesh(path, tmp_path / "out.glb", 0), process=False, force="scene")
    offset = scene.graph["bodies"][0][:3, 3]
    assert np.array_equal(offset, np.round(FAR + np.array([0.0, 1.0, 0.0])))
    points = scene.geometry["bodies"].vertices + offset
    assert points.mean(axis=0) == pytest.approx([0.5, 0.3, -0.4], abs=0.2)


def test_tables_and_arrays_hold_every_bit(path: Path, sheet: Sheet, tmp_path: Path) -> None:
    t = (FRAMES - 1) / RATE
    with np.load(export_npz(path, tmp_path / "a.npz")) as arrays:
        assert arrays["x"].tobytes() == sheet.x(t).tobytes()
    with open_recording(path) as recording:
        series = recording.series()
    with export_csv(path, tmp_path / "a.csv").open(newline="") as stream:
        assert [float(row["depth [m]"]) for row in csv.DictReader(stream)] == series["depth"].tolist()


def test_a_picture_shows_the_same_cloth(tmp_path: Path) -> None:
    """Without the body, which stays where it is: two scenes that differ by their place only."""
    pictures = []
    for name, shift in (("near", np.zeros(3)), ("far", np.round(FAR))):
        writer = RecordingWriter(tmp_path / f"{name}.mcap", metadata(), {})
        for item in items(Moved(shift), 2):
            if item[0] not in (GEOMETRY.name, BODIES.name):
                writer.write(*item)
        out = export_picture(writer.finish({}), tmp_path / f"{name}.png", 1, (96, 64))
        with Image.open(out) as image:
            pictures.append(np.asarray(image, np.float64))
    assert np.ptp(pictures[0]) > 100.0
    assert np.abs(pictures[0] - pictures[1]).max() <= 2.0


def test_the_viewer_colours_and_shades_the_same_cloth() -> None:
    """Its positions are float32, 6 cm apart there; what the cloth looks like is not."""
    from nuno.viewer.cloth import Cloth

    shown: list[Any] = []

    class Kept:
        def log(self, path: str, what: Any, **_: object) -> None:
            shown.append(what)

    near = Sheet()
    arrays = {"faces": near.faces, "edges": near.edges, "edge_rest": near.edge_rest}
    text = {"vertices": near.number, "objects": [{"name": "cloth", "start": 0, "stop": near.number}]}
    (piece,) = cut_pieces(arrays, text, by_stretch=True)
    cloth, looks = Cloth(Kept(), "cloth", piece, lambda path: None), []
    for x in (near.x(0.1), near.x(0.1) + FAR):
        cloth.log(x)
        parts = (shown[-1].vertex_normals, shown[-1].vertex_colors)
        normals, colours = (np.array(part.as_arrow_array().to_pylist()) for part in parts)
        looks.append((normals, colours[:, None] >> np.array([24, 16, 8]) & 255))
    (normals, colours), (far_normals, far_colours) = looks
    assert np.abs(normals - far_normals).max() < 2e-6
    assert len(np.unique(colours, axis=0)) > 3 and np.abs(colours - far_colours).max() < 8
