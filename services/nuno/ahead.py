"""How long a run will take, before it does: by frames of it that are stepped here and now, then by what is done."""

from __future__ import annotations

from dataclasses import dataclass, field

from nuno.choose.cloth import decide
from nuno.scene.scene_file import Loaded
from nuno.verification import steppers


@dataclass
class Pace:
    """What is left of several pieces of work.

    expected  wall time that each was found to take beforehand [s], by its name; only their ratios matter once one is
              done, for the others are then taken to be as much slower or faster
    """

    expected: dict[str, float]
    taken: dict[str, float] = field(default_factory=dict)
    """Wall time of those that are done [s]."""

    @property
    def left(self) -> float:
        """Wall time of the others [s]."""
        done = sum(self.expected[name] for name in self.taken)
        ratio = sum(self.taken.values()) / done if done > 0.0 else 1.0
        return ratio * sum(seconds for name, seconds in self.expected.items() if name not in self.taken)


def run_seconds(loaded: Loaded) -> float:
    """Wall time of a scene's steps [s], by a frame of it. Raises BadInput for a scene that would not start."""
    loaded = decide(loaded)
    return loaded.scene.frames * sum(make().time_frame() for make in steppers(loaded).values())
