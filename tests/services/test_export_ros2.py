"""The bag of ROS 2, read by rosbags and by mcap's decoder of ROS messages: what the recording shows, when it does."""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from exported import FAR, picture, png, write_items
from foxglove_file import Heard, placed, vectors
from persons import skinned
from recorded_sheet import RATE, Sheet, items, write
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.collision.messages import encode_geometry, encode_poses
from nuno.exports.cloth import body_vertices, paint_stretch, read_bodies, read_pieces
from nuno.exports.ros2 import export_ros2
from nuno.recording.reader import open_recording
from nuno_schemas.bodies import Poses
from nuno_schemas.colour import to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import BODIES, GEOMETRY

pytest.importorskip("rosbags", reason="needs nuno[ros]")
pytest.importorskip("mcap_ros2", reason="needs mcap-ros2-support, of nuno[dev]")
FRAMES = 5
SHEET = Sheet()


def read(bag: Path) -> dict[str, list[Heard]]:
    """Messages by topic, decoded by mcap-ros2-support, which knows of ROS what the file says."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found = defaultdict(list)
    with (bag / f"{bag.name}.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for _, channel, message, value in reader.iter_decoded_messages():
            found[channel.topic].append(Heard(message.log_time, value))
    return found


def transforms(heard: dict[str, list[Heard]], at: int) -> dict[str, Any]:
    """By the frame that is placed, the last until a time [ns]."""
    before = (one for topic in ("/tf_static", "/tf") for one in heard[topic] if one.at <= at)
    return {t.child_frame_id: t for one in before for t in one.value.transforms}


def in_world(heard: dict[str, list[Heard]], marker: Any, at: int) -> Float:
    """Points (n, 3) of a marker [m]: its pose is that of its frame."""
    assert vectors([marker.pose.position]).tolist() == [[0, 0, 0]] and marker.pose.orientation.w == 1.0
    known = {name: (t.header.frame_id, t.transform) for name, t in transforms(heard, at).items()}
    return placed(known, vectors(marker.points), marker.header.frame_id, "world")


def stamped(header: Any) -> int:
    return int(header.stamp.sec * 10**9 + header.stamp.nanosec)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ros2") / "run.mcap"
    write(path, SHEET, FRAMES)
    return path


@pytest.mark.parametrize("shift", [np.zeros(3), FAR], ids=["near", "far"])
def test_every_frame_is_where_the_recording_has_it(tmp_path: Path, shift: Float) -> None:
    """Triangles and points, to the last bit of float32, a million metres away, too."""

    class Moved(Sheet):
        def x(self, t: float) -> Float:
            return super().x(t) + shift

    write(tmp_path / "run.mcap", Moved(), FRAMES)
    heard = read(export_ros2(tmp_path / "run.mcap", tmp_path / "bag"))
    with nuno.open(tmp_path / "run.mcap") as recording:
        frames = list(recording.frames())
    assert len(heard["/cloth"]) == len(heard["/cloth_points"]) == len(frames) == FRAMES
    cloth = transforms(heard, 0)["cloth"]
    origin = vectors([cloth.transform.translation])
    assert (cloth.header.frame_id, cloth.transform.rotation.w) == ("world", 1.0)
    for frame, (at, markers), (also_at, cloud) in zip(frames, heard["/cloth"], heard["/cloth_points"], strict=True):
        x = (frame.x - origin).astype(np.float32)
        (marker,) = markers.markers
        assert at == also_at == stamped(marker.header) == stamped(cloud.header) == round(frame.t * 1e9)
        assert (marker.type, marker.action, marker.ns, marker.id, marker.header.frame_id) == (
            11,
            0,
            "cloth",
            0,
            "cloth",
        )
        assert np.array_equal(vectors(marker.points), x[SHEET.faces].reshape(-1, 3))
        assert (cloud.header.frame_id, cloud.width, cloud.height, cloud.point_step) == ("cloth", len(x), 1, 12)
        assert [(one.name, one.offset, one.datatype) for one in cloud.fields] == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]
        assert np.array_equal(np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 3), x)
    known = {"world": ("map", transforms(heard, 0)["world"].transform)}
    assert np.array_equal(placed(known, np.eye(3), "world", "map").round(12), [[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def test_bodies_are_sent_once_and_moved_by_their_frames(path: Path, tmp_path: Path) -> None:
    heard = read(export_ros2(path, tmp_path / "bag"))
    assert [one.at for one in heard["/bodies"]] == [0] and "/skins" not in heard
    assert [one.at for one in heard["/tf"]] == [round(1e9 * k / RATE) for k in range(FRAMES)]
    (marker,) = heard["/bodies"][0].value.markers
    assert marker.frame_locked and marker.header.frame_id == "ball/world"
    with open_recording(path) as recording:
        bodies = read_bodies(recording)
        assert bodies is not None
        for at, _ in heard["/tf"]:
            x = body_vertices(recording, bodies, at / 1e9)[bodies.faces].reshape(-1, 3)
            assert in_world(heard, marker, at) == pytest.approx(x, abs=1e-7)


def test_a_skin_is_sent_as_it_is_bent(tmp_path: Path) -> None:
    found = []
    for topic, header, payload in items(SHEET, 2):
        if topic == BODIES.name:
            half = 0.1 * header.frame
            turns = np.array([[np.cos(half), 0, 0, -np.sin(half)], [np.cos(half), 0, 0, np.sin(half)]])
            payload = encode_poses(Poses(header.t, turns, np.zeros((2, 3))), header.frame)
        found.append((topic, header, encode_geometry(skinned()) if topic == GEOMETRY.name else payload))
    write_items(tmp_path / "run.mcap", found)
    heard = read(export_ros2(tmp_path / "run.mcap", tmp_path / "bag"))
    assert "/bodies" not in heard
    with open_recording(tmp_path / "run.mcap") as recording:
        bodies = read_bodies(recording)
        assert bodies is not None
        for at, markers in heard["/skins"]:
            x = body_vertices(recording, bodies, at / 1e9)[bodies.faces].reshape(-1, 3)
            assert in_world(heard, markers.markers[0], at) == pytest.approx(x, abs=1e-6)
    assert len(heard["/skins"]) == 2


def test_cloth_has_its_colours_and_a_net_its_links(tmp_path: Path) -> None:
    def colours(marker: Any) -> Float:
        return np.array([(c.r, c.g, c.b) for c in marker.colors or [marker.color]])

    stretched = tmp_path / "stretch.mcap"
    write(stretched, SHEET, 3, scene={"name": "waving", "view": {"colour": "stretch"}})
    with open_recording(stretched) as recording:
        (piece,) = read_pieces(recording)
        frames = list(recording.frames())
    for frame, (_, markers) in zip(frames, read(export_ros2(stretched, tmp_path / "a"))["/cloth"], strict=True):
        painted = to_srgb(paint_stretch(piece.stretch(frame.x)))[SHEET.faces].reshape(-1, 3)
        assert colours(markers.markers[0]) == pytest.approx(painted, abs=1e-4)
    image = np.asarray(picture(5, 6)).reshape(-1, 3)  # as many pixels as vertices: each lies on one
    write(tmp_path / "print.mcap", SHEET, 1, {"check.png": png(picture(5, 6))}, texture="check.png")
    (one,) = read(export_ros2(tmp_path / "print.mcap", tmp_path / "b"))["/cloth"]
    assert 255 * colours(one.value.markers[0]) == pytest.approx(image[SHEET.faces].reshape(-1, 3), abs=1e-4)
    nuno.run(write_scene(tmp_path, duration=0.02), record=tmp_path / "net.mcap")
    with nuno.open(tmp_path / "net.mcap") as recording:
        frames, edges = list(recording.frames()), recording.fabric()[0]["edges"]
    for frame, (_, markers) in zip(
        frames, read(export_ros2(tmp_path / "net.mcap", tmp_path / "c"))["/cloth"], strict=True
    ):
        (marker,) = markers.markers
        assert marker.type == 5 and marker.scale.x > 0.0  # LINE_LIST
        assert np.array_equal(vectors(marker.points), frame.x[edges].reshape(-1, 3))


def test_the_series_are_numbers(path: Path, tmp_path: Path) -> None:
    """To the last bit, at their frames' times."""
    heard = read(export_ros2(path, tmp_path / "bag"))
    with open_recording(path) as recording:
        series = recording.series()
    shown = {"energy_kinetic", "energy_springs", "stretch", "depth", "mean"}
    assert {f"/series/{name}" for name in shown} <= set(heard)
    for name in series.keys() - {"frame", "t"}:
        expected = [(round(t * 1e9), value) for t, value in zip(series["t"], series[name].astype(float), strict=True)]
        assert [(at, number.data) for at, number in heard[f"/series/{name}"]] == expected


def test_rosbags_reads_the_same_and_its_metadata_fit(path: Path, tmp_path: Path) -> None:
    """As `ros2 bag info` does: counts, times and types; what is sent once is kept for those who come later."""
    from rosbags.interfaces import QosDurability
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    bag, store = export_ros2(path, tmp_path / "bag"), get_typestore(Stores.ROS2_JAZZY)
    told = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (told["version"], told["storage_identifier"], told["relative_file_paths"]) == (8, "mcap", ["bag.mcap"])
    assert (told["compression_format"], told["starting_time"]) == ("", {"nanoseconds_since_epoch": 0})
    assert told["duration"]["nanoseconds"] == round(1e9 * (FRAMES - 1) / RATE)
    heard = read(bag)
    counts = {one["topic_metadata"]["name"]: one["message_count"] for one in told["topics_with_message_count"]}
    assert counts == {topic: len(found) for topic, found in heard.items()}
    assert told["message_count"] == sum(counts.values())
    seen = defaultdict(list)
    with Reader(bag) as reader:
        for connection in reader.connections:
            kept = [one.durability for one in connection.ext.offered_qos_profiles]
            assert (kept == [QosDurability.TRANSIENT_LOCAL]) == (connection.topic in ("/tf_static", "/bodies"))
        for connection, at, payload in reader.messages():
            seen[connection.topic].append(Heard(at, store.deserialize_cdr(payload, connection.msgtype)))
    for topic in ("/cloth", "/bodies"):
        for theirs, ours in zip(seen[topic], heard[topic], strict=True):
            assert theirs.at == ours.at
            for one, other in zip(theirs.value.markers, ours.value.markers, strict=True):
                assert np.array_equal(vectors(one.points), vectors(other.points)) and one.ns == other.ns
    for theirs, ours in zip(seen["/cloth_points"], heard["/cloth_points"], strict=True):
        assert bytes(theirs.value.data) == bytes(ours.value.data)


def test_what_cannot_be_written_is_said_first(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bag").mkdir()
    assert main(["export", str(path), "--ros2", str(tmp_path / "bag")]) == 2
    assert "something of that name exists" in capsys.readouterr().err
    assert main(["export", str(path), "--ros2", str(tmp_path / "no" / "bag")]) == 2
    assert "no such folder" in capsys.readouterr().err

    class Lost(Sheet):
        def x(self, t: float) -> Float:
            return super().x(t) if t < 2.5 / RATE else np.full((self.number, 3), np.nan)

    write(tmp_path / "lost.mcap", Lost(), FRAMES)
    with pytest.raises(BadInput, match="not finite"):
        export_ros2(tmp_path / "lost.mcap", tmp_path / "new")
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert main(["export", str(path), "--csv", str(tmp_path / "o.csv"), "--ros2", str(tmp_path / "new")]) == 2
    assert 'pip install "nuno[ros]"' in capsys.readouterr().err
    assert sorted(one.name for one in tmp_path.iterdir()) == ["bag", "lost.mcap"]
