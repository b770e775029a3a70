"""The cloth that the page shows: of scenes at their start, and of the run that goes on."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import zenoh

from nuno.bus.encodings import BadMessage
from nuno.cloth import build
from nuno.draw.keep import Trial
from nuno.live_view.follower import Follower
from nuno.live_view.snapshot import NO_FACES, NO_POINTS, Board, Sight
from nuno.live_view.sources import see_objects
from nuno.pages.guard import Refused
from nuno.pages.server import NOT_FOUND, whole
from nuno.pages.worker import Workshop
from nuno.scene.scene_file import Loaded
from nuno.studio import scenes
from nuno.supervision import runs
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric

MOST = 4
"""Starts that are kept for pages: each page shows the newest that it has asked for."""
LEAVE = 2.0
"""How long nobody looks at a run [s] until it is followed no more: a page asks again at once."""
AGAIN = 0.5
"""How long a page that could not be shown a run waits until it asks again [s]."""
NO_COLOURS = "dye and textures are not shown here: the picture of a recording has them"


@dataclass(frozen=True)
class Start:
    """A scene's cloth as it begins, as it is shown and as it is tried."""

    loaded: Loaded
    sight: Sight
    fabric: Fabric
    objects: Sequence[Fabric]

    @cached_property
    def trial(self) -> Trial:
        """Of its objects, on which lines are tried."""
        return Trial(self.loaded, self.objects)


class Starts:
    """The cloth of scenes as they begin, built in a workshop when a page asks for it, without a run."""

    def __init__(self, workshop: Workshop) -> None:
        self._numbers = itertools.count(1)
        self.kept: dict[int, Start] = {}
        self._workshop = workshop

    def see(self, loaded: Loaded, page: str, *text: Any) -> dict[str, Any]:
        """Build a scene's cloth: the number that it is told by, and what is not shown of it, in words. Raises BadInput.

        text: what `scenes.load` makes the scene of.
        """
        sight, fabric, objects = self._workshop.make(page, _build, *text)
        number = next(self._numbers)
        self.kept[number] = Start(loaded, Board(sight).now, fabric, objects)
        for old in sorted(self.kept)[:-MOST]:
            self.kept.pop(old, None)
        return {"number": number, "words": NO_COLOURS if _painted(loaded, sight) else ""}

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """One of them, for the page that asked for it. Raises Refused."""
        start = self.kept.get(whole(query, "number"))
        if start is None:
            raise Refused(NOT_FOUND, "this start is no longer kept")
        return "application/octet-stream", start.sight.encode(-1, -1)


def _build(*text: Any) -> tuple[Sight, Fabric, list[Fabric]]:
    loaded = scenes.load(*text)
    build.check_memory(loaded)
    return see_objects(loaded)


def _painted(loaded: Loaded, sight: Sight) -> bool:
    return loaded.scene.dye is not None or any(piece.texture for piece in sight.pieces)


class Live:
    """A run's cloth as it moves. It is followed only while a page looks at it: nothing of it is sent here else."""

    def __init__(self, run: str, endpoint: str, config: str | None = None) -> None:
        self.run, self.endpoint, self.config = run, endpoint, config
        self.board = Board(Sight(NO_POINTS, NO_FACES, ()))
        self.follower: Follower | None = None
        self._looking, self._last = 0, 0.0
        self._lock = threading.Lock()
        self._closed = threading.Event()

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """The next frame, for a page that says what it has. Raises Refused."""
        with self._looked():
            return self.board.tell(query)

    @contextlib.contextmanager
    def _looked(self) -> Iterator[None]:
        with self._lock:
            self._looking += 1
            if self.follower is not None and self.follower.lost and self.run in runs.running():
                self.follower = None  # it did not answer for a while
            if self.follower is None and not self._closed.is_set():
                self._begin()
        try:
            yield
        finally:
            with self._lock:
                self._looking -= 1
                self._last = time.monotonic()

    def _begin(self) -> None:
        follower = None
        try:
            follower = Follower(self.run, self.endpoint, self.board, self.config)
            follower.start()
        except (RunFailed, BadInput, BadMessage, zenoh.ZError) as error:
            if follower is not None:
                follower.close()
            self.board.show(state="lost", message=str(error))
            self._closed.wait(AGAIN)
        else:
            self.follower = follower
            threading.Thread(target=self._leave, args=(follower,), name="leave", daemon=True).start()

    def _leave(self, follower: Follower) -> None:
        """Follow no more once nobody has looked for a while."""
        while not self._closed.wait(LEAVE / 4):
            with self._lock:
                if self.follower is not follower:
                    break
                if not self._looking and time.monotonic() - self._last > LEAVE:
                    self.follower = None
                    break
        follower.close()

    def close(self) -> None:
        """Follow no more."""
        self._closed.set()
