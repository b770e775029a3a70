"""Bodies in rerun: one mesh per frame of the skeleton, moved by transforms; and skins with moving vertices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from nuno.bus.encodings import BadMessage
from nuno.collision.bodies import NO_SURFACES, Surfaces, surface, vertex_normals
from nuno.exports.paint import BODY, INSET
from nuno.viewer import layout
from nuno.viewer.cloth import pack
from nuno_schemas.bodies import PLANE, SKIN, Geometry, Poses
from nuno_schemas.colour import parse_hex
from nuno_schemas.fabric import Float

GROUND = "#d3d6d9"


class BodiesView:
    """Logs a scene's bodies: meshes at once, poses and vertices of skins in batches.

    recording  the rerun stream
    geometry   shapes of the bodies
    batch      number of poses that are logged together: rerun takes 0.1 ms for a call, and
               a skeleton has dozens of frames

    Raises BadMessage for an inconsistent geometry.
    """

    def __init__(self, recording: Any, geometry: Geometry, batch: int) -> None:
        number = len(geometry.frames)
        if len(geometry.frame) and not (geometry.frame.min() >= 0 and geometry.frame.max() < number):
            raise BadMessage(f"a primitive of a frame that is not among the {number}")
        self.recording, self.batch = recording, batch
        self.paths = [layout.entity("world", "bodies", *name.split("/", 1)) for name in geometry.frames]
        rigid = geometry.of_primitives(np.flatnonzero(geometry.kind != SKIN).tolist())
        self.skins = [SkinView(recording, geometry, i) for i in np.flatnonzero(geometry.kind == SKIN).tolist()]
        shown = surface(rigid, INSET)
        vertices, faces, frames = shown.vertices, shown.faces, shown.frame
        for frame, path in enumerate(self.paths):
            part = frames == frame
            if part.any():
                triangles = (np.cumsum(part) - 1)[faces[part[faces[:, 0]]]]
                colour = GROUND if (rigid.kind[rigid.frame == frame] == PLANE).all() else BODY
                recording.log(path, solid(vertices[part], triangles, colour), static=True, strict=True)
        self.ground = bool((rigid.kind == PLANE).any())
        """Whether any of them is a plane, which is drawn as the ground."""
        # Planes are infinite, and are not fitted into view.
        finite = ~np.isin(frames, rigid.frame[rigid.kind == PLANE])
        self._finite = Surfaces(vertices[finite], NO_SURFACES.faces, frames[finite])
        self._last: Poses | None = None
        self._shown: Poses | None = None
        self._waiting: list[tuple[int, Poses]] = []

    def points(self) -> Float:
        """Return the present vertices of the bodies, shape (n, 3) [m], without planes; empty before the first poses."""
        if (last := self._last) is None:
            return NO_SURFACES.vertices
        return np.concatenate([self._finite.at(last), *(skin.at(last) for skin in self.skins)])

    def move(self, frame: int, poses: Poses) -> None:
        """Set the poses of a frame. Raises BadMessage for a wrong number of poses."""
        if len(poses.rotation) != len(self.paths):
            raise BadMessage(f"{len(poses.rotation)} poses for {len(self.paths)} frames")
        self._last = poses
        self._waiting.append((frame, poses))
        if len(self._waiting) >= self.batch:
            self.flush()

    def flush(self) -> None:
        """Log the waiting poses, of each body only those in which it has moved."""
        if not self._waiting:
            return
        numbers = np.array([frame for frame, _ in self._waiting])
        times = np.array([poses.t for _, poses in self._waiting])

        def index(rows: NDArray[Any]) -> list[Any]:
            frame = rr.TimeColumn("frame", sequence=numbers[rows])
            return [frame, rr.TimeColumn(layout.TIMELINE, duration=times[rows])]

        pose = np.array([np.hstack([p.rotation, p.translation]) for _, p in self._waiting])
        shown = self._shown
        first = (
            np.full_like(pose[:1], np.nan) if shown is None else np.hstack([shown.rotation, shown.translation])[None]
        )
        moved = (np.diff(pose, axis=0, prepend=first) != 0.0).any(axis=2)
        for i, path in enumerate(self.paths):
            rows = moved[:, i]
            if rows.any():
                turn, shift = pose[rows, i, :4][:, [1, 2, 3, 0]], pose[rows, i, 4:]
                columns = rr.Transform3D.columns(translation=shift, quaternion=turn)
                self.recording.send_columns(path, index(rows), columns, strict=True)
        changed = np.flatnonzero(moved.any(axis=1))
        for skin in self.skins if len(changed) else ():
            skin.log(index(changed), [self._waiting[i][1] for i in changed])
        self._shown = self._waiting[-1][1]
        self._waiting = []


class SkinView:
    """Logs a skin's triangles at once, and its vertices in batches.

    recording  the rerun stream
    geometry   shapes of the bodies, with the skin `primitive`
    """

    def __init__(self, recording: Any, geometry: Geometry, primitive: int) -> None:
        self.recording, self.geometry, self.primitive = recording, geometry, primitive
        self.faces = geometry.mesh(primitive)[1]
        self.path = layout.entity("world", "bodies", geometry.bodies[geometry.body[primitive]], "skin")
        mesh = rr.Mesh3D.from_fields(
            triangle_indices=self.faces.astype(np.uint32), albedo_factor=int(pack(parse_hex(BODY))[0])
        )
        recording.log(self.path, mesh, static=True, strict=True)

    def at(self, poses: Poses) -> Float:
        """Return its vertices, shape (n, 3) [m]."""
        return self.geometry.placed(self.primitive, poses)[0]

    def log(self, index: list[Any], poses: Sequence[Poses]) -> None:
        """Log its vertices at the times of `index`."""
        placed = [self.at(moment) for moment in poses]
        columns = rr.Mesh3D.columns(
            vertex_positions=np.concatenate(placed).astype(np.float32),
            vertex_normals=np.concatenate([vertex_normals(x, self.faces) for x in placed]).astype(np.float32),
        )
        sizes = [len(x) for x in placed]
        self.recording.send_columns(self.path, index, columns.partition(sizes), strict=True)


def solid(vertices: Float, faces: NDArray[Any], colour: str) -> Any:
    """Return a smoothly shaded mesh with sharp edges: if the normals of a face and its vertex differ
    by more than 40 degrees, that of the face is used, so that boxes have edges.
    """
    corners = vertices[faces].reshape(-1, 3)
    unshared = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    flat = vertex_normals(corners, unshared)
    smooth = vertex_normals(vertices, faces)[faces].reshape(-1, 3)
    near = (smooth * flat).sum(axis=1, keepdims=True) > np.cos(np.radians(40.0))
    return rr.Mesh3D(
        vertex_positions=corners.astype(np.float32),
        triangle_indices=unshared,
        vertex_normals=np.where(near, smooth, flat).astype(np.float32),
        albedo_factor=int(pack(parse_hex(colour))[0]),
    )
