"""A recording, message by message, as coloured shapes and moving frames for robotics viewers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import origin_of
from nuno.collision.messages import decode_poses
from nuno.exports.cloth import Pieces, ShownPiece, check_size, read_bodies
from nuno.exports.dyed_pictures import read_dyed_object
from nuno.exports.paint import BODY, PLAIN, paint_stretch, paint_yarns
from nuno.recording.reader import Recording
from nuno.recording.recorded import Frame, Recorded
from nuno_schemas.bodies import Poses
from nuno_schemas.colour import parse_hex, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.messages import STATE

ROOT, WORLD, CLOTH = "map", "world", "cloth"
"""Frames: z up, for these viewers; y up, as in scenes; and with its origin near the cloth's start."""
UP = (float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0)
"""The quaternion w, x, y, z that turns y to z and z to -y."""


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
    """A recording's cloth and bodies, for its messages in their order.

    fixed   transforms of the whole run
    bodies  rigid bodies: the name of the frame of each, and its shape in it
    frames  names of the bodies' frames
    floor   height of the level floor [m], or None

    Cloth and skins are in the frame CLOTH, with its origin near the cloth's start, since viewers use float32. Raises
    BadInput for a recording of dye alone, one without cloth, and a damaged one.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording, self._pieces = recording, Pieces(recording)
        first = next(recording.messages([STATE.name]), None)
        if first is None:
            raise BadInput("the recording holds no positions of cloth", str(recording.path))
        self._dyed = read_dyed_object(recording)
        self.origin = origin_of(self.recording.points(first))
        self.fixed = [
            Turn(ROOT, WORLD, (0.0, 0.0, 0.0), UP),
            Turn(WORLD, CLOTH, _row(self.origin), (1.0, 0.0, 0.0, 0.0)),
        ]
        self._bodies = read_bodies(recording)
        self.frames: list[str] = [str(name) for name in recording.geometry()[1].get("frames", ())]
        self.floor = None if self._bodies is None else self._bodies.floor
        self.bodies = self._rigid()

    def cloth(self, message: Recorded) -> list[Shape]:
        """Return the cloth in a message of `sim/state`. Raises BadInput if it is damaged or not finite."""
        x, t = self.recording.points(message), message.t
        number, digest = self.recording.marks().get(message.log_time, (message.seq, ""))
        pieces = self._pieces.at(t)
        check_size(self.recording, pieces, Frame(number, t, digest, x), finite=True)
        dressed = pieces if self._dyed is None else self._dyed.dress(pieces, t)
        return [shape_piece(piece, x[piece.start : piece.stop] - self.origin) for piece in dressed]

    def poses(self, message: Recorded) -> Poses:
        """Return the bodies' poses in a message of `collision/bodies`. Raises BadInput if it is damaged."""
        with self.recording.damage_reported(message):
            return decode_poses(message.payload, len(self.frames))

    def turns(self, poses: Poses) -> list[Turn]:
        """Return the transforms of the bodies' frames in the world."""
        rows = zip(self.frames, poses.translation, poses.rotation, strict=True)
        return [Turn(WORLD, name, _row(shift), _row(turn)) for name, shift, turn in rows]

    def skins(self, poses: Poses) -> list[Shape]:
        """Return the shapes of the bending bodies."""
        if (bodies := self._bodies) is None:
            return []
        shapes = []
        for first, skin in bodies.skins:
            part, joint = slice(first, first + len(skin.joint)), int(bodies.frame[first])
            x = poses.bend(skin, joint, bodies.vertices[part]) - self.origin
            faces = bodies.faces[(bodies.faces[:, 0] >= first) & (bodies.faces[:, 0] < part.stop)] - first
            shapes.append(Shape(self.frames[joint].split("/")[0], x, faces, _sole(BODY)))
        return shapes

    def points(self, message: Recorded, poses: Poses | None) -> Float:
        """Return all points of cloth and bodies in the world, shape (n, 3) [m]."""
        bodies = np.zeros((0, 3)) if poses is None or self._bodies is None else self._bodies.at(poses)
        return np.concatenate([self.recording.points(message), bodies])

    def _rigid(self) -> list[tuple[str, Shape]]:
        if (bodies := self._bodies) is None:
            return []
        rigid = np.ones(len(bodies.vertices), bool)
        for first, skin in bodies.skins:
            rigid[first : first + len(skin.joint)] = False
        shapes = []
        for number, name in enumerate(self.frames):
            part = rigid & (bodies.frame == number)
            if part.any():
                faces = (np.cumsum(part) - 1)[bodies.faces[part[bodies.faces[:, 0]]]].astype(np.int32)
                shapes.append((name, Shape(name, bodies.vertices[part], faces, _sole(BODY))))
        return shapes


def shape_piece(piece: ShownPiece, x: Float) -> Shape:
    """Return a piece at points x (n, 3) [m] as a shape: its triangles, or a net's links, in the colours of its image,
    else its own, else by stretch. With an image each vertex has the colour of its pixel.
    """
    piece = replace(piece, yarns=None)
    if not len(piece.faces):
        ends = np.arange(2 * len(piece.edges), dtype=np.int32).reshape(-1, 2)
        links = np.repeat(paint_piece(piece, x), 2, axis=0)
        return Shape(piece.name, x[piece.edges.reshape(-1)], ends, _fewest(to_srgb(links)))
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
