"""The run that was started from the page: a process of its own, heard on its bus."""

from __future__ import annotations

import contextlib
import tempfile
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import zenoh

from nuno.pages.child import Child
from nuno.scene.scene_file import Loaded
from nuno.seen.follow import EVENTS, SAYS, order
from nuno.studio.cloth import Live
from nuno.supervision import runs
from nuno.wire.bus import Bus, Inbox, Message
from nuno.wire.sessions import spoke
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import DYE_STATUS, EVENT, STATUS, Event, FrameStatus

SPAN = 3.0
"""Wall time that the real-time factor is told of [s]."""
LOOK = 0.1
"""How often a run that is getting ready is looked for [s]."""
PAUSE = 0.3
"""How long nothing may come [s] until the run is asked what it does."""
ASK = 30.0
"""How long that answer may take [s]."""
GOING = ("preparing", "running", "paused")
ENDS = {0: "over", 1: "failed", 2: "refused"}
"""What exit codes mean; another is that of a process that was ended by a signal."""


class Run:
    """One run of a scene's text.

    What the run's services say of each frame is heard in small messages, of which only the newest is taken; positions
    are asked for while a page looks at the cloth (`live`). Neither slows the run.
    """

    def __init__(
        self, loaded: Loaded, entry: str, text: str | None, paused: bool, resume: Sequence[str] | None = None
    ) -> None:
        """entry: what the page calls the scene; text: what is run in the place of its file, where it is another;
        resume: a recording to go on with, and what is changed of its scene, as arguments of --resume.
        """
        scene, path = loaded.scene, loaded.path
        self.name, self.entry = runs.new_id(scene.name), entry
        self.frames, self.end = scene.frames, scene.frames / scene.frame_rate
        self.record = runs.record_path(runs.RECORDINGS, self.name)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        roots: list[str] = []
        if text is not None:
            self._folder = tempfile.TemporaryDirectory(prefix="nuno-")
            for root in (loaded.files.folder, *loaded.files.roots):
                roots += ["--root", str(root)]
            path = Path(self._folder.name) / path.name
            path.write_text(text, encoding="utf-8")
        more = ["--paused"] if paused else []
        what = [str(path)] if resume is None else ["--resume", *resume]
        self._child = Child(["run", *what, "--no-view", "--run", self.name, *roots, *more])
        self.state, self.frame, self.t = "preparing", -1, 0.0
        self._heard: deque[tuple[float, float]] = deque(maxlen=10_000)
        self._bus: Bus | None = None
        self.live: Live | None = None
        self._thread = threading.Thread(target=self._follow, name="studio", daemon=True)
        self._thread.start()

    @property
    def going(self) -> bool:
        return self._child.code is None

    def tell(self) -> dict[str, Any]:
        """What the page shows: the state, how far it is, simulated seconds a second, and what the run has printed."""
        code = self._child.code
        # A run that has stopped still finishes its recording.
        now = self.state if self.state in GOING else "ending"
        return {
            "run": self.name,
            "scene": self.entry,
            "live": self.live is not None,
            "recording": self.record.name,
            "state": now if code is None else ENDS.get(code, "stopped"),
            "frame": self.frame,
            "frames": self.frames,
            "t": self.t,
            "end": self.end,
            "factor": self._factor() if self.state == "running" and code is None else None,
            "said": self._child.said[-20_000:],
        }

    def _factor(self) -> float | None:
        """The real-time factor of the last SPAN; None where there are too few frames."""
        now, heard = time.monotonic(), list(self._heard)
        first = next((one for one in heard if now - one[0] <= SPAN), None)
        if first is None or heard[-1][0] <= first[0]:
            return None
        return (heard[-1][1] - first[1]) / (heard[-1][0] - first[0])

    def control(self, action: str, **more: object) -> dict[str, Any]:
        """Pause, resume, step or stop it, or set a field; what it answers. Raises BadInput."""
        if not self.going:
            raise BadInput("no run goes on", remedy="start one with Run")
        if self._bus is None:
            if action != "stop":
                raise BadInput("the run is getting ready", remedy="wait until it has begun, or stop it")
            self._child.end()
            return {}
        answer = order(self._bus, {"action": action} | more)
        self.state, self.frame, self.t = str(answer["state"]), int(answer["frame"]), float(answer["t"])
        if action != "set":
            self._heard.clear()
        return answer

    def close(self) -> None:
        """End it, where it goes on."""
        if self.going:
            with contextlib.suppress(BadInput):
                self.control("stop")
            self._child.end(terminate=self._bus is None)
        if self.live is not None:
            self.live.close()
        self._thread.join(ASK)
        if self._folder is not None:
            self._folder.cleanup()

    def _follow(self) -> None:
        endpoint: str | None = None
        while self.going and endpoint is None:
            time.sleep(LOOK)
            endpoint = runs.running().get(self.name)
        if endpoint is None:
            return
        with contextlib.suppress(RunFailed, zenoh.ZError), spoke(endpoint, None, 1.0) as session:
            bus = Bus(session, self.name, "studio")
            inbox = Inbox(bus, [STATUS, DYE_STATUS, EVENTS], newest_only=True)
            self._ask(bus)
            self._bus, self.live = bus, Live(self.name, endpoint)
            while self.going:
                item = inbox.get(PAUSE)
                if isinstance(item, Message):
                    self._hear(item)
                else:  # it stands, as it does after a step, or its frame takes long
                    self._ask(bus)
            bus.close()

    def _ask(self, bus: Bus) -> None:
        """What the run does, asked of it: it says nothing by itself while it stands."""
        with contextlib.suppress(RunFailed):
            answer = bus.ask_json("control", {"action": "status"}, ASK)
            self.state, self.frame, self.t = str(answer["state"]), int(answer["frame"]), float(answer["t"])

    def _hear(self, message: Message) -> None:
        with contextlib.suppress(ValueError):
            if message.topic.startswith(EVENT.name):
                event = Event.model_validate_json(message.payload)
                if event.kind == "control" and event.text in SAYS:
                    self.state = SAYS[event.text]
                    self._heard.clear()
                return
            status = FrameStatus.model_validate_json(message.payload)
            self.frame, self.t = status.frame, status.t
            self.state = status.state if status.state != "done" else self.state
            self._heard.append((time.monotonic(), status.t))
