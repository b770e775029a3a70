"""Questions to the collision service: what the bodies are, and where."""

from __future__ import annotations

import json
from collections.abc import Callable

from nuno.collision.messages import GEOMETRY_QUESTION, POSES_QUESTION, decode_geometry, decode_poses
from nuno.service import Context
from nuno.wire.sessions import PATIENCE
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import RunFailed


def ask_poses(context: Context, frame: int) -> Callable[[], Poses]:
    """Ask for a frame's poses now; the function that is returned waits for them, and says so where it takes long.

    The service answers between two measurements, which on a busy machine take their time; and what is asked ahead
    waits while the cloth steps. A service that dies is noticed by whoever supervises it.
    """

    def slow() -> None:
        limit = f"given up after {PATIENCE:g} s"
        context.event("warning", f"waiting for the collision service: no bodies of frame {frame} yet ({limit})")

    answer = context.bus.ask_ahead(POSES_QUESTION, json.dumps({"frame": frame}).encode(), PATIENCE, slow)
    return lambda: decode_poses(answer())


def ask_geometry(context: Context) -> Geometry:
    """The bodies of a run, once their service is there. Raises RunFailed if it does not come.

    How long that may take is for the supervisor to say, who then goes: a distance field may have to be built there.
    """
    while context.watch.wait_for({"collision"}, 0.1):
        if context.orphaned():
            raise RunFailed("the supervisor has gone")
    return decode_geometry(context.bus.ask(GEOMETRY_QUESTION))
