"""What the simulation asks the collision service: what the bodies are, and where they are in each frame."""

from __future__ import annotations

import json
from collections import deque

from nuno.collision.messages import GEOMETRY_QUESTION, POSES_QUESTION, decode_geometry, decode_poses
from nuno.service import Context
from nuno.stepping.driver import WINDOW
from nuno.wire.asked import Asked
from nuno.wire.sessions import PATIENCE
from nuno_schemas.bodies import Geometry, Poses


def ask_geometry(context: Context) -> Geometry:
    """The bodies of a run, once their service is there. Raises RunFailed if it does not come.

    How long that may take is for the supervisor to say, who then goes: a distance field may have to be built there.
    """
    while context.watch.wait_for({"collision"}, 0.1):
        context.require_supervisor()
    return decode_geometry(context.bus.ask(GEOMETRY_QUESTION))


def ask_poses(context: Context, frame: int) -> Asked:
    """Ask for a frame's poses now."""
    return context.bus.ask_ahead(POSES_QUESTION, json.dumps({"frame": frame}).encode(), PATIENCE)


def take_poses(context: Context, frame: int, asked: Asked) -> Poses:
    """The poses of a frame that were asked for, waited for; it is said where that takes long.

    The service answers between two measurements, which on a busy machine take their time; and what is asked ahead
    waits while the cloth steps. A service that dies is noticed by whoever supervises it.
    """

    def slow() -> None:
        limit = f"given up after {PATIENCE:g} s"
        context.event("warning", f"waiting for the collision service: no bodies of frame {frame} yet ({limit})")

    return decode_poses(asked.answer(slow))


class PosesAhead:
    """Poses of the next frames, asked for before the steps wait for them.

    The collision service answers between two measurements, and what the way there and back takes is shared by as many
    frames as are asked for at once.
    """

    def __init__(self, context: Context) -> None:
        self._context, self._frames = context, context.loaded.scene.frames
        self._ahead = 0 if context.loaded.live else WINDOW
        """Frames beyond the next; of bodies that are told where to be none is known yet."""
        self._coming: deque[Asked] = deque()

    def there(self, frame: int) -> bool:
        """Whether those of the next frame have come; they are asked for where they have not been yet. Raises Refused
        where none will come, RunFailed where the service is gone.
        """
        self._ask(frame)
        asked = self._coming[0]
        if there := asked.there():
            asked.answer()
        return there

    def take(self, frame: int) -> Poses:
        """Those of the next frame. Raises RunFailed where they do not come."""
        self._ask(frame)
        return take_poses(self._context, frame, self._coming.popleft())

    def _ask(self, frame: int) -> None:
        for ahead in range(frame + len(self._coming), min(frame + self._ahead, self._frames) + 1):
            self._coming.append(ask_poses(self._context, ahead))
