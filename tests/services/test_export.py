"""Exports read back equal to what was recorded."""

from __future__ import annotations

import csv
import errno
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from exported import picture, png, seen
from recorded_sheet import RATE, Sheet, items, metadata, write

import nuno
from nuno.exports.cloth import body_vertices, read_bodies, read_pieces
from nuno.exports.meshes import export_mesh, export_meshes
from nuno.exports.paint import CLOTHS
from nuno.exports.tables import export_csv, export_npz
from nuno.recording.reader import Recording, open_recording
from nuno.recording.writer import RecordingWriter
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import STATE

FRAMES = 20
SHEET = Sheet()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "run.mcap"
    write(path, SHEET, FRAMES, {"check.png": png(picture())}, texture="/home/someone/scene/check.png")
    return path


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without a texture."""
    path = tmp_path_factory.mktemp("export") / "plain.mcap"
    write(path, SHEET, FRAMES)
    return path


def test_npz_is_the_last_checkpoint_and_nothing_else(path: Path, tmp_path: Path) -> None:
    export_npz(path, tmp_path / "out.npz")
    t = (FRAMES - 1) / RATE
    with np.load(tmp_path / "out.npz", allow_pickle=False) as archive:
        assert set(archive.files) == {"x", "v", "t"}
        assert archive["x"].dtype == archive["v"].dtype == archive["t"].dtype == np.float64
        assert archive["x"].tobytes() == SHEET.x(t).tobytes()
        assert archive["v"].tobytes() == SHEET.v(t).tobytes()
        assert archive["t"].shape == ()
        assert float(archive["t"]) == t


def test_csv_holds_every_digit_and_names_units(path: Path, tmp_path: Path) -> None:
    export_csv(path, tmp_path / "out.csv")
    with open_recording(path) as recording:
        series = recording.series()
    with (tmp_path / "out.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == FRAMES
    assert list(rows[0]) == [
        "frame", "t [s]", "steps", "step_seconds [s]", "stretch [1]", "energy_kinetic [J]", "energy_springs [J]",
        "depth [m]", "inside", "mean [m]",
    ]  # fmt: skip
    for heading, column in zip(rows[0], series.values(), strict=True):
        assert [float(row[heading]) for row in rows] == column.tolist()


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_mesh_files_hold_positions_and_faces(path: Path, tmp_path: Path, suffix: str) -> None:
    for number in (0, 7, FRAMES - 1):
        out = export_mesh(path, tmp_path / f"out{suffix}", number)
        mesh = trimesh.load(out, process=False, maintain_order=True, force="mesh")
        assert isinstance(mesh, trimesh.Trimesh)
        assert np.array_equal(mesh.vertices, seen(path, number))
        assert np.array_equal(mesh.faces, SHEET.faces)


def test_obj_and_ply_hold_texture_coordinates(path: Path, tmp_path: Path) -> None:
    text = export_mesh(path, tmp_path / "out.obj").read_text().splitlines()
    found = np.array([line.split()[1:] for line in text if line.startswith("vt ")], np.float32)
    assert np.array_equal(found, SHEET.uv)
    data = export_mesh(path, tmp_path / "out.ply").read_bytes()
    body = data[data.index(b"end_header\n") + len(b"end_header\n") :]
    table = np.frombuffer(body, [("x", "<f8", 3), ("uv", "<f4", 2)], SHEET.number)
    assert np.array_equal(table["uv"], SHEET.uv)


def test_every_frame_into_a_folder(path: Path, tmp_path: Path) -> None:
    steps: list[tuple[int, int]] = []
    written = export_meshes(path, tmp_path / "frames", ".ply", lambda done, total: steps.append((done, total)))
    assert [p.name for p in written] == [f"frame_{k:05d}.ply" for k in range(FRAMES)]
    assert steps == [(k + 1, FRAMES) for k in range(FRAMES)]
    for k, out in enumerate(written):
        mesh = trimesh.load(out, process=False, force="mesh")
        assert np.array_equal(mesh.vertices, seen(path, k))
    assert len(list((tmp_path / "frames").iterdir())) == FRAMES


def test_one_frame_is_not_written_as_all_of_them(path: Path, tmp_path: Path) -> None:
    """A folder takes every frame: to name one beside it means a file."""
    with pytest.raises(BadInput) as refused:
        nuno.export(path, obj=tmp_path / "frames", frame=1)
    assert str(refused.value.remedy).endswith(".obj") and not (tmp_path / "frames").exists()


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
def test_a_folder_does_not_mix_frames_of_two_recordings(path: Path, tmp_path: Path, suffix: str) -> None:
    """Frames of the same numbers are replaced; where others would stay, nothing is written."""
    first, *_ = export_meshes(path, tmp_path / "frames", suffix)
    assert len(export_meshes(path, tmp_path / "frames", suffix)) == FRAMES
    longer = first.rename(first.with_name(f"frame_{FRAMES:05d}{suffix}"))
    with pytest.raises(BadInput, match=rf"(?s)would stay.*{longer.name}.*choose another folder, or empty it"):
        export_meshes(path, tmp_path / "frames", suffix)
    assert not first.exists() and longer.exists()
    assert len(export_meshes(path, tmp_path / "other", suffix)) == FRAMES


def test_glb_holds_cloth_texture_and_bodies(path: Path, tmp_path: Path) -> None:
    scene = trimesh.load(export_mesh(path, tmp_path / "out.glb", 5), process=False, force="scene")
    assert isinstance(scene, trimesh.Scene)
    cloth, body = scene.geometry["cloth"], scene.geometry["bodies"]
    assert np.array_equal(cloth.vertices + scene.graph["cloth"][0][:3, 3], seen(path, 5))
    assert np.array_equal(cloth.faces, SHEET.faces)
    assert cloth.visual.uv == pytest.approx(SHEET.uv, abs=1e-6)
    image = cloth.visual.material.baseColorTexture.convert("RGB")
    assert np.array_equal(np.asarray(image), np.asarray(picture()))
    with open_recording(path) as recording:
        expected = body_vertices(recording, read_bodies(recording), 5 / RATE)
    assert body.vertices + scene.graph["bodies"][0][:3, 3] == pytest.approx(expected, abs=1e-7)


def test_glb_normals_are_those_of_the_surface_and_need_no_scipy(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.glb"
    hidden = "import sys; sys.modules['scipy'] = None; from nuno.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", hidden, "export", str(path), "--glb", str(out), "--frame", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    scene = trimesh.load(out, process=False, force="scene")
    cloth, body = scene.geometry["cloth"], scene.geometry["bodies"]
    # z = 0.1 sin(4 y + 6 t): the normal is (0, -dz/dy, 1). Triangles are 0.2 m high, and leave out
    # a curvature of 1.6 / m: within 1.6 * 0.2 / 2 of a slope, about.
    slope = 0.4 * np.cos(4.0 * SHEET.rest[:, 1])
    normal = np.stack([0.0 * slope, -slope, 1.0 + 0.0 * slope], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(cloth.vertex_normals - normal).max() < 0.16
    a, b = np.array([0.3, 0.3, -0.4]), np.array([0.7, 0.3, -0.4])
    points = body.vertices + scene.graph["bodies"][0][:3, 3]
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    outward = (points - a - along[:, None] * (b - a)) / 0.198
    assert (body.vertex_normals * outward).sum(axis=1).min() > np.cos(np.radians(4.0))


def test_glb_without_a_texture_has_a_colour_or_is_coloured_by_stretch(plain: Path, tmp_path: Path) -> None:
    write(tmp_path / "stretch.mcap", SHEET, FRAMES, scene={"name": "waving", "view": {"colour": "stretch"}})
    scene = trimesh.load(export_mesh(tmp_path / "stretch.mcap", tmp_path / "a.glb"), process=False, force="scene")
    assert len(np.unique(scene.geometry["cloth"].visual.vertex_colors, axis=0)) > 1
    scene = trimesh.load(export_mesh(plain, tmp_path / "b.glb"), process=False, force="scene")
    factor = scene.geometry["cloth"].visual.material.baseColorFactor
    assert np.abs(factor[:3] - 255.0 * parse_hex(CLOTHS[0])).max() <= 0.5


def test_bodies_are_where_their_poses_say(path: Path) -> None:
    """A capsule's surface, inset by 2 mm, at the translation of the frame."""
    with open_recording(path) as recording:
        bodies = read_bodies(recording)
        points = body_vertices(recording, bodies, 10 / RATE)
    a, b = np.array([0.3, 0.3, -0.4]), np.array([0.7, 0.3, -0.4])
    rise = np.array([0.0, 0.1 * 10 / RATE, 0.0])
    along = np.clip((points - rise - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    distance = np.linalg.norm(points - rise - a - along[:, None] * (b - a), axis=1)
    assert distance == pytest.approx(0.198, abs=1e-9)


def test_stretch_is_the_largest_of_a_vertex(path: Path) -> None:
    with open_recording(path) as recording:
        (piece,) = read_pieces(recording)
    assert piece.stretch(SHEET.rest) == pytest.approx(0.0, abs=1e-6)
    doubled = piece.stretch(SHEET.rest * np.array([2.0, 1.0, 1.0]))
    assert doubled == pytest.approx(1.0, abs=1e-6)
    one = SHEET.rest.copy()
    one[0, 2] = 1.0
    moved = np.flatnonzero(piece.stretch(one) > 1e-6)
    assert moved.tolist() == [0, 1, SHEET.cols]


def test_a_texture_is_read_only_from_the_recording(tmp_path: Path) -> None:
    """A recording from somewhere else names a file of this machine: it is not opened."""
    secret = tmp_path / "secret.png"
    secret.write_bytes(png(picture()))
    write(tmp_path / "a.mcap", SHEET, 2, {"other.png": png(picture())}, texture=str(secret))
    with open_recording(tmp_path / "a.mcap") as recording:
        assert read_pieces(recording)[0].image is None


@pytest.mark.parametrize("name", ["out.npz", "out.csv", "out.obj", "out.ply", "out.glb"])
def test_only_files_of_their_own_kind_are_replaced(path: Path, tmp_path: Path, name: str) -> None:
    def export(target: Path) -> None:
        if name.endswith("npz"):
            export_npz(path, target)
        elif name.endswith("csv"):
            export_csv(path, target)
        else:
            export_mesh(path, target)

    target = tmp_path / name
    target.write_text("precious notes")
    with pytest.raises(BadInput, match="would be lost"):
        export(target)
    assert target.read_text() == "precious notes"
    target.unlink()
    export(target)
    first = target.read_bytes()
    export(target)
    assert target.read_bytes() == first
    for wrong in (tmp_path / "no" / "such" / name, tmp_path / "name.txt"):
        with pytest.raises(BadInput) as caught:
            export(wrong)
        assert caught.value.remedy
    assert sorted(p.name for p in tmp_path.iterdir()) == [name]


def test_frames_that_are_not_there_are_refused(path: Path, tmp_path: Path) -> None:
    for number in (-1, FRAMES, 10**6):
        with pytest.raises(BadInput, match="no such frame") as caught:
            export_mesh(path, tmp_path / "out.obj", number)
        assert caught.value.limit == f"frames 0 to {FRAMES - 1}"


def test_a_recording_without_checkpoint_or_cloth_is_refused(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap", metadata(), {})
    for item in items(SHEET, 3):
        if item[0] == STATE.name:
            writer.write(*item)
    recording = Recording(writer.finish({}))
    for export, name in ((export_npz, "a.npz"), (export_csv, "a.csv"), (export_mesh, "a.obj")):
        with pytest.raises(BadInput):
            export(recording, tmp_path / name)
    recording.close()
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_positions_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    sheet = Sheet()
    sheet.rest[4, 1] = np.nan
    write(tmp_path / "a.mcap", sheet, 3)
    with pytest.raises(BadInput, match="not finite"):
        export_mesh(tmp_path / "a.mcap", tmp_path / "a.obj")


def test_a_disk_that_cannot_be_written_is_refused_in_words(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it can only be read, removing what was never made fails, too."""

    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    with open_recording(path) as recording:
        recording.series()
        monkeypatch.setattr(Path, "open", fail)
        monkeypatch.setattr(Path, "unlink", fail)
        with pytest.raises(BadInput, match="cannot write there: Read-only file system"):
            export_csv(recording, tmp_path / "a.csv")
