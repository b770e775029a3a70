"""A recording for replay in the page: its frames by time, and the changes of its cloth."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import origin_of
from nuno.collision.bodies import NO_SURFACES, Surfaces
from nuno.collision.messages import decode_geometry, decode_poses
from nuno.exports.cloth import ShownPiece, as_png, check_size, read_pieces
from nuno.exports.dyed_pictures import DyedPictures, dyed_pictures, read_dyed_object
from nuno.recording.reader import Recording, open_recording, shortcoming
from nuno.recording.recorded import Frame, Recorded
from nuno.studio.live_view import NO_EDGES, NO_FACES, NO_LENGTHS, NO_POINTS, draw_bodies, print_of, size_of
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.messages import BODIES, CONCENTRATION, DYE_STATUS, FABRIC, GEOMETRY, STATE, STATUS
from nuno_schemas.pictures import Picture

EDGES = 1024
"""More than the edges of a panel."""

# The topology and colours of a recording's cloth, as the page shows them.


@dataclass(frozen=True)
class Shape:
    """The cloth between two changes by operations.

    faces (f, 3), edges (e, 2) with rest (e,) [m]: threads and links; printed: number of the piece with an image, which
    is the dyed one if any is, and uv (f, 6) its texture coordinates as of `print_of`; None without.
    """

    pieces: tuple[ShownPiece, ...]
    faces: Int
    edges: Int
    rest: NDArray[np.float32]
    printed: int | None = None
    uv: NDArray[np.float32] | None = None

    def sewn(self) -> tuple[list[str], dict[str, NDArray[np.float32]]]:
        """Return the names of all panels; of each triangle's corners the flat positions `flat` (f, 6) [m], and of its
        sides `side` (f, 3) the panel and the edge that they lie on, as EDGES * panel + edge; NaN for none.
        """
        names, parts = list[str](), []
        for piece in self.pieces:
            part, own = np.full((len(piece.faces), 9), np.nan, np.float32), piece.corners
            if own is not None and (panels := own.panels) is not None:
                of = np.maximum(panels.of, 0)[:, None]
                part[:, :6] = own.points[own.faces].reshape(-1, 6) * panels.unit[of]
                part[:, 6:] = np.where(panels.edge >= 0, EDGES * (of + len(names)) + panels.edge, np.nan)
                names += panels.names
            parts.append(part)
        flat, side = np.split(np.concatenate([np.zeros((0, 9), np.float32), *parts]), [6], axis=1)
        return names, {"flat": flat, "side": side} if names else {}

    def same_as(self, other: Shape) -> bool:
        """Return whether both have the same pieces, vertices, triangles and edges."""
        return all(
            (one.start, one.stop) == (two.start, two.stop)
            and np.array_equal(one.faces, two.faces)
            and np.array_equal(one.edges, two.edges)
            for one, two in zip(self.pieces, other.pieces, strict=False)
        ) and len(self.pieces) == len(other.pieces)


def read_shape(recording: Recording, t: float) -> Shape:
    """Return the shape of the cloth at t [s]. Raises BadInput if its description is damaged."""
    pieces = read_pieces(recording, t, by_view=False)
    faces, edges, rest = (
        np.concatenate([none, *rows])
        for none, rows in (
            (NO_FACES, (piece.faces + piece.start for piece in pieces)),
            (NO_EDGES, (piece.edges + piece.start for piece in pieces)),
            (NO_LENGTHS, (piece.rest for piece in pieces)),
        )
    )
    dyed = (recording.scene.get("dye") or {}).get("object")
    shown = [i for i, one in enumerate(pieces) if one.laid_out and (one.image is not None or one.name == dyed)]
    which = min(shown, key=lambda i: pieces[i].name != dyed, default=None)
    parts = [print_of(one.faces, one.laid_out if i == which else None, (0, one.stop)) for i, one in enumerate(pieces)]
    uv = None if which is None else np.concatenate(parts)
    return Shape(tuple(pieces), faces, edges, rest.astype(np.float32), which, uv)


DYED = "This cloth is dyed and does not move: it is shown from above, as its pictures have it."
NOTHING = "It holds no positions of cloth that could be shown."
MOST_SHAPES = 8
"""Shapes that are kept; older ones are read again."""
NET = "This cloth has no triangles: its links are shown as lines."


@dataclass(frozen=True)
class Still:
    """Cloth and bodies at one moment.

    x (n, 3) [m], recorded or, if `between` two frames, interpolated linearly; body (b, 3) [m]; frame is the number
    of the last frame until then, and shape the number of the cloth's shape.
    """

    t: float
    frame: int
    shape: int
    x: Float
    body: Float
    between: bool = False


class Film:
    """An open recording, for use by any thread.

    times    log times [ns] of the readable frames, ascending
    numbers  numbers of these frames
    moves    whether frames have positions; those of dye alone have none
    end      the time [s] up to which the file is readable; None if it is not damaged
    problem  description of the damage

    Raises BadInput for a file that is not a recording.
    """

    def __init__(self, path: Path) -> None:
        self.recording = open_recording(path)
        self._lock, self._closed = threading.RLock(), False
        try:
            self._read()
        except BaseException:
            self.close()
            raise

    def _read(self) -> None:
        recording, last = self.recording, 0
        states, numbers, changes = set[int](), dict[int, int](), list[int]()
        self.end: float | None = None
        self.problem = ""
        try:
            for message in recording.messages([STATE.name, STATUS.name, DYE_STATUS.name, FABRIC.name]):
                last = message.log_time
                if message.topic == STATE.name:
                    states.add(last)
                elif message.topic == FABRIC.name:
                    changes.append(last)
                else:
                    numbers[last] = recording.said(message)["frame"]
        except BadInput as error:  # frames before the damage are shown
            later = [one.message_start_time for one in recording.layout.chunks if one.message_end_time > last]
            self.end, self.problem = min(later, default=last) / 1e9, str(error)
        self.moves = bool(states)
        self.times = sorted(time for time in states or numbers if self.end is None or time < self.end * 1e9)
        self.numbers = [numbers.get(time, i) for i, time in enumerate(self.times)]
        self._changes = [time for time in changes if self.times and time <= self.times[-1]]
        self._shape = lru_cache(MOST_SHAPES)(lambda number: read_shape(recording, self._changes[number] / 1e9))
        self._bodies: Surfaces = NO_SURFACES
        self._dyed: DyedPictures | None = None
        self.origin = np.zeros(3)
        if self.moves and self.times:
            x = self.stills(self.times[:1])[0].x
            self.origin, geometry = origin_of(x), recording.last(GEOMETRY.name)
            if geometry is not None:
                with recording.damage_reported(geometry):
                    self._bodies = draw_bodies(decode_geometry(geometry.payload), size_of(x))

    @property
    def says(self) -> list[str]:
        """Remarks for the user of the page."""
        with self._open():
            remarks = [self.problem or shortcoming(self.recording)]
            if not self.times or not self.moves:
                remarks.append(DYED if self.dyed else NOTHING)
            elif any(not len(piece.faces) for piece in self.shape(0).pieces):
                remarks.append(NET)
        return [text for text in remarks if text]

    @property
    def dyed(self) -> bool:
        """Whether it is a recording of dye alone, with amounts to draw."""
        return not self.moves and self.recording.dyed_alone and CONCENTRATION.name in self.recording.counts

    @contextmanager
    def _open(self) -> Iterator[None]:
        """Hold the recording open. Raises BadInput if it was closed meanwhile, to make room for other films."""
        with self._lock:
            if self._closed:
                remedy = "load the page again"
                raise BadInput("the recording was closed meanwhile", str(self.recording.path), remedy=remedy)
            yield

    def close(self) -> None:
        with self._lock:
            self._closed = True
            self.recording.close()

    def series(self) -> dict[str, NDArray[Any]]:
        """Return columns over the readable frames, as `nuno.recording.reader.read_series` does."""
        with self._open():
            return self.recording.series(self.end)

    def picture(self, number: int) -> bytes:
        """Return the PNG of dyed cloth, or of the image on cloth that moves, at the frame of an index into `times`, or
        at the last frame before it with recorded amounts. Raises BadInput if it cannot be drawn, IndexError without it.
        """
        with self._open():
            if self.moves:
                return as_png(self._image(self.times[number]))
            if self._dyed is None:
                with dyed_pictures(self.recording) as pictures:
                    self._dyed = pictures
            message = self.recording.last(CONCENTRATION.name, self.times[number] / 1e9)
            if message is None:
                raise BadInput("no amounts of dye were recorded until then", str(self.recording.path))
            picture = self._dyed.draw(message)
        return as_png(picture)

    def _image(self, time: int) -> Picture:
        shape = self.shape(self.shape_at(time))
        if self._dyed is None and isinstance(dye := self.recording.scene.get("dye"), dict) and dye.get("object"):
            self._dyed = read_dyed_object(self.recording)
        image = self._dyed.texture(time / 1e9) if self._dyed else None
        if image is None and shape.printed is not None:
            image = shape.pieces[shape.printed].image
        if image is None:
            raise BadInput("nothing is printed on this cloth, nor dyed until then", str(self.recording.path))
        return image

    @property
    def body_faces(self) -> Int:
        """Triangles (g, 3) of the bodies."""
        return self._bodies.faces

    def shape_at(self, time: int) -> int:
        """Return the number of the cloth's shape at a log time [ns]."""
        return max(bisect_right(self._changes, time) - 1, 0)

    def shape(self, number: int) -> Shape:
        """Return a shape by its number. Raises BadInput if it is damaged, IndexError if it does not exist."""
        with self._open():
            if not self._changes:
                raise BadInput("the recording does not describe its cloth", str(self.recording.path))
            if not 0 <= number < len(self._changes):
                raise IndexError("there is no such shape")
            return self._shape(number)

    def stills(self, times: Sequence[int]) -> list[Still]:
        """Return the cloth at ascending log times [ns] between the first frame and the last.

        Raises BadInput if a frame is damaged.
        """
        around = [self._around(time) for time in times]
        wanted = {time for pair in around for time in pair}
        if not wanted:
            return []
        with self._open():
            states, poses = dict[int, Float](), dict[int, Float]()
            window = min(wanted) / 1e9, max(wanted) / 1e9 + 1e-9
            for message in self.recording.messages([STATE.name, BODIES.name], *window):
                if message.log_time in wanted:
                    if message.topic == STATE.name:
                        states[message.log_time] = self._points(message)
                    else:
                        poses[message.log_time] = self._body(message)
            for time in wanted - poses.keys():
                poses[time] = self._body(self.recording.last(BODIES.name, time / 1e9))
            return [self._still(time, *pair, states, poses) for time, pair in zip(times, around, strict=True)]

    def _around(self, time: int) -> tuple[int, int]:
        """Return the last frame until a log time and the first one from it on: the same if a frame has that time."""
        index = bisect_right(self.times, time) - 1
        before = self.times[index]
        return before, before if before == time else self.times[index + 1]

    def _still(self, time: int, before: int, after: int, states: dict[int, Float], poses: dict[int, Float]) -> Still:
        number, shape = self.numbers[bisect_right(self.times, time) - 1], self.shape_at(before)
        x, body = states[before], poses[before]
        if after != before and shape == self.shape_at(after):
            share = (time - before) / (after - before)
            x = (1.0 - share) * x + share * states[after]
            body = (1.0 - share) * body + share * poses[after]
        return Still(time / 1e9, number, shape, x, body, after != before)

    def _points(self, message: Recorded) -> Float:
        x = self.recording.points(message)
        number, digest = self.numbers[bisect_right(self.times, message.log_time) - 1], ""
        if self._changes:
            check_size(self.recording, list(self.shape(self.shape_at(message.log_time)).pieces),
                       Frame(number, message.t, digest, x))  # fmt: skip
        return x

    def _body(self, message: Recorded | None) -> Float:
        if message is None or not len(self._bodies.vertices):
            return NO_POINTS
        with self.recording.damage_reported(message):
            return self._bodies.at(decode_poses(message.payload))
