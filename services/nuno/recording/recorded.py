"""What a recording holds: messages, frames and checkpoints, as its reader hands them out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from nuno_schemas.fabric import Float

Arrays = dict[str, NDArray[Any]]
MEMORY = "memory/"
"""What arrays of a solver's memory begin with in a checkpoint."""
STATE = ("x", "v", "phi", "fixed")


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
    """The float64 state after a frame, with all solver memory: what a run resumes from.

    arrays  x and v (n, 3) [m, m/s], or of dye phi and fixed (dyes, 2, ny, nx); each array of the solver's memory as
            memory/NAME, in which the vertices of renumbered cloth are those of numbers (n,) in turn; of objects that
            operations have changed fabric/...; energy (2,) [J], see nuno.simulation.energy_growth; and resist
            (2, ny, nx), B of the cells, where a resist was added during the run
    text    frame, t [s], digest, dt [s], steps, and what the service says beside the arrays
    """

    arrays: Arrays
    text: dict[str, Any]

    @property
    def frame(self) -> int:
        return int(self.text["frame"])

    @property
    def t(self) -> float:
        return float(self.text["t"])

    @property
    def digest(self) -> str:
        return str(self.text.get("digest", ""))

    @property
    def state(self) -> Arrays:
        """The state by itself."""
        return {name: self.arrays[name] for name in STATE if name in self.arrays}

    @property
    def memory(self) -> Arrays:
        """The solver's memory, by its own names."""
        return {name.removeprefix(MEMORY): a for name, a in self.arrays.items() if name.startswith(MEMORY)}

    @property
    def x(self) -> Float:
        return self.arrays["x"]

    @property
    def v(self) -> Float:
        return self.arrays["v"]


def per_dye(amounts: Float) -> Float:
    """(dyes, 2, ny, nx) as people write it: without the first axis where there is one dye."""
    return amounts[0] if len(amounts) == 1 else amounts
