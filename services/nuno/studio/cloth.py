"""The cloth shown in the page: of scenes at their start, and of the present run."""

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
from nuno.runtime import runs
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno.studio import scenes
from nuno.studio.draw import Trial
from nuno.studio.live_view import NO_FACES, NO_POINTS, Board, Follower, Sight, see_objects
from nuno.studio.processes import Workshop
from nuno.studio.server import NOT_FOUND, Refused, whole
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric

MOST = 4
"""Starts that are kept: each page shows the newest that it requested."""
LEAVE = 2.0
"""Time without a viewing page after which a run is no longer followed [s]: a viewing page asks again at once."""
AGAIN = 0.5
"""Wait of a page before it asks again for a run that could not be followed [s]."""
NO_DYE = "dye is shown as it begins: the replay of a recording has it over time"


@dataclass(frozen=True)
class Start:
    """A scene's cloth at its start, for display and for checks of lines."""

    loaded: Loaded
    sight: Sight
    objects: Sequence[Fabric]

    @cached_property
    def trial(self) -> Trial:
        """The trial of its objects, for checks of lines."""
        return Trial(self.loaded, self.objects)


class Starts:
    """Builds the cloth of scenes at their start in a workshop when a page asks for it, without a run."""

    def __init__(self, workshop: Workshop) -> None:
        self._numbers = itertools.count(1)
        self.kept: dict[int, Start] = {}
        self._workshop = workshop

    def see(self, loaded: Loaded, page: str, *text: Any) -> dict[str, Any]:
        """Build a scene's cloth, and return its number and a remark on parts that are not shown. Raises BadInput.

        text: the arguments of `scenes.load`.
        """
        sight, _, objects = self._workshop.make(page, _build, *text)
        number = next(self._numbers)
        self.kept[number] = Start(loaded, Board(sight).now, objects)
        for old in sorted(self.kept)[:-MOST]:
            self.kept.pop(old, None)
        return {"number": number, "words": NO_DYE if loaded.scene.dye is not None else ""}

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return the bytes of a start for the page. Raises Refused."""
        start = self.kept.get(whole(query, "number"))
        if start is None:
            raise Refused(NOT_FOUND, "this start is no longer kept")
        if query.get("image"):
            return "image/png", start.sight.image
        return "application/octet-stream", start.sight.encode(-1, -1)


def _build(*text: Any) -> tuple[Sight, Fabric, list[Fabric]]:
    loaded = scenes.load(*text)
    cloth.check_memory(loaded)
    return see_objects(loaded)


class Live:
    """A run's moving cloth. It is followed only while a page shows it: otherwise nothing of it is sent here."""

    def __init__(self, run: str, endpoint: str, config: str | None = None) -> None:
        self.run, self.endpoint, self.config = run, endpoint, config
        self.board = Board(Sight(NO_POINTS, NO_FACES, ()))
        self.follower: Follower | None = None
        self._viewers, self._last = 0, 0.0
        self._lock = threading.Lock()
        self._closed = threading.Event()

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return the next frame after the one that the page has. Raises Refused."""
        with self._viewing():
            return self.board.tell(query)

    @contextlib.contextmanager
    def _viewing(self) -> Iterator[None]:
        with self._lock:
            self._viewers += 1
            if self.follower is not None and self.follower.lost and self.run in runs.running():
                self.follower = None  # it did not answer for a while
            if self.follower is None and not self._closed.is_set():
                self._begin()
        try:
            yield
        finally:
            with self._lock:
                self._viewers -= 1
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
        """Stop following after a time without viewers."""
        while not self._closed.wait(LEAVE / 4):
            with self._lock:
                if self.follower is not follower:
                    break
                if not self._viewers and time.monotonic() - self._last > LEAVE:
                    self.follower = None
                    break
        follower.close()

    def close(self) -> None:
        """Stop following the run."""
        self._closed.set()
