"""The map of a scene of dye: coefficients of diffusion over steps, each point held against an extrapolated run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from nuno import registry
from nuno.scene import scene_file
from nuno_bench.problem.dye import SCHEME, DyeProblem, make_dye_problem
from nuno_bench.problem.dye_reference import extrapolate
from nuno_bench.problem.observe import Run
from nuno_bench.stability.case import Motion, Setting
from nuno_bench.sweep.packed import pack, unpacked
from nuno_schemas.errors import BadInput

AXIS = "diffusion"
FACTORS = (1e-2, 1e-1, 1.0, 1e1)
"""Of the scene's coefficients: a larger one costs its reference so many times the steps."""
FRAMES = 4
LONGEST = 32.0
"""Of a frame, in steps at the scene's own limit: the scene's frames may hold thousands of them."""
FINER = 8
"""Steps of the reference for one that is stable; it is extrapolated from these and twice as many."""
MOST_HALVINGS = 11
"""Of a frame, to the shortest step."""


def dye_settings(path: Path, overrides: Sequence[str]) -> list[Setting]:
    """A setting for each factor, the scene's own first, of frames that hold few steps. Raises BadInput."""
    loaded = scene_file.read(path, [*overrides, "allow_unstable=true"])
    dye, problem = loaded.scene.dye, make_dye_problem(loaded, threads=1)
    if dye is None:
        raise BadInput("the scene has no dye", str(path))
    frame = min(problem.frame, LONGEST * _limit(problem))
    few = f"frame_rate={dye.speed / frame!r}", f"duration={FRAMES * frame / dye.speed!r}"
    scene = pack(path, overrides)
    made = [
        Setting(scene, (*few, *(f"dye.dyes.{i}.D0={one.D0 * value!r}" for i, one in enumerate(dye.dyes))), AXIS, value)
        for value in FACTORS
    ]
    return sorted(made, key=lambda setting: abs(math.log(setting.value)))


def _limit(problem: DyeProblem) -> float:
    """Stable step of the explicit scheme [s]."""
    plugin = registry.load(problem.group, SCHEME)
    return problem.limit(plugin, plugin.Config()).dt


@dataclass(frozen=True)
class DyePosed:
    """A setting, built; see nuno_bench.stability.case.Posed, which is one of cloth."""

    problem: DyeProblem
    group: ClassVar[str] = DyeProblem.group

    @property
    def frame(self) -> float:
        return self.problem.frame

    @property
    def edge(self) -> float:
        """Side of a cell [m]."""
        return float(self.problem.start.cells.size)

    def limit(self, plugin: Any, config: Any) -> float:
        """The solver's own limit [s], once it is compiled. Raises BadInput where it refuses the scene."""
        self.problem.begin(plugin, config, 1).measure()
        return self.problem.limit(plugin, config).dt

    def run(self, plugin: Any, config: Any, steps: int, most: float = math.inf) -> tuple[Motion | None, str, str]:
        """The path with so many steps a frame; or None with how it ended and why."""
        found = self.problem.run(plugin, config, steps, most)
        if found.status == "ok":
            return _motion(found), "", ""
        outcome = {"cut": "left out", "diverged": "diverged"}.get(found.status, "refused")
        return None, outcome, found.message


@contextmanager
def pose_dye(setting: Setting) -> Iterator[DyePosed]:
    """A setting, which needs its files as long as it is run. Raises BadInput."""
    with unpacked(setting.scene, [*setting.overrides, "allow_unstable=true"]) as loaded:
        yield DyePosed(make_dye_problem(loaded, threads=1))


def prepare_dye(posed: DyePosed, setting: Setting) -> tuple[list[int], Motion]:
    """Numbers of steps a frame, the same for all factors, and the setting's reference. Raises BadInput."""
    plugin = registry.load(DyeProblem.group, SCHEME)
    limit = _limit(posed.problem)
    # A tenth of the scene's own limit is the limit at ten times its coefficients.
    finest = 10.0 * posed.frame / (limit * setting.value)
    counts = [2**i for i in range(min(MOST_HALVINGS, math.ceil(math.log2(max(2.0, finest)))) + 1)]
    steps = FINER * max(1, math.ceil(posed.frame / limit))
    coarse, fine = (posed.problem.run(plugin, plugin.Config(), n) for n in (steps, 2 * steps))
    if coarse.status != "ok" or fine.status != "ok":
        raise BadInput(f"the reference run by {SCHEME} {fine.status}: {fine.message}")
    return counts, _motion(extrapolate(coarse, fine))


def _motion(found: Run) -> Motion:
    """Amounts as the path; all dye is what must neither come nor go."""
    values = found.series.values
    total = (values["mobile"] + values["fixed"]).sum(axis=1)
    return Motion(found.series.x, np.abs(total), total)
