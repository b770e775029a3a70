"""Pieces of cloth and bodies at a frame of a recording, as arrays, and their colours."""

from __future__ import annotations

import base64
import io
import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nuno.collision.bodies import Surfaces, surface
from nuno.collision.messages import decode_geometry, decode_poses
from nuno.recording.reader import Recording
from nuno.recording.recorded import Arrays, Frame, Recorded
from nuno.scene.recorded_scene import restored_scene
from nuno.simulation import cloth
from nuno_schemas.bodies import PLANE, Geometry, Poses
from nuno_schemas.colour import colours, parse_hex, read_rgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Corners, Float, Int, Panels
from nuno_schemas.messages import BODIES, FABRIC, GEOMETRY, STATE
from nuno_schemas.vectors import unit_rows

if TYPE_CHECKING:
    from nuno.simulation.yarns import Tensions

# Texture coordinates per corner of a triangle, and panels, from a fabric message.


def read_corners(arrays: Arrays, faces: Int, number: int, names: Sequence[str]) -> Corners | None:
    """Return the corners of all objects, or None. Raises LookupError or ValueError if they do not match the faces."""
    if "corner_uv" not in arrays:
        return None
    points, vertex = np.asarray(arrays["corner_uv"], np.float32), arrays["corner_vertex"]
    vertex = read_indices("corner_vertex", vertex.reshape(-1, 1), 1, number)[:, 0]
    corner_faces = read_indices("corner_faces", arrays["corner_faces"], 3, len(vertex))
    if points.shape != (len(vertex), 2) or corner_faces.shape != faces.shape or (vertex[corner_faces] != faces).any():
        raise ValueError("texture coordinates of corners that are not those of the faces")
    return Corners(points, vertex, corner_faces, _panels(arrays, tuple(map(str, names)), len(faces), len(points)))


def _panels(arrays: Arrays, names: tuple[str, ...], faces: int, points: int) -> Panels | None:
    """Return the panels of all objects, or None. Raises LookupError or ValueError if they do not match the corners."""
    if "panel_of" not in arrays:
        return None
    of, seam = arrays["panel_of"], arrays["panel_seam"]
    edge = arrays.get("panel_edge", np.full((faces, 3), -1, np.int32))  # earlier recordings have none
    unit = np.asarray(arrays["panel_unit"], np.float64)
    pairs = read_indices("panel_pairs", arrays["panel_pairs"], 2, points)
    if of.shape != (faces,) or not (-1 <= of.min(initial=-1) <= of.max(initial=-1) < len(names)):
        raise ValueError("triangles of panels that are not those of the names")
    if edge.shape != (faces, 3):
        raise ValueError("edges of panels that are not those of the triangles")
    if unit.shape != (len(names),) or not (unit > 0.0).all() or seam.shape != (len(pairs),):
        raise ValueError("panels without a size, or stitches without a seam")
    return Panels(names, np.asarray(of, np.int32), np.asarray(edge, np.int32), unit, pairs, np.asarray(seam, np.int32))


def cut_corners(corners: Corners, own: NDArray[np.bool_], start: int, stop: int) -> Corners:
    """Return the corners of one object, given its triangles and the range of its vertices."""
    mine = (corners.vertex >= start) & (corners.vertex < stop)
    place = np.cumsum(mine, dtype=np.int32) - 1
    panels = None if corners.panels is None else _cut_panels(corners.panels, own, mine, place)
    faces = place[corners.faces[own]].astype(np.int32)
    return Corners(corners.points[mine], corners.vertex[mine] - start, faces, panels)


def _cut_panels(panels: Panels, own: NDArray[np.bool_], mine: NDArray[np.bool_], place: Int) -> Panels | None:
    """Return the panels of one object, given its triangles, its corners and their new numbers; None without panels."""
    of, kept = panels.of[own], mine[panels.pairs].all(axis=1)
    used = np.unique(of[of >= 0])
    if not len(used):
        return None
    number = np.full(len(panels.names) + 1, -1, np.int32)  # the last entry is for index -1
    number[used] = np.arange(len(used))
    seam = np.unique(panels.seam[kept], return_inverse=True)[1].reshape(-1).astype(np.int32)
    names = tuple(panels.names[k] for k in used)
    pairs = place[panels.pairs[kept]].astype(np.int32)
    return Panels(names, number[of], panels.edge[own], panels.unit[used], pairs, seam)


def read_indices(name: str, values: NDArray[Any], width: int, number: int) -> Int:
    """Return an array of `width` columns of vertex numbers as int32. Raises ValueError for any other array."""
    fits = values.ndim == 2 and values.shape[1] == width and values.dtype.kind in "iu"
    if not fits or (values.size and not 0 <= values.min() <= values.max() < number):
        raise ValueError(f"{name} of {values.dtype} and shape {values.shape} for {number} vertices")
    return np.asarray(values, np.int32)


Pressures = Callable[[Float], Float]
"""Returns the pressure (n,) [Pa] of a knit at positions (n, 3) [m]."""


@dataclass(frozen=True)
class ShownPiece:
    """One object of the scene: vertices start to stop of all; indices count from start.

    faces (f, 3), edges (e, 2) int32; rest (e,) [m]; uv (n, 2) with v up, or None;
    image (h, w, 3) uint8 sRGB or None, and texture, the name of its file; colour "#rrggbb" or None; yarns (e,) kind of
    yarn of each edge, -1 for none, or None without yarns; pinned (n,) whether each vertex is held;
    corners: texture coordinates instead of uv, if vertices have several, or None.
    """

    name: str
    start: int
    stop: int
    faces: Int
    edges: Int
    rest: Float
    uv: NDArray[np.float32] | None
    image: NDArray[np.uint8] | None
    colour: str | None
    yarns: NDArray[np.int8] | None = None
    texture: str | None = None
    pinned: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    tensions: Tensions | None = None
    corners: Corners | None = None

    @property
    def seamed(self) -> bool:
        """Whether vertices have several texture coordinates."""
        return self.corners is not None and len(self.corners.vertex) > self.stop - self.start

    @property
    def laid_out(self) -> Corners | None:
        """Texture coordinates with the vertices and triangles of a mesh with an image; or None."""
        if self.corners is not None or self.uv is None:
            return self.corners
        return Corners(self.uv, np.arange(self.stop - self.start, dtype=np.int32), self.faces)

    def link_stretch(self, x: Float) -> Float:
        """Return |d| / rest - 1 of every spring, shape (e,), for x (n, 3) [m] of this piece."""
        start, end = np.take(x, self.edges.T, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.linalg.norm(end - start, axis=1) / self.rest - 1.0)

    def stretch(self, x: Float) -> Float:
        """Return the largest link_stretch of each vertex's springs, (n,), for x (n, 3) [m]; NaN if any of them is."""
        value, most = self.link_stretch(x), np.full(len(x), -1.0)
        with np.errstate(invalid="ignore"):
            for end in (0, 1):
                np.maximum.at(most, self.edges[:, end], value)
        return most


class Pieces:
    """The cloth of a recording over time, with changes by operations. Raises BadInput as `read_pieces`."""

    def __init__(self, recording: Recording) -> None:
        self._times = [message.t for message in recording.messages([FABRIC.name])]
        self._read = cache(partial(read_pieces, recording))

    def at(self, t: float) -> list[ShownPiece]:
        """Return the pieces at t [s]."""
        index = max(bisect_right(self._times, t) - 1, 0)
        return self._read(self._times[index] if self._times else None)


def read_pieces(recording: Recording, t: float | None = None, by_view: bool = True) -> list[ShownPiece]:
    """Return the cloth of a recording at t [s], or at its end, in its colours unless the scene's view is by stretch and
    followed (`by_view`). Raises BadInput for a missing or damaged description.
    """
    try:
        by_stretch = by_view and dict(recording.scene.get("view") or {}).get("colour") == "stretch"
        pieces = cut_pieces(*recording.fabric(t), by_stretch)
    except (LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise BadInput(f"the recording does not describe its cloth: {error}", str(recording.path)) from None
    return [p if p.laid_out is None else replace(p, image=read_texture(recording, p.texture)) for p in pieces]


def cut_pieces(arrays: Arrays, text: Mapping[str, Any], by_stretch: bool = False) -> list[ShownPiece]:
    """Return the objects of a fabric message, without images. Objects of triangles without a colour get one of CLOTHS,
    in their order, unless they are painted by_stretch; nets show their links.

    Raises LookupError, ValueError, TypeError, AttributeError or OverflowError for an inconsistent message.
    """
    from nuno.simulation.yarns import Tensions  # a recorder of dye alone has no use for it

    number = int(text["vertices"])
    faces, edges = (read_indices(name, arrays[name], width, number) for name, width in (("faces", 3), ("edges", 2)))
    lengths = {"edge_rest": len(edges), "edge_yarn": len(edges), "uv": number, "pinned": number}
    for name, length in lengths.items():
        if name in arrays and len(arrays[name]) != length:
            raise ValueError(f"{name} has {len(arrays[name])} rows, not {length}")
    rest, pinned = np.asarray(arrays["edge_rest"], np.float64), arrays.get("pinned", np.zeros(number)).astype(bool)
    yarns = np.asarray(arrays["edge_yarn"], np.int8) if "edge_yarn" in arrays else None
    corners = read_corners(arrays, faces, number, text.get("panels", ()))
    pieces: list[ShownPiece] = []
    for item in text["objects"]:
        start, stop = int(item["start"]), int(item["stop"])
        if not 0 <= start <= stop <= number:
            raise ValueError(f"an object of vertices {start} to {stop} of {number}")
        mine, own = _inside(edges, start, stop), _inside(faces, start, stop)
        colour = item.get("colour") or (None if by_stretch or not own.any() else colour_of(len(pieces)))
        pieces.append(
            ShownPiece(
                str(item["name"]), start, stop, faces[own] - start, edges[mine] - start,
                rest[mine], arrays["uv"][start:stop] if "uv" in arrays else None, None, colour,
                None if yarns is None or (yarns[mine] < 0).all() else yarns[mine], item.get("texture"),
                pinned[start:stop], Tensions.read(arrays, mine),
                None if corners is None else cut_corners(corners, own, start, stop),
            )
        )  # fmt: skip
    return pieces


def coloured(piece: ShownPiece, colour: str) -> ShownPiece:
    """Return the piece prepared for painting: by its texture, else its colour, else its yarns, else its stretch."""
    if colour in ("stretch", "pressure"):
        return replace(piece, image=None, texture=None, colour=None, yarns=None, tensions=None)
    if colour == "auto" or piece.colour is not None or len(piece.faces):
        piece = replace(piece, yarns=None)
    return replace(piece, colour=piece.colour or PLAIN) if colour == "cloth" and piece.yarns is None else piece


def _inside(indices: Int, start: int, stop: int) -> NDArray[np.bool_]:
    inside = (indices >= start) & (indices < stop)
    if (inside.any(axis=1) != inside.all(axis=1)).any():
        raise ValueError("a face or spring joins two objects")
    return np.asarray(inside.all(axis=1))


def read_texture(recording: Recording, texture: str | None) -> NDArray[np.uint8] | None:
    """Return (h, w, 3) sRGB of an image attached to the recording, or None.

    Only attachments are read: a path in someone else's file must not select files here.
    """
    name = find_named(texture or "", recording.attachments)
    if name is None:
        return None
    try:
        return read_rgb(io.BytesIO(recording.attachment(name)))
    except (OSError, ValueError) as error:
        raise BadInput(f"the texture cannot be read: {error}", str(recording.path), value=name) from None


def find_named(path: str, names: Iterable[str]) -> str | None:
    """Return the first of the names of a scene's files in which a path from another machine ends, or None."""
    parts = PurePath(path).parts
    return next((name for name in names if parts[-len(PurePath(name).parts) :] == PurePath(name).parts), None)


@dataclass(frozen=True)
class ShownBodies(Surfaces):
    """Bodies without level floors; `floor` is the height of the highest floor [m], or None; `frames` the name of each
    frame, body/joint.
    """

    floor: float | None = None
    frames: tuple[str, ...] = ()


def read_bodies(recording: Recording) -> ShownBodies | None:
    """Return the bodies of a recording, or None. Raises BadInput."""
    message = recording.last(GEOMETRY.name)
    if message is None:
        return None
    first = next(recording.messages([BODIES.name]), None)
    with recording.damage_reported(message):
        return shape_bodies(decode_geometry(message.payload), decode_poses(first.payload) if first else None)


def shape_bodies(geometry: Geometry, first: Poses | None) -> ShownBodies:
    """Return the surfaces of bodies; `first` are their poses at the start, None if unknown."""
    # A floor stands still: its first pose is that of the whole run.
    level = _level(geometry, first.rotation) if first else np.zeros(len(geometry.kind), bool)
    moved = first.translation[geometry.frame] if first else np.zeros_like(geometry.a)
    heights = (geometry.a + moved)[level, 1]
    shown = surface(geometry.of_primitives(np.flatnonzero(~level).tolist()))
    return ShownBodies(**vars(shown), floor=float(heights.max()) if len(heights) else None, frames=geometry.frames)


def _level(geometry: Geometry, rotation: Float) -> NDArray[np.bool_]:
    still = (np.abs(rotation[geometry.frame, 0]) == 1.0) & (geometry.kind == PLANE)
    return np.asarray(still & (geometry.b[:, 1] > 1.0 - 1e-9))


def body_vertices(recording: Recording, bodies: ShownBodies | None, t: float) -> Float:
    """Return the vertices of the bodies at t [s], shape (n, 3) [m]; empty without bodies."""
    message = recording.last(BODIES.name, t) if bodies is not None else None
    if message is None or bodies is None:
        return np.zeros((0, 3))
    with recording.damage_reported(message):
        return bodies.at(decode_poses(message.payload))


def read_frame(recording: Recording, number: int | None = None) -> Frame:
    """Return a frame by its number, or the last. Raises BadInput if it is not in the recording."""
    message, times = find_message(recording, STATE.name, number)
    if message is None:
        raise recording.no_frame(number, times)
    frame, digest = recording.mark(message)
    return Frame(frame, message.t, digest, recording.points(message))


def find_message(recording: Recording, topic: str, number: int | None) -> tuple[Recorded | None, dict[int, int]]:
    """Return a topic's message of a frame by its number, or the last; and the log times [ns] of all frames."""
    times = {frame: time for time, (frame, _) in recording.marks().items()}
    if number is None:
        return recording.last(topic), times
    if number not in times:
        return None, times
    start = times[number] / 1e9
    return next(recording.messages([topic], start, start + 1e-9), None), times


def check_size(recording: Recording, pieces: list[ShownPiece], frame: Frame, finite: bool = False) -> None:
    """Raise BadInput if a frame has too few points for the cloth, or, with `finite`, any that is not finite."""
    most = max((piece.stop for piece in pieces), default=0)
    if len(frame.x) < most:
        problem = f"frame {frame.number} has {len(frame.x)} points for {most} vertices"
        raise BadInput(problem, str(recording.path))
    if finite and not np.isfinite(frame.x).all():
        problem, remedy = "the frame's positions are not finite", "export single frames before it: --glb, --frame N"
        raise BadInput(problem, str(recording.path), value=frame.number, remedy=remedy)


def read_pressure(recording: Recording) -> Pressures | None:
    """Return a function for the pressure of a recording's knit, after building its scene; None without a knit."""
    arrays, _ = recording.fabric()
    if "edge_yarn" not in arrays:
        return None
    from nuno.simulation.yarns import find_pressure, has_pressure

    with restored_scene(recording) as loaded:
        fabric, _ = cloth.build_fabric(loaded)
    if not has_pressure(fabric):
        return None

    def measure(x: Float) -> Float:
        return np.asarray(find_pressure(loaded, fabric, np.asarray(x, np.float64)).arrays["pressure"])

    return measure


# Colours of cloth and bodies in pictures and mesh files, and nets as tubes for renderers of triangles.

STRETCH = (0.001, 1.0)
"""Ends of the colour map for stretch, logarithmic: wool under its own weight
stretches by a thousandth, the skirt paper's springs by half."""
SIDES = 6
THICKNESS = 0.004
"""Radius of a tube, as part of the net's extent."""
CLOTHS = ("#5f84ad", "#c4795c", "#84a06c", "#cfa75b", "#95749f", "#5a9590")
"""Colours of objects without one of their own, in their order: soft dye colours that are easy to distinguish."""
PLAIN, BODY = "#d8d3cb", "#b9c0c9"
YARNS = ("#c98b6b", "#3b5b8c", "#5d8a4f", "#b5523b", "#7d5ba6", "#c9a227")
"""Colours of kinds of yarn in the order of their names, repeated if there are more kinds."""


def colour_of(index: int) -> str:
    """Return the colour of an object without one of its own, by its index in the scene."""
    return CLOTHS[index % len(CLOTHS)]


def as_png(picture: NDArray[np.uint8], **how: Any) -> bytes:
    """Encode a picture (h, w, 3) as PNG, fast rather than small unless `how`, Pillow's options, says otherwise."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(picture).save(out, "PNG", **({"compress_level": 1} | how))
    return out.getvalue()


def as_url(picture: NDArray[np.uint8]) -> str:
    """Return a picture (h, w, 3) as a PNG in a data URL, small rather than fast."""
    return "data:image/png;base64," + base64.b64encode(as_png(picture, optimize=True)).decode()


def paint_yarns(kinds: NDArray[np.int8]) -> NDArray[np.float64]:
    """Return the linear light (e, 3) of links by their kind of yarn; -1, no yarn, is plain."""
    table = np.stack([parse_hex(colour) for colour in (*YARNS, PLAIN)])
    return np.asarray(table[np.where(kinds < 0, len(YARNS), kinds % len(YARNS))])


def paint_pressure(pressure: Float, high: float) -> NDArray[np.float64]:
    """Return the linear light (n, 3) of n pressures [Pa] from 0 to `high`; below 0 as 0, NaN grey."""
    return colours(np.maximum(pressure, 0.0), 0.0, high)


def paint_stretch(stretch: Float) -> NDArray[np.float64]:
    """Return the linear light (n, 3) of n stretches; NaN is grey."""
    low, high = (math.log10(end) for end in STRETCH)
    with np.errstate(invalid="ignore"):
        return colours(np.log10(np.maximum(stretch, STRETCH[0])), low, high)


def tubes(x: Float, edges: Int) -> tuple[Float, Int, NDArray[np.int64]]:
    """Make open tubes along edges (e, 2) between points x (n, 3) [m].

    Returns vertices (12 e, 3), faces (12 e, 3) counter-clockwise seen from outside, and the
    point (12 e,) that gives each vertex its colour.
    """
    finite = x[np.isfinite(x).all(axis=1)]
    extent = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
    start, end = x[edges[:, 0]], x[edges[:, 1]]
    axis = end - start
    helper = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    u = unit_rows(np.cross(helper, axis))
    v = unit_rows(np.cross(axis, u))
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None]
    ring *= THICKNESS * (extent or 1.0)
    vertices = np.stack([start[:, None] + ring, end[:, None] + ring], axis=1).reshape(-1, 3)
    side = np.arange(SIDES)
    after = (side + 1) % SIDES
    pattern = np.concatenate(
        [np.stack([side, after, side + SIDES], axis=1), np.stack([after, after + SIDES, side + SIDES], axis=1)]
    )
    faces = (pattern[None] + 2 * SIDES * np.arange(len(edges))[:, None, None]).reshape(-1, 3).astype(np.int32)
    return vertices, faces, np.repeat(edges, SIDES, axis=1).reshape(-1).astype(np.int64)
