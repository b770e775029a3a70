"""Forces told apart by kind: each is its law's, whatever the solver, and nothing is changed by asking."""

from __future__ import annotations

import math

import closed_meshes as meshes
import numpy as np
import pytest
from nets import make_fabric, make_system, random_net
from sliding_world import GAP, STILL, G, World, body, loose

from nuno.plugin_contract import registry
from nuno_cloth.wind import ParticleWindForce
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float, State
from nuno_schemas.system import Forces, Term


def push(x: Float, v: Float, t: float, out: Float) -> None:
    """A force written in Python."""
    out += np.stack([x[:, 1], -2.0 * v[:, 0], np.full(len(x), t)], axis=1)


@pytest.mark.quick(name=["symplectic_euler", "implicit_euler"])
@pytest.mark.parametrize(
    "name", ["symplectic_euler", "respa", "rk4", "rk4_printed", "implicit_euler", "dopri5", "xpbd"]
)
def test_each_kind_is_its_laws(name: str) -> None:
    x, springs = random_net(12, 30, 1, c=0.5)
    rng = np.random.default_rng(2)
    v = rng.normal(size=x.shape)
    mass, pinned = rng.uniform(0.5, 2.0, 12), np.arange(12) < 2
    fabric = make_fabric(x, springs, mass=mass, pinned=pinned)
    wind = ParticleWindForce()
    terms = (wind.prepare(wind.Config.model_validate({"strength": 0.3}), fabric, 0), Term("python", push))
    system = make_system(fabric, np.array([0.0, -G, 0.0]), 0.7, terms)
    plugin, state = registry.load("nuno.integrators", name), State(x.copy(), v.copy(), 1.5)
    memory = plugin.prepare(plugin.Config(), system, state)
    before = {key: values.copy() for key, values in memory.arrays.items()}
    found: Forces = plugin.forces(system, state, memory, None)
    pairs, d = springs.pairs(), x[springs.pairs()[:, 1]] - x[springs.pairs()[:, 0]]
    length = np.linalg.norm(d, axis=1)
    tension = springs.k * (length - springs.rest)
    speed = ((v[pairs[:, 1]] - v[pairs[:, 0]]) * d).sum(axis=1) / length
    pull = ((tension + springs.c * speed) / length)[:, None] * d
    expected = {"gravity": mass[:, None] * [0.0, -G, 0.0], "damping": -0.7 * mass[:, None] * v}
    expected["springs"] = np.zeros_like(x)
    np.add.at(expected["springs"], pairs[:, 0], pull)
    np.add.at(expected["springs"], pairs[:, 1], -pull)
    expected["python"] = np.stack([x[:, 1], -2.0 * v[:, 0], np.full(12, 1.5)], axis=1)
    blown = found.parts["particle_wind"]
    assert np.linalg.norm(blown, axis=1) == pytest.approx(np.full(12, 0.3))
    assert set(found.parts) == {*expected, "particle_wind"}
    for kind, force in expected.items():
        assert np.allclose(found.parts[kind], force, rtol=0.0, atol=1e-12 * np.abs(force).max()), kind
    assert np.allclose(found.tension, tension, rtol=0.0, atol=1e-12)
    moved = sum(expected.values(), blown) / mass[:, None]
    assert np.allclose(found.acceleration[~pinned], moved[~pinned], rtol=1e-12, atol=1e-12)
    assert not found.acceleration[pinned].any()
    assert state.x.tobytes() == x.tobytes() and state.v.tobytes() == v.tobytes()
    assert all(np.array_equal(values, memory.arrays[key]) for key, values in before.items())


@pytest.mark.parametrize(("slope", "friction"), [(0.0, 0.0), (0.3, 0.0), (0.3, 0.5), (0.3, 0.1)])
def test_what_sliding_contact_holds_against(slope: float, friction: float) -> None:
    """On an incline a point at rest is held off by m g cos, and along it by up to mu times that; one in the air by
    nothing.
    """
    gravity = G * np.array([math.sin(slope), -math.cos(slope), 0.0])
    x = np.array([[0.0, 1.0 + GAP, 0.0], [0.0, 1.5, 0.0]])
    world = World(loose(x), body(meshes.box((2.0, 2.0, 2.0)), friction), gravity)
    poses = Poses(0.0, STILL, np.zeros((1, 3)))
    found: Forces = world.plugin.forces(world.system, world.state, world.memory, (poses, poses))
    across, along = 0.01 * G * math.cos(slope), 0.01 * G * math.sin(slope)
    held = min(along, friction * across)
    assert found.parts["contact"][0] == pytest.approx([-held, across, 0.0], abs=1e-6)
    assert found.acceleration[0] == pytest.approx([(along - held) / 0.01, 0.0, 0.0], abs=1e-4)
    assert found.parts["contact"][1] == pytest.approx([0.0, 0.0, 0.0])
    assert found.acceleration[1] == pytest.approx(gravity)
