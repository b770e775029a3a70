"""What a recording holds: messages, frames and checkpoints, as its reader hands them out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from nuno_schemas.fabric import Float, State

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Recorded:
    """One message: log time is simulation time [ns], publish time wall time [ns]."""

    topic: str
    seq: int
    log_time: int
    publish_time: int
    payload: bytes

    @property
    def t(self) -> float:
        """Simulation time [s], the float nearest to it: times 1e-9, two frames in five would come after k / rate."""
        return self.log_time / 1e9


@dataclass(frozen=True)
class Frame:
    """Published positions x (n, 3) [m] at time t [s]: float32 precision in float64."""

    number: int
    t: float
    digest: str
    x: Float


@dataclass(frozen=True)
class Checkpoint:
    """The float64 state after a frame, with all solver memory: what a run resumes from."""

    frame: int
    t: float
    digest: str
    x: Float
    v: Float
    memory: Arrays
    text: dict[str, Any]
    """What the simulation wrote beside the arrays: dt, steps, what has changed the cloth."""
    fabric: Arrays = field(default_factory=dict)
    """Of the objects that have been changed."""

    @property
    def state(self) -> State:
        """A copy that may be changed."""
        return State(self.x.copy(), self.v.copy(), self.t)
