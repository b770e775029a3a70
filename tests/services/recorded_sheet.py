"""A synthetic recording: a sheet that waves over a moving capsule, written without a simulation."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nuno.bus.encodings import encode_arrays, encode_points
from nuno.collision.messages import encode_geometry, encode_poses
from nuno.recording.reader import END
from nuno.recording.writer import RecordingWriter
from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.bodies import CAPSULE, Geometry, Poses
from nuno_schemas.fabric import Float
from nuno_schemas.messages import (
    BODIES,
    CHECKPOINT,
    FABRIC,
    GEOMETRY,
    PENETRATION,
    REPORT,
    STATE,
    STATUS,
    Event,
    Header,
    Penetration,
    Status,
)

RATE = 50.0
REPORT_TEXT = {"scene": "waving", "energy": {"start": 1.0, "end": 0.5}, "state": "done"}
Item = tuple[str, Header, bytes]


class Sheet:
    """rows x cols vertices of a unit square, hanging in the plane z = 0."""

    def __init__(self, rows: int = 6, cols: int = 5) -> None:
        self.rows, self.cols, self.number = rows, cols, rows * cols
        v, u = (a.ravel() for a in np.meshgrid(np.linspace(1, 0, rows), np.linspace(0, 1, cols), indexing="ij"))
        self.uv = np.stack([u, v], axis=1).astype(np.float32)
        self.rest = np.stack([u, v, 0 * u], axis=1)
        index = np.arange(self.number).reshape(rows, cols)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        self.faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))]).astype(
            np.int32
        )
        across, down = np.stack([index[:, :-1], index[:, 1:]], -1), np.stack([index[:-1], index[1:]], -1)
        self.edges = np.concatenate([across.reshape(-1, 2), down.reshape(-1, 2)]).astype(np.int32)
        ends = self.rest[self.edges]
        self.edge_rest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).astype(np.float32)

    def x(self, t: float) -> Float:
        wave = 0.1 * np.sin(4.0 * self.rest[:, 1] + 6.0 * t)
        return np.ascontiguousarray(self.rest + wave[:, None] * np.array([0.0, 0.0, 1.0]))

    def v(self, t: float) -> Float:
        wave = 0.6 * np.cos(4.0 * self.rest[:, 1] + 6.0 * t)
        return np.ascontiguousarray(wave[:, None] * np.array([0.0, 0.0, 1.0]))


GEOMETRY_VALUE = Geometry(
    ("ball",), ("ball/world",), np.array([CAPSULE], np.int8), np.zeros(1, np.int32), np.zeros(1, np.int32),
    np.array([[0.3, 0.3, -0.4]]), np.array([[0.7, 0.3, -0.4]]), np.array([0.2]),
    np.array([np.nan]), np.array([0.5]), np.array([0.3]),
)  # fmt: skip


def poses(t: float) -> Poses:
    return Poses(t, np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, 0.1 * t, 0.0]]))


def _header(seq: int, frame: int, t: float, digest: str = "") -> Header:
    return Header(run="waving-run", service="simulation", seq=seq, frame=frame, t=t, digest=digest)


def status(frame: int, t: float) -> Status:
    return Status(
        frame=frame, t=t, digest=f"digest-{frame}", state="running", steps=10, step_seconds=0.001,
        energy={"kinetic": 0.5 + t, "springs": 0.25}, stretch=0.01 * frame,
    )  # fmt: skip


def items(sheet: Sheet, frames: int, checkpoint_every: int = 10, texture: str | None = None) -> Iterator[Item]:
    """The messages of a run, in order."""
    arrays = {"faces": sheet.faces, "edges": sheet.edges, "edge_rest": sheet.edge_rest, "uv": sheet.uv}
    arrays["pinned"] = np.arange(sheet.number) < sheet.cols
    piece = {"name": "cloth", "start": 0, "stop": sheet.number, "texture": texture, "colour": None}
    yield FABRIC.name, _header(0, 0, 0.0), encode_arrays(arrays, {"vertices": sheet.number, "objects": [piece]})
    yield GEOMETRY.name, _header(0, -1, 0.0), encode_geometry(GEOMETRY_VALUE)
    for frame in range(frames):
        t, digest = frame / RATE, f"digest-{frame}"
        yield BODIES.name, _header(frame, frame, t), encode_poses(poses(t), frame)
        yield STATE.name, _header(frame, frame, t, digest), encode_points(sheet.x(t), t)
        yield STATUS.name, _header(frame, frame, t, digest), status(frame, t).model_dump_json().encode()
        deep = Penetration(frame=frame, t=t, depth=1e-4 * frame, vertex=2, inside=3, mean=5e-5 * frame, seconds=0.0)
        yield PENETRATION.name, _header(frame, frame, t), deep.model_dump_json().encode()
        if frame % checkpoint_every == checkpoint_every - 1 or frame == frames - 1:
            state = {"x": sheet.x(t), "v": sheet.v(t), "memory/anchor": np.full((sheet.number, 3), float(frame))}
            text = {"t": t, "frame": frame, "digest": digest, "dt": 0.002, "steps": 10}
            yield CHECKPOINT.name, _header(frame // checkpoint_every, frame, t, digest), encode_arrays(state, text)
    end = Event(frame=frames - 1, t=t, service="simulation", kind="end", text="done")
    yield "run/event/simulation", _header(0, frames - 1, t), end.model_dump_json().encode()
    yield REPORT.name, _header(0, -1, 0.0), json.dumps(REPORT_TEXT).encode()


def metadata(scene: dict[str, Any] | None = None) -> dict[str, dict[str, str]]:
    run = {"id": "waving-run", "seed": "7", "schema_version": str(SCHEMA_VERSION)}
    return {"run": run, "scene": {"json": json.dumps(scene or {"name": "waving"})}}


def write(
    path: Path,
    sheet: Sheet,
    frames: int = 20,
    attachments: dict[str, bytes] | None = None,
    scene: dict[str, Any] | None = None,
    **options: Any,
) -> list[Item]:
    """Write a finished recording; the messages in it."""
    messages = list(items(sheet, frames, **options))
    usual = {"name": "waving", "objects": [{"name": "cloth", "model": {"texture": "check.png"}}]}
    writer = RecordingWriter(path, metadata(scene or usual), attachments or {})
    for topic, header, payload in messages:
        writer.write(topic, header, payload)
    writer.finish({END: {"state": "done", "complete": "true", "missing": "{}"}})
    return messages
