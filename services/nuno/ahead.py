"""How long a run will take, before it does: by frames of it that are stepped here and now, then by what is done."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from nuno.collision.bodies import Bodies, build_bodies
from nuno.scene.choose import decide
from nuno.scene.scene_file import Loaded
from nuno.simulation.run import Simulation


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
    loaded, frame = decide(loaded), 0.0
    if loaded.scene.moves:
        bodies = build_bodies(loaded) if loaded.scene.bodies else None
        geometry, poses = (bodies.geometry, bodies.poses(0.0)) if bodies else (None, None)
        frame = time_frame(Simulation(loaded, geometry, poses, 0), bodies)
    if loaded.dye is not None:
        from nuno.dye import describe
        from nuno.dye.run import DyeRun

        frame += describe.time_frame(DyeRun(loaded, 0))
    return frame * loaded.scene.frames


def time_frame(simulation: Simulation, bodies: Bodies | None) -> float:
    """Wall time of the second frame of cloth [s]; the first one may compile."""
    seconds, rate = 0.0, simulation.loaded.scene.frame_rate
    for frame in range(2):
        ends = [bodies.poses((frame + i) / rate) if bodies else None for i in range(2)]
        start = time.perf_counter()
        simulation.advance(*ends)
        seconds = time.perf_counter() - start
    return max(seconds, 1e-9)
