"""Follows a run for the page: shows its newest frame with the topology at that time."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from dataclasses import replace
from typing import Any

import zenoh

from nuno.bus.encodings import BadMessage, decode_arrays, decode_points
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import spoke
from nuno.collision.bodies import Surfaces
from nuno.collision.messages import GEOMETRY_QUERY, POSES_QUERY, decode_geometry, decode_poses
from nuno.runtime import runs
from nuno.simulation.service import NOW
from nuno.studio.live_view.snapshot import NO_POINTS, Board, Sight
from nuno.studio.live_view.sources import draw_bodies, see_now, size_of
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import BODIES, EVENT, FABRIC, STATE, Event, Topic

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
                geometry = decode_geometry(self._bus.ask(GEOMETRY_QUERY, timeout=ASK))
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
                    self._check_status()
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

    def _check_status(self) -> None:
        """After a silence, show whether the run is paused. Raises RunFailed if it has ended."""
        if self.run not in runs.running():
            raise RunFailed("the run is over")
        status = self._bus.ask_json("control", {"action": "status"}, ASK)
        if status["state"] != self.board.now.state:
            self.board.show(state=str(status["state"]))

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
