"""Recordings, for replay and whatever else reads them; and scenes."""

from __future__ import annotations

import math
import tempfile
import zlib
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import nuno
from nuno.exports.cloth import read_bodies, read_pieces
from nuno.recording.reader import Recording, control_events
from nuno.scene import scene_file, shipped
from nuno.scene.recorded_scene import restored_scene
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import DYE_CHECKPOINT
from soak.fuzz.containers import RECORDING
from soak.fuzz.forged import forge
from soak.fuzz.kind import TAU3, Kind, Read, require
from soak.fuzz.mutate import mutate_text

CLOTH: dict[str, Any] = {
    "nuno": 1, "name": "cloth", "duration": "40 ms", "frame_rate": "50 Hz",
    "record": {"checkpoint_every": "20 ms", "contact_forces": True},
    "objects": [{"name": "a", "model": {
        "plugin": "sheet", "size": ["1 m", "1 m"], "resolution": [2, 2], "cells": "triangles"}}],
    "bodies": [{"name": "ball", "collider": {"plugin": "sphere", "radius": "0.1 m", "centre": [0, -3, 0]}}],
    "solver": {"plugin": "symplectic_euler", "dt": "1 ms"},
}  # fmt: skip
DYED: dict[str, Any] = {
    "nuno": 1, "name": "dyed", "duration": "2 s", "frame_rate": "1 Hz", "record": {"checkpoint_every": "1 s"},
    "dye": {
        "cloth": {"plugin": "woven", "cells": [4, 4], "cell_size": "0.1 mm", "tau3": TAU3,
                  "supply": [{"kind": "bath", "amount": 0.5,
                              "region": {"shape": "disc", "centre": ["0.2 mm", "0.2 mm"], "diameter": "0.2 mm"}}]},
        "dyes": [{"name": "indigo", "D0": "1 mm^2/h", "adsorption": 0.01, "isotherm": {"plugin": "langmuir", "K": 20}}],
    },
}  # fmt: skip
SELDOM = 8
"""Of so many recordings one has its scene made ready to run: that takes longer than all the rest."""
MOST_SCENE = 450
"""Bytes of a shipped scene that inputs are made from: long ones take long to read."""
WORDS = (
    "&a ", "*a", "<<: *a", "!!python/object:os.system", "!!float", "null", "~", "[]", "{}", "? ", "- ", ": ", "|", ">",
    "nan", ".nan", ".inf", "1e400", "1e308 m", "-1 s", "0 Hz", "auto", "plugin: mesh", "file: ../../x", "2001-01-01",
    "a: &a [*a, *a]", "!!binary aGk=", "0x7fffffffffffffff", "999999999999999999", "1 kg/m^3", "1 m**1e9", "%YAML 1.1",
    "---", "...", "yes", "1:30", "'", '"', "#", "\t", "size: [1e300 m, 1 m]", "resolution: [1000000, 1000000]",
)  # fmt: skip


@cache
def recorded() -> tuple[bytes, ...]:
    """Short recordings: of cloth that falls beside a ball, and of cloth that is dyed."""
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        for scene in (CLOTH, DYED):
            nuno.run(scene, record=Path(folder) / f"{scene['name']}.mcap")
        return tuple((Path(folder) / f"{scene['name']}.mcap").read_bytes() for scene in (CLOTH, DYED))


def _recording(folder: Path) -> Read:
    path = folder / "input.mcap"

    def read(data: bytes) -> None:
        path.write_bytes(data)
        with Recording(path) as recording:
            parts = PARTS if zlib.crc32(data) % SELDOM == 0 else PARTS[:-1]
            refused = []
            for part in parts:
                try:
                    part(recording)
                except BadInput as error:  # the others must still say what they can
                    refused.append(error)
        if refused:
            raise refused[0]

    return read


def _frames(recording: Recording) -> None:
    for frame in recording.frames():
        require(frame.x.ndim == 2 and frame.x.shape[1] == 3, "positions (n, 3)")


def _restored(recording: Recording) -> None:
    with restored_scene(recording) as loaded:
        require(loaded.scene.frames >= 0, "a scene of frames")


PARTS: tuple[Any, ...] = (
    lambda recording: [(m.topic, m.t, len(m.payload)) for m in recording.messages()],
    lambda recording: (recording.complete, recording.counts, recording.span, recording.missing, recording.attachments),
    _frames,
    lambda recording: recording.series(),
    lambda recording: list(recording.checkpoints()),
    lambda recording: list(recording.checkpoints(DYE_CHECKPOINT.name)),
    lambda recording: recording.common_checkpoint(),
    lambda recording: (recording.report(), recording.poses(), recording.geometry()),
    lambda recording: None if recording.dyed_alone else read_pieces(recording),
    read_bodies,
    control_events,
    lambda recording: [recording.attachment(name) for name in recording.attachments],
    _restored,
)


def _mutate(data: bytes, random: Random) -> bytes:
    return forge(data, random) if random.random() < 0.3 else RECORDING.mutate(data, random)


def _scenes(folder: Path) -> list[bytes]:
    """Short ones that come with nuno and need no files, and one with an anchor."""
    found = [
        b"nuno: 1\nname: a\nduration: &a 1 s\nuntil: rest\nrecord: {checkpoint_every: *a}\n"
        b"forces: [{plugin: wind, velocity: [1 m/s, 0, 0]}]\n"
    ]
    for path in shipped.scenes().values():
        text = path.read_bytes()
        if len(text) <= MOST_SCENE and b"file:" not in text:
            found.append(text)
    return found


def _scene(folder: Path) -> Read:
    path = folder / "input.yaml"

    def read(data: bytes) -> None:
        path.write_bytes(data)
        scene = scene_file.read(path).scene
        require(math.isfinite(scene.duration) and scene.duration >= 0, "a duration")
        require(scene.frames >= 0, "a number of frames")

    return read


RECORDINGS = (
    Kind("scene YAML", _scenes, _scene, lambda data, random: mutate_text(data, random, WORDS),
         ("nuno.scene", "nuno_schemas")),
    Kind("MCAP", lambda folder: list(recorded()), _recording, _mutate,
         ("nuno.recording", "nuno.bus.encodings", "mcap", "nuno.exports.cloth", "nuno.collision.messages"),
         longest=80_000),
)  # fmt: skip
