"""What steps cost, by part, and how many threads pay: nothing changes by asking."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from contact_world import STILL, capsule, geometry
from nets import make_system, start
from numba.core import event

from nuno.runtime.stepper import hash_of
from nuno.scene import scene_file, shipped
from nuno.simulation import cloth
from nuno.simulation.costs import MOST_STARTS, Stage
from nuno.simulation.run import Simulation
from nuno_cloth.models.skirt import Skirt
from nuno_cloth.wind import Wind, WindConfig
from nuno_contact.penalty.plugin import Penalty
from nuno_integrators.compiled import BETTER, TRY_AGAIN, ThreadTuning
from nuno_integrators.explicit.fixed_step import Leapfrog, SymplecticEuler
from nuno_integrators.xpbd import XPBD
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Memory, State
from nuno_schemas.system import System, Term

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


@pytest.mark.full
@pytest.mark.parametrize("solver", ["symplectic_euler", "dopri5", "implicit_euler", "xpbd"])
def test_frames_that_are_stepped_again_are_those_of_the_run(solver: str, tmp_path: Path) -> None:
    """To the last bit, with all that contact has in the middle of it; and without contact they are not."""
    simulation, after = fall(tmp_path, solver)
    stage = Stage(simulation.loaded.integrator, simulation.system, simulation.steps, simulation.dt)
    starts, every = simulation.costs.starts, simulation.costs.every
    assert every == 4
    assert len(starts) == FRAMES / every <= MOST_STARTS
    touched = False
    for number, one_start in enumerate(starts):
        state, report = stage.replay(one_start)
        assert hash_of([state.x, state.v]) == after[number * every]
        other, _ = stage.replay(one_start, ("cloth_contact",))
        if report.counts["cloth_contacts"]:
            touched = True
            assert hash_of([other.x, other.v]) != after[number * every]
    assert touched


@pytest.mark.full
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


GRAVITY = np.array([0.0, -9.81, 0.0])
SKIRT: dict[str, Any] = {"columns": 32, "rows": 9, "fullness": 1.3, "pleats": 4, "fabric": "jacket"}
POSES = (
    Poses(0.0, STILL[None], np.zeros((1, 3))),
    Poses(0.01, STILL[None], np.array([[0.01, 0.0, 0.0]])),
)


def worn_skirt() -> System:
    """A skirt in the wind, pushed aside by a capsule."""
    fabric = Skirt().build(Skirt.Config.model_validate(SKIRT), None, 0)
    middle = fabric.position.mean(axis=0)
    body = geometry(capsule(middle, middle + np.array([0.3, 0.0, 0.0]), 0.1), friction=0.3)
    wind = Wind().prepare(WindConfig(velocity=(3.0, 0.0, 1.0)), fabric, 0)
    contact = Penalty().prepare(Penalty.Config(), fabric, body, GRAVITY)
    return make_system(fabric, GRAVITY, 0.3, (wind, contact))


def moved(plugin: Any, system: System) -> tuple[State, Memory]:
    state = start(system)
    memory = plugin.prepare(plugin.Config(), system, state)
    plugin.advance(system, state, memory, POSES, 50, 1e-4)
    return state, memory


@pytest.mark.quick(plugin=["symplectic_euler"])
@pytest.mark.parametrize("plugin", [SymplecticEuler(), Leapfrog(), XPBD()], ids=lambda p: p.name)
def test_a_profile_changes_nothing(plugin: Any) -> None:
    """Not the state, not the friction anchors, and not one bit of what follows."""
    system = worn_skirt()
    state, memory = moved(plugin, system)
    other, kept = moved(plugin, system)
    assert (memory.arrays["anchor_frame"] >= 0).any()
    plugin.profile(system, state, memory, POSES)
    for name, array in memory.arrays.items():
        assert array.tobytes() == kept.arrays[name].tobytes()
    plugin.advance(system, state, memory, POSES, 50, 1e-4)
    plugin.advance(system, other, kept, POSES, 50, 1e-4)
    assert (state.x.tobytes(), state.v.tobytes()) == (other.x.tobytes(), other.v.tobytes())


def test_a_profile_names_every_part_and_compiles_nothing() -> None:
    class Compilations(event.Listener):
        seen = 0

        def on_start(self, happened: event.Event) -> None:
            self.seen += 1

        def on_end(self, happened: event.Event) -> None:
            pass

    plugin, system, compilations = SymplecticEuler(), worn_skirt(), Compilations()
    state, memory = moved(plugin, system)
    with event.install_listener("numba:compile", compilations):
        parts = plugin.profile(system, state, memory, POSES)
    assert list(parts) == ["springs", "hinges", "wind", "contact"]
    assert all(seconds >= 0.0 for seconds in parts.values())
    assert sum(parts.values()) > 0.0
    assert compilations.seen == 0


def test_parts_that_a_system_lacks_are_left_out() -> None:
    """And a force written in Python is a part of its own."""
    calls = []
    bare = make_system(Skirt().build(Skirt.Config.model_validate(SKIRT), None, 0), GRAVITY)
    forced = make_system(bare.fabric, GRAVITY, terms=(Term("python", lambda x, v, t, out: calls.append(t)),))
    for system, expected in (
        (bare, ["springs", "hinges"]),
        (forced, ["springs", "hinges", "python"]),
    ):
        plugin, state = SymplecticEuler(), start(system)
        memory = plugin.prepare(plugin.Config(), system, state)
        assert list(plugin.profile(system, state, memory, None)) == expected
        assert state.x.tobytes() == system.fabric.position.tobytes()
    assert calls


def frames(pace: ThreadTuning, number: int, seconds: dict[int, float]) -> list[int]:
    """Threads of each frame where a step takes so long with 1 and with 2."""
    used = []
    for _ in range(number):
        used.append(pace.choose())
        pace.took(100 * seconds[used[-1]], 100)
    return used


@pytest.mark.parametrize("faster", [1, 2])
def test_takes_what_is_faster(faster: int) -> None:
    used = frames(ThreadTuning(2), 10 * TRY_AGAIN, {faster: 1.0, 3 - faster: 3.0})
    assert used.count(3 - faster) <= 12
    assert {1, 2} == set(used[:3])


def test_notices_that_the_machine_has_changed() -> None:
    pace = ThreadTuning(2)
    assert frames(pace, 10, {1: 2.0, 2: 1.0})[-1] == 2
    assert frames(pace, 2 * TRY_AGAIN, {1: 2.0, 2: 9.0})[-2] == 1
    assert frames(pace, 2 * TRY_AGAIN, {1: 2.0, 2: 1.0})[-2] == 2


def test_changes_for_no_difference_that_is_noise() -> None:
    close = (1.0 + BETTER) / 2.0
    assert frames(ThreadTuning(2), 5 * TRY_AGAIN, {1: close, 2: 1.0}).count(1) <= 7


def test_a_single_slow_frame_changes_nothing() -> None:
    pace = ThreadTuning(2)
    frames(pace, 10, {1: 1.5, 2: 1.0})
    assert frames(pace, 1, {1: 1.5, 2: 9.0}) == [2]
    assert set(frames(pace, 5, {1: 1.5, 2: 1.0})) == {2}


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_one_pass_has_the_bits_of_two(steps: int) -> None:
    """A force in Python that adds nothing takes the way by forces first and updates after."""
    overrides = ("objects.0.model.resolution=[9, 8]", "objects.0.model.velocity=[0.1, 0.2, 0.3]", "damping=0.5")
    loaded = scene_file.read(Path(shipped.find("stiff-sheet")), overrides)
    fabric, _ = cloth.build_fabric(loaded)
    plain = System(fabric, np.array([0.0, -9.81, 0.0]), 0.5)
    nothing = replace(plain, terms=(Term("python", lambda x, v, t, out: None),))
    ends = []
    for system in (plain, nothing):
        method, state = SymplecticEuler(), cloth.start_state(fabric)
        memory = method.prepare(method.Config(), system, state)
        for _ in range(3):
            method.advance(system, state, memory, None, steps, 1e-4)
        ends.append(state)
    assert np.array_equal(ends[0].x, ends[1].x) and np.array_equal(ends[0].v, ends[1].v)
    assert not np.array_equal(ends[0].x, cloth.start_state(fabric).x)
