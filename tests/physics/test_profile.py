"""A step told apart into its parts: the parts there are, and nothing changed by asking."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from contact_world import STILL, capsule, geometry
from nets import make_system, start
from numba.core import event

from nuno_cloth.models.skirt import Skirt
from nuno_cloth.wind import Wind, WindConfig
from nuno_contact.penalty.plugin import Penalty
from nuno_integrators.explicit.fixed_step import Leapfrog, SymplecticEuler
from nuno_integrators.xpbd import XPBD
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Memory, State
from nuno_schemas.system import System, Term

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
