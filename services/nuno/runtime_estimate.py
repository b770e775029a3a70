"""How long a run will take, before it does: by frames of it that are stepped here and now, then by what is done."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.solver_selection.budget import Budget
from nuno.solver_selection.cloth import decide
from nuno.verification import steppers


@dataclass
class RuntimeEstimate:
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
    return loaded.scene.frames * frame_seconds(loaded)


def frame_seconds(loaded: Loaded) -> float:
    """Wall time of a frame's steps [s], of a scene in which nothing is left to choose."""
    return sum(make().time_frame() for make in steppers(loaded).values())


def keep_up(loaded: Loaded, budget: Budget | None = None) -> Loaded:
    """The scene decided for a run whose frames wait for the clock: where it leaves its accuracy open, and a frame takes
    longer than it lasts, `preview` does, if that is faster. Raises BadInput as `decide`.
    """
    budget = budget or Budget()
    found = decide(loaded, budget)
    if not loaded.scene.step_undecided or loaded.scene.accuracy is not None:
        return found
    lasts, takes = 1.0 / loaded.scene.frame_rate, frame_seconds(found)
    if takes <= lasts:
        return found
    open_ = scene_file.load(loaded.data | {"accuracy": "preview"}, loaded.lines, loaded.file, loaded.files)
    coarser = decide(replace(open_, path=loaded.path, overrides=(*loaded.overrides, "accuracy=preview")), budget)
    if not (less := frame_seconds(coarser)) < takes:
        return found
    clock = (
        f"for the clock, at normal a frame of {1e3 * lasts:.3g} ms takes {1e3 * takes:.3g} ms, here {1e3 * less:.3g}"
    )
    return replace(coarser, why=f"{coarser.why}; {clock}")
