"""Export of frames as OBJ, PLY and glTF files; and a recording as coloured shapes in moving frames."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import BadMessage, decode_arrays, origin_of
from nuno.collision.bodies import Surfaces, vertex_normals
from nuno.collision.messages import decode_geometry, decode_poses
from nuno.exports.cloth import (
    BODY,
    PLAIN,
    Pieces,
    ShownBodies,
    ShownPiece,
    body_vertices,
    check_size,
    colour_of,
    cut_pieces,
    paint_stretch,
    paint_yarns,
    read_bodies,
    read_frame,
    read_pieces,
    read_texture,
    shape_bodies,
)
from nuno.output_files import Progress, following, make_folder, together, writing
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import Frame, Recorded
from nuno_schemas.bodies import Geometry, Poses, Skin
from nuno_schemas.colour import parse_hex, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Corners, Float, Int
from nuno_schemas.messages import BODIES, CONCENTRATION, FABRIC, GEOMETRY, STATE
from nuno_schemas.messages import CLOTH as CLOTH_CELLS

if TYPE_CHECKING:  # a scene without dye loads no module of it
    from nuno.exports.dyed_pictures import DyedPictures

MATT = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
"""Properties of glTF's materials."""


def export_mesh(source: Recording | Path | str, path: Path, frame: int | None = None) -> Path:
    """Write one frame (default: the last) of the cloth, in the format of the name's ending.

    .obj and .ply hold the cloth: positions [m] with all their digits, faces, texture coordinates. .glb also
    holds the bodies, the texture images and colours; its positions, float32 by the format, are about an origin to
    which its nodes are moved. Raises BadInput for another ending, a missing frame or one that is not finite, or a file
    that cannot be written.
    """
    from nuno.exports.dyed_pictures import read_dyed_object

    suffix = _known(path.suffix.lower(), path)
    with opened(source) as recording:
        shown = read_frame(recording, frame)
        dyed = read_dyed_object(recording) if suffix == ".glb" else None
        _write(path, suffix, recording, read_pieces(recording, shown.t), dyed, shown)
    return path


def export_meshes(
    source: Recording | Path | str, folder: Path, suffix: str, progress: Progress | None = None
) -> list[Path]:
    """Write every frame into a folder, made if it is missing: frame_00000.obj, and so on.

    Raises the errors of `export_mesh`, and BadInput where the folder has frames that would not be replaced: it would
    mix two recordings.
    """
    from nuno.exports.dyed_pictures import read_dyed_object

    _known(suffix, folder)
    written, name = [], f"frame_{{:05d}}{suffix}"
    with together(), opened(source) as recording:
        there = {path.name for path in folder.glob(f"frame_*{suffix}")}
        if left := sorted(there and there - {name.format(frame.number) for frame in recording.frames()}):
            problem, remedy = "frames of another recording would stay there", "choose another folder, or empty it"
            raise BadInput(problem, field=f"--{suffix[1:]}", value=str(folder / left[0]), remedy=remedy)
        make_folder(folder)
        cloth, number = Pieces(recording), recording.counts.get("sim/state", 0)
        dyed = read_dyed_object(recording) if suffix == ".glb" else None
        for frame in following(recording.frames(), number, progress):
            path = folder / name.format(frame.number)
            _write(path, suffix, recording, cloth.at(frame.t), dyed, frame)
            written.append(path)
    return written


def _known(suffix: str, path: Path) -> str:
    if suffix not in (".obj", ".ply", ".glb"):
        remedy = "change the ending"
        raise BadInput("no such kind of mesh file", value=str(path), limit=".obj, .ply, .glb", remedy=remedy)
    return suffix


def _write(
    path: Path, suffix: str, recording: Recording, pieces: list[ShownPiece], dyed: DyedPictures | None, frame: Frame
) -> None:
    check_size(recording, pieces, frame, finite=True)
    with writing(path, suffix) as new, new.open("wb") as stream:
        if suffix == ".obj":
            _write_obj(stream, pieces, frame)
        elif suffix == ".ply":
            _write_ply(stream, pieces, frame)
        else:
            stream.write(_glb(recording, pieces if dyed is None else dyed.dress(pieces, frame.t), frame))


def _write_obj(stream: BinaryIO, pieces: list[ShownPiece], frame: Frame) -> None:
    """Write one object per piece, and one group per panel, with enough digits to restore every float64.

    OBJ counts from 1 over all pieces.
    """
    stream.write(f"# nuno frame {frame.number} at {frame.t!r} s\n".encode())
    written = 1
    for piece in pieces:
        x = frame.x[piece.start : piece.stop]
        lines = [f"o {piece.name}", *("v {!r} {!r} {!r}".format(*row) for row in x.tolist())]
        corners = piece.faces + piece.start + 1
        if (laid := piece.laid_out) is not None:
            lines += ["vt {:.9g} {:.9g}".format(*row) for row in laid.points.tolist()]
            both = np.stack([corners, laid.faces + written], axis=2).reshape(-1, 6)
            rows = ["f {}/{} {}/{} {}/{}".format(*row) for row in both.tolist()]
            for name, first, stop in panel_runs(piece):
                lines += [f"g {'_'.join(name.split())}"] if name else []
                lines += rows[first:stop]
            written += len(laid.points)
        else:
            lines += ["f {} {} {}".format(*row) for row in corners.tolist()]
        stream.write(("\n".join(lines) + "\n").encode())


def panel_runs(piece: ShownPiece) -> list[tuple[str, int, int]]:
    """Return the runs of triangles of one panel: its name, the first, and the end; "" for no panel."""
    panels = None if piece.corners is None else piece.corners.panels
    if panels is None:
        return [("", 0, len(piece.faces))]
    ends = [0, *(np.flatnonzero(np.diff(panels.of)) + 1).tolist(), len(panels.of)]
    names = (*panels.names, "")
    return [(names[panels.of[first]], first, stop) for first, stop in pairwise(ends)]


def _write_ply(stream: BinaryIO, pieces: list[ShownPiece], frame: Frame) -> None:
    """Write binary PLY, all pieces as one mesh, positions as double, texture coordinates as s and t.

    If vertices have several, along seams, these are lists per face, so that seams stay closed.
    """
    faces = np.concatenate([np.zeros((0, 3), np.int32), *(piece.faces + piece.start for piece in pieces)])
    uvs = [piece.uv for piece in pieces if piece.uv is not None and not piece.seamed]
    laid = [piece.laid_out for piece in pieces if piece.laid_out is not None]
    cut = len(laid) == len(pieces) > len(uvs)
    textured = len(uvs) == len(pieces) > 0 and sum(map(len, uvs)) == len(frame.x)
    kinds = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), *([("s", "<f4"), ("t", "<f4")] if textured else [])]
    columns = [*frame.x.T, *(np.concatenate(uvs).T if textured else [])]
    vertices = np.rec.fromarrays(columns, dtype=np.dtype(kinds))
    texcoord = "property list uchar float texcoord\n" if cut else ""
    properties = "".join(f"property {'double' if kind == '<f8' else 'float'} {name}\n" for name, kind in kinds)
    stream.write(
        f"ply\nformat binary_little_endian 1.0\ncomment nuno frame {frame.number} at {frame.t!r} s\n"
        f"element vertex {len(frame.x)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n{texcoord}end_header\n".encode()
    )
    stream.write(vertices.tobytes())
    lists = [("uvs", "u1"), ("uv", "<f4", 6)] if cut else []
    table = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3), *lists]))
    table["count"], table["corners"] = 3, faces
    if cut:
        table["uvs"], table["uv"] = 6, np.concatenate([one.points[one.faces].reshape(-1, 6) for one in laid])
    stream.write(table.tobytes())


def _glb(recording: Recording, pieces: list[ShownPiece], frame: Frame) -> bytes:
    """Return a binary glTF file, which is y up and right-handed like the scene."""
    import trimesh

    scene, place = trimesh.Scene(), np.eye(4)
    place[:3, 3] = origin = origin_of(frame.x)
    for piece in pieces:
        if len(piece.faces):
            x = frame.x[piece.start : piece.stop] - origin
            split = piece.laid_out if piece.image is not None else None
            mesh = _trimesh(x, piece.faces, _visual(piece, x), split)
            if piece.corners is not None and piece.corners.panels is not None:
                mesh.metadata["panels"] = [list(run) for run in panel_runs(piece)]  # among glTF's extras
            scene.add_geometry(mesh, node_name=piece.name, geom_name=piece.name, transform=place)
    bodies = read_bodies(recording)
    points = body_vertices(recording, bodies, frame.t)
    if bodies is not None and len(points):
        mesh = _trimesh(points - origin, bodies.faces, _plain(BODY, two_sided=False))
        scene.add_geometry(mesh, node_name="bodies", geom_name="bodies", transform=place)
    if not scene.geometry:
        raise BadInput("nothing in the recording has faces", str(recording.path), remedy="a net has none: export .npz")
    return bytes(scene.export(file_type="glb", include_normals=True))


def _trimesh(x: Float, faces: Int, visual: Any, split: Corners | None = None) -> Any:
    """Return a mesh with vertex normals: trimesh would compute them with scipy, which takes a second to import.

    Vertices that are split along seams keep the normal of the whole vertex: seams are shaded smoothly.
    """
    import trimesh

    normals = vertex_normals(x, faces)
    normals[~normals.any(axis=1)] = 0.0, 1.0, 0.0  # glTF wants unit length, also of a vertex of no triangle
    if split is not None:
        x, normals, faces = x[split.vertex], normals[split.vertex], split.faces
    return trimesh.Trimesh(x, faces, vertex_normals=normals, process=False, visual=visual)


def _visual(piece: ShownPiece, x: Float) -> Any:
    """Return the texture if there is one, else the colour, else colours by stretch."""
    from PIL import Image
    from trimesh.visual import ColorVisuals, TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if piece.image is not None and (laid := piece.laid_out) is not None:
        image = Image.fromarray(piece.image)
        return TextureVisuals(uv=laid.points, material=PBRMaterial(baseColorTexture=image, doubleSided=True, **MATT))
    if piece.colour is not None or not len(piece.edges):
        return _plain(piece.colour or PLAIN, two_sided=True)
    # glTF's vertex colours are linear light.
    linear = np.round(255.0 * paint_stretch(piece.stretch(x))).astype(np.uint8)
    return ColorVisuals(vertex_colors=np.concatenate([linear, np.full((len(x), 1), 255, np.uint8)], axis=1))


def _plain(colour: str, two_sided: bool) -> Any:
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    # Factors, like vertex colours, are linear light.
    factor = [*np.round(255.0 * parse_hex(colour)).astype(np.uint8).tolist(), 255]
    return TextureVisuals(material=PBRMaterial(baseColorFactor=factor, doubleSided=two_sided, **MATT))


# A recording, message by message, as coloured shapes and moving frames for robotics viewers.

ROOT, WORLD, CLOTH = "map", "world", "cloth"
"""Frames: z up, for these viewers; y up, as in scenes; and with its origin near the cloth's start."""
UP = (float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0)
"""The quaternion w, x, y, z that turns y to z and z to -y."""


ReadImage = Callable[[str], NDArray[np.uint8] | None]


@dataclass(frozen=True)
class Shape:
    """Triangles (k, 3), or lines (k, 2), between points x (n, 3) [m], in a frame.

    colours  (1, 3) for all points, or (n, 3) for each: sRGB in [0, 1]
    """

    name: str
    x: Float
    indices: Int
    colours: Float


@dataclass(frozen=True)
class Turn:
    """Pose of a frame in its parent: translation (3,) [m], rotation a unit quaternion w, x, y, z."""

    parent: str
    child: str
    translation: tuple[float, ...]
    rotation: tuple[float, ...]


class Show:
    """Cloth and bodies of a run as shapes, from its messages in their order: `take` each.

    read_image  reads a texture by its path; returns None if it cannot
    painter     of the dyed cloth, from `nuno.dye.painter`; None without one
    colour      auto: as in pictures; stretch: cloth without a colour of its own by its stretch; plain: nets too have a
                colour, which does not change
    frames      names of the bodies' frames; own: numbers of those that are not of single vertices

    Cloth and skins are in the frame CLOTH, with its origin near the cloth's start, since viewers use float32.
    """

    def __init__(self, read_image: ReadImage, painter: Any = None, colour: str = "auto") -> None:
        self._read_image, self.painter, self._colour = read_image, painter, colour
        self.pieces: list[ShownPiece] = []
        self.frames: tuple[str, ...] = ()
        self.own = np.zeros(0, np.int32)
        self.bodies: ShownBodies | None = None
        self.poses: Poses | None = None
        self.origin: Float | None = None
        self._geometry: Geometry | None = None
        self._amounts = b""

    def take(self, topic: str, payload: bytes) -> None:
        """Take one message. Raises BadMessage for one that is damaged."""
        try:
            if topic == FABRIC.name:
                self._take_fabric(payload)
            elif topic == GEOMETRY.name:
                self._geometry, self.bodies = decode_geometry(payload), None
                self.frames, self.own = self._geometry.frames, self._geometry.own_frames
            elif topic == BODIES.name:
                self.poses = decode_poses(payload, len(self.frames))
                if self.bodies is None and self._geometry is not None:
                    self.bodies = shape_bodies(self._geometry, self.poses)
            elif topic == CLOTH_CELLS.name and self.painter is not None and not self.painter.ready:
                self.painter.take_cloth(payload)
            elif topic == CONCENTRATION.name:
                self._amounts = payload
        except (BadInput, LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
            raise BadMessage(f"{topic}: {error}") from None

    def _take_fabric(self, payload: bytes) -> None:
        self.pieces = cut_pieces(*decode_arrays(payload), by_stretch=self._colour == "stretch")
        for i, piece in enumerate(self.pieces):
            image = self._read_image(piece.texture) if piece.texture and piece.laid_out is not None else None
            colour = piece.colour or (colour_of(i) if self._colour == "plain" else None)
            self.pieces[i] = replace(piece, image=image, colour=colour)

    @property
    def vertices(self) -> int:
        """Number of vertices of all cloth."""
        return max((piece.stop for piece in self.pieces), default=0)

    def cloth(self, x: Float) -> list[tuple[str, Shape]]:
        """Return the cloth at positions x (n, 3) [m], with the name of its frame. Raises BadMessage for damaged dye."""
        self.origin = origin_of(x) if self.origin is None else self.origin
        parts = [(self._dress(piece), x[piece.start : piece.stop] - self.origin) for piece in self.pieces]
        return [(CLOTH, shape_piece(*part)) for part in parts]

    def _dress(self, piece: ShownPiece) -> ShownPiece:
        if self.painter is None or piece.name != self.painter.object or piece.laid_out is None or not self._amounts:
            return piece
        return replace(piece, image=self.painter.draw(self._amounts), colour=None)

    def fixed(self) -> list[Turn]:
        """Return the transforms of the whole run, once there is cloth."""
        assert self.origin is not None
        return [Turn(ROOT, WORLD, (0.0, 0.0, 0.0), UP), Turn(WORLD, CLOTH, _row(self.origin), (1.0, 0.0, 0.0, 0.0))]

    def turns(self) -> list[Turn]:
        """Return the transforms of the bodies' frames in the world."""
        assert self.poses is not None
        shift, turn = self.poses.translation, self.poses.rotation
        return [Turn(WORLD, self.frames[i], _row(shift[i]), _row(turn[i])) for i in self.own.tolist()]

    def skins(self) -> list[tuple[str, Shape]]:
        """Return the shapes of the bending bodies, once there is cloth, and the name of their frame."""
        if (bodies := self.bodies) is None or self.poses is None or self.origin is None:
            return []
        shapes = []
        for first, skin in bodies.skins:
            x, faces, joint = *_of_skin(bodies, first, skin), int(bodies.frame[first])
            bent = self.poses.bend(skin, joint, x) - self.origin
            shapes.append((CLOTH, Shape(self.frames[joint].split("/")[0], bent, faces, _sole(BODY))))
        return shapes

    def parts(self) -> list[tuple[str, Shape]]:
        """Return the rigid bodies, and of each on a skeleton the triangles that follow a frame most, as rigid ones."""
        if (bodies := self.bodies) is None:
            return []
        shapes = self.rigid()
        for first, skin in (one for one in bodies.skins if not one[1].is_surface):
            x, faces = _of_skin(bodies, first, skin)
            joint = skin.joint[faces[:, 0], 0]
            for k in np.unique(joint).tolist():
                frame = self.frames[int(bodies.frame[first]) + k]
                shapes.append((frame, Shape(frame, x - skin.place[k], faces[joint == k], _sole(BODY))))
        return shapes

    def points(self, x: Float) -> Float:
        """Return all points of cloth x (n, 3) [m] and bodies in the world."""
        return x if self.bodies is None or self.poses is None else np.concatenate([x, self.bodies.at(self.poses)])

    def rigid(self) -> list[tuple[str, Shape]]:
        """Return the frame of each rigid body, and its shape in it."""
        if (bodies := self.bodies) is None:
            return []
        rigid = np.ones(len(bodies.vertices), bool)
        for first, skin in bodies.skins:
            rigid[first : first + len(skin.joint)] = False
        shapes = []
        for number in self.own.tolist():
            name, part = self.frames[number], rigid & (bodies.frame == number)
            if part.any():
                faces = (np.cumsum(part) - 1)[bodies.faces[part[bodies.faces[:, 0]]]].astype(np.int32)
                shapes.append((name, Shape(name, bodies.vertices[part], faces, _sole(BODY))))
        return shapes


def _of_skin(bodies: Surfaces, first: int, skin: Skin) -> tuple[Float, Int]:
    """Return vertices and triangles of the skin whose vertices begin with `first`."""
    stop = first + len(skin.joint)
    return bodies.vertices[first:stop], bodies.faces[
        (bodies.faces[:, 0] >= first) & (bodies.faces[:, 0] < stop)
    ] - first


def show_recording(recording: Recording) -> Show:
    """Return a show for a recording's messages, with its textures and dye. Raises BadInput without cloth."""
    from nuno.exports.dyed_pictures import read_dyed_object

    for topic, noun in ((STATE, "positions of cloth"), (FABRIC, "description of its cloth")):
        if not recording.counts.get(topic.name):
            raise BadInput(f"the recording holds no {noun}", str(recording.path))
    dyed, view = read_dyed_object(recording), dict(recording.scene.get("view") or {})
    colour = "stretch" if view.get("colour") == "stretch" else "auto"
    return Show(functools.partial(read_texture, recording), None if dyed is None else dyed.painter, colour)


def follow(recording: Recording, show: Show, progress: Progress | None) -> Iterator[tuple[Recorded, Float | None]]:
    """Yield each message once `show` has taken it, with positions (n, 3) [m] of `sim/state`.

    Raises BadInput for one that is damaged, and for positions that are not finite.
    """
    done = 0
    for message in recording.messages():
        with recording.damage_reported(message):
            show.take(message.topic, message.payload)
        x = None
        if message.topic == STATE.name:
            number, digest = recording.mark(message)
            x = recording.points(message)
            check_size(recording, show.pieces, Frame(number, message.t, digest, x), finite=True)
            done += 1
            if progress is not None:
                progress(done, recording.counts[STATE.name])
        yield message, x


def shape_piece(piece: ShownPiece, x: Float) -> Shape:
    """Return a piece at points x (n, 3) [m] as a shape: its triangles, or a net's links, in the colours of its image,
    else its own, else by stretch. With an image each vertex has the colour of its pixel.
    """
    piece = replace(piece, yarns=None)
    if not len(piece.faces):
        links = _fewest(to_srgb(paint_piece(piece, x)))
        if len(links) == 1:
            return Shape(piece.name, x, piece.edges, links)
        ends = np.arange(2 * len(piece.edges), dtype=np.int32).reshape(-1, 2)
        return Shape(piece.name, x[piece.edges.reshape(-1)], ends, np.repeat(links, 2, axis=0))
    if piece.image is not None and (laid := piece.laid_out) is not None:
        return Shape(piece.name, x[laid.vertex], laid.faces, sample(piece.image, laid.points) / 255.0)
    return Shape(piece.name, x, piece.faces, _fewest(to_srgb(paint_piece(piece, x))))


def paint_piece(piece: ShownPiece, x: Float) -> Float:
    """Return the linear light of vertices (n, 3), or of a net's links (e, 3): by yarn, the piece's, else by stretch."""
    net = not len(piece.faces)
    if net and piece.yarns is not None:
        return paint_yarns(piece.yarns)
    if piece.colour is not None or not len(piece.edges):
        return np.tile(parse_hex(piece.colour or PLAIN), (len(piece.edges) if net else len(x), 1))
    return paint_stretch(piece.link_stretch(x) if net else piece.stretch(x))


def sample(image: NDArray[np.uint8], uv: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the pixels (n, 3) of an image (h, w, 3), which repeats, at texture coordinates (n, 2), v up."""
    height, width = image.shape[:2]
    u, v = (uv - np.floor(np.where(uv == 1.0, 0.0, uv))).T
    column, row = np.minimum(u * width, width - 1), np.minimum((1.0 - v) * height, height - 1)
    return np.asarray(image[row.astype(np.int64), column.astype(np.int64)])


def _sole(colour: str) -> Float:
    return to_srgb(parse_hex(colour))[None]


def _fewest(colours: Float) -> Float:
    """Return a single colour if all are equal."""
    return colours[:1] if len(colours) and (colours == colours[0]).all() else colours


def _row(values: Float) -> tuple[float, ...]:
    return tuple(values.tolist())
