"""A made-up run for the viewer's tests: a waving sheet over a capsule on a plane."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import encode_arrays, encode_points
from nuno.collision.messages import encode_geometry, encode_poses
from nuno_schemas.bodies import CAPSULE, PLANE, Geometry, Poses
from nuno_schemas.messages import (
    BODIES,
    EVENT,
    FABRIC,
    GEOMETRY,
    PENETRATION,
    STATE,
    STATUS,
    Event,
    Penetration,
    Status,
)

Fed = tuple[str, int, float, bytes]
RATE = 60.0


def sheet(cols: int, rows: int) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
    """Grid points in [0, 1] (n, 2), faces and structural edges."""
    v, u = np.meshgrid(np.linspace(1, 0, rows), np.linspace(0, 1, cols), indexing="ij")
    at = np.arange(cols * rows, dtype=np.int32).reshape(rows, cols)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    across = np.stack([at[:, :-1].ravel(), at[:, 1:].ravel()], 1)
    down = np.stack([at[:-1].ravel(), at[1:].ravel()], 1)
    return np.stack([u.ravel(), v.ravel()], 1), faces, np.concatenate([across, down])


def wave(uv: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """(n, 3) positions [m] of a sheet of 1.2 m by 0.9 m that hangs and waves."""
    u, v = uv.T
    z = 0.12 * (1 - v) * np.sin(7.0 * u + 2.0 * v - 4.0 * t)
    return np.stack([1.2 * (u - 0.5), 0.4 + 0.9 * v, z], 1)


def fabric(uv: NDArray[np.float64], faces: NDArray[np.int32], edges: NDArray[np.int32], **spec: object) -> bytes:
    flat = wave(uv, 0.0) * np.array([1.0, 1.0, 0.0])
    rest = np.linalg.norm(flat[edges[:, 0]] - flat[edges[:, 1]], axis=1)
    arrays = {"faces": faces, "edges": edges, "edge_rest": rest.astype(np.float32)}
    arrays |= {"pinned": uv[:, 1] == 1.0, "uv": uv.astype(np.float32)}
    piece = {"name": "sheet", "start": 0, "stop": len(uv), "texture": None, "colour": None} | spec
    return encode_arrays(arrays, {"vertices": len(uv), "scene": "waving-sheet", "objects": [piece]})


def bodies() -> Geometry:
    """A floor, and a capsule that swings."""
    ends = np.array([[0.0, 0.0, 0.0], [-0.3, 0.0, 0.0]])
    tips = np.array([[0.0, 1.0, 0.0], [0.3, 0.0, 0.0]])
    one = np.ones(2)
    kind, frame = np.array([PLANE, CAPSULE], np.int8), np.array([0, 1], np.int32)
    return Geometry(
        ("floor", "bar"), ("floor/root", "bar/root"), kind, frame, frame, ends, tips, np.array([0, 0.12]), one, one, one
    )


def poses(t: float) -> Poses:
    half = 0.4 * np.sin(2.0 * t)
    turn = np.array([[1.0, 0, 0, 0], [np.cos(half), 0, np.sin(half), 0]])
    return Poses(t, turn, np.array([[0.0, 0, 0], [0.3, 0.25, 0.35]]))


def messages(frames: int, cols: int = 64, rows: int = 48, **spec: object) -> Iterator[Fed]:
    """All messages of a run, in order."""
    uv, faces, edges = sheet(cols, rows)
    yield GEOMETRY.name, -1, 0.0, encode_geometry(bodies())
    yield FABRIC.name, 0, 0.0, fabric(uv, faces, edges, **spec)
    for frame in range(frames):
        t = frame / RATE
        yield BODIES.name, frame, t, encode_poses(poses(t), frame)
        yield STATE.name, frame, t, encode_points(wave(uv, t), t)
        energy = {"kinetic": 0.2 * np.cos(t) ** 2, "gravitational": 0.4 - 0.1 * t, "springs": 0.1 * np.sin(t) ** 2}
        fields = {
            "frame": frame,
            "t": t,
            "digest": "",
            "state": "running",
            "steps": 20,
            "stretch": 0.1,
            "energy": energy,
        }
        status = Status.model_validate(fields | {"step_seconds": 0.006 + 0.001 * np.sin(9 * t)})
        yield STATUS.name, frame, t, status.model_dump_json().encode()
        depth = Penetration(frame=frame, t=t, depth=2e-4, vertex=3, inside=5, mean=5e-5, seconds=0.001)
        yield PENETRATION.name, frame, t, depth.model_dump_json().encode()
    end = Event(frame=-1, t=0.0, service="simulation", kind="end", text="done")
    yield f"{EVENT.name}/simulation", -1, 0.0, end.model_dump_json().encode()
