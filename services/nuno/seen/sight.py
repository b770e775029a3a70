"""What the page shows: the cloth and the bodies at one moment, as bytes for the browser."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.cloth.build import Piece
from nuno.pages.server import whole
from nuno_schemas.fabric import Float, Int

NO_POINTS = np.zeros((0, 3))
NO_FACES = np.zeros((0, 3), np.int32)
SAID = ("name", "start", "stop", "colour")
"""What the page is told of a piece of cloth."""
PATIENCE = 10.0
"""How long a question for the next frame waits for one [s]."""


@dataclass(frozen=True)
class Sight:
    """The cloth at one moment.

    number  grows with every one that is shown, shape with every change of topology, place with every move of bodies
    x (n, 3) [m], faces (f, 3), body (b, 3) [m], body_faces (g, 3); origin (3,) [m] stays what it was at first
    state   start (no run), preparing, running, paused, or how a run ended
    """

    x: Float
    faces: Int
    pieces: tuple[Piece, ...]
    body: Float = field(default_factory=lambda: NO_POINTS)
    body_faces: Int = field(default_factory=lambda: NO_FACES)
    origin: Float = field(default_factory=lambda: np.zeros(3))
    state: str = "start"
    run: str = ""
    frame: int = 0
    frames: int = 0
    t: float = 0.0
    message: str = ""
    number: int = 0
    shape: int = 0
    place: int = 0

    def encode(self, shape: int, place: int) -> bytes:
        """A length, a JSON text and arrays, little-endian.

        Topology goes only to a page that has another `shape`, bodies to one that has another `place`.

        Positions are float32 about `origin`, so that cloth far from the world's origin keeps its digits.
        """
        origin = self.origin
        arrays: dict[str, NDArray[Any]] = {"x": _about(self.x, origin)}
        if (shape, place) != (self.shape, self.place):
            arrays["body"] = _about(self.body, origin)
        if shape != self.shape:
            arrays |= {"faces": self.faces.astype("<u4"), "bodyFaces": self.body_faces.astype("<u4")}
        names = ("state", "run", "frame", "frames", "t", "message", "number", "shape", "place")
        head = {name: getattr(self, name) for name in names} | {
            "origin": origin.tolist(),
            "pieces": [{name: getattr(piece, name) for name in SAID} for piece in self.pieces],
            "arrays": [[name, str(a.dtype), a.size] for name, a in arrays.items()],
        }
        text = json.dumps(head).encode()
        text += b" " * (-len(text) % 4)
        return b"".join([len(text).to_bytes(4, "little"), text, *(a.tobytes() for a in arrays.values())])


def _about(x: Float, origin: Float) -> NDArray[np.float32]:
    return np.ascontiguousarray(x - origin, "<f4")


class Board:
    """The newest sight; a page that asks for the next one waits for it."""

    def __init__(self, sight: Sight) -> None:
        finite = len(sight.x) > 0 and bool(np.isfinite(sight.x).all())
        self._sight = replace(sight, origin=np.round(sight.x.mean(axis=0)) if finite else np.zeros(3))
        self._changed = threading.Condition()

    @property
    def now(self) -> Sight:
        return self._sight

    def show(self, sight: Sight | None = None, **changes: Any) -> None:
        """Show another sight, or this one changed; its numbers follow on those before."""
        with self._changed:
            before = self._sight
            sight = replace(sight or before, **changes)
            shape = before.shape + (not np.array_equal(sight.faces, before.faces))
            shape += not np.array_equal(sight.body_faces, before.body_faces)
            place = before.place + (not np.array_equal(sight.body, before.body))
            self._sight = replace(sight, number=before.number + 1, shape=shape, place=place, origin=before.origin)
            self._changed.notify_all()

    def wait(self, after: int, patience: float) -> Sight:
        """The first sight with another number than `after`, or after `patience` [s] the present one."""
        with self._changed:
            self._changed.wait_for(lambda: self._sight.number != after, patience)
            return self._sight

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """The next frame, for a page that says what it has. Raises Refused."""
        after, shape, place = (whole(query, key) for key in ("after", "shape", "place"))
        return "application/octet-stream", self.wait(after, PATIENCE).encode(shape, place)
