"""What the page asks for: start and control a run, add lines to it, save and export them."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Mapping
from typing import Any

from nuno.draw import keep
from nuno.draw.lines import by_object, pieces_of, read_strokes, to_obj
from nuno.draw.refusals import beside
from nuno.draw.shown import see_scene
from nuno.pages.child import Child
from nuno.pages.server import Server, describe
from nuno.scene.scene_file import Loaded
from nuno.seen.follow import Follower
from nuno.seen.sight import Board, Sight
from nuno.supervision import runs
from nuno.wire.arrays import BadMessage
from nuno_schemas.errors import BadInput, RunFailed

START_PATIENCE = 1800.0
"""Longest that a run may take to be there [s]: the first one on a machine compiles kernels for minutes."""
ACTS = dict.fromkeys(("pause", "resume", "step"), "control")
ACTS |= {name: name for name in ("about", "start", "back", "check", "apply", "save", "export")}
"""What the page may ask for, and which method of a desk does it."""


class Desk:
    """One page's work.

    loaded   the scene; None for a run whose scene is nowhere to be read
    follower the run that the page shows, if there is one
    """

    def __init__(self, loaded: Loaded | None, board: Board, follower: Follower | None = None) -> None:
        self.loaded, self.board, self.follower = loaded, board, follower
        self.start_sight = board.now
        """What the page began with: lines are saved by their places there."""
        self._own: Child | None = None
        self._waiting: threading.Thread | None = None
        self._trial: keep.Trial | None = None
        self._keeper = keep.Keeper(loaded) if loaded is not None else None
        self._lock = threading.Lock()

    def act(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out one request of the page's. Raises BadInput, which the page shows."""
        name = str(request.get("do"))
        if name not in ACTS:
            raise BadInput("no such request", value=name, limit=", ".join(ACTS))
        if name == "check":  # it may compile kernels for a while, and changes nothing
            return self.check(request)
        with self._lock:
            found: dict[str, Any] = getattr(self, ACTS[name])(request)
            return found

    def server(self) -> Server:
        """What serves the page, until it is closed."""
        return Server("nuno.draw", self.act, {"frame": self.board.tell})

    def about(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """What the page begins with."""
        scene = self.loaded.scene if self.loaded else None
        return {
            "name": scene.name if scene else self.board.now.run,
            "canStart": self.loaded is not None and self.follower is None,
            "target": self._keeper.path.name if self._keeper else "",
        }

    # A run of one's own: a process of its own, so that the page answers while kernels compile.
    def start(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Start a run of the scene, which waits before its first frame. Raises BadInput."""
        if self.loaded is None or self.follower is not None or self._own is not None:
            raise BadInput("a run goes on already", remedy="pause it, or go back to the start")
        run = runs.new_id(self.loaded.scene.name)
        saved = self._keeper is not None and self._keeper.saved
        self._own = Child(_arguments(self.loaded, run, saved))
        self.board.show(state="preparing", run=run)
        self._waiting = threading.Thread(target=self._join, args=(run, self._own), daemon=True)
        self._waiting.start()
        return {"run": run}

    def _join(self, run: str, process: Child) -> None:
        """Wait until a run that was started here can be followed, and show it; or show why it is not there."""
        end = time.monotonic() + START_PATIENCE
        while process.code is None and time.monotonic() < end and self._own is process:
            endpoint = runs.running().get(run)
            if endpoint is not None:
                with contextlib.suppress(RunFailed, BadInput, BadMessage):
                    # It is there to be asked before the page sees that it is.
                    self.follower = follower = Follower(run, endpoint, self.board)
                    try:
                        if self.loaded is not None and any(op.at == 0.0 for op in self.loaded.scene.operations):
                            follower.step()  # what the scene itself does to the cloth comes first
                        follower.start()
                    except BaseException:
                        self.follower = None
                        follower.close()
                        raise
                    return
            time.sleep(0.1)
        if self._own is process:
            self._own = None
            said = process.said[-2000:] or "the run did not start"
            self.board.show(self.start_sight, state="start", run="", message=said)

    def back(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """End the run that was started here, and show the scene's start again."""
        if self.loaded is None or (self._own is None and self.follower is not None):
            raise BadInput(
                "this run was not started here", remedy="end it where it was started, or: nuno control RUN stop"
            )
        self._end_own()
        self.start_sight = see_scene(self.loaded)
        self.board.show(self.start_sight, state="start", run="", frame=0, t=0.0, message="")
        return {}

    def _end_own(self) -> None:
        follower, process = self.follower, self._own
        self.follower = self._own = None
        if follower is not None:
            if process is not None and follower.going:
                with contextlib.suppress(BadInput):
                    follower.control(action="stop")
            follower.close()
        if process is not None:
            process.end(terminate=follower is None)

    def close(self) -> None:
        """End what was started here."""
        with self._lock:
            self._end_own()

    def control(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Pause, resume or step the run. Raises BadInput."""
        answer = self._running().control(action=request["do"])
        self.board.show(state=str(answer["state"]))
        return {"state": answer["state"]}

    def _running(self) -> Follower:
        if self.follower is None or not self.follower.going:
            raise BadInput("no run goes on", remedy="start one with Simulate")
        return self.follower

    def _sight(self, request: Mapping[str, Any]) -> Sight:
        """What is shown, if the page has drawn on that. Raises BadInput."""
        sight = self.board.now
        if request.get("shape") != sight.shape:
            remedy = "try again: the lines have moved along"
            raise BadInput("the cloth's triangles have changed meanwhile", field="shape", remedy=remedy)
        return sight

    def check(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Try the lines on the cloth as the scene begins, where that is what is shown. Raises BadInput."""
        sight = self._sight(request)
        if self.loaded is None or sight.state != "start":
            return {}
        if self._trial is None:
            self._trial = keep.Trial(self.loaded)
        strokes = read_strokes(request.get("lines"), sight)
        for which in pieces_of(strokes, sight).values():
            lines = by_object([strokes[i] for i in which], sight)
            (operation,) = keep.as_operations(lines, request.get("settings"))
            try:
                self._trial.apply(operation)
            except BadInput as error:
                raise beside(error, strokes, which, sight) from None
        return {}

    def apply(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Add lines to the run, those of each object at once; numbers of those that it took, and what it refused."""
        follower, sight = self._running(), self._sight(request)
        strokes = read_strokes(request.get("lines"), sight)
        refused: dict[str, Any] = {}
        applied: list[int] = []
        for which in pieces_of(strokes, sight).values():
            lines = by_object([strokes[i] for i in which], sight)
            (item,) = keep.as_items(lines, request.get("settings"))
            try:
                follower.control(action="add", item=item)
            except BadInput as error:
                refused = {"ok": False} | describe(beside(error, strokes, which, sight))
                break
            applied += which
        with contextlib.suppress(RunFailed, BadMessage):
            follower.see()
        return {"applied": applied} | refused

    def save(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Add lines to the scene's file. Raises BadInput."""
        if self._keeper is None:
            raise BadInput("the run's scene is no file that lines could be added to", remedy="export the lines instead")
        base = self.start_sight
        strokes = read_strokes(request.get("lines"), base)
        lines = {exact: by_object(strokes, base, exact) for exact in (True, False)}
        return self._keeper.save(base, lines, request.get("settings"))

    def export(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The lines as an OBJ file's text, which the browser saves. Raises BadInput."""
        sight = self._sight(request)
        name = self.loaded.scene.name if self.loaded else sight.run
        return {"name": f"{name}-lines.obj", "text": to_obj(read_strokes(request.get("lines"), sight), sight)}


def _arguments(loaded: Loaded, run: str, saved: bool) -> list[str]:
    roots = [text for root in loaded.files.roots for text in ("--root", str(root))]
    # The scene as it was opened: what is saved to its file meanwhile, the page adds itself.
    opened = f"{keep.LIST}={json.dumps(loaded.data.get(keep.LIST) or [])}"
    changes = [text for item in (*loaded.overrides, *([opened] if saved else [])) for text in ("--set", item)]
    return ["run", str(loaded.path), "--paused", "--no-view", "--run", run, *roots, *changes]
