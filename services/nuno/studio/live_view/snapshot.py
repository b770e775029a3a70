"""The cloth and the bodies at one moment, as bytes for the browser."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.simulation.cloth import Piece
from nuno.studio.pages.server import whole
from nuno_schemas.fabric import Float, Int

NO_POINTS = np.zeros((0, 3))
NO_FACES = np.zeros((0, 3), np.int32)
NO_EDGES, NO_LENGTHS = np.zeros((0, 2), np.int32), np.zeros(0, np.float32)
SAID = ("name", "start", "stop", "colour")
"""Fields of a piece of cloth that the page gets."""
PATIENCE = 10.0
"""Longest wait for the next frame [s]."""


@dataclass(frozen=True)
class Sight:
    """The cloth at one moment.

    number  grows with every shown sight, shape with every change of topology, place with every move of bodies
    x (n, 3) [m], faces (f, 3), body (b, 3) [m], body_faces (g, 3); origin (3,) [m] is that of the first sight
    edges (e, 2), rest (e,) [m]: threads and links, and their rest lengths
    state   start (no run), preparing, running, paused, or the end state of a run
    """

    x: Float
    faces: Int
    pieces: tuple[Piece, ...]
    body: Float = field(default_factory=lambda: NO_POINTS)
    body_faces: Int = field(default_factory=lambda: NO_FACES)
    edges: Int = field(default_factory=lambda: NO_EDGES)
    rest: NDArray[np.float32] = field(default_factory=lambda: NO_LENGTHS)
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
        """Return the sight as bytes in the format of `pack`.

        Topology is included only for a page with another `shape`, bodies only for one with another `place`.

        Positions are float32 about `origin`, so that cloth far from the world's origin keeps its digits.
        """
        origin = self.origin
        arrays: dict[str, NDArray[Any]] = {"x": about(self.x, origin)}
        if (shape, place) != (self.shape, self.place):
            arrays["body"] = about(self.body, origin)
        if shape != self.shape:
            arrays |= {"faces": self.faces.astype("<u4"), "bodyFaces": self.body_faces.astype("<u4")}
            arrays |= {"edges": self.edges.astype("<u4"), "rest": self.rest.astype("<f4")}
        names = ("state", "run", "frame", "frames", "t", "message", "number", "shape", "place")
        head = {name: getattr(self, name) for name in names} | {
            "origin": origin.tolist(),
            "pieces": [{name: getattr(piece, name) for name in SAID} for piece in self.pieces],
        }
        return pack(head, arrays)


def pack(head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return a length, a JSON text that lists the arrays, and arrays of four-byte numbers, little-endian, as bytes."""
    table = [[name, str(a.dtype), a.size] for name, a in arrays.items()]
    text = json.dumps({**head, "arrays": table}).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([len(text).to_bytes(4, "little"), text, *(a.tobytes() for a in arrays.values())])


def about(x: Float, origin: Float) -> NDArray[np.float32]:
    """Return positions (n, 3) [m] as float32 about an origin."""
    return np.ascontiguousarray(x - origin, "<f4")


class Board:
    """Holds the newest sight; a page can wait for the next one."""

    def __init__(self, sight: Sight) -> None:
        self._sight = replace(sight, origin=_origin(sight.x))
        self._changed = threading.Condition()
        self._waiting = 0

    @property
    def now(self) -> Sight:
        return self._sight

    def show(self, sight: Sight | None = None, **changes: Any) -> None:
        """Show another sight, or the present one with changes; its numbers continue the previous ones."""
        with self._changed:
            before = self._sight
            sight = replace(sight or before, **changes)
            shape = before.shape + (not np.array_equal(sight.faces, before.faces))
            shape += not np.array_equal(sight.body_faces, before.body_faces)
            shape += not np.array_equal(sight.edges, before.edges)
            place = before.place + (not np.array_equal(sight.body, before.body))
            origin = before.origin if len(before.x) else _origin(sight.x)
            self._sight = replace(sight, number=before.number + 1, shape=shape, place=place, origin=origin)
            self._changed.notify_all()

    def wait(self, after: int, patience: float) -> Sight:
        """Return the first sight with another number than `after`, or after `patience` [s] the present one."""
        with self._changed:
            self._waiting += 1
            self._changed.notify_all()
            try:
                self._changed.wait_for(lambda: self._sight.number != after, patience)
            finally:
                self._waiting -= 1
            return self._sight

    def wanted(self, patience: float) -> bool:
        """Return whether a page waits for the next sight, or does so within `patience` [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: self._waiting > 0, patience)

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return the next frame after the one that the page has. Raises Refused."""
        after, shape, place = (whole(query, key) for key in ("after", "shape", "place"))
        return "application/octet-stream", self.wait(after, PATIENCE).encode(shape, place)


def _origin(x: Float) -> Float:
    """Return a point (3,) near the centre of points (n, 3) [m]; 0 without points."""
    return np.asarray(np.round(x.mean(axis=0))) if len(x) and np.isfinite(x).all() else np.zeros(3)
