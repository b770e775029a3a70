"""Pinned vertices that move with a body's frame, at the time of every stage."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from nets import make_fabric, make_system, random_net, start

from nuno_integrators.explicit.fixed_step import RK4, Euler, Leapfrog, SymplecticEuler
from nuno_schemas.bodies import Poses, rotation_matrices
from nuno_schemas.fabric import Float, Springs
from nuno_schemas.system import Carried

METHODS = [Euler(), SymplecticEuler(), Leapfrog(), RK4()]


def about(axis: Float, angle: float) -> Float:
    unit = axis / np.linalg.norm(axis)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * unit])


def spinning(t: float, rate: float, axis: Float, speed: Float) -> Poses:
    rotation = np.stack([about(np.array([0.0, 0.0, 1.0]), 0.0), about(axis, rate * t)])
    return Poses(t, rotation, np.stack([np.zeros(3), speed * t]))


@pytest.mark.quick(plugin=["symplectic_euler"])
@pytest.mark.parametrize("plugin", METHODS, ids=lambda p: p.name)
def test_bound_vertices_follow_their_frame(plugin: Any) -> None:
    axis, speed, rate = np.array([1.0, 2.0, -0.5]), np.array([0.3, 0.0, -0.2]), 1.7
    local = np.random.default_rng(1).standard_normal((3, 3))
    vertices = np.array([4, 0, 2], np.int32)
    position, springs = random_net(6, 12, 2)
    position[vertices] = local
    pinned = np.zeros(6, bool)
    pinned[vertices] = True
    carried = Carried(vertices, local, np.ones(3, np.int32))
    system = make_system(make_fabric(position, springs, mass=1.0, pinned=pinned), damping=0.5, carried=(carried,))
    state = start(system)
    memory = plugin.prepare(plugin.Config(), system, state)
    for frame in range(3):
        poses = spinning(0.2 * frame, rate, axis, speed), spinning(0.2 * (frame + 1), rate, axis, speed)
        plugin.advance(system, state, memory, poses, 20, 0.01)
        turned = local @ rotation_matrices(poses[1].rotation)[1].T
        spin = rate * axis / np.linalg.norm(axis)
        assert np.abs(state.x[vertices] - turned - poses[1].translation[1]).max() < 1e-13
        assert np.abs(state.v[vertices] - np.cross(spin, turned) - speed).max() < 1e-12


def test_stages_see_the_frame_where_it_is() -> None:
    """A mass on a spring whose other end moves at constant speed: order 4 survives."""
    omega, speed, duration, errors, counts = 3.0, 0.7, 1.0, [], (10, 20, 40, 80)
    springs = Springs.from_pairs(np.array([[0, 1]], np.int32), np.array([omega**2]), np.zeros(1), np.zeros(1))
    for count in counts:
        carried = Carried(np.array([0], np.int32), np.zeros((1, 3)), np.array([1], np.int32))
        fabric = make_fabric(np.zeros((2, 3)), springs, mass=1.0, pinned=np.array([True, False]))
        system = make_system(fabric, carried=(carried,))
        state, plugin = start(system), RK4()
        memory = plugin.prepare(plugin.Config(), system, state)
        still, move = np.array([0.0, 0.0, 1.0]), np.array([speed, 0.0, 0.0])
        poses = spinning(0.0, 0.0, still, move), spinning(duration, 0.0, still, move)
        plugin.advance(system, state, memory, poses, count, duration / count)
        errors.append(abs(state.x[1, 0] - speed * (duration - np.sin(omega * duration) / omega)))
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 4.0) < 0.1
