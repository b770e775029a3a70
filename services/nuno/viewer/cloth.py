"""Cloth and bodies in rerun: shaded meshes, the springs and masses of a net, skins with moving vertices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.blueprint.encodings import ComponentSourceKind as Source
from rerun.blueprint.encodings import VisualizerComponentMapping as Mapped

from nuno.bus.encodings import BadMessage, origin_of
from nuno.collision.bodies import NO_SURFACES, Surfaces, surface, vertex_normals
from nuno.exports.cloth import BODY, PLAIN, ShownPiece, paint_yarns
from nuno.viewer import layout
from nuno.viewer.fields import Scale, mean_curvature, pack
from nuno_schemas.bodies import PLANE, SKIN, Geometry, Poses
from nuno_schemas.colour import parse_hex, read_rgb
from nuno_schemas.fabric import Float

SPRING_WIDTH, MASS_SIZE = -2.0, -4.5
"""Radii; negative ones are in pixels on the screen."""
CROSSING_SIZE = -2.5
"""Radius of masses in nets of yarns: larger ones hide the links of a dense knit."""
MESH, LINKS = "Mesh3D", "LineStrips3D"
WHITE = 0xFFFFFFFF
TEXTURE = ("albedo_texture_buffer", "albedo_texture_format")

ReadImage = Callable[[str], NDArray[np.uint8] | None]


def read_image(path: str) -> NDArray[np.uint8] | None:
    """Return (h, w, 3) sRGB of an image file, or None if it cannot be read."""
    try:
        return read_rgb(Path(path))
    except (OSError, ValueError):
        return None


class Cloth:
    """Logs one object of a scene below `path`: its own look, and colours by fields, which views choose.

    recording  the rerun stream
    scales     colour scales of fields, by name; they grow with the values
    dyed       whether its texture changes with the frames
    """

    def __init__(
        self,
        recording: Any,
        path: str,
        piece: ShownPiece,
        images: ReadImage,
        scales: Mapping[str, Scale],
        dyed: bool = False,
    ) -> None:
        self.recording, self.path, self.piece, self.scales = recording, path, piece, scales
        self.dyed = dyed and piece.laid_out is not None
        named = piece.texture if not self.dyed else None
        image = images(named) if named and piece.laid_out is not None else None
        self.split = piece.laid_out if image is not None or self.dyed else None
        self.untextured = bool(named) and image is None
        self.meshed = len(piece.faces) > 0
        self._log_static(piece, image)

    def coloured_by(self, field: str) -> tuple[str, Any]:
        """Return the path of what a view colours by a field, and how: colours of the field in the place of its own, and
        for a mesh without its texture and its colour.
        """
        what = MESH if self.meshed else LINKS
        target = f"{what}:vertex_colors" if self.meshed else f"{what}:colors"
        mappings = [Mapped(target, Source.SourceComponent, source_component=f"{field}:colors")]
        if not self.meshed:
            return f"{self.path}/springs", rr.LineStrips3D.from_fields().visualizer(mappings=mappings)
        mappings += [Mapped(f"{what}:{name}", Source.Default) for name in TEXTURE]
        mappings.append(Mapped(f"{what}:albedo_factor", Source.Override))
        return self.path, rr.Mesh3D.from_fields(albedo_factor=WHITE).visualizer(mappings=mappings)

    def _log_static(self, piece: ShownPiece, image: NDArray[np.uint8] | None) -> None:
        colour = pack(parse_hex(piece.colour or PLAIN))
        if not self.meshed:
            points = np.where(piece.pinned, pack(parse_hex("#c0392b")), pack(parse_hex("#34495e")))
            size = MASS_SIZE if piece.yarns is None else CROSSING_SIZE
            self._log("masses", rr.Points3D.from_fields(colors=points.astype(np.uint32), radii=size), static=True)
            if piece.yarns is not None and not piece.colour:
                colour = pack(paint_yarns(piece.yarns))
            self._log("springs", rr.LineStrips3D.from_fields(radii=SPRING_WIDTH, colors=colour), static=True)
            return
        faces = piece.faces if self.split is None else self.split.faces
        self._log("", rr.Mesh3D.from_fields(triangle_indices=faces.astype(np.uint32)), static=True)
        if self.split is not None:
            self._log("", rr.Mesh3D.from_fields(vertex_texcoords=self.split.in_image), static=True)
        if image is not None:
            self._log("", texture_of(image), static=True)
        elif not self.dyed:
            self._log("", rr.Mesh3D.from_fields(albedo_factor=int(colour[0])), static=True)

    def clear(self) -> None:
        """Hide the cloth from now on, since other cloth replaces it."""
        for below in ("",) if self.meshed else ("masses", "springs"):
            self._log(below, rr.Clear(recursive=False))

    def log_texture(self, image: NDArray[np.uint8]) -> None:
        """Set the texture (h, w, 3) sRGB of dyed cloth from now on."""
        self._log("", texture_of(image))

    def log(self, positions: NDArray[np.float64]) -> None:
        """Log one frame, positions (n, 3) [m] of all objects.

        rerun's positions are float32 about the world's origin; normals and fields use an origin near the cloth.
        """
        piece = self.piece
        part = positions[piece.start : piece.stop]
        x, near = np.ascontiguousarray(part, np.float32), part - origin_of(part)
        if self.meshed:
            unit: Float | None = vertex_normals(near, piece.faces)
            normals = np.asarray(unit).astype(np.float32)
            if self.split is not None:  # normals of whole vertices, so that seams are shaded smoothly
                x, normals = x[self.split.vertex], normals[self.split.vertex]
            self._log("", rr.Mesh3D.from_fields(vertex_positions=x, vertex_normals=normals))
        else:
            unit = None
            self._log("masses", rr.Points3D.from_fields(positions=x))
            self._log("springs", rr.LineStrips3D.from_fields(strips=segments(x, piece.edges)))
        for name, values in field_values(piece, near, normals=unit):
            self.log_field(name, values)

    def log_field(self, name: str, values: Float) -> None:
        """Log the colours of a field's values [SI] at vertices, of a net at its links, as component NAME:colors."""
        scale = self.scales[name]
        if scale.widen(values):
            self.recording.log(layout.legend(name), rr.Image(scale.legend()), strict=True)
        if self.split is not None:
            values = values[self.split.vertex]
        colours = rr.components.ColorBatch(scale.paint(values))
        self._log("" if self.meshed else "springs", rr.DynamicArchetype(name, components={"colors": colours}))

    def _log(self, below: str, what: Any, static: bool = False) -> None:
        self.recording.log(f"{self.path}/{below}" if below else self.path, what, static=static, strict=True)


def fields_of(piece: ShownPiece) -> list[str]:
    """Return the names of the fields of a piece that follow from positions."""
    kinds = {"stretch": len(piece.edges) > 0, "curvature": len(piece.faces) > 0}
    kinds["tension"] = not len(piece.faces) and piece.tensions is not None
    return [name for name, there in kinds.items() if there]


def field_values(piece: ShownPiece, x: Float, normals: Float | None = None) -> Iterator[tuple[str, Float]]:
    """Yield each of `fields_of` with its values [SI] at vertices x (n, 3) [m], of a net at its links; `normals` of the
    vertices (n, 3) if they are known.
    """
    for name in fields_of(piece):
        if name == "curvature":
            unit = vertex_normals(x, piece.faces) if normals is None else normals
            yield name, mean_curvature(x, piece.faces, unit)
        elif len(piece.faces):
            yield name, piece.stretch(x)
        else:
            stretch = piece.link_stretch(x)
            yield name, stretch if name == "stretch" or piece.tensions is None else piece.tensions(stretch)


def texture_of(image: NDArray[np.uint8]) -> Any:
    """Return the texture (h, w, 3) sRGB of a mesh."""
    shape = rr.components.ImageFormat(
        width=image.shape[1],
        height=image.shape[0],
        color_model=rr.ColorModel.RGB,
        channel_datatype=rr.ChannelDatatype.U8,
    )
    return rr.Mesh3D.from_fields(albedo_texture_buffer=image.tobytes(), albedo_texture_format=shape)


def segments(x: NDArray[np.float32], edges: NDArray[np.int32]) -> Any:
    """Return line strips of two points each, built as arrow arrays: rerun's API loops over strips in Python."""
    import pyarrow as pa

    kind = rr.components.LineStrip3DBatch._ARROW_DATATYPE
    points = pa.FixedSizeListArray.from_arrays(pa.array(x[edges].reshape(-1)), type=kind.value_type)
    offsets = pa.array(np.arange(0, 2 * len(edges) + 1, 2, dtype=np.int32))
    return pa.ListArray.from_arrays(offsets, points, type=kind)


# Bodies in rerun: one mesh per frame of the skeleton, moved by transforms; and skins with moving vertices.

GROUND = "#d3d6d9"


class BodiesView:
    """Logs a scene's bodies: meshes at once, poses and vertices of skins in batches.

    entities  where they are
    geometry  shapes of the bodies
    batch     number of poses that are logged together: rerun takes 0.1 ms for a call, and
              a skeleton has dozens of frames

    Raises BadMessage for an inconsistent geometry.
    """

    def __init__(self, entities: layout.Entities, geometry: Geometry, batch: int) -> None:
        self.number = number = len(geometry.frames)
        if len(geometry.frame) and not (geometry.frame.min() >= 0 and geometry.frame.max() < number):
            raise BadMessage(f"a primitive of a frame that is not among the {number}")
        self.recording, self.batch = entities.recording, batch
        self.own = geometry.own_frames
        self.paths = [entities.world("bodies", *geometry.frames[i].split("/", 1)) for i in self.own.tolist()]
        rigid = geometry.of_primitives(np.flatnonzero(geometry.kind != SKIN).tolist())
        self.skins = [SkinView(entities, geometry, i) for i in np.flatnonzero(geometry.kind == SKIN).tolist()]
        shown = surface(rigid)
        vertices, faces, frames = shown.vertices, shown.faces, shown.frame
        for frame, path in zip(self.own.tolist(), self.paths, strict=True):
            part = frames == frame
            if part.any():
                triangles = (np.cumsum(part) - 1)[faces[part[faces[:, 0]]]]
                colour = GROUND if (rigid.kind[rigid.frame == frame] == PLANE).all() else BODY
                entities.log(path, solid(vertices[part], triangles, colour), static=True)
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
        if len(poses.rotation) != self.number:
            raise BadMessage(f"{len(poses.rotation)} poses for {self.number} frames")
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

        all_poses: list[Poses | None] = [self._shown, *(poses for _, poses in self._waiting)]
        pose = np.array([
            np.full((len(self.own), 7), np.nan) if p is None
            else np.hstack([p.rotation[self.own], p.translation[self.own]]) for p in all_poses
        ])  # fmt: skip
        moved, pose = (np.diff(pose, axis=0) != 0.0).any(axis=2), pose[1:]
        for i, path in enumerate(self.paths):
            rows = moved[:, i]
            if rows.any():
                turn, shift = pose[rows, i, :4][:, [1, 2, 3, 0]], pose[rows, i, 4:]
                columns = rr.Transform3D.columns(translation=shift, quaternion=turn)
                self.recording.send_columns(path, index(rows), columns, strict=True)
        changed = np.flatnonzero([a is None or not b.same_place(a) for a, b in pairwise(all_poses) if b is not None])
        for skin in self.skins if len(changed) else ():
            skin.log(index(changed), [self._waiting[i][1] for i in changed])
        self._shown = self._waiting[-1][1]
        self._waiting = []


class SkinView:
    """Logs a skin's triangles at once, and its vertices in batches.

    entities  where it is
    geometry  shapes of the bodies, with the skin `primitive`
    """

    def __init__(self, entities: layout.Entities, geometry: Geometry, primitive: int) -> None:
        self.recording, self.geometry, self.primitive = entities.recording, geometry, primitive
        self.faces = geometry.mesh(primitive)[1]
        self.path = entities.world("bodies", geometry.bodies[geometry.body[primitive]], "skin")
        mesh = rr.Mesh3D.from_fields(
            triangle_indices=self.faces.astype(np.uint32), albedo_factor=int(pack(parse_hex(BODY))[0])
        )
        entities.log(self.path, mesh, static=True)

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
