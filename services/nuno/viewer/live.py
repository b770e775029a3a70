"""A live view that never slows a run, and the options of commands that open one."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil

from nuno.output_files import check_target
from nuno.viewer.stream import END, Subject
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import FRAMES, STATE

RING_BYTES = 64 * 2**20
"""Most bytes of frames on their way to the viewer; beyond that the oldest are skipped. A window takes
seconds to open: short runs of small cloth wait here meanwhile, and are shown completely."""
FINISH_SECONDS, FINISH_MOST = 20.0, 60.0
"""Longest wait for one of the last frames, and for all of them, once the viewer is connected [s]. The first frame of
dye waits for its painter, which may be compiled first; a viewer that hangs is given up before, after
`stream.FLUSH_SECONDS`.
"""
CONNECT_SECONDS = 20.0
"""Longest wait for the connection [s]: a first import may take longer than a short run."""

Item = tuple[str, int, float, bytes]


class Ring:
    """Queue of messages between two threads: all are kept except frames, which are dropped for newer ones."""

    def __init__(self, limit: int = RING_BYTES) -> None:
        self._limit, self._bytes = limit, 0
        self._items: deque[Item] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def put(self, item: Item) -> None:
        with self._changed:
            if self._closed:
                return
            self._items.append(item)
            self._bytes += _weight(item)
            while self._bytes > max(self._limit, _weight(item)):
                oldest = next(i for i, kept in enumerate(self._items) if _weight(kept))
                self._bytes -= _weight(self._items[oldest])
                del self._items[oldest]
            self._changed.notify()

    def get(self) -> Item | None:
        """Return the next message; None when the ring is closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            if not self._items:
                return None
            item = self._items.popleft()
            self._bytes -= _weight(item)
            return item

    def close(self, forget: bool = False) -> None:
        """Accept no more messages; with `forget`, drop the remaining ones."""
        with self._changed:
            self._closed = True
            if forget:
                self._items.clear()
                self._bytes = 0
            self._changed.notify_all()


def _weight(item: Item) -> int:
    """Return the bytes that count against the ring's limit: those of frames."""
    return len(item[3]) if item[0] in FRAMES else 0


class LiveView:
    """Passes messages to a process that shows them, `nuno.viewer.stream`.

    view      "window", "web" or the address of an open viewer
    subject   what is shown
    announce  called with messages for the user ("warning" or "start", text)
    leader    the topic with one message per frame

    `feed` returns at once, whatever the viewer does. `finish` waits until the viewer is connected, at most
    CONNECT_SECONDS, and then until it has taken all frames, at most FINISH_MOST, and FINISH_SECONDS while none is
    shown. A viewer that is closed, hangs or cannot start ends the view, not the run.
    """

    def __init__(
        self,
        view: str,
        subject: Subject,
        announce: Callable[[str, str], object],
        leader: str = STATE.name,
    ) -> None:
        self.frames = self.shown = 0
        self.pid: int | None = None
        self.page = ""
        self.error = ""
        self._announce, self._leader = announce, leader
        self._ring = Ring()
        self._connected = threading.Event()
        # -P: a module of the user's folder must not replace one of ours.
        command = [sys.executable, "-P", "-m", "nuno.viewer.stream", view, subject.model_dump_json()]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, start_new_session=True
        )
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._write, self._read)]
        for thread in self._threads:
            thread.start()

    @property
    def skipped(self) -> int:
        """Number of frames that were not shown so far."""
        return self.frames - self.shown

    def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
        """Pass on one message, without waiting."""
        self.frames += topic == self._leader
        self._ring.put((topic, frame, t, payload))

    def finish(self, last: str = END) -> None:
        """Wait for a limited time until the last frames are shown; the viewer itself stays open after END or LOOP, and
        ends as when this process is killed without a `last` message.
        """
        if last:
            self._ring.put((last, 0, 0.0, b""))
        self._ring.close()
        self._connected.wait(CONNECT_SECONDS)
        end = time.monotonic() + FINISH_MOST
        shown = -1
        while self._process.poll() is None and self.shown > shown and time.monotonic() < end:
            shown = self.shown
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(FINISH_SECONDS)
        if self._process.poll() is None:
            self._fail("the viewer was too slow for the last frames")
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
            if not line.startswith(b"{"):
                continue
            status = json.loads(line)
            self.shown = status.get("shown", self.shown)
            if "connected" in status:
                self._connected.set()
            if "pid" in status:
                self.pid, self.page = status["pid"], status["page"]
                what = "it is shown in the viewer that is open" if status["reused"] else "the viewer is open"
                self._announce("start", f"the viewer is at {self.page}" if self.page else what)
            if "warning" in status:
                self._announce("warning", status["warning"])
            if "error" in status:
                self._fail(status["error"])
        if self._process.wait() != 0:
            self._fail("it ended unexpectedly")
        self._connected.set()

    def _fail(self, error: str) -> None:
        """Note and announce the first error."""
        if not self.error:
            self.error = error
            self._announce("warning", f"the run goes on without a view: {error}")


def keep_page(view: str | None, answer: Mapping[str, Any], stays: bool = True) -> None:
    """Keep the page of a web view open until the user ends it (Ctrl-C), or, unless it `stays`, end it at once; `answer`
    is the viewer service's last.
    """
    if view != "web" or not answer.get("pid"):
        return
    with contextlib.suppress(psutil.NoSuchProcess):
        viewer = psutil.Process(int(answer["pid"]))
        try:
            if not stays:
                raise KeyboardInterrupt
            print("the page stays until you press Ctrl-C", flush=True)
            viewer.wait()
        except KeyboardInterrupt:
            viewer.terminate()
            viewer.wait()


# Requirements of viewing, checked before a run starts.

VIEWS = ("window", "web")
ADDRESS = "rerun+http://"


def has_screen() -> bool:
    """Return whether a window can be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def add_view(parser: argparse.ArgumentParser, no_view: str = "") -> None:
    """Add the flags of commands that show a run; `no_view` is the help text of --no-view, "" for a command that only
    shows.
    """
    view = parser.add_argument_group("viewing").add_mutually_exclusive_group()
    words = (
        "show it in rerun: a window (default where there is a screen), web on loopback, or the address of a viewer "
        f"that is open elsewhere, such as {ADDRESS}127.0.0.1:9876/proxy"
    )
    view.add_argument("--view", nargs="?", const="window", metavar="window|web|ADDRESS", help=words)
    if no_view:
        view.add_argument("--no-view", action="store_true", help=no_view)
    save = "also write a file for the rerun viewer" if no_view else "write a file for the rerun viewer instead"
    parser.add_argument("--save", type=Path, metavar="FILE.rrd", help=save)


def choose_view(args: argparse.Namespace) -> str | None:
    """Return the view of a run: by default a window, if there is a screen and no other output. Raises BadInput."""
    view: str | None = args.view
    if view is None and not args.no_view and args.save is None and has_screen():
        view = "window"
    require(view, args.save)
    return view


def require(view: str | None, save: Path | None, option: str = "--save") -> None:
    """Raise BadInput if a run could not be shown (`view`) or written (`save`) as requested.

    view  "window", "web", the address of a viewer that is open already, or None
    save  a rerun file to write, or None; `option` is the flag for it
    """
    if view is None and save is None:
        return
    if view is not None and view not in VIEWS and not view.startswith(ADDRESS):
        known = f"known: {', '.join(VIEWS)}, or an open viewer's address such as {ADDRESS}127.0.0.1:9876/proxy"
        raise BadInput("no such view", field="--view", value=view, remedy=known)
    if view == "window" and not has_screen():
        remedy = "--view web serves a page for a browser; --save FILE.rrd writes a file; --no-view shows nothing"
        raise BadInput("there is no screen to open a window on", field="--view", value=view, remedy=remedy)
    if save is not None:
        try:
            check_target(save, ".rrd")
        except BadInput as error:
            raise replace(error, field=option) from None
