"""Contents of a recording, as its reader returns them: messages, frames and checkpoints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from nuno_schemas.fabric import Float

Arrays = dict[str, NDArray[Any]]
MEMORY = "memory/"
"""Prefix of the arrays of a solver's memory in a checkpoint."""
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
    """The float64 state after a frame, with all solver memory, from which a run can resume.

    arrays  x and v (n, 3) [m, m/s], or phi and fixed (dyes, 2, ny, nx) of dye; each array of the solver's memory as
            memory/NAME, with the vertices of renumbered cloth in the order of numbers (n,); fabric/... of objects that
            operations have changed; energy (2,) [J], the account of nuno.simulation.run; and resist
            (2, ny, nx), B of the cells, where a resist was added during the run
    text    frame, t [s], digest, dt [s], steps, and further fields of the service
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
        """The arrays of the state."""
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
    """Return amounts (dyes, 2, ny, nx) without the first axis if there is one dye."""
    return amounts[0] if len(amounts) == 1 else amounts
