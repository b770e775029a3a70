"""A run that goes on, as the page sees it: the newest frame, whatever its topology is by then."""

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
from nuno.collision.messages import GEOMETRY_QUERY, POSES_QUERY, decode_geometry, decode_poses
from nuno.collision.surfaces import Surfaces
from nuno.live_view.snapshot import NO_POINTS, Board, Sight
from nuno.live_view.sources import draw_bodies, see_now, size_of
from nuno.simulation.service import NOW
from nuno.supervision import runs
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import BODIES, EVENT, FABRIC, STATE, Event, Topic

EVENTS = Topic(f"{EVENT.name}/*", EVENT.encoding, EVENT.schema)
SAYS = {"pause": "paused", "resume": "running", "step": "running"}
"""What a run does after each request."""
PAUSE = 0.2
"""How long nothing may come [s] until it is asked whether the run goes on."""
INTERVAL = 1 / 60
"""Least time between two frames of the page [s]: more, no screen shows."""
ASK = 120.0
"""How long an answer may take [s]: it comes between frames, and of a run that may be compiling."""
CLOSE = 5.0
"""How long closing waits for what is being asked [s]."""


def order(bus: Bus, request: dict[str, object]) -> dict[str, Any]:
    """A request to a run, as of `nuno control`; what it answers. Raises BadInput where it refuses."""
    try:
        answer = bus.ask_json("control", request, ASK)
    except RunFailed as error:
        remedy = "look at what the run says where it was started"
        raise BadInput(f"the run does not answer: {error}", remedy=remedy) from None
    if answer.get("ok"):
        return answer
    told = answer.get("refused", {"problem": str(answer.get("error", "refused"))})
    raise BadInput(**(told | {"file": None}))  # whatever the run calls what it was asked


class Follower:
    """Follows one run in a thread of its own, on to a board, until the run ends or `close` is called.

    Messages are taken in as they come, and only the newest is looked into: a page never slows a run. Each state has
    a number of vertices; where it is another than the cloth's that is shown, or the run tells of new cloth, the run is
    asked for both at once, so that positions and triangles always belong together.
    """

    def __init__(self, run: str, endpoint: str, board: Board, config: str | None = None) -> None:
        self.run, self.board = run, board
        self._stop, self.lost = threading.Event(), False
        """Whether it is to follow no more, and whether the run did not answer."""
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
        """Show the run's cloth as it is, and go on showing it. Raises RunFailed where the run does not answer."""
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
        """Follow no more."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE)
        self._bus.close()
        self._stack.close()

    def _place(self, poses: Poses) -> None:
        """Move the bodies, where they have moved."""
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
                if not self._take_in():
                    self._look_after()
                    continue
                if self.board.wanted(PAUSE):  # bodies are placed for what is shown alone
                    self._take_in(0.0)
                self._show_newest()
                self._stop.wait(max(0.0, INTERVAL - (time.monotonic() - begin)))
        except (RunFailed, BadMessage, zenoh.ZError) as error:
            self.lost = True
            if not self._stop.is_set():
                self.board.show(state="lost", message=str(error))
            return
        if self._ended:
            self.board.show(state=self._ended)

    def _take_in(self, patience: float = PAUSE) -> bool:
        """Take in all that has come, or comes first within `patience` [s]; whether anything has."""
        item = self._inbox.get(patience)
        came = item is not None
        while item is not None:
            if isinstance(item, Message) and item.topic.startswith(EVENT.name):
                self._hear(item)
            elif isinstance(item, Message):
                self._newest[item.topic] = item
            item = self._inbox.get(0)
        return came

    def _hear(self, message: Message) -> None:
        try:
            event = Event.model_validate_json(message.payload)
        except ValueError:
            return
        if event.kind == "end":
            self._ended = event.text
        elif event.kind == "control" and event.text in SAYS:
            self.board.show(state=SAYS[event.text])

    def _look_after(self) -> None:
        """Nothing has come for a while: the run is paused, or it is no more."""
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
