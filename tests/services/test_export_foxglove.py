"""The MCAP file for Foxglove and Lichtblick, read by mcap and its protobuf decoder: what the recording shows, when it
does; and the layout, which looks at what is there.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import write_scene as write_dye_scene
from exported import FAR, picture, png, write_items
from foxglove_file import known_at, placed, read, vectors
from persons import skinned
from recorded_sheet import RATE, Sheet, items, write
from scenes import write_scene

import nuno
from nuno.bus.encodings import decode_arrays, encode_arrays
from nuno.cli import main
from nuno.collision.messages import encode_geometry, encode_poses
from nuno.exports.cloth import body_vertices, paint_stretch, read_bodies, read_pieces
from nuno.exports.foxglove import export_foxglove
from nuno.recording.reader import open_recording
from nuno_schemas.bodies import Poses
from nuno_schemas.colour import to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import BODIES, GEOMETRY, PENETRATION, STATUS

pytest.importorskip("mcap_protobuf", reason="needs mcap-protobuf-support, of nuno[dev]")

FRAMES = 5
SHEET = Sheet()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foxglove") / "run.mcap"
    write(path, SHEET, FRAMES)
    return path


@pytest.mark.parametrize("shift", [np.zeros(3), FAR], ids=["near", "far"])
def test_every_frame_is_where_the_recording_has_it(tmp_path: Path, shift: Float) -> None:
    """To the last bit of float32, a million metres away, too; each frame replaces the last."""

    class Moved(Sheet):
        def x(self, t: float) -> Float:
            return super().x(t) + shift

    write(tmp_path / "run.mcap", Moved(), FRAMES)
    heard = read(export_foxglove(tmp_path / "run.mcap", tmp_path / "out.mcap")[0])
    with nuno.open(tmp_path / "run.mcap") as recording:
        frames = list(recording.frames())
    assert len(heard["scene/cloth"]) == len(frames) == FRAMES
    for frame, (at, update) in zip(frames, heard["scene/cloth"], strict=True):
        (entity,) = update.entities
        assert (at, entity.id, entity.frame_id) == (round(frame.t * 1e9), "cloth", "cloth")
        assert entity.timestamp.ToNanoseconds() == at and entity.lifetime.ToNanoseconds() == 0
        (mesh,) = entity.triangles
        origin = placed(known_at(heard, at), np.zeros((1, 3)), "cloth", "world")
        assert np.array_equal(vectors(mesh.points), (frame.x - origin).astype(np.float32))
        assert np.array_equal(np.array(mesh.indices).reshape(-1, 3), SHEET.faces)
    assert np.array_equal(
        placed(known_at(heard, 0), np.eye(3), "world", "map").round(12), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    )


def test_bodies_are_sent_once_and_moved_by_their_frames(path: Path, tmp_path: Path) -> None:
    heard = read(export_foxglove(path, tmp_path / "out.mcap")[0])
    assert [one.at for one in heard["scene/bodies"]] == [0] and "scene/skins" not in heard
    assert [one.at for one in heard["scene/frames"]] == [round(1e9 * k / RATE) for k in range(FRAMES)]
    (entity,) = heard["scene/bodies"][0].value.entities
    assert entity.frame_locked and entity.frame_id == "ball/world"
    with open_recording(path) as recording:
        bodies = read_bodies(recording)
        assert bodies is not None
        assert np.array_equal(np.array(entity.triangles[0].indices).reshape(-1, 3), bodies.faces)
        for at, _ in heard["scene/frames"]:
            x = placed(known_at(heard, at), vectors(entity.triangles[0].points), entity.frame_id, "world")
            assert x == pytest.approx(body_vertices(recording, bodies, at / 1e9), abs=1e-7)


def test_a_skin_is_sent_as_it_is_bent(tmp_path: Path) -> None:
    found = []
    for topic, header, payload in items(SHEET, 3):
        if topic == BODIES.name:
            half = 0.1 * header.frame
            turns = np.array([[np.cos(half), 0, 0, -np.sin(half)], [np.cos(half), 0, 0, np.sin(half)]])
            payload = encode_poses(Poses(header.t, turns, np.zeros((2, 3))), header.frame)
        found.append((topic, header, encode_geometry(skinned()) if topic == GEOMETRY.name else payload))
    write_items(tmp_path / "run.mcap", found)
    heard = read(export_foxglove(tmp_path / "run.mcap", tmp_path / "out.mcap")[0])
    assert "scene/bodies" not in heard
    with open_recording(tmp_path / "run.mcap") as recording:
        bodies, seen = read_bodies(recording), []
        for at, update in heard["scene/skins"]:
            (entity,) = update.entities
            x = placed(known_at(heard, at), vectors(entity.triangles[0].points), entity.frame_id, "world")
            assert x == pytest.approx(body_vertices(recording, bodies, at / 1e9), abs=1e-6)
            seen.append(x)
    assert len(seen) == 3 and np.abs(seen[2] - seen[0]).max() > 0.01


def test_cloth_has_its_colours(tmp_path: Path) -> None:
    """Those of its stretch, where the scene shows that, which change; its own, once; or those of its print at each
    vertex.
    """

    def colours(recording: Path) -> list[Any]:
        heard = read(export_foxglove(recording, tmp_path / "out.mcap")[0])["scene/cloth"]
        return [one.value.entities[0].triangles[0] for one in heard]

    stretched = tmp_path / "stretch.mcap"
    write(stretched, SHEET, 3, scene={"name": "waving", "view": {"colour": "stretch"}})
    with open_recording(stretched) as recording:
        (piece,) = read_pieces(recording)
        frames = list(recording.frames())
    for mesh, frame in zip(colours(stretched), frames, strict=True):
        assert np.array([(c.r, c.g, c.b) for c in mesh.colors]) == pytest.approx(
            to_srgb(paint_stretch(piece.stretch(frame.x))), abs=1e-4
        )
    image = np.asarray(picture(5, 6))  # as many pixels as vertices: each lies on one
    write(tmp_path / "print.mcap", SHEET, 1, {"check.png": png(picture(5, 6))}, texture="check.png")
    (mesh,) = colours(tmp_path / "print.mcap")
    assert np.array([(c.r, c.g, c.b) for c in mesh.colors]) * 255 == pytest.approx(image.reshape(-1, 3))
    found = list(items(SHEET, 2))
    arrays, text = decode_arrays(found[0][2])
    text["objects"][0]["colour"] = "#336699"
    write_items(tmp_path / "own.mcap", [(*found[0][:2], encode_arrays(arrays, text)), *found[1:]])
    for mesh in colours(tmp_path / "own.mcap"):
        assert not mesh.colors and [mesh.color.r, mesh.color.g, mesh.color.b] == pytest.approx([0.2, 0.4, 0.6])


def test_a_net_is_its_links(tmp_path: Path) -> None:
    nuno.run(write_scene(tmp_path, duration=0.02), record=tmp_path / "run.mcap")
    heard = read(export_foxglove(tmp_path / "run.mcap", tmp_path / "out.mcap")[0])
    with nuno.open(tmp_path / "run.mcap") as recording:
        frames, edges = list(recording.frames()), recording.fabric()[0]["edges"]
    for frame, (_, update) in zip(frames, heard["scene/cloth"], strict=True):
        (lines,) = update.entities[0].lines
        assert lines.type == lines.LINE_LIST and lines.scale_invariant
        assert np.array_equal(vectors(lines.points)[np.array(lines.indices).reshape(-1, 2)], frame.x[edges])


def test_numbers_are_doubles_of_their_names_and_events_are_logged(path: Path, tmp_path: Path) -> None:
    """In every frame, to the bit; the sum of the energies, too."""
    heard = read(export_foxglove(path, tmp_path / "out.mcap")[0])
    with open_recording(path) as recording:
        for name in (STATUS.name, PENETRATION.name):
            sent = [(message.log_time, recording.said(message)) for message in recording.messages([name])]
            assert [at for at, _ in sent] == [at for at, _ in heard[f"numbers/{name}"]] and len(sent) == FRAMES
        for (_, said), (_, numbers) in zip(sent, heard[f"numbers/{PENETRATION.name}"], strict=True):
            assert (numbers.depth, numbers.mean, numbers.inside) == (said["depth"], said["mean"], said["inside"])
        (event,) = recording.events()
        end = [message.log_time for message in recording.messages(["run/event/*"])]
    for k, (_, numbers) in enumerate(heard[f"numbers/{STATUS.name}"]):
        assert (numbers.energy_kinetic, numbers.stretch) == (0.5 + k / RATE, 0.01 * k)
        assert numbers.energy_total == numbers.energy_kinetic + numbers.energy_springs
    (line,) = heard["log"]
    assert (line.value.message, line.value.name) == (event.text, "simulation")
    assert [line.at] == end == [line.value.timestamp.ToNanoseconds()]


def test_a_status_with_other_numbers_has_a_type_of_its_own(tmp_path: Path) -> None:
    """An operation adds an energy in the middle of a run: no number is lost, and none is read as another."""
    found = []
    for topic, header, payload in items(SHEET, FRAMES):
        if topic == STATUS.name and header.frame >= 2:
            fields = json.loads(payload)
            payload = json.dumps(fields | {"energy": {"hinges": None, **fields["energy"]}}).encode()
        found.append((topic, header, payload))
    write_items(tmp_path / "run.mcap", found)
    heard = read(export_foxglove(tmp_path / "run.mcap", tmp_path / "out.mcap")[0])[f"numbers/{STATUS.name}"]
    assert [numbers.energy_kinetic for _, numbers in heard] == [0.5 + k / RATE for k in range(FRAMES)]
    assert [hasattr(numbers, "energy_hinges") for _, numbers in heard] == [False, False, True, True, True]
    assert np.isnan(heard[2].value.energy_hinges)


def test_what_would_be_lost_is_refused(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A recording above all: it has the same ending; and a layout that was changed and saved from a viewer."""
    before = path.read_bytes()
    assert main(["export", str(path), "--foxglove", str(path)]) == 2
    assert "would be lost" in capsys.readouterr().err and path.read_bytes() == before
    assert main(["export", str(path), "--foxglove", str(tmp_path / "out.bag")]) == 2
    assert "must end in .mcap" in capsys.readouterr().err
    out, layout = tmp_path / "out.mcap", tmp_path / "out.layout.json"
    for _ in range(2):  # its own files are replaced
        assert main(["export", str(path), "--foxglove", str(out)]) == 0
        assert capsys.readouterr().out.split() == [str(out), str(layout)]
    changed = json.dumps(dict(reversed(json.loads(layout.read_text()).items())))
    layout.write_text(changed)
    assert main(["export", str(path), "--foxglove", str(out)]) == 2
    assert "would be lost" in capsys.readouterr().err and layout.read_text() == changed
    assert main(["export", str(path), "--foxglove", str(tmp_path / "b.mcap"), "--frame", "2"]) == 2
    assert "has all frames" in capsys.readouterr().err
    assert sorted(one.name for one in tmp_path.iterdir()) == ["out.layout.json", "out.mcap"]


def test_what_cannot_be_shown_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    class Lost(Sheet):
        def x(self, t: float) -> Float:
            return super().x(t) if t < 2.5 / RATE else np.full((self.number, 3), np.nan)

    write(tmp_path / "lost.mcap", Lost(), FRAMES)
    with pytest.raises(BadInput, match="not finite") as told:
        export_foxglove(tmp_path / "lost.mcap", tmp_path / "out.mcap")
    assert told.value.value == 3
    nuno.run(write_dye_scene(tmp_path), record=tmp_path / "dye.mcap")
    assert main(["export", str(tmp_path / "dye.mcap"), "--foxglove", str(tmp_path / "out.mcap")]) == 2
    assert "without a shape" in capsys.readouterr().err
    assert not list(tmp_path.glob("*out*"))
