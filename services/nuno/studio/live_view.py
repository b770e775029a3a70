"""The cloth and bodies that the page shows: of a scene at its start, or of a run that goes on."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from numpy.typing import NDArray

from nuno.bus.encodings import BadMessage, decode_arrays, decode_points
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import spoke
from nuno.collision.bodies import NO_SURFACES, Surfaces, build_bodies, surface
from nuno.collision.messages import DRAWN_QUERY, POSES_QUERY, decode_geometry, decode_poses
from nuno.exports.cloth import as_png, cut_pieces
from nuno.recording.recorded import Arrays
from nuno.runtime import runs
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno.simulation.cloth import Piece, join_fabrics
from nuno.simulation.service import NOW
from nuno.simulation.yarns import structural_edges
from nuno.studio.server import whole
from nuno_schemas.bodies import PLANE, Geometry, Poses
from nuno_schemas.colour import read_rgb
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Corners, Fabric, Float, Int
from nuno_schemas.messages import BODIES, EVENT, FABRIC, STATE, Event, Topic

GROUND = 4.0
"""Edge of the square that represents a plane that is not level, in sizes of the cloth."""


def draw_bodies(geometry: Geometry | None, size: float) -> Surfaces:
    """Return the surfaces of a scene's bodies for cloth of a size [m]."""
    if geometry is None:
        return NO_SURFACES
    level = geometry.b[geometry.kind == PLANE, 1] > 1.0 - 1e-9  # the page draws such a floor
    return surface(geometry, 0.0 if level.all() else GROUND * size)


def size_of(x: Float) -> float:
    """Return the diagonal of the bounding box of the finite points among (n, 3) [m]."""
    finite = x[np.isfinite(x).all(axis=1)]
    return float(np.linalg.norm(np.ptp(finite, axis=0))) if len(finite) else 1.0


def see_objects(loaded: Loaded) -> tuple[Sight, Fabric, list[Fabric]]:
    """Return a scene's cloth at the start, its fabric, and each object's. Raises BadInput for a scene without cloth."""
    if not loaded.scene.moves:
        remedy = "name a scene with objects, such as hanging-sheet"
        raise BadInput("there is no cloth here that moves", value=loaded.scene.name, remedy=remedy)
    bodies = build_bodies(loaded) if loaded.scene.bodies else None
    geometry, poses = (bodies.geometry, bodies.poses(0.0)) if bodies else (None, None)
    fabrics = cloth.build_fabrics(loaded, geometry, poses)
    fabric, pieces = join_fabrics(fabrics, loaded.scene.name), cloth.place_pieces(loaded, fabrics)
    drawn = draw_bodies(bodies.drawn if bodies else None, size_of(fabric.position))
    edges, rest = structural_edges(fabric)
    uv, image = _print(loaded, fabric, pieces)
    arrays: Arrays = {"x": fabric.position, "faces": fabric.faces, "edges": edges, "edge_rest": rest.astype(np.float32)}
    text = {"vertices": fabric.number, "objects": [vars(piece) for piece in pieces], "frame": 0, "t": 0.0}
    body = drawn.at(poses) if poses is not None else NO_POINTS
    sight = replace(
        see_now(arrays, text), body=body, body_faces=drawn.faces, frames=loaded.scene.frames, uv=uv, image=image
    )
    return sight, fabric, fabrics


def print_of(faces: Int, laid: Corners | None, shown: Sequence[int]) -> NDArray[np.float32]:
    """Return the texture coordinates of each triangle's corners, v down, (f, 6): NaN but for the vertices from shown[0]
    to shown[1], which have an image.
    """
    uv = np.full((len(faces), 6), np.nan, np.float32)
    if laid is not None:
        own = (faces >= shown[0]).all(axis=1) & (faces < shown[1]).all(axis=1)
        uv[own] = laid.in_image[laid.faces[own]].reshape(-1, 6)
    return uv


def _print(loaded: Loaded, fabric: Fabric, pieces: Iterable[Piece]) -> tuple[NDArray[np.float32] | None, bytes]:
    """Return where an image lies on a scene's cloth, and it as a PNG: empty for dye, which is drawn elsewhere."""
    dyed = loaded.scene.dye and loaded.dyed.said.object
    shown = next((one for one in pieces if (one.name == dyed if dyed else one.texture)), None)
    if shown is None or fabric.laid_out is None:
        return None, b""
    uv = print_of(fabric.faces, fabric.laid_out, (shown.start, shown.stop))
    return uv, b"" if dyed or not shown.texture else as_png(read_rgb(Path(shown.texture)))


def see_now(arrays: Arrays, text: Mapping[str, Any]) -> Sight:
    """Return a description of cloth, as `sim/fabric` has it, with x (n, 3) [m], frame and t [s], without its bodies.
    Raises BadMessage.
    """
    try:
        x, pieces = arrays["x"], cut_pieces(arrays, text)
        if x.shape != (text["vertices"], 3):
            raise ValueError(f"positions of shape {x.shape} for {text['vertices']} vertices")
        return Sight(
            x, arrays["faces"], tuple(Piece(one.name, one.start, one.stop, colour=one.colour) for one in pieces),
            edges=arrays["edges"], rest=arrays["edge_rest"], frame=int(text["frame"]), t=float(text["t"]),
        )  # fmt: skip
    except (LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise BadMessage(f"{NOW}: {error}") from None


# The cloth and the bodies at one moment, as bytes for the browser.

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
    uv (f, 6): where an image lies, as of `print_of`, or None; image: its PNG, empty for dye
    state   start (no run), preparing, running, paused, or the end state of a run
    """

    x: Float
    faces: Int
    pieces: tuple[Piece, ...]
    body: Float = field(default_factory=lambda: NO_POINTS)
    body_faces: Int = field(default_factory=lambda: NO_FACES)
    edges: Int = field(default_factory=lambda: NO_EDGES)
    rest: NDArray[np.float32] = field(default_factory=lambda: NO_LENGTHS)
    uv: NDArray[np.float32] | None = None
    image: bytes = b""
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
            arrays |= {} if self.uv is None else {"uv": self.uv}
        names = ("state", "run", "frame", "frames", "t", "message", "number", "shape", "place")
        head = {name: getattr(self, name) for name in names} | {
            "origin": origin.tolist(),
            "printed": bool(self.image),
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


# Follows a run for the page: shows its newest frame with the topology at that time.

EVENTS = Topic(f"{EVENT.name}/*", EVENT.encoding, EVENT.schema)
SAYS = {"pause": "paused", "resume": "running", "step": "running"}
"""State of a run after each request."""
PAUSE = 0.2
"""Silence after which the run is asked for its status [s]."""
INTERVAL = 1 / 60
"""Least time between two frames of the page [s]: screens show no more."""
ASK = 120.0
"""Longest wait for an answer [s]: the run answers between frames, and may be compiling."""
CLOSE = 5.0
"""Longest wait for a pending answer on closing [s]."""


def order(bus: Bus, request: dict[str, object]) -> dict[str, Any]:
    """Send a request of `nuno control` to a run, and return its answer. Raises BadInput if the run refuses it."""
    try:
        answer = bus.ask_json("control", request, ASK)
    except RunFailed as error:
        remedy = "look at what the run says where it was started"
        raise BadInput(f"the run does not answer: {error}", remedy=remedy) from None
    if answer.get("ok"):
        return answer
    error_fields = answer.get("refused", {"problem": str(answer.get("error", "refused"))})
    raise BadInput(**(error_fields | {"file": None}))  # the page does not know the run's name for the request


class Follower:
    """Shows a run on a board from a separate thread, until the run ends or `close` is called.

    Only the newest message of each topic is decoded: a page never slows a run. If the number of vertices of a state
    differs from that of the shown cloth, or the run sends a new fabric, the run is asked for positions and topology
    together, so that they always match.
    """

    def __init__(self, run: str, endpoint: str, board: Board, config: str | None = None) -> None:
        self.run, self.board = run, board
        self._stop, self.lost = threading.Event(), False
        """The request to stop following, and whether the run did not answer."""
        self._newest: dict[str, Message] = {}
        self._ended = ""
        self._bodies: Surfaces | None = None
        self._poses: Poses | None = None
        self._body = NO_POINTS
        self._stack = contextlib.ExitStack()
        session: zenoh.Session = self._stack.enter_context(spoke(endpoint, config, 1.0))
        self._bus = Bus(session, run, "page")
        self._inbox = Inbox(self._bus, [STATE, BODIES, FABRIC, EVENTS], newest_only=True)
        self._thread = threading.Thread(target=self._follow, name="page", daemon=True)

    def start(self) -> None:
        """Show the run's cloth, and keep following it. Raises RunFailed if the run does not answer."""
        self.see()
        self._thread.start()

    def see(self) -> None:
        """Ask the run for its cloth and bodies, and show them."""
        sight = see_now(*decode_arrays(self._bus.ask(NOW, timeout=ASK)))
        status = self._bus.ask_json("control", {"action": "status"}, ASK)
        if self._bodies is None:
            geometry = None
            with contextlib.suppress(RunFailed, BadMessage):  # a scene without bodies has no such service
                geometry = decode_geometry(self._bus.ask(DRAWN_QUERY, timeout=ASK))
            self._bodies = draw_bodies(geometry, size_of(sight.x))
        if len(self._bodies.faces):
            request = json.dumps({"frame": sight.frame}).encode()
            self._place(decode_poses(self._bus.ask(POSES_QUERY, request, ASK)))
        self.board.show(
            self._with_bodies(sight), state=str(status["state"]), run=self.run, frames=int(status["frames"]), message=""
        )

    def close(self) -> None:
        """Stop following the run."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE)
        self._bus.close()
        self._stack.close()

    def _place(self, poses: Poses) -> None:
        """Update the bodies' vertices, if their poses have changed."""
        before = self._poses
        if (before is None or not before.same_place(poses)) and self._bodies is not None:
            self._poses, self._body = poses, self._bodies.at(poses)

    def _with_bodies(self, sight: Sight) -> Sight:
        assert self._bodies is not None
        return replace(sight, body=self._body, body_faces=self._bodies.faces)

    def _follow(self) -> None:
        try:
            while not self._stop.is_set() and not self._ended:
                begin = time.monotonic()
                if not self._receive():
                    if self.run not in runs.running():
                        raise RunFailed("the run is over")
                    status = self._bus.ask_json("control", {"action": "status"}, ASK)
                    if status["state"] != self.board.now.state:
                        self.board.show(state=str(status["state"]))
                    continue
                if self.board.wanted(PAUSE):  # only shown frames are decoded
                    self._receive(0.0)
                self._show_newest()
                self._stop.wait(max(0.0, INTERVAL - (time.monotonic() - begin)))
        except (RunFailed, BadMessage, zenoh.ZError) as error:
            self.lost = True
            if not self._stop.is_set():
                self.board.show(state="lost", message=str(error))
            return
        if self._ended:
            self.board.show(state=self._ended)

    def _receive(self, patience: float = PAUSE) -> bool:
        """Receive all messages, after waiting up to `patience` [s] for the first; return whether there were any."""
        item = self._inbox.get(patience)
        received = item is not None
        while item is not None:
            if isinstance(item, Message) and item.topic.startswith(EVENT.name):
                self._handle(item)
            elif isinstance(item, Message):
                self._newest[item.topic] = item
            item = self._inbox.get(0)
        return received

    def _handle(self, message: Message) -> None:
        try:
            event = Event.model_validate_json(message.payload)
        except ValueError:
            return
        if event.kind == "end":
            self._ended = event.text
        elif event.kind == "control" and event.text in SAYS:
            self.board.show(state=SAYS[event.text])

    def _show_newest(self) -> None:
        newest, self._newest = self._newest, {}
        if BODIES.name in newest:
            self._place(decode_poses(newest[BODIES.name].payload))
        if FABRIC.name in newest and not self._ended:
            self.see()
            return
        if STATE.name not in newest:
            return
        message, shown = newest[STATE.name], self.board.now
        x = decode_points(message.payload)
        if len(x) == len(shown.x):
            sight = replace(shown, x=x, frame=message.header.frame, t=message.header.t)
            self.board.show(self._with_bodies(sight))
        elif not self._ended:
            self.see()
