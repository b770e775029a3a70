"""A body of a run that goes on, told where to be: by a tracker, a robot's program, or whoever plays one."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import zenoh
from numpy.typing import ArrayLike

from nuno.api.words import in_python
from nuno.collision.messages import GEOMETRY_QUESTION, decode_geometry
from nuno.stepping.driver import CONTROL
from nuno.supervision import runs
from nuno.supervision.supervisor import CONTROL_TIMEOUT
from nuno.wire.bus import Bus
from nuno.wire.sessions import spoke
from nuno_schemas.errors import BadInput, RunFailed, nearest
from nuno_schemas.live import BodyPoses
from nuno_schemas.messages import POSES

STILL = (1.0, 0.0, 0.0, 0.0)
LOOK = 0.1
"""How often a run that is waited for is looked for [s]."""
T = TypeVar("T")


class Driving:
    """What moves one body, and takes hold of cloth with it; it can be closed, and used with `with`."""

    def __init__(self, run: str, body: str, endpoint: str, key: str | None, config: str | None, end: float) -> None:
        with contextlib.ExitStack() as stack, in_python():
            session = stack.enter_context(spoke(endpoint, config))
            self._bus = Bus(session, run, "drive")
            self._publisher = session.declare_publisher(
                key or self._bus.key(f"{POSES.name}/{body}"),
                congestion_control=zenoh.CongestionControl.BLOCK,
                reliability=zenoh.Reliability.RELIABLE,
            )
            answer = _asked_until(end, lambda: self._bus.ask(GEOMETRY_QUESTION, timeout=CONTROL_TIMEOUT), RunFailed)
            known = decode_geometry(answer).bodies
            if body not in known:
                raise BadInput("the run has no such body", field="body", value=body, remedy=nearest(body, known))
            self._stack = stack.pop_all()

    def send(self, position: ArrayLike, rotation: ArrayLike = STILL) -> None:
        """Tell the body where to be: position (3,) [m] and rotation (4,), a quaternion w, x, y, z, of any length but
        zero; or of a skeleton (j, 3) and (j, 4), of all joints. What the run cannot follow it refuses, and says so.
        Raises BadInput for what is of another shape or not finite.
        """
        positions, rotations = (np.atleast_2d(np.asarray(values, np.float64)) for values in (position, rotation))
        for name, values, width in (("position", positions, 3), ("rotation", rotations, 4)):
            if values.shape[1:] != (width,) or len(values) != len(positions):
                limit = f"{width} numbers, or as many of each joint"
                raise BadInput("of another shape", field=name, value=f"shape {values.shape}", limit=limit)
            if not np.isfinite(values).all():
                raise BadInput("not finite", field=name, value=values.tolist())
        sent = BodyPoses.model_validate({"positions": positions.tolist(), "rotations": rotations.tolist()})
        self._publisher.put(sent.model_dump_json().encode())

    def add(self, item: str) -> dict[str, Any]:
        """Change the cloth at once, as `nuno control RUN add`: "attach: {body: hand}", "release: {body: hand}"; what
        became of it. Raises BadInput where the run refuses it, RunFailed where it does not answer.
        """
        answer = self._bus.ask_json(CONTROL, {"action": "add", "item": item}, CONTROL_TIMEOUT)
        if answer.get("ok") is not True:
            refused = answer.get("refused") or {"problem": str(answer.get("error"))}
            raise BadInput(**refused)
        return dict(answer.get("new") or {})

    def close(self) -> None:
        """Tell it nothing more."""
        self._stack.close()

    def __enter__(self) -> Driving:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def drive(
    run: str,
    body: str,
    *,
    wait: float = 0.0,
    key: str | None = None,
    connect: str | None = None,
    config: str | None = None,
) -> Driving:
    """Move a body of a run whose motion is `{plugin: topic}`: with nuno.drive("last", "hand") as hand: hand.send(...).

    run: its id, the beginning of that, or "last"; body: its name in the scene; wait: how long the run may take to be
    there, and ready [s]; key: that of its motion, where that has one; connect and config: endpoint and zenoh
    configuration, for a run on another host, whose id is then needed in full. Raises BadInput for a run that does not
    go on and a body that it has not, RunFailed where it cannot be reached.
    """
    end = time.monotonic() + wait
    with in_python():
        name, endpoint = (run, connect) if connect else _asked_until(end, lambda: runs.find(run), BadInput)
    return Driving(name, body, endpoint, key, config, end)


def _asked_until(end: float, ask: Callable[[], T], refusal: type[Exception]) -> T:
    """What is asked for, as soon as it is there; refused as it is at the end of the time."""
    while True:
        try:
            return ask()
        except refusal:
            if time.monotonic() >= end:
                raise
        time.sleep(LOOK)
