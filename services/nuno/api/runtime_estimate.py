"""Estimate of a run's time: from frames that are stepped for it, then from the parts that are done."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from nuno.replay.verification import steppers
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.cloth import decide
from nuno.simulation.solver_selection.trials import Budget


@dataclass
class RuntimeEstimate:
    """Estimate of the remaining time of several pieces of work.

    expected  wall time of each by a prior estimate [s], by name; once one is done, only their ratios matter, since the
              others are assumed to be slower or faster by the same factor
    """

    expected: dict[str, float]
    taken: dict[str, float] = field(default_factory=dict)
    """Wall time of finished pieces [s]."""

    @property
    def left(self) -> float:
        """Remaining wall time [s]."""
        done = sum(self.expected[name] for name in self.taken)
        ratio = sum(self.taken.values()) / done if done > 0.0 else 1.0
        return ratio * sum(seconds for name, seconds in self.expected.items() if name not in self.taken)


def run_seconds(loaded: Loaded) -> float:
    """Estimate the wall time of a scene's steps [s] from a frame. Raises BadInput for a scene that cannot start."""
    loaded = decide(loaded)
    return loaded.scene.frames * frame_seconds(loaded)


def frame_seconds(loaded: Loaded) -> float:
    """Return the wall time of a frame's steps [s], of a scene without open choices."""
    return sum(make().time_frame() for make in steppers(loaded).values())


def keep_up(loaded: Loaded, budget: Budget | None = None) -> Loaded:
    """Decide a scene for a run whose frames wait for the clock: with an open accuracy, and frames that are slower than
    real time, it is `preview`, if that is faster. Raises BadInput as `decide`.
    """
    budget = budget or Budget()
    decided = decide(loaded, budget)
    if not loaded.scene.step_undecided or loaded.scene.accuracy is not None:
        return decided
    lasts, takes = 1.0 / loaded.scene.frame_rate, frame_seconds(decided)
    if takes <= lasts:
        return decided
    open_ = scene_file.load(loaded.data | {"accuracy": "preview"}, loaded.lines, loaded.file, loaded.files)
    coarser = decide(replace(open_, path=loaded.path, overrides=(*loaded.overrides, "accuracy=preview")), budget)
    if not (less := frame_seconds(coarser)) < takes:
        return decided
    clock = (
        f"for the clock, at normal a frame of {1e3 * lasts:.3g} ms takes {1e3 * takes:.3g} ms, here {1e3 * less:.3g}"
    )
    return replace(coarser, why=f"{coarser.why}; {clock}")
