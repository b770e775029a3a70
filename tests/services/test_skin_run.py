"""A person who moves with the skin, in whole runs: what is recorded, drawn and replayed; and a sewn garment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import animated_tube as hero
import numpy as np
import pytest
import yaml
from persons import person_file, skinned
from rrd import read, write
from viewer_run import messages

from nuno.cli import main
from nuno.collision.messages import decode_geometry, decode_poses, encode_geometry, encode_poses
from nuno.exports.cloth import body_vertices, read_bodies
from nuno.recording.reader import open_recording
from nuno_bench.piles import Oracle
from nuno_schemas.bodies import SKIN, Poses
from nuno_schemas.messages import BODIES, GEOMETRY, PENETRATION

WALK = Path(__file__).resolve().parents[2] / "scenes" / "walk.bvh"


def write_scene(folder: Path, **fields: Any) -> Path:
    """A scarf falls on the shoulders of a person who sets out."""
    (folder / "person.obj").write_text(person_file(0.025))
    (folder / "walk.bvh").write_bytes(WALK.read_bytes())
    model = {"plugin": "sheet", "size": [0.5, 0.3], "resolution": [9, 7], "plane": "xz", "centre": [0.004, 1.76, 0.003],
             "fabric": "interlock", "cells": "triangles"}  # fmt: skip
    scene = {
        "nuno": 1, "name": "walker", "duration": 0.4, "frame_rate": 50, "solver": {"plugin": "symplectic_euler"},
        "objects": [{"name": "scarf", "model": model}],
        "bodies": [{"name": "wearer", "collider": {"plugin": "skin", "file": "person.obj", "blend": 0.2},
                    "motion": {"plugin": "bvh", "file": "walk.bvh"}}],
        "cloth_contact": {"plugin": "offset", "thickness": "2 mm", "bodies": ["wearer"]},
    } | fields  # fmt: skip
    (folder / "walker.yaml").write_text(yaml.safe_dump(scene))
    return folder / "walker.yaml"


def judge(record: Path) -> tuple[int, int]:
    """In how many frames anything passes through anything, as ipctk sees it, and as the collision service does."""
    with open_recording(record) as recording:
        message = recording.last(GEOMETRY.name)
        assert message is not None
        geometry = decode_geometry(message.payload)
        poses = [decode_poses(message.payload) for message in recording.messages([BODIES.name])]
        told = [recording.json(message.payload)["crossings"] for message in recording.messages([PENETRATION.name])]
        cloth, seen = recording.fabric()[0]["faces"], 0
        for frame, pose in zip(recording.frames(), poses, strict=True):
            x = np.asarray(frame.x, np.float64)
            body, faces = geometry.placed(0, pose)
            oracle = Oracle(np.concatenate([x, body]), np.concatenate([cloth, faces + np.int32(len(x))]))
            seen += oracle.crossed(np.concatenate([x, body]))
        return seen, sum(number > 0 for number in told)


def test_a_skin_is_drawn_where_its_frames_bend_it(tmp_path: Path) -> None:
    """In each frame, in the world; and where nothing moves, no more."""
    geometry, still, fed = skinned(), Poses(0.0, np.eye(4)[[0, 0]], np.zeros((2, 3))), []

    def bent(frame: int, t: float) -> Poses:
        half = 0.1 * min(frame, 2)
        turns = np.array([[np.cos(half), 0, 0, -np.sin(half)], [np.cos(half), 0, 0, np.sin(half)]])
        return Poses(t, turns, still.translation)

    for topic, frame, t, payload in messages(4, 8, 6):
        if topic == GEOMETRY.name:
            payload = encode_geometry(geometry)
        fed.append((topic, frame, t, encode_poses(bent(frame, t), frame) if topic == BODIES.name else payload))
    found = read(write(tmp_path / "skin.rrd", fed), "/world/bodies/bar/skin", "Mesh3D:vertex_positions")
    assert sorted(found) == [0, 1, 2]
    for frame, points in found.items():
        expected = geometry.placed(0, bent(frame, 0.0))[0]
        assert np.array_equal(np.float32(points), expected.astype(np.float32))
    assert np.abs(np.array(found[2]) - found[0]).max() > 0.02


@pytest.mark.full
def test_a_run_is_recorded_drawn_and_simulated_again_with_the_same_bits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = tmp_path / "walker.mcap"
    assert main(["run", str(write_scene(tmp_path)), "--record", str(record), "--no-view"]) == 0
    assert judge(record) == (0, 0)
    with open_recording(record) as recording:
        bodies = read_bodies(recording)
        first, last = (body_vertices(recording, bodies, t) for t in (0.0, 0.4))
        message = recording.last(GEOMETRY.name)
        assert message is not None
        geometry = decode_geometry(message.payload)
    assert geometry.kind.tolist() == [SKIN]
    assert np.abs(first - geometry.vertices).max() < 1e-12
    moved = np.linalg.norm(last - first, axis=1)
    assert moved.max() > 0.2 > 0.1 > moved.min()
    assert main(["verify", str(record)]) == 0
    assert main(["replay", str(record), "--save", str(tmp_path / "walker.rrd")]) == 0
    assert (tmp_path / "walker.rrd").stat().st_size > 1e6
    assert main(["export", str(record), "--png", str(tmp_path / "walker.png")]) == 0
    capsys.readouterr()


@pytest.mark.full
@pytest.mark.parametrize("closed", [True, False])
def test_cloth_on_an_animated_body_passes_through_nothing_and_is_simulated_again(tmp_path: Path, closed: bool) -> None:
    """A sheet falls on a tube that bends and swells, from files of each frame, with ends or open: 0 crossings by ipctk
    and by the collision service; and resumed, and from the recording, which has the files, the same bits.
    """
    x, faces = hero.tube(closed=closed)
    first = hero.write_sequence(tmp_path, np.stack([hero.posed(x, t) for t in hero.times(11)]), faces)
    motion = {"plugin": "animation", "file": first, "frame_rate": hero.RATE, "preroll": 0.1}
    model = {"plugin": "sheet", "size": [0.4, 0.4], "resolution": [13, 13], "plane": "xz", "fabric": "interlock",
             "centre": [0.004, 0.43, 0.003], "cells": "triangles"}  # fmt: skip
    scene = write_scene(
        tmp_path, duration=0.6, objects=[{"name": "sheet", "model": model}], record={"checkpoint_every": 0.3},
        bodies=[{"name": "wearer", "collider": {"plugin": "surface"}, "motion": motion}],
    )  # fmt: skip
    record = tmp_path / "hero.mcap"
    assert main(["run", str(scene), "--record", str(record), "--no-view"]) == 0
    assert judge(record) == (0, 0)
    part, rest = tmp_path / "part.mcap", tmp_path / "rest.mcap"
    assert main(["run", str(scene), "--record", str(part), "--no-view", "--set", "duration=0.3"]) == 0
    for file in tmp_path.glob("*.obj"):
        file.unlink()
    assert main(["run", "--resume", str(part), "--record", str(rest), "--no-view", "--set", "duration=0.6"]) == 0
    with open_recording(record) as one, open_recording(rest) as other:
        assert [frame.digest for frame in one.frames()] == [frame.digest for frame in other.frames()]
    assert main(["verify", str(record)]) == 0
    assert main(["replay", str(record), "--save", str(tmp_path / "hero.rrd")]) == 0


@pytest.mark.full
def test_contact_by_distance_refuses_a_skin_before_anything_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, cloth_contact={"plugin": "offset"}, contact={"plugin": "penalty"})
    assert main(["run", str(scene), "--no-view"]) == 2
    said = capsys.readouterr().err
    assert "bend" in said
    assert "bodies: [wearer]" in said


@pytest.mark.full
def test_a_sewn_shirt_is_worn_by_a_body_that_walks(shared_data: Path, tmp_path: Path) -> None:
    """For 1.5 s, all but 0.1 s on the move: no edge of cloth through the skin in any frame, nor of it through cloth."""
    model = {"plugin": "pattern", "file": "patterns/shirt.json", "edge": "3 cm", "fabric": "interlock",
             "over": {"body": "wearer", "clearance": "2 cm"}}  # fmt: skip
    collider = {"plugin": "skin", "file": "body-mean.obj", "stand": 0.1, "blend": 0.8}
    motion = {"plugin": "bvh", "file": "cmu_12_01_walk.bvh"}
    scene = write_scene(
        tmp_path, duration=1.5, frame_rate=60, solver={"plugin": "respa"}, damping=8,
        objects=[{"name": "shirt", "model": model}], operations=[{"plugin": "untangle"}],
        bodies=[{"name": "wearer", "collider": collider, "motion": motion, "friction": 0.4}],
    )  # fmt: skip
    record = tmp_path / "shirt.mcap"
    assert main(["run", str(scene), "--record", str(record), "--no-view", "--root", str(shared_data)]) == 0
    with open_recording(record) as recording:
        told = [recording.json(message.payload)["crossings"] for message in recording.messages([PENETRATION.name])]
    assert len(told) == 91 and not any(told)
