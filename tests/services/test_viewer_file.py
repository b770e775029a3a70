"""Rerun files: every frame, unchanged; what cannot be written is refused before a run starts."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from rrd import read, write, write_all
from viewer_run import RATE, Fed, bodies, fabric, messages, poses, sheet, wave

from nuno.bus.encodings import BadMessage, decode_arrays, decode_points, encode_arrays, encode_points
from nuno.collision.surfaces import surface, vertex_normals
from nuno.exports.cloth import ShownPiece
from nuno.exports.paint import INSET, paint_yarns
from nuno.recording.writer import part_of
from nuno.viewer.cloth import pack
from nuno.viewer.file import PIPES, RerunFile
from nuno.viewer.layout import HALF_VIEW, fit_eye, stage
from nuno.viewer.require import require
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import BODIES, FABRIC, STATE
from nuno_schemas.view import View

CLOTH = "/world/cloth/sheet"


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("rerun") / "run.rrd", list(messages(20)))


def test_a_saved_file_passes_reruns_own_check(saved: Path) -> None:
    import rerun_cli

    binary = os.path.join(rerun_cli.__path__[0], "rerun")
    subprocess.run([binary, "rrd", "verify", str(saved)], check=True, timeout=60)
    assert not part_of(saved).exists()


def test_a_saved_file_holds_each_frames_positions_to_the_last_bit(saved: Path) -> None:
    sent = [payload for topic, _, _, payload in messages(20) if topic == STATE.name]
    found = read(saved, CLOTH, "Mesh3D:vertex_positions")
    assert sorted(found) == list(range(20))
    for frame, points in found.items():
        assert np.array_equal(np.float32(points), decode_points(sent[frame]).astype(np.float32))


def test_a_saved_file_shades_each_frame_by_its_own_shape(saved: Path) -> None:
    """Arrays that rerun still holds are not those of the next frame."""
    faces = np.int32(read(saved, CLOTH, "Mesh3D:triangle_indices", static=True)[0])
    shown, normals = (read(saved, CLOTH, f"Mesh3D:vertex_{what}") for what in ("positions", "normals"))
    assert sorted(normals) == list(range(20))
    for frame, points in shown.items():
        expected = vertex_normals(np.float32(points), faces)
        assert np.abs(np.float32(normals[frame]) - expected).max() < 1e-3


def test_two_conversions_of_one_run_are_equal(tmp_path: Path) -> None:
    fed = list(messages(5, 8, 6))
    for entity, column in ((CLOTH, "Mesh3D:vertex_positions"), ("/plots/energy", "Scalars:scalars")):
        first, second = (read(write(tmp_path / f"{i}.rrd", fed), entity, column) for i in range(2))
        assert len(first) == 5
        assert first == second


def test_bodies_stand_where_the_poses_put_them(saved: Path) -> None:
    """Drawn vertices, moved by rerun's transform, lie on the capsule of the inset radius."""
    path = "/world/bodies/bar/root"
    vertices = np.array(read(saved, path, "Mesh3D:vertex_positions", static=True)[0])
    turns = read(saved, path, "Transform3D:quaternion")
    shifts = read(saved, path, "Transform3D:translation")
    geometry = bodies()
    for frame in (0, 19):
        x, y, z, w = turns[frame][0]
        world = vertices @ rotation_matrices(np.array([[w, x, y, z]]))[0].T + shifts[frame][0]
        pose = poses(frame / RATE)
        a, b = (rotation_matrices(pose.rotation)[1] @ end[1] + pose.translation[1] for end in (geometry.a, geometry.b))
        along = np.clip((world - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        distance = np.linalg.norm(world - a - along[:, None] * (b - a), axis=1)
        assert np.abs(distance - (geometry.radius[1] - INSET)).max() < 1e-6


def test_a_body_that_rests_is_placed_once(saved: Path) -> None:
    assert list(read(saved, "/world/bodies/floor/root", "Transform3D:translation")) == [0]


def test_curves_carry_the_messages_values_in_the_units_of_their_titles(saved: Path) -> None:
    energy = read(saved, "/plots/energy", "Scalars:scalars")[3]
    assert energy[-1] == pytest.approx(sum(energy[:-1]), rel=1e-15)
    assert read(saved, "/plots/energy", "SeriesLines:names", static=True)[0][-1] == "total"
    assert read(saved, "/plots/stretch", "Scalars:scalars")[3] == [pytest.approx(10.0)]
    assert read(saved, "/plots/penetration", "Scalars:scalars")[3] == pytest.approx([0.2, 0.05])


def test_normals_of_a_capsule_point_from_its_axis() -> None:
    geometry = bodies()
    shown = surface(geometry)
    x, faces, frames = shown.vertices, shown.faces, shown.frame
    normals = vertex_normals(x, faces)
    capsule = x[frames == 1]
    along = np.clip(capsule[:, :1], -0.3, 0.3) * np.array([[1.0, 0, 0]])
    outward = (capsule - along) / geometry.radius[1]
    # Rings are 15 degrees apart; by symmetry the mean of faces departs by a fraction of that.
    assert ((normals[frames == 1] * outward).sum(axis=1)).min() > np.cos(np.radians(4.0))
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0, abs=1e-6)


def test_a_vertex_shows_its_most_stretched_edge_and_never_hides_nan() -> None:
    edges = np.array([[0, 1], [1, 2], [2, 3]], np.int32)
    x = np.column_stack([[0.0, 1.2, 2.3, np.nan], np.zeros((4, 2))])
    out = ShownPiece("line", 0, 4, edges[:0], edges, np.ones(3), None, None, None).stretch(x)
    assert out[:2] == pytest.approx([0.2, 0.2])
    assert np.isnan(out[2:]).all()


def test_colours_run_from_violet_to_yellow_by_powers_of_ten(tmp_path: Path) -> None:
    from nuno.viewer.cloth import GREY, TABLE, paint

    colours = paint(np.array([-0.1, 0.001, 10**-1.5, 1.0, 5.0, np.nan]))
    assert list(colours[[0, 1, 3, 4, 5]]) == [TABLE[0], TABLE[0], TABLE[-1], TABLE[-1], GREY]
    assert colours[2] in TABLE[126:130]


def test_a_texture_is_laid_upright(tmp_path: Path) -> None:
    """v points up on cloth, down in rerun's images: the top row's v = 1 must become 0."""
    image = tmp_path / "image.png"
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(image)
    path = write(tmp_path / "run.rrd", list(messages(2, 8, 6, texture=str(image))))
    uv = np.array(read(path, CLOTH, "Mesh3D:vertex_texcoords", static=True)[0])
    assert uv[:8, 1] == pytest.approx(0.0)
    assert uv[-8:, 1] == pytest.approx(1.0)
    assert read(path, CLOTH, "Mesh3D:vertex_colors") == {}
    pixels = np.array(read(path, CLOTH, "Mesh3D:albedo_texture_buffer", static=True)[0]).ravel()
    assert pixels.tolist() == list(range(48))


def test_a_texture_that_is_gone_is_said_and_does_not_end_the_view(tmp_path: Path) -> None:
    path = write(tmp_path / "run.rrd", list(messages(2, 8, 6, texture="gone.png")))
    assert "gone.png" in read(path, "/log", "TextLog:text")[0][0]
    assert len(read(path, CLOTH, "Mesh3D:vertex_positions")) == 2


def test_a_net_without_faces_shows_masses_and_springs(tmp_path: Path) -> None:
    uv, _, edges = sheet(5, 4)
    points = encode_points(wave(uv, 0.0), 0.0)
    fed = [
        (FABRIC.name, 0, 0.0, fabric(uv, np.zeros((0, 3), np.int32), edges)),
        (STATE.name, 0, 0.0, points),
    ]
    path = write(tmp_path / "net.rrd", fed)
    x = decode_points(points).astype(np.float32)
    assert np.array_equal(np.float32(read(path, f"{CLOTH}/masses", "Points3D:positions")[0]), x)
    assert np.array_equal(np.float32(read(path, f"{CLOTH}/springs", "LineStrips3D:strips")[0]), x[edges])


def test_links_show_their_yarns_where_the_view_says_so(tmp_path: Path) -> None:
    """Colours once, by kind, as in pictures; by stretch they come with every frame."""
    uv, _, edges = sheet(5, 4)
    kinds = (np.arange(len(edges)) % 3 - 1).astype(np.int8)
    arrays, text = decode_arrays(fabric(uv, np.zeros((0, 3), np.int32), edges))
    told = encode_arrays(arrays | {"edge_yarn": kinds}, text)
    fed = [(FABRIC.name, 0, 0.0, told), (STATE.name, 0, 0.0, encode_points(wave(uv, 0.0), 0.0))]
    expected = pack(paint_yarns(kinds)).tolist()
    by_yarn = write_all(RerunFile(tmp_path / "yarn.rrd", "run", View(links="yarn")), fed)
    assert read(by_yarn, f"{CLOTH}/springs", "LineStrips3D:colors", static=True)[0] == expected
    assert not read(by_yarn, f"{CLOTH}/springs", "LineStrips3D:colors")
    by_stretch = write(tmp_path / "stretch.rrd", fed)
    assert len(read(by_stretch, f"{CLOTH}/springs", "LineStrips3D:colors")[0]) == len(edges)
    assert len(set(expected)) == 3


def broken(uv: NDArray[np.float64]) -> dict[str, Fed]:
    """Messages that are not what their topics promise."""
    _, faces, edges = sheet(5, 4)
    points = encode_points(wave(uv, 0.0), 0.0)
    short = {"faces": faces, "edges": edges, "edge_rest": np.ones(3, np.float32), "pinned": np.zeros(20, bool)}
    return {
        "cut": (STATE.name, 1, 0.1, points[:-5]),
        "too few": (STATE.name, 1, 0.1, encode_points(wave(uv, 0.0)[:7], 0.0)),
        "time": (STATE.name, 1, float("nan"), points),
        "index": (FABRIC.name, 1, 0.1, fabric(uv, faces + 1, edges)),
        "negative": (FABRIC.name, 1, 0.1, fabric(uv, faces - 1, edges)),
        "lengths": (FABRIC.name, 1, 0.1, encode_arrays(short, {"vertices": 20, "objects": []})),
        "no name": (FABRIC.name, 1, 0.1, encode_arrays({}, {})),
        "poses": (BODIES.name, 1, 0.1, b"\xff\xff"),
        "text": ("sim/status", 1, 0.1, b"{}"),
        "report": ("run/report", 1, 0.1, b"["),
    }


@pytest.mark.parametrize("name", broken(sheet(5, 4)[0]))
def test_a_malformed_message_is_refused_and_the_view_goes_on(name: str, tmp_path: Path) -> None:
    fed = list(messages(2, 5, 4))
    file = RerunFile(tmp_path / "run.rrd", "run")
    for message in fed[:6]:
        file.feed(*message)
    with pytest.raises(BadMessage):
        file.feed(*broken(sheet(5, 4)[0])[name])
    for message in fed[6:]:
        file.feed(*message)
    path = file.finish()
    assert sorted(read(path, CLOTH, "Mesh3D:vertex_positions")) == [0, 1]


def test_the_eye_has_the_whole_stage_in_view() -> None:
    points = np.random.default_rng(1).normal(size=(500, 3)) * [2.0, 0.5, 1.0]
    eye = fit_eye(points, View())
    toward = (eye.target - eye.position) / np.linalg.norm(eye.target - eye.position)
    seen = points - eye.position
    angle = np.arccos(seen @ toward / np.linalg.norm(seen, axis=1))
    assert angle.max() <= HALF_VIEW + 1e-9
    assert angle.max() > 0.6 * HALF_VIEW


def test_the_stage_leaves_room_for_what_swings_down() -> None:
    rod = np.stack([np.linspace(0, 1, 11), np.zeros(11), np.zeros(11)], 1)
    lowest = stage(rod, np.arange(11) == 0, np.zeros((0, 3)))[:, 1].min()
    assert lowest == pytest.approx(-1.0)


def test_the_stage_has_all_of_the_bodies_and_the_floor_is_below_them() -> None:
    """Of a skirt's dancer head and feet, too."""
    waist, dancer = np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, 0.1, 0.0], [0.3, 1.8, 0.0]])
    points = stage(waist, np.ones(1, bool), dancer)
    assert {*map(tuple, dancer.tolist())} <= {*map(tuple, points.tolist())}
    assert fit_eye(points, View()).lowest == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("view", "name", "field"),
    [
        ("window", None, "--view"),
        ("hologram", None, "--view"),
        (None, "run.mcap", "--save"),
        (None, "gone/run.rrd", "--save"),
        (None, "folder.rrd", "--save"),
        (None, "text.rrd", "--save"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    view: str | None, name: str | None, field: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    (tmp_path / "folder.rrd").mkdir()
    (tmp_path / "text.rrd").write_text("a letter")
    with pytest.raises(BadInput) as caught:
        require(view, None if name is None else tmp_path / name)
    assert caught.value.field == field
    assert caught.value.remedy
    assert (tmp_path / "text.rrd").read_text() == "a letter"
    assert not list(tmp_path.glob("*.part"))


def test_a_file_that_cannot_be_finished_keeps_no_name(tmp_path: Path) -> None:
    """A full disk, stood in for by a limit on the size of files."""
    resource = pytest.importorskip("resource", reason="needs limits on file sizes")
    if not PIPES.is_dir():
        pytest.skip("rerun writes by itself on this system")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    file = RerunFile(tmp_path / "run.rrd", "run")
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, before[1]))
        with pytest.raises(RunFailed, match="could not be written"):
            write_all(file, messages(20))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not (tmp_path / "run.rrd").exists()
