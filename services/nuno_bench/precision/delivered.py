"""What a level of accuracy promised for a scene, and what it delivered."""

from __future__ import annotations

from dataclasses import dataclass

from nuno_schemas.solver import Accuracy

WITHIN = 3.0
"""How many times the promised error may be delivered, where the error of a whole scene is judged by its beginning."""
HEADINGS = ("scene", "accuracy", "solver", "steps a frame", "promised", "delivered", "until [s]", "time [s]", "verdict")


@dataclass(frozen=True)
class Delivered:
    """One scene at one level: promise and error, up to the time that the promise goes, and what it took.

    Both are shares of the cloth's size, or of the largest amount of dye. floor is what the reference itself is known
    to; error is nan where the run failed; `within` is how many times the promise it may be.
    """

    scene: str
    accuracy: Accuracy
    solver: str
    steps: int
    promised: float
    error: float
    floor: float
    until: float
    seconds: float
    why: str
    within: float = WITHIN

    @property
    def verdict(self) -> str:
        if self.error <= self.within * self.promised:
            return "agrees"
        return "failed" if not self.error <= 3.0 * self.floor else "failed: not known, the reference is no better"

    def row(self) -> list[str]:
        return [self.scene, self.accuracy, self.solver, str(self.steps), f"{self.promised:g}", f"{self.error:.2g}",
                f"{self.until:.3g}", f"{self.seconds:.3g}", self.verdict]  # fmt: skip
