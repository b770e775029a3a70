"""The run that the page follows on its bus: started by the page, in another process, or elsewhere."""

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

from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import spoke
from nuno.runtime import runs
from nuno.scene.scene_file import Loaded
from nuno.studio.cloth import Live
from nuno.studio.live_view import EVENTS, SAYS, order
from nuno.studio.processes import Child
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import DYE_STATUS, EVENT, STATUS, Event, FrameStatus
from nuno_schemas.scene import Scene

SPAN = 3.0
"""Wall time over which the real-time factor is measured [s]."""
LOOK = 0.1
"""Interval of looking for a run that is getting ready [s]."""
PAUSE = 0.3
"""Silence after which the run is asked for its status [s]."""
ASK = 30.0
"""Longest wait for that answer [s]."""
GOING = ("preparing", "running", "paused")
ENDS = {0: "over", 1: "failed", 2: "refused"}
"""State by exit code; a process that was ended by a signal has another code."""


class Run:
    """A run: of a scene's text, started here, or one that was started elsewhere.

    Its status of each frame comes in small messages, of which only the newest is read; positions are requested while
    a page shows the cloth (`live`). Neither slows the run.
    """

    def __init__(self, name: str, entry: str, child: Child | None = None, config: str | None = None) -> None:
        """`entry` is the page's name of the scene, `child` the process of a run that was started here."""
        self.name, self.entry = name, entry
        self.frames, self.end = 0, 0.0
        self.record = ""
        self._child, self._config = child, config
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.state, self.frame, self.t = "preparing", -1, 0.0
        self._warning, self._begun = "", time.monotonic()
        self._progress: deque[tuple[float, float]] = deque(maxlen=10_000)
        self._bus: Bus | None = None
        self.live: Live | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="studio", daemon=True)

    @classmethod
    def start(cls, loaded: Loaded, entry: str, text: str | None, paused: bool) -> Run:
        """Start a run of a scene, with `text` instead of the scene's file unless it is None."""
        path = loaded.path
        folder: tempfile.TemporaryDirectory[str] | None = None
        roots = [str(root) for root in loaded.files.roots]
        if text is not None:
            folder = tempfile.TemporaryDirectory(prefix="nuno-")
            roots.insert(0, str(loaded.files.folder))
            path = Path(folder.name) / path.name
            path.write_text(text, encoding="utf-8")
        more = [part for root in roots for part in ("--root", root)] + (["--paused"] if paused else [])
        run = cls._begin(loaded.scene, entry, [str(path), *more])
        run._folder = folder
        return run

    @classmethod
    def resume(cls, loaded: Loaded, arguments: Sequence[str]) -> Run:
        """Resume a recording; `arguments` are its file and the changes of its scene, as in `nuno run --resume`."""
        return cls._begin(loaded.scene, "", ["--resume", *arguments])

    @classmethod
    def _begin(cls, scene: Scene, entry: str, arguments: Sequence[str]) -> Run:
        name = runs.new_id(scene.name)
        run = cls(name, entry, Child(["run", *arguments, "--no-view", "--run", name]))
        run.frames, run.end = scene.frames, scene.frames / scene.frame_rate
        run.record = runs.record_path(runs.RECORDINGS, name).name
        run._thread.start()
        return run

    @classmethod
    def attach(cls, name: str, entry: str, config: str | None) -> Run:
        """Follow a run that was started elsewhere, and does not end with this object."""
        run = cls(name, entry, config=config)
        run._thread.start()
        return run

    @property
    def going(self) -> bool:
        return self._code is None

    @property
    def _code(self) -> int | None:
        """Exit code; None while the run goes on, 0 for an ended run from elsewhere."""
        if self._child is not None:
            return self._child.code
        return None if self.name in runs.running() else 0

    def tell(self) -> dict[str, Any]:
        """Return the run's state, progress, real-time factor and output for the page."""
        code = self._code
        # A run that has stopped still finishes its recording.
        now = self.state if self.state in GOING else "ending"
        killed = self.state == "stopped" and self._bus is None  # ended by a signal while it got ready
        return {
            "run": self.name,
            "scene": self.entry,
            "live": self.live is not None,
            "recording": self.record,
            "state": now if code is None else "stopped" if killed else ENDS.get(code, "stopped"),
            "frame": self.frame,
            "frames": self.frames,
            "t": self.t,
            "end": self.end,
            "waited": time.monotonic() - self._begun,
            "factor": self._factor() if self.state == "running" and code is None else None,
            "said": (self._child.said if self._child is not None else "") + self._warning,
        }

    def _factor(self) -> float | None:
        """Return the real-time factor of the last SPAN; None with too few frames."""
        now, progress = time.monotonic(), list(self._progress)
        first = next((one for one in progress if now - one[0] <= SPAN), None)
        if first is None or progress[-1][0] <= first[0]:
            return None
        return (progress[-1][1] - first[1]) / (progress[-1][0] - first[0])

    def control(self, action: str, **more: object) -> dict[str, Any]:
        """Pause, resume, step or stop the run, set a field or add an item; return its answer. Raises BadInput."""
        if not self.going:
            raise BadInput("no run goes on", remedy="start one with Run")
        if self._bus is None:
            if action != "stop":
                raise BadInput("the run is getting ready", remedy="wait until it has begun, or stop it")
            if self._child is not None:
                self.state = "stopped"
                self._child.end()
            return {}
        answer = order(self._bus, {"action": action} | more)
        self.state, self.frame, self.t = str(answer["state"]), int(answer["frame"]), float(answer["t"])
        if action not in ("set", "add"):
            self._progress.clear()
        return answer

    def close(self) -> None:
        """End a run that was started here, and stop following it."""
        if self._child is not None and self.going:
            with contextlib.suppress(BadInput):
                self.control("stop")
            self._child.end(terminate=self._bus is None)
        self._closed.set()
        if self.live is not None:
            self.live.close()
        self._thread.join(ASK)
        if self._folder is not None:
            self._folder.cleanup()

    def _follow(self) -> None:
        endpoint: str | None = None
        while self.going and endpoint is None and not self._closed.wait(LOOK):
            endpoint = runs.running().get(self.name)
        if endpoint is None:
            return
        try:
            self._listen(endpoint)
        except (RunFailed, zenoh.ZError) as error:
            if self.going:
                self._warning = f"\nWARNING this page does not hear the run: {error}"

    def _listen(self, endpoint: str) -> None:
        with spoke(endpoint, self._config, 1.0) as session:
            bus = Bus(session, self.name, "studio")
            inbox = Inbox(bus, [STATUS, DYE_STATUS, EVENTS], newest_only=True)
            self._query_status(bus)
            self._bus = bus
            while self.going and not self._closed.is_set():
                if self.live is None and self.state != "preparing":  # its services answer
                    self.live = Live(self.name, endpoint, self._config)
                item = inbox.get(PAUSE)
                if isinstance(item, Message):
                    self._handle(item)
                else:  # it is paused, for example after a step, or its frame takes long
                    self._query_status(bus)
            bus.close()

    def _query_status(self, bus: Bus) -> None:
        """Ask the run for its status, since a paused run sends no messages."""
        with contextlib.suppress(RunFailed):
            answer = bus.ask_json("control", {"action": "status"}, ASK)
            self.state, self.frame, self.t = str(answer["state"]), int(answer["frame"]), float(answer["t"])
            self.frames = int(answer["frames"])

    def _handle(self, message: Message) -> None:
        with contextlib.suppress(ValueError):
            if message.topic.startswith(EVENT.name):
                event = Event.model_validate_json(message.payload)
                if event.kind == "control" and event.text in SAYS:
                    self.state = SAYS[event.text]
                    self._progress.clear()
                return
            status = FrameStatus.model_validate_json(message.payload)
            if status.frame < self.frame:  # older than the last queried status
                return
            self.frame, self.t = status.frame, status.t
            self.state = status.state if status.state != "done" else self.state
            self._progress.append((time.monotonic(), status.t))
