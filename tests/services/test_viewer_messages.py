"""What a recording holds for viewers of MCAP files, read as they read it: by mcap and its protobuf decoder."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import write_scene as write_dye_scene
from foxglove_file import Heard, placed, read, vectors
from persons import skinned
from PIL import Image
from recorded_sheet import GEOMETRY_VALUE, RATE, Item, Sheet, items, metadata
from scenes import write_scene

import nuno
from nuno.bus.encodings import BadMessage, encode_arrays
from nuno.collision.messages import encode_geometry, encode_poses
from nuno.exports.cloth import body_vertices, read_bodies
from nuno.exports.meshes import Shape, Show
from nuno.exports.viewer_messages import GRAIN, ViewerMessages, scatter
from nuno.recording.reader import open_recording
from nuno.recording.writer import RecordingWriter
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float
from nuno_schemas.messages import BODIES, FABRIC, GEOMETRY, STATE, STATUS

pytest.importorskip("mcap_protobuf", reason="needs mcap-protobuf-support, of nuno[dev]")


def write(path: Path, found: list[Item], shown: bool = True, warned: list[str] | None = None) -> Path:
    """Write messages with those for viewers, as a recorder does."""
    told: list[str] = [] if warned is None else warned
    repeat = ViewerMessages(Show(lambda name: None, colour="plain"), len(found) / 4, told.append)
    writer = RecordingWriter(path, metadata(), {}, *([repeat] if shown else []))
    for topic, header, payload in found:
        writer.write(topic, header, payload)
        writer.show(topic, payload)
    writer.finish({})
    assert warned is not None or not told
    return path


def transforms(heard: dict[str, list[Heard]], at: int) -> dict[str, tuple[str, Any]]:
    before = (one for topic in ("scene/fixed", "scene/frames") for one in heard[topic] if one.at <= at)
    return {t.child_frame_id: (t.parent_frame_id, t) for one in before for t in one.value.transforms}


def upright(x: Float) -> Float:
    """Points of a scene, y up, in a viewer, z up."""
    return x @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def test_cloth_and_bodies_are_where_they_are_and_upright(tmp_path: Path) -> None:
    """Meshes to their rounding, points on bodies on their surface, from 0 s on, in the frame of viewers, z up."""
    sheet = Sheet(24, 20)
    heard = read(write(tmp_path / "run.mcap", list(items(sheet, 60))))
    with nuno.open(tmp_path / "run.mcap") as recording:
        frames = {round(frame.t * 1e9): frame.x for frame in recording.frames()}
    meshes = heard["scene/cloth"]
    assert len(meshes) > 3 and meshes[0].at == 0 and heard["scene/bodies"][0].at == 0
    for at, update in meshes:
        (entity,) = update.entities
        x = placed(transforms(heard, at), vectors(entity.triangles[0].points), entity.frame_id, "map")
        assert np.abs(x - upright(frames[at])).max() <= GRAIN
        assert np.array_equal(np.array(entity.triangles[0].indices).reshape(-1, 3), sheet.faces)
    for at, cloud in heard[STATE.name]:  # what viewers without meshes show
        x = np.frombuffer(cloud.data, np.float32).reshape(-1, 3) + vectors([cloud.pose.position])
        assert placed(transforms(heard, at), x, cloud.frame_id, "map") == pytest.approx(upright(frames[at]), abs=1e-6)
    (ball,), a, b = heard["scene/points/ball/world"], GEOMETRY_VALUE.a[0], GEOMETRY_VALUE.b[0]
    assert ball.value.frame_id == "ball/world" and ball.value.point_stride == 16
    x = np.ndarray((len(ball.value.data) // 16, 3), "<f4", ball.value.data, strides=(16, 4)).astype(np.float64)
    along = np.clip((x - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    away = np.linalg.norm(x - a - along[:, None] * (b - a), axis=1)
    assert len(x) > 400 and away.max() <= 0.2 + 1e-6 and away.min() > 0.19
    assert [one.at for one in heard["scene/frames"]] == sorted(frames)  # the ball moves in each


def test_a_body_that_bends_has_its_skin_and_points_near_it(tmp_path: Path) -> None:
    """The mesh to its rounding, in some frames; in all of them points on it, but for the bend between its halves."""
    found = []
    for topic, header, payload in items(Sheet(), 20):
        if topic == BODIES.name:
            half = 0.02 * header.frame
            turns = np.array([[np.cos(half), 0, 0, -np.sin(half)], [np.cos(half), 0, 0, np.sin(half)]])
            payload = encode_poses(Poses(header.t, turns, np.zeros((2, 3))), header.frame)
        found.append((topic, header, encode_geometry(skinned()) if topic == GEOMETRY.name else payload))
    heard = read(write(tmp_path / "run.mcap", found))
    assert "scene/bodies" not in heard and len(heard["scene/skins"]) >= 2
    with open_recording(tmp_path / "run.mcap") as recording:
        bodies = read_bodies(recording)
        for at, update in heard["scene/skins"]:
            (skin,) = update.entities
            x = placed(transforms(heard, at), vectors(skin.triangles[0].points), skin.frame_id, "world")
            assert x == pytest.approx(body_vertices(recording, bodies, at / 1e9), abs=2.0 * GRAIN)
        assert bodies is not None
        for at in (one.at for one in heard["scene/frames"]):
            bent = body_vertices(recording, bodies, at / 1e9)
            for side in ("left", "right"):
                ((_, cloud),) = heard[f"scene/points/bar/{side}"]
                x = np.ndarray((len(cloud.data) // 16, 3), "<f4", cloud.data, strides=(16, 4)).astype(np.float64)
                x = placed(transforms(heard, at), x, cloud.frame_id, "world")
                outer = np.abs(x[:, 0]) > 0.2 * np.ptp(bent[:, 0])  # weights pass over a fifth of the length
                a, b, c = np.take(bent, bodies.faces.T, axis=0)
                normal = np.cross(b - a, c - a)
                normal /= np.linalg.norm(normal, axis=1)[:, None]
                away = np.abs(np.einsum("pfk,fk->pf", x[outer][:, None] - a, normal)).min(axis=1)
                assert outer.sum() > 50 and away.max() < 1e-6


def test_points_spread_evenly_over_a_surface() -> None:
    """Each tenth of a plate of long and short triangles has a tenth of the points, with as many gaps as a grid."""
    edge = np.concatenate([[0.0, 0.03, 0.05], np.linspace(0.1, 1.0, 7)])
    x = np.array([(u, v, 0.0) for u in edge for v in (0.0, 1.0)])
    a = 2 * np.arange(len(edge) - 1)[:, None]
    faces = np.concatenate([a + np.array([0, 1, 2]), a + np.array([2, 1, 3])]).astype(np.int32)
    points, shade = scatter(Shape("plate", x, faces, np.ones((1, 3))), 1000)
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=10, range=[[0, 1], [0, 1]])
    assert np.abs(counts.sum(axis=1) - 100).max() <= 8 and np.abs(counts.sum(axis=0) - 100).max() <= 8
    assert counts.min() >= 4 and np.ptp(shade) == 0.0


@pytest.mark.parametrize("size", [(12, 10), (60, 50)], ids=["small", "large"])
def test_a_recording_grows_by_a_tenth_at_most(tmp_path: Path, size: tuple[int, int]) -> None:
    """And has meshes and numbers from its begin to its end."""
    found = list(items(Sheet(*size), 400, checkpoint_every=100))
    plain, whole = write(tmp_path / "a.mcap", found, shown=False), write(tmp_path / "b.mcap", found)
    assert whole.stat().st_size <= 1.1 * plain.stat().st_size
    heard, end = read(whole), 1e9 * 399 / RATE
    for topic, least in (("scene/cloth", 10), (f"numbers/{STATUS.name}", 30), ("curves/energy_kinetic", 30)):
        at = np.array([one.at for one in heard[topic]])
        assert len(at) >= least and at[0] == 0 and np.diff([*at, end]).max() < 0.05 * end
    assert heard["scene/cloth"][-1].at == round(end)


def test_readers_of_recordings_do_not_see_them(tmp_path: Path) -> None:
    """Every message, its number and time are as in a recording without, and so are the counts."""
    found = list(items(Sheet(), 20))
    with (
        open_recording(write(tmp_path / "a.mcap", found, shown=False)) as plain,
        open_recording(write(tmp_path / "b.mcap", found)) as whole,
    ):
        rows = [[(m.topic, m.seq, m.log_time, m.payload) for m in one.messages()] for one in (plain, whole)]
        assert rows[0] == rows[1] and plain.counts == whole.counts and plain.span == whole.span
        assert whole.layout.indexed and not whole.damage


def test_what_cannot_be_shown_is_recorded_all_the_same(tmp_path: Path) -> None:
    """A cloth whose description is damaged has no meshes, which is said once; all else is there."""
    found, warned = list(items(Sheet(), 10)), list[str]()
    found[0] = (*found[0][:2], encode_arrays({}, {"vertices": 3}))
    heard = read(write(tmp_path / "run.mcap", found, warned=warned))
    assert len(warned) == 1 and FABRIC.name in warned[0]
    assert "scene/cloth" not in heard and len(heard[STATE.name]) == 10 and heard["scene/bodies"] and heard["log"]
    with pytest.raises(BadMessage, match=FABRIC.name):
        Show(lambda name: None).take(FABRIC.name, found[0][2])


def test_a_run_has_them_from_its_start_on(tmp_path: Path) -> None:
    nuno.run(write_scene(tmp_path, duration=0.1), record=tmp_path / "run.mcap")
    heard = read(tmp_path / "run.mcap")
    (net,) = heard["scene/cloth"][0].value.entities
    with nuno.open(tmp_path / "run.mcap") as recording:
        frame, edges = next(recording.frames()), recording.fabric()[0]["edges"]
    x = placed(transforms(heard, 0), vectors(net.lines[0].points), net.frame_id, "map")
    assert heard["scene/cloth"][0].at == 0 and np.abs(x - upright(frame.x)).max() <= GRAIN
    assert np.array_equal(np.array(net.lines[0].indices).reshape(-1, 2), edges)
    for at, numbers in heard[f"numbers/{STATUS.name}"]:
        assert 0.0 <= at <= 1e8 and np.isfinite(numbers.energy_total) and numbers.energy_kinetic >= 0.0
    assert [one.value.message for one in heard["log"]][-1] == "done"


def test_dyed_cloth_has_pictures(tmp_path: Path) -> None:
    """The darker, the more dye a cell holds; and a curve for the dye."""
    nuno.run(write_dye_scene(tmp_path), record=tmp_path / "run.mcap")
    heard = read(tmp_path / "run.mcap")
    with open_recording(tmp_path / "run.mcap") as recording:
        arrays, _ = recording.arrays(next(recording.messages(["dye/concentration"])))
    amount = (arrays["phi"] + arrays["fixed"])[0].mean(axis=0)
    first = heard["scene/dye"][0]
    picture = np.asarray(Image.open(io.BytesIO(first.value.data)), np.float64)
    assert first.at == 0 and first.value.format == "png" and picture.shape == (*amount.shape, 3)
    order = np.argsort(amount.reshape(-1))
    light = picture.sum(axis=2).reshape(-1)[order]
    assert (np.diff(light) <= 0.0).all() and light[-1] < light[0]
    assert heard["numbers/dye/status"][0].value.mobile_blue > 0.0 and heard["curves/mobile_blue"]


def chunks(path: Path, folder: Path) -> Iterator[str]:
    """The components that rerun's viewer makes of an MCAP file, by entity."""
    import subprocess

    import rerun_cli

    rerun = str(Path(next(iter(rerun_cli.__path__))) / "rerun")
    out = folder / "out.rrd"
    subprocess.run([rerun, "mcap", "convert", str(path), "-o", str(out)], check=True, capture_output=True, timeout=60)
    shown = subprocess.run([rerun, "rrd", "print", str(out)], check=True, capture_output=True, timeout=60).stdout
    return (line for line in shown.decode().splitlines() if line.startswith("Chunk("))


@pytest.mark.full
def test_rerun_shows_points_transforms_curves_and_log(tmp_path: Path) -> None:
    """Without an export: what its viewer draws of a recording, by the names of its archetypes."""
    path = write(tmp_path / "run.mcap", list(items(Sheet(), 20)))
    lines = list(chunks(path, tmp_path))
    for entity, component in {
        "/sim/state": "Points3D:positions", "/scene/points/ball/world": "Points3D:colors",
        "/scene/frames": "Transform3D:quaternion", "/scene/fixed": "Transform3D:child_frame",
        "/curves/energy_kinetic": "Measurements:values", "/log": "TextLog:text",
    }.items():  # fmt: skip
        assert any(f"- {entity} -" in line and component in line for line in lines), entity
