"""A live view that never holds up a run."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable

from nuno_schemas.messages import STATE
from nuno_schemas.scene import View

RING = 16
"""Frames on their way to the viewer; when there are more, the oldest is skipped."""
FINISH_SECONDS = 5.0
"""How long the viewer may take for the last frames."""

Item = tuple[str, int, float, bytes]


class Ring:
    """Messages between two threads: every one is kept but frames, which give way to newer ones."""

    def __init__(self, frames: int = RING) -> None:
        self.skipped = 0
        self._limit, self._waiting = frames, 0
        self._items: deque[Item] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def put(self, item: Item) -> None:
        with self._changed:
            if self._closed:
                return
            if item[0] == STATE.name:
                self._waiting += 1
                if self._waiting > self._limit:
                    oldest = next(i for i, kept in enumerate(self._items) if kept[0] == STATE.name)
                    del self._items[oldest]
                    self._waiting -= 1
                    self.skipped += 1
            self._items.append(item)
            self._changed.notify()

    def get(self) -> Item | None:
        """The next message; None when the ring is closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            if not self._items:
                return None
            item = self._items.popleft()
            self._waiting -= item[0] == STATE.name
            return item

    def close(self, forget: bool = False) -> None:
        """Take nothing more; with `forget`, drop what is left."""
        with self._changed:
            self._closed = True
            if forget:
                self._drop()
            self._changed.notify_all()

    def _drop(self) -> None:
        self.skipped += self._waiting
        self._items.clear()
        self._waiting = 0


class LiveView:
    """Hands messages to a process that shows them; see `nuno.viewer.stream`.

    view      "window", "web" or the address of an open viewer
    announce  called with what there is to tell the user ("warning" or "start", text)

    `feed` returns at once, whatever the viewer does. `finish` takes at most about
    FINISH_SECONDS. A viewer that is closed, hangs or cannot start ends the view, not the run.
    """

    def __init__(self, view: str, run: str, scene_view: View, announce: Callable[[str, str], None]) -> None:
        self.shown = 0
        self.pid: int | None = None
        self.page = ""
        self.error = ""
        self._announce = announce
        self._ring = Ring()
        command = [sys.executable, "-m", "nuno.viewer.stream", view, run, scene_view.model_dump_json()]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, start_new_session=True)
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._write, self._read)]
        for thread in self._threads:
            thread.start()

    @property
    def skipped(self) -> int:
        """Frames that the viewer was too slow for."""
        return self._ring.skipped

    def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
        """Pass one message on, without waiting."""
        self._ring.put((topic, frame, t, payload))

    def finish(self) -> None:
        """Wait, not for long, until the last frames are shown; the viewer itself stays open."""
        self._ring.close()
        try:
            self._process.wait(FINISH_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._ring.close(forget=True)
        for thread in self._threads:
            thread.join(1.0)

    def _write(self) -> None:
        stdin = self._process.stdin
        assert stdin is not None
        try:
            while (item := self._ring.get()) is not None:
                topic, frame, t, payload = item
                head = json.dumps({"topic": topic, "frame": frame, "t": t, "size": len(payload)})
                stdin.write(head.encode() + b"\n" + payload)
                stdin.flush()
            stdin.close()
        except OSError:
            self._ring.close(forget=True)

    def _read(self) -> None:
        stdout = self._process.stdout
        assert stdout is not None
        for line in stdout:
            said = json.loads(line)
            self.shown = said.get("shown", self.shown)
            if "pid" in said:
                self.pid, self.page = said["pid"], said["page"]
                self._announce("start", f"the viewer is at {self.page}" if self.page else "the viewer is open")
            if "error" in said:
                self.error = said["error"]
                self._announce("warning", f"the run goes on without a view: {self.error}")
