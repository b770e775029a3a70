"""Rerun files: every frame unchanged, textures, crossings and tension; what cannot be written is refused."""

from __future__ import annotations

import os
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import dye_scene
import numpy as np
import pytest
import recorded_sheet
from numpy.typing import NDArray
from PIL import Image
from recorded_sheet import Sheet
from rrd import columns, curves, read, write, write_all
from scenes import write_scene
from viewer_run import RATE, Fed, bodies, fabric, messages, poses, sheet, wave

import nuno
from nuno.bus.encodings import BadMessage, decode_arrays, decode_points, encode_arrays, encode_points
from nuno.bus.messages import Bus
from nuno.cli import main
from nuno.collision.bodies import surface, vertex_normals
from nuno.exports.cloth import ShownPiece, cut_pieces, paint_yarns
from nuno.recording.reader import open_recording
from nuno.recording.recorded import Recorded
from nuno.recording.writer import part_of
from nuno.replay.publisher import Replay
from nuno.report.run_report import recorded_lines
from nuno.scene import scene_file
from nuno.simulation import cloth as build
from nuno.simulation.yarns import Tensions, structural_edges, tension_arrays
from nuno.viewer.cloth import read_image
from nuno.viewer.fields import GREY, QUANTITIES, SIDE, TOP, Scale, mean_curvature, pack
from nuno.viewer.file import PIPES, RerunFile, convert
from nuno.viewer.layout import HALF_VIEW, fit_eye, stage
from nuno.viewer.live import require
from nuno.viewer.service import with_own_textures
from nuno.viewer.stream import END, LOOP, Subject
from nuno_kernels.forces.yarn_tension import link_tensions
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.messages import BODIES, CHECKPOINT, EVENT, FABRIC, PENETRATION, STATE, Event, Penetration
from nuno_schemas.scene import View

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


def test_an_interrupt_as_writing_begins_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("nuno.viewer.file.describe", interrupted)
    with pytest.raises(KeyboardInterrupt):
        RerunFile(tmp_path / "run.rrd", Subject(run="run"))
    assert not list(tmp_path.iterdir())


def test_two_conversions_of_one_run_are_equal(tmp_path: Path) -> None:
    fed = list(messages(5, 8, 6))
    for entity, column in ((CLOTH, "Mesh3D:vertex_positions"), ("/plots/energy/total", "Scalars:scalars")):
        first, second = (read(write(tmp_path / f"{i}.rrd", fed), entity, column) for i in range(2))
        assert len(first) == 5
        assert first == second


def test_bodies_stand_where_the_poses_put_them(saved: Path) -> None:
    """Drawn vertices, moved by rerun's transform, lie on the capsule."""
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
        assert np.abs(distance - geometry.radius[1]).max() < 1e-6


def test_a_body_that_rests_is_placed_once(saved: Path) -> None:
    assert list(read(saved, "/world/bodies/floor/root", "Transform3D:translation")) == [0]


def test_curves_carry_the_messages_values_in_the_units_of_their_titles(saved: Path) -> None:
    energy = {name: values[3] for name, values in curves(saved, "/plots/energy").items()}
    assert set(energy) == {"kinetic", "gravitational", "springs", "total"}
    assert energy["gravitational"] == pytest.approx(-0.1 * 3 / RATE), "from the start"
    assert energy.pop("total") == pytest.approx(sum(energy.values()), rel=1e-15)
    assert curves(saved, "/plots/stretch")["largest stretch"][3] == pytest.approx(10.0)
    found = {name: values[3] for name, values in curves(saved, "/plots/penetration").items()}
    assert found == pytest.approx({"deepest": 0.2, "mean of those inside": 0.05})


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


def test_a_scale_is_linear_and_ends_at_the_values_but_for_single_ones() -> None:
    scale = Scale(QUANTITIES["stretch"])
    values = np.linspace(0.0, 0.042, 1001)
    values[-1] = 7.0  # at a pin
    assert scale.widen(values) and scale.end == 0.05
    assert not scale.widen(0.5 * values), "it does not shrink"
    packed = scale.paint(np.array([-0.1, 0.0, 0.025, 0.05, 7.0, np.nan]))
    table = [int.from_bytes(bytes([*row, 255]), "big") for row in scale.table]
    assert packed.tolist() == [table[0], table[0], table[128], table[-1], table[-1], GREY]


def test_a_scale_of_both_signs_is_pale_in_its_middle_and_rounding_errors_are_pale() -> None:
    scale = Scale(QUANTITIES["curvature"])
    scale.widen(np.array([-30.0, 30.0]))
    ends = [scale.paint(np.array([value]))[0] for value in (-50.0, 0.0, 50.0)]
    red, _, blue = np.array([[packed >> shift & 255 for shift in (24, 16, 8)] for packed in ends], int).T
    assert blue[0] > red[0] + 100 and red[2] > blue[2] + 100 and min(red[1], blue[1]) > 220
    still = Scale(QUANTITIES["stretch"])
    still.widen(np.full(9, 1e-9))
    assert still.paint(np.array([1e-9]))[0] == still.paint(np.zeros(1))[0]


@pytest.mark.parametrize("spacing", [0.2, 0.1, 0.05])
def test_mean_curvature_is_that_of_a_cylinder_and_of_a_sphere(spacing: float) -> None:
    """Half and the whole of 1 / r, with an error of second order in the spacing [rad]."""
    r, turn = 0.3, np.arange(0.0, 2.0 * np.pi - 0.5 * spacing, 2.0 * np.pi / round(2.0 * np.pi / spacing))
    rows, columns = round(1.6 / spacing) | 1, len(turn)
    up = np.linspace(-0.8, 0.8, rows)
    a, b = np.meshgrid(up, turn, indexing="ij")
    at = np.arange(rows * columns).reshape(rows, columns)
    right = np.roll(at, -1, axis=1)
    corners = (part.ravel() for part in (at[:-1], right[:-1], at[1:], right[1:]))
    p, q, s, t = corners
    faces = np.concatenate([np.stack([p, s, q], 1), np.stack([q, s, t], 1)]).astype(np.int32)
    inner = at[2:-2].ravel()
    tube = np.stack([r * np.cos(b), r * a, r * np.sin(b)], axis=-1).reshape(-1, 3)
    ball = np.stack([r * np.cos(a) * np.cos(b), r * np.sin(a), r * np.cos(a) * np.sin(b)], axis=-1).reshape(-1, 3)
    for x, expected in ((tube, 0.5 / r), (ball, 1.0 / r)):
        curvature = mean_curvature(x, faces, vertex_normals(x, faces))
        assert np.abs(curvature[inner] / expected - 1.0).max() < 2.0 * spacing**2


def test_a_texture_is_laid_upright(tmp_path: Path) -> None:
    """v points up on cloth, down in rerun's images: the top row's v = 1 must become 0."""
    image = tmp_path / "image.png"
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(image)
    path = write(tmp_path / "run.rrd", list(messages(2, 8, 6, texture=str(image))))
    uv = np.array(read(path, CLOTH, "Mesh3D:vertex_texcoords", static=True)[0])
    assert uv[:8, 1] == pytest.approx(0.0)
    assert uv[-8:, 1] == pytest.approx(1.0)
    pixels = np.array(read(path, CLOTH, "Mesh3D:albedo_texture_buffer", static=True)[0]).ravel()
    assert pixels.tolist() == list(range(48))


def test_a_texture_that_is_gone_is_said_and_does_not_end_the_view(tmp_path: Path) -> None:
    path = write(tmp_path / "run.rrd", list(messages(2, 8, 6, texture="gone.png")))
    assert "gone.png" in read(path, "/log", "TextLog:text")[0][0]
    assert len(read(path, CLOTH, "Mesh3D:vertex_positions")) == 2


def test_the_log_says_what_was_set(tmp_path: Path) -> None:
    fields = {"frame": 0, "t": 0.0, "service": "simulation", "kind": "control", "text": "set"}
    event = Event.model_validate(fields | {"args": {"item": "damping=3.0"}}).model_dump_json().encode()
    path = write(tmp_path / "run.rrd", [*messages(1, 8, 6), (f"{EVENT.name}/simulation", 0, 0.0, event)])
    assert "damping=3.0" in read(path, "/log", "TextLog:text")[0][0]


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


def test_links_have_the_colours_of_their_yarns_and_beside_them_those_of_their_stretch(tmp_path: Path) -> None:
    """Colours once, by kind, as in pictures; by stretch they come with every frame, for a view of their own."""
    uv, _, edges = sheet(5, 4)
    kinds = (np.arange(len(edges)) % 3 - 1).astype(np.int8)
    arrays, text = decode_arrays(fabric(uv, np.zeros((0, 3), np.int32), edges))
    told = encode_arrays(arrays | {"edge_yarn": kinds}, text)
    fed = [(FABRIC.name, 0, 0.0, told), (STATE.name, 0, 0.0, encode_points(wave(uv, 0.0), 0.0))]
    path, expected = write(tmp_path / "yarn.rrd", fed), pack(paint_yarns(kinds)).tolist()
    assert read(path, f"{CLOTH}/springs", "LineStrips3D:colors", static=True)[0] == expected
    assert not read(path, f"{CLOTH}/springs", "LineStrips3D:colors")
    assert len(read(path, f"{CLOTH}/springs", "stretch:colors")[0]) == len(edges)
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
    file = RerunFile(tmp_path / "run.rrd", Subject(run="run"))
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
    file = RerunFile(tmp_path / "run.rrd", Subject(run="run"))
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, before[1]))
        with pytest.raises(RunFailed, match="could not be written"):
            write_all(file, messages(20))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not (tmp_path / "run.rrd").exists()


YARNS = [
    {"name": "soft", "k": 1.0, "lock": 0.2, "k_lock": 8.0, "mu": 0.1},
    {"name": "stiff", "k": 10.0, "lock": 0.5, "k_lock": 30.0},
]


def two_knits(folder: Path) -> Fabric:
    """A tube, whose yarns are rings, and a panel, pulled about so that some links have locked."""
    models = [{"plugin": "knit", "wales": 4, "courses": 5, "form": form, "yarns": YARNS} for form in ("tube", "panel")]
    objects = [{"name": f"knit{i}", "model": model} for i, model in enumerate(models)]
    return build.build_fabric(scene_file.read(write_scene(folder, objects=objects)))[0]


def moved(fabric: Fabric) -> Float:
    return fabric.position * 1.4 + 1e-4 * np.random.default_rng(2).normal(size=fabric.position.shape)


def test_tension_is_that_of_the_forces(tmp_path: Path) -> None:
    fabric = two_knits(tmp_path)
    assert fabric.springs is not None
    x, pairs = moved(fabric), fabric.springs.pairs()
    rest = fabric.springs.per_spring(fabric.springs.rest)
    stretch = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / rest - 1.0
    arrays = tension_arrays(fabric) | {"edge_rest": rest.astype(np.float32)}
    expected = link_tensions(fabric, x)
    for mine in (pairs[:, 0] < 48, pairs[:, 0] >= 48):  # each object by itself: yarns do not reach across
        found = Tensions.read(arrays, mine)
        assert found is not None
        assert np.abs(found(stretch[mine]) - expected[mine]).max() < 1e-6 * expected.max()
    assert (stretch > 0.5).any() and (stretch < 0.2).any()


def test_links_show_their_tension(tmp_path: Path) -> None:
    fabric = two_knits(tmp_path)
    assert fabric.springs is not None
    x = moved(fabric)
    edges, rest = structural_edges(fabric)
    arrays: dict[str, Any] = {"faces": fabric.faces, "edges": edges, "edge_rest": rest.astype(np.float32)}
    arrays |= {"pinned": fabric.pinned} | tension_arrays(fabric)
    cloth = {"name": "knits", "start": 0, "stop": fabric.number, "colour": "#202020"}
    described = encode_arrays(arrays, {"vertices": fabric.number, "scene": "two", "objects": [cloth]})
    file = RerunFile(tmp_path / "run.rrd", Subject(run="run", view=View(links="tension")))
    file.feed(FABRIC.name, 0, 0.0, described)
    file.feed(STATE.name, 0, 0.0, encode_points(x, 0.0))
    assert file.bridge.window.active == "tension"
    path = file.finish()
    shown = np.array(read(path, "/world/cloth/knits/springs", "tension:colors")[0])
    scale, tension = Scale(QUANTITIES["tension"]), link_tensions(fabric, x)
    scale.widen(tension)
    near = [scale.paint(tension + k * scale.end / 255.0) for k in (-1.0, 0.0, 1.0)]  # positions there are float32
    assert (shown == np.stack(near)).any(axis=0).all() and len(np.unique(shown)) > 50


def test_a_legend_has_the_colours_of_the_values_at_its_ticks() -> None:
    for name in ("tension", "curvature"):
        scale = Scale(QUANTITIES[name])
        scale.widen(np.array([-0.9, 1.7]))
        bar = scale.legend()[TOP + 1, SIDE:-SIDE].astype(int)
        for share, label in scale.ticks():
            value = float(label) / QUANTITIES[name].factor
            painted = int(scale.paint(np.array([value]))[0]) >> np.array([24, 16, 8]) & 255
            assert np.abs(bar[round(share * (len(bar) - 1))] - painted).max() <= 3


PIXELS = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A recording of a sheet with an image, which is gone from the disk since."""
    folder = tmp_path / "scene"
    folder.mkdir()
    Image.fromarray(PIXELS).save(folder / "image.png")
    model = {"plugin": "sheet", "resolution": [4, 4], "texture": "image.png"}
    scene = write_scene(folder, objects=[{"name": "cloth", "model": model}], duration=0.1)
    nuno.run(scene, record=tmp_path / "run.mcap")
    (folder / "image.png").unlink()
    return tmp_path / "run.mcap"


def test_a_replay_is_saved_with_the_recordings_own_image(recording: Path, tmp_path: Path) -> None:
    import rerun.chunk

    saved = tmp_path / "again.rrd"
    assert main(["replay", str(recording), "--fast", "--save", str(saved)]) == 0
    column = "Mesh3D:albedo_texture_buffer"
    batches = (chunk.to_record_batch() for chunk in rerun.chunk.RrdReader(saved).stream().to_chunks())
    found = [batch[column].to_pylist() for batch in batches if column in batch.schema.names]
    assert np.ravel(found).tolist() == PIXELS.ravel().tolist()


def test_an_export_has_the_colours_of_stretch_on_the_scale_of_the_whole_run(recording: Path, tmp_path: Path) -> None:
    """Beside the cloth's own image, which the view of stretch leaves out."""
    saved = tmp_path / "run.rrd"
    assert main(["export", str(recording), "--rrd", str(saved), "--colour", "stretch"]) == 0
    assert "/world/cloth/cloth" in columns(saved, "Mesh3D:albedo_texture_buffer")
    colours, scale = read(saved, "/world/cloth/cloth", "stretch:colors"), Scale(QUANTITIES["stretch"])
    with open_recording(recording) as opened:
        (piece,) = cut_pieces(*opened.fabric())
        stretches = [piece.stretch(frame.x) for frame in opened.frames()]
    for stretch in stretches:
        scale.widen(stretch)
    assert len(colours) == len(stretches)
    for shown, stretch in zip(colours.values(), stretches, strict=True):
        assert np.array_equal(shown, scale.paint(stretch))


def test_a_live_view_of_a_replay_is_given_an_image_that_is_there(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Any] = []

    class Watched:
        """Reads the image as soon as a view hears of it."""

        pid, page, error, shown, skipped = None, "", "", 0, 0

        def __init__(self, *_: object) -> None:
            pass

        def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
            if topic == FABRIC.name:
                seen.append(read_image(decode_arrays(payload)[1]["objects"][0]["texture"]))

        def finish(self, last: str = END) -> None:
            pass

    monkeypatch.setattr("nuno.viewer.service.LiveView", Watched)
    assert main(["replay", str(recording), "--fast", "--view", "web"]) == 0
    assert len(seen) == 1
    assert np.array_equal(seen[0], PIXELS)


@pytest.mark.parametrize("passes", [1, 3])
def test_a_live_view_of_a_loop_gets_each_message_once(
    passes: int, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fed, last = [], []

    class Counting:
        pid, page, error, shown, skipped = None, "", "", 0, 0

        def __init__(self, *_: object) -> None:
            pass

        def feed(self, topic: str, *_: object) -> None:
            fed.append(topic)

        def finish(self, last_message: str = "") -> None:
            last.append(last_message)

    publish, sent = Replay._publish, []

    def publish_some(self: Replay, bus: Bus, message: Recorded, *mark: Any) -> None:
        if len(sent) == passes * frames:
            raise KeyboardInterrupt
        sent.append(message)
        publish(self, bus, message, *mark)

    with open_recording(recording) as opened:
        frames, shown = len(list(opened.messages())), [m.topic for m in opened.messages() if m.topic != CHECKPOINT.name]
    monkeypatch.setattr("nuno.viewer.service.LiveView", Counting)
    monkeypatch.setattr(Replay, "_publish", publish_some)
    assert main(["replay", str(recording), "--fast", "--loop", "--view", "web"]) == 0, "an interrupt is its end"
    assert Counter(fed) == Counter(shown)
    assert last == [LOOP]


@pytest.mark.parametrize(
    ("texture", "own"),
    [
        ("/elsewhere/scene/image.png", "/here/image.png"),
        ("/elsewhere/scene/prints/leaf.png", "/here/prints/leaf.png"),
        ("/elsewhere/scene/leaf.png", "leaf.png (not among the scene's files)"),
        ("/etc/secret.png", "secret.png (not among the scene's files)"),
        (None, None),
    ],
)
def test_a_message_picks_no_file_but_the_scenes_own(texture: str | None, own: str | None) -> None:
    files = {name: Path("/here") / name for name in ("image.png", "prints/leaf.png")}
    payload = fabric(*sheet(3, 3), texture=texture)
    arrays, text = decode_arrays(with_own_textures(payload, files))
    before, _ = decode_arrays(payload)
    assert text["objects"][0]["texture"] == own
    assert {name: values.tobytes() for name, values in arrays.items()} == {
        name: values.tobytes() for name, values in before.items()
    }


def test_what_is_no_fabric_message_is_left_for_the_views_to_refuse() -> None:
    assert with_own_textures(b"noise", {}) == b"noise"


def test_cloth_that_passes_through_cloth_is_marked_in_those_frames_alone(tmp_path: Path) -> None:
    """With whose cloth it is; and the least distance is a curve in millimetres, with a gap where none was found."""
    places, found = [(0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (0.7, 0.8, 0.9)], dict[int, Penetration]()
    objects = [("sheet", "scarf"), ("sheet", "sheet"), ("scarf", "sheet")]
    for frame, number in enumerate((0, 3, 1, 0, 0)):
        distance = 0.0 if number else 5e-4 if frame == 0 else None
        found[frame] = Penetration(
            frame=frame, t=frame / RATE, depth=0.0, vertex=-1, inside=0, mean=0.0, seconds=0.0, crossings=number,
            places=places[:number], objects=objects[:number], distance=distance,
        )  # fmt: skip
    fed = [
        (topic, frame, t, found[frame].model_dump_json().encode() if topic == PENETRATION.name else payload)
        for topic, frame, t, payload in messages(5)
    ]
    path = write(tmp_path / "run.rrd", fed)
    between, itself = "/world/crossings/scarf/sheet", "/world/crossings/sheet/sheet"
    assert read(path, between, "Points3D:positions") == {
        1: [pytest.approx(places[0]), pytest.approx(places[2])], 2: [pytest.approx(places[0])],
    }  # fmt: skip
    assert read(path, itself, "Points3D:positions") == {1: [pytest.approx(places[1])]}
    labels = [read(path, entity, "Points3D:labels")[1] for entity in (between, itself)]
    assert labels == [["scarf passes through sheet"], ["sheet passes through itself"]]
    assert {e: list(read(path, e, "Clear:is_recursive")) for e in (between, itself)} == {between: [3], itself: [2]}
    curve = curves(path, "/plots/distance")["least distance"]
    assert [curve[frame] for frame in range(5)] == pytest.approx([0.5, 0.0, 0.0, np.nan, np.nan], nan_ok=True)


def test_recordings_share_a_layout_where_their_scenes_show_the_same(tmp_path: Path) -> None:
    import rerun.chunk

    def layout(**fields: Any) -> str:
        recorded_sheet.write(tmp_path / "run.mcap", Sheet(), frames=2, scene={"name": "waving"} | fields)
        with open_recording(tmp_path / "run.mcap") as recording:
            path = convert(recording, tmp_path / "run.rrd")
        (entry,) = rerun.chunk.RrdReader(path).recordings()
        return str(entry.application_id)

    shown = [layout(), layout(name="other"), layout(bodies=[{}]), layout(cloth_contact={}), layout(cloth_contact=None)]
    shown += [layout(view={"links": "tension"}), layout(view={"pictures": "end"})]
    assert shown.pop(4) == shown[0] == layout(solver={"plugin": "rk4"}, damping=0.1)
    assert len(set(shown)) == len(shown)


@pytest.mark.parametrize("dyed", [False, True])
def test_a_runs_file_has_the_report_of_its_recording_but_for_its_own_frames(dyed: bool, tmp_path: Path) -> None:
    scene = (dye_scene.write_scene if dyed else write_scene)(tmp_path)
    record, saved = tmp_path / "run.mcap", tmp_path / "run.rrd"
    assert main(["run", str(scene), "--record", str(record), "--save", str(saved), "--no-view"]) == 0
    (texts,) = columns(saved, "TextDocument:text")["/report"]
    rows = [row[2:-2].split(" | ") for row in texts[0].splitlines()[2:]]
    with open_recording(record) as recording:
        kept = [[name, text.replace("|", "/")] for name, text in recorded_lines(recording.report())]
    assert [row for row in rows if row[0] not in ("frames", "parts")] == [
        row for row in kept if row[0] not in ("frames", "parts")
    ]
