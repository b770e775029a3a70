"""What a run's steps cost by part: frames that are stepped again are the run's own, and all of the time is told."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from nuno.runtime.stepper import hash_of
from nuno.scene import scene_file
from nuno.simulation.costs import MOST_STARTS, Stage
from nuno.simulation.run import Simulation

pytestmark = pytest.mark.full

FRAMES = 24


def sheet(name: str, size: str, height: float) -> dict[str, object]:
    model = {"plugin": "sheet", "size": [size, size], "resolution": [7, 7], "plane": "xz", "centre": [0, height, 0]}
    return {"name": name, "model": model | {"fabric": "jacket"}}


def fall(folder: Path, solver: str) -> tuple[Simulation, list[str]]:
    """A sheet falls on another, which lies on a ball; and the state after each frame."""
    scene = {
        "nuno": 1, "name": "fall", "duration": FRAMES / 100, "frame_rate": 100,
        "solver": {"plugin": solver, "dt": "0.2 ms"}, "cloth_contact": {"plugin": "offset", "thickness": "4 mm"},
        "objects": [sheet("below", "0.1 m", 0.12), sheet("above", "0.09 m", 0.13)],
        "bodies": [{"name": "ball", "collider": {"plugin": "sphere", "centre": [0, 0, 0], "radius": 0.1}}],
    }  # fmt: skip
    path = folder / "fall.yaml"
    path.write_text(yaml.safe_dump(scene))
    simulation = Simulation.with_bodies(scene_file.read(path), 1)
    return simulation, [hash_of(simulation.step() and simulation.arrays().values()) for _ in range(FRAMES)]


@pytest.mark.parametrize("solver", ["symplectic_euler", "dopri5", "implicit_euler", "xpbd"])
def test_frames_that_are_stepped_again_are_those_of_the_run(solver: str, tmp_path: Path) -> None:
    """To the last bit, with all that contact has in the middle of it; and without contact they are not."""
    simulation, after = fall(tmp_path, solver)
    stage = Stage(simulation.loaded.integrator, simulation.system, simulation.steps, simulation.dt)
    starts, every = simulation.costs.starts, simulation.costs.every
    assert every == 4
    assert len(starts) == FRAMES / every <= MOST_STARTS
    touched = False
    for number, start in enumerate(starts):
        state, report = stage.replay(start)
        assert hash_of([state.x, state.v]) == after[number * every]
        other, _ = stage.replay(start, ("cloth_contact",))
        if report.counts["cloth_contacts"]:
            touched = True
            assert hash_of([other.x, other.v]) != after[number * every]
    assert touched


def test_all_of_the_time_is_told(tmp_path: Path) -> None:
    """And nothing changed by asking: the run goes on in the same bits."""
    (simulation, _), (asked, _) = fall(tmp_path, "symplectic_euler"), fall(tmp_path, "symplectic_euler")
    seconds = asked.costs.seconds
    parts = asked.divide(seconds)
    assert list(parts) == ["springs", "hinges", "contact", "cloth_contact", "other"]
    assert parts["cloth_contact"] > 0.0
    assert all(cost >= 0.0 for cost in parts.values())
    assert sum(parts.values()) == pytest.approx(seconds)
    assert asked.step().digest == simulation.step().digest
