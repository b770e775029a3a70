"""Exports read back equal to what was recorded, far from the origin too, in the colours that are asked for."""

from __future__ import annotations

import csv
import errno
import io
import itertools
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
import trimesh
from exported import picture, png, seen
from PIL import Image
from recorded_sheet import RATE, Sheet, items, metadata, write
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.exports.animations import export_animation
from nuno.exports.cloth import (
    CLOTHS,
    PLAIN,
    ShownPiece,
    body_vertices,
    cut_pieces,
    paint_stretch,
    read_bodies,
    read_pieces,
)
from nuno.exports.meshes import export_mesh, export_meshes
from nuno.exports.pictures import Colour, Painter, _cloth_mesh, export_picture
from nuno.exports.tables import export_csv
from nuno.exports.vertex_caches import export_mdd, export_pc2
from nuno.recording.reader import Recording, open_recording
from nuno.recording.writer import RecordingWriter
from nuno.resimulation.frame_state import export_npz
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import BODIES, GEOMETRY, STATE

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
        "depth [m]", "inside", "mean [m]", "area [m^2]", "area_depth [m]",
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


def test_vertex_caches_hold_every_frame_in_the_order_of_a_mesh(path: Path, tmp_path: Path) -> None:
    """As the two formats are described: PC2 in little-endian numbers, MDD in big-endian ones, with times."""
    number, obj = len(SHEET.rest), export_mesh(path, tmp_path / "rest.obj", 0).read_text().splitlines()
    first = np.array([line.split()[1:] for line in obj if line.startswith("v ")], float)
    frames = np.stack([seen(path, k) for k in range(FRAMES)]).astype(np.float32)
    assert np.array_equal(frames[0], first.astype(np.float32))
    data = export_pc2(path, tmp_path / "out.pc2")[0].read_bytes()
    assert struct.unpack("<12siiffi", data[:32]) == (b"POINTCACHE2\0", 1, number, 0.0, 1.0, FRAMES)
    assert np.array_equal(np.frombuffer(data, "<f4", offset=32).reshape(FRAMES, number, 3), frames)
    data = export_mdd(path, tmp_path / "out.mdd")[0].read_bytes()
    assert struct.unpack(">ii", data[:8]) == (FRAMES, number)
    assert np.array_equal(np.frombuffer(data, ">f4", FRAMES, 8), (np.arange(FRAMES) / RATE).astype(np.float32))
    assert np.array_equal(np.frombuffer(data, ">f4", offset=8 + 4 * FRAMES).reshape(FRAMES, number, 3), frames)


def test_each_object_has_a_vertex_cache_of_its_own(tmp_path: Path) -> None:
    chain = {"plugin": "net", "file": "chain.npz"}
    scene = write_scene(tmp_path, duration=0.04, objects=[{"name": name, "model": chain} for name in ("left", "right")])
    run = nuno.run(scene, record=tmp_path / "run.mcap").path
    with pytest.raises(BadInput, match="one object"):
        nuno.export(run, pc2=tmp_path / "both.pc2")
    for name, out in zip(("left", "right"), nuno.export(run, pc2=tmp_path / "both"), strict=True):
        assert out == tmp_path / "both" / f"{name}.pc2" and out.stat().st_size == 32 + 3 * 6 * 12


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
    outward = (points - a - along[:, None] * (b - a)) / 0.2
    assert (body.vertex_normals * outward).sum(axis=1).min() > np.cos(np.radians(4.0))


def test_glb_without_a_texture_has_a_colour_or_is_coloured_by_stretch(plain: Path, tmp_path: Path) -> None:
    write(tmp_path / "stretch.mcap", SHEET, FRAMES, scene={"name": "waving", "view": {"colour": "stretch"}})
    scene = trimesh.load(export_mesh(tmp_path / "stretch.mcap", tmp_path / "a.glb"), process=False, force="scene")
    assert len(np.unique(scene.geometry["cloth"].visual.vertex_colors, axis=0)) > 1
    scene = trimesh.load(export_mesh(plain, tmp_path / "b.glb"), process=False, force="scene")
    factor = scene.geometry["cloth"].visual.material.baseColorFactor
    assert np.abs(factor[:3] - 255.0 * parse_hex(CLOTHS[0])).max() <= 0.5


def test_bodies_are_where_their_poses_say(path: Path) -> None:
    """A capsule's surface, in its size, at the translation of the frame."""
    with open_recording(path) as recording:
        bodies = read_bodies(recording)
        points = body_vertices(recording, bodies, 10 / RATE)
    a, b = np.array([0.3, 0.3, -0.4]), np.array([0.7, 0.3, -0.4])
    rise = np.array([0.0, 0.1 * 10 / RATE, 0.0])
    along = np.clip((points - rise - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    distance = np.linalg.norm(points - rise - a - along[:, None] * (b - a), axis=1)
    assert distance == pytest.approx(0.2, abs=1e-9)


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


@pytest.mark.parametrize("name", ["out.npz", "out.csv", "out.obj", "out.ply", "out.glb", "out.pc2", "out.mdd"])
def test_only_files_of_their_own_kind_are_replaced(path: Path, tmp_path: Path, name: str) -> None:
    def export(target: Path) -> None:
        if name.endswith("npz"):
            export_npz(path, target)
        elif name.endswith("csv"):
            export_csv(path, target)
        elif name.endswith("pc2"):
            export_pc2(path, target)
        elif name.endswith("mdd"):
            export_mdd(path, target)
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
    others = [] if name.endswith(("pc2", "mdd")) else [tmp_path / "name.txt"]  # a folder, of those
    for wrong in (tmp_path / "no" / "such" / name, *others):
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


@pytest.mark.parametrize(("kind", "name"), [("glb", "a.gltf"), ("obj", "a.stl"), ("ply", "a.glb"), ("glb", "a.mp4")])
def test_a_mesh_of_another_ending_is_no_folder(path: Path, tmp_path: Path, kind: str, name: str) -> None:
    assert main(["export", str(path), f"--{kind}", str(tmp_path / name)]) == 2
    assert not list(tmp_path.iterdir())


KINDS = {
    "npz": ".npz", "csv": ".csv", "png": ".png", "gif": ".gif", "mp4": ".mp4", "obj": ".obj", "ply": ".ply",
    "glb": ".glb", "usd": ".usdz", "pc2": ".pc2", "mdd": ".mdd", "rrd": ".rrd", "foxglove": ".mcap",
}  # fmt: skip


@pytest.mark.usefixtures("capsys")  # the limit would hold for files of what is printed, too
@pytest.mark.parametrize("kind", KINDS)
def test_a_full_disk_is_an_error_and_leaves_no_file(tmp_path: Path, kind: str) -> None:
    """Whoever writes the file, libraries and other processes too; a limit on the size of files stands in for it."""
    resource = pytest.importorskip("resource", reason="needs limits on file sizes")
    whole, cut = tmp_path / f"whole{KINDS[kind]}", tmp_path / f"cut{KINDS[kind]}"
    write(tmp_path / "run.mcap", SHEET, 3)
    small = ["--size", "96x64"] if kind in ("png", "gif", "mp4") else []
    command = ["export", str(tmp_path / "run.mcap"), *small, f"--{kind}"]
    assert main([*command, str(whole)]) == 0
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    size = whole.stat().st_size
    last = int(0.95 * size) if kind == "rrd" else size - 16  # rerun's files vary in length
    for room in (int(0.4 * size), last):
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
            code = main([*command, str(cut)])
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert code in (1, 2) and not cut.exists()


SIZE = (96, 64)


def painted(path: Path, colour: Colour) -> tuple[Painter, np.ndarray | None, bool]:
    """The painter, the colours of the cloth's vertices, and whether it shows an image."""
    with open_recording(path) as recording:
        frames = list(recording.frames())
        painter = Painter(recording, frames[-1:], SIZE, colour=colour)
        mesh = painter.meshes(frames[-1])[0]
    return painter, mesh.colours, mesh.image is not None


@pytest.fixture(scope="module")
def coloured_plainly(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plain") / "run.mcap"
    write(path, Sheet(), 3)
    return path


@pytest.fixture(scope="module")
def by_stretch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of a scene that shows stretch."""
    path = tmp_path_factory.mktemp("stretch") / "run.mcap"
    write(path, Sheet(), 3, scene={"name": "waving", "view": {"colour": "stretch"}})
    return path


@pytest.fixture(scope="module")
def textured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("textured")
    data = io.BytesIO()
    Image.new("RGB", (4, 4), "#208040").save(data, "PNG")
    write(folder / "run.mcap", Sheet(), 3, {"check.png": data.getvalue()}, texture="check.png")
    return folder / "run.mcap"


def test_cloth_without_a_colour_has_one_by_its_place_or_shows_its_stretch(
    coloured_plainly: Path, by_stretch: Path
) -> None:
    with open_recording(coloured_plainly) as recording:
        last = list(recording.frames())[-1]
        piece = Painter(recording, [last], SIZE).pieces(last.t)[0]
    stretch = paint_stretch(piece.stretch(last.x))
    for path, colour in ((by_stretch, "auto"), (by_stretch, "stretch"), (coloured_plainly, "stretch")):
        painter, colours, _ = painted(path, colour)  # type: ignore[arg-type]
        assert colours is not None and np.array_equal(colours, stretch)
        assert painter.legend is not None
    for path, colour, own in (
        (coloured_plainly, "auto", CLOTHS[0]),
        (coloured_plainly, "cloth", CLOTHS[0]),
        (by_stretch, "cloth", PLAIN),
    ):
        painter, colours, _ = painted(path, colour)  # type: ignore[arg-type]
        assert colours is not None and np.array_equal(colours, np.tile(parse_hex(own), (piece.stop, 1)))
        assert painter.legend is None


def test_links_of_a_net_show_their_own_stretch() -> None:
    edges, x = np.array([[0, 1], [1, 2]], np.int32), np.array([[0.0, 0.0, 0.0], [1.01, 0.0, 0.0], [2.51, 0.0, 0.0]])
    net = ShownPiece("net", 0, 3, np.zeros((0, 3), np.int32), edges, np.ones(2), None, None, None)
    colours = _cloth_mesh(net, x).colours
    assert colours is not None
    assert np.allclose(colours.reshape(2, -1, 3), paint_stretch(np.array([0.01, 0.5]))[:, None], rtol=1e-12)


def test_cloth_with_a_texture_can_show_its_stretch(textured: Path) -> None:
    for colour in ("auto", "cloth"):
        painter, colours, image = painted(textured, colour)  # type: ignore[arg-type]
        assert image and colours is None and painter.legend is None
    painter, colours, image = painted(textured, "stretch")
    assert not image and colours is not None and painter.legend is not None


def test_the_command_passes_it_on_to_pictures_and_animations(coloured_plainly: Path, tmp_path: Path) -> None:
    shown = {}
    for colour in ("auto", "cloth", "stretch"):
        png, gif = tmp_path / f"{colour}.png", tmp_path / f"{colour}.gif"
        asked = [
            "export",
            str(coloured_plainly),
            "--png",
            str(png),
            "--gif",
            str(gif),
            "--size",
            "96x64",
            "--colour",
            colour,
        ]
        assert main(asked) == 0
        shown[colour] = png.read_bytes(), gif.read_bytes()
    assert shown["auto"] == shown["cloth"]
    assert shown["auto"][0] != shown["stretch"][0]
    assert shown["auto"][1] != shown["stretch"][1]


def test_another_colour_is_refused_before_anything_is_written(
    coloured_plainly: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(coloured_plainly), "--png", str(tmp_path / "a.png"), "--colour", "red"]) == 2
    assert "auto" in capsys.readouterr().err
    with pytest.raises(BadInput, match="painted"):
        export_animation(coloured_plainly, tmp_path / "a.gif", SIZE, colour="red")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


FAR = np.array([1e6, -1e6, 1e6 + 0.25])
FEW_FRAMES = 5


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
def far_recording(sheet: Sheet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    far_recording = tmp_path_factory.mktemp("far") / "run.mcap"
    write(far_recording, sheet, FEW_FRAMES)
    return far_recording


def placed(far_recording: Path) -> Float:
    """Positions of the cloth in a mesh file, wherever its nodes are."""
    scene = trimesh.load(far_recording, process=False, maintain_order=True, force="scene")
    name = "cloth" if "cloth" in scene.geometry else next(iter(scene.geometry))
    node = next(node for node in scene.graph.nodes_geometry if scene.graph[node][1] == name)
    return np.asarray(scene.geometry[name].vertices + scene.graph[node][0][:3, 3], np.float64)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
def test_mesh_files_hold_what_was_recorded(far_recording: Path, sheet: Sheet, tmp_path: Path, suffix: str) -> None:
    """To the last bit; and the recording is within float32 of the cloth's size, not of its distance."""
    with open_recording(far_recording) as recording:
        frames = list(recording.frames())
    each = export_meshes(far_recording, tmp_path / "frames", suffix)
    for frame, out in zip(frames, [*each[:-1], export_mesh(far_recording, tmp_path / f"out{suffix}")], strict=True):
        found = placed(out)
        assert np.array_equal(found, frame.x)
        assert np.abs(found - sheet.x(frame.t)).max() < 2e-7


def test_bodies_stand_with_the_cloth(far_recording: Path, tmp_path: Path) -> None:
    """The capsule is a million metres away from this cloth, and exactly where it is."""
    scene = trimesh.load(export_mesh(far_recording, tmp_path / "out.glb", 0), process=False, force="scene")
    offset = scene.graph["bodies"][0][:3, 3]
    assert np.array_equal(offset, np.round(FAR + np.array([0.0, 1.0, 0.0])))
    points = scene.geometry["bodies"].vertices + offset
    assert points.mean(axis=0) == pytest.approx([0.5, 0.3, -0.4], abs=0.2)


def test_tables_and_arrays_hold_every_bit(far_recording: Path, sheet: Sheet, tmp_path: Path) -> None:
    t = (FEW_FRAMES - 1) / RATE
    with np.load(export_npz(far_recording, tmp_path / "a.npz")) as arrays:
        assert arrays["x"].tobytes() == sheet.x(t).tobytes()
    with open_recording(far_recording) as recording:
        series = recording.series()
    with export_csv(far_recording, tmp_path / "a.csv").open(newline="") as stream:
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
    from nuno.viewer.fields import QUANTITIES, Scale

    shown: dict[str, Any] = {}

    class Kept:
        def log(self, path: str, what: Any, **_: object) -> None:
            shown.update(
                (str(batch.component_descriptor()), batch.as_arrow_array()) for batch in what.as_component_batches()
            )

    near = Sheet()
    arrays = {"faces": near.faces, "edges": near.edges, "edge_rest": near.edge_rest}
    text = {"vertices": near.number, "objects": [{"name": "cloth", "start": 0, "stop": near.number}]}
    (piece,) = cut_pieces(arrays, text, by_stretch=True)
    scales = {name: Scale(quantity) for name, quantity in QUANTITIES.items()}
    cloth, looks = Cloth(Kept(), "cloth", piece, lambda texture: None, scales), []
    for x in (near.x(0.1), near.x(0.1) + FAR):
        cloth.log(x)
        parts = [
            next(value for key, value in shown.items() if key.startswith(name))
            for name in ("Mesh3D:vertex_normals", "stretch:colors")
        ]
        normals, colours = (np.array(part.to_pylist()) for part in parts)
        looks.append((normals, colours[:, None] >> np.array([24, 16, 8]) & 255))
    (normals, colours), (far_normals, far_colours) = looks
    assert np.abs(normals - far_normals).max() < 2e-6
    assert len(np.unique(colours, axis=0)) > 3 and np.abs(colours - far_colours).max() < 8


@pytest.mark.parametrize(("second", "flags", "told"), [(0.0, (), 0), (1.0, (), 4), (0.0, ("--progress",), FRAMES)])
def test_a_long_export_tells_how_far_it_is_where_there_is_no_terminal(
    second: float, flags: tuple[str, ...], told: int, path: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Every five seconds, where a frame takes one; with --progress at each."""
    clock = itertools.count(0.0, second)
    monkeypatch.setattr("nuno.python_api.export.time", SimpleNamespace(monotonic=lambda: next(clock)))
    assert main(["export", str(path), "--obj", str(tmp_path / "frames"), *flags]) == 0
    every = FRAMES // max(told, 1)
    lines = [f"{done} of {FRAMES}" for done in range(every, FRAMES + 1, every)]
    assert capsys.readouterr().err.splitlines() == lines[:told]


def test_it_is_told_once_that_a_picture_waits_for_the_compiler(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And never of a picture that finds everything compiled."""
    ready = numba.njit(lambda x: x + 1)

    def draw(*_: object) -> list[Path]:
        ready(1), ready(1.0)
        return []

    monkeypatch.setattr("nuno.cli.recordings.write", draw)
    told = []
    for _ in range(2):
        assert main(["export", str(path), "--png", str(tmp_path / "a.png")]) == 0
        told.append(len(capsys.readouterr().err.splitlines()))
    assert told == [1, 0]
