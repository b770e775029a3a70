"""Loose vertices and cloth on bodies of triangles under sliding contact, stepped by any solver."""

from __future__ import annotations

import numpy as np

from nuno.plugin_contract import registry
from nuno_contact.sliding.plugin import Sliding, SlidingConfig
from nuno_schemas.bodies import MESH, Geometry, Poses
from nuno_schemas.fabric import Fabric, Float, Int, Memory, State
from nuno_schemas.system import System

STILL = np.array([[1.0, 0.0, 0.0, 0.0]])
GAP = 5e-5
G = 9.81


def body(mesh: tuple[Float, Int], friction: float = 0.0) -> Geometry:
    x, faces = mesh
    one = np.zeros(1, np.int32)
    return Geometry(
        ("body",), ("body/world",), np.array([MESH], np.int8), one, one, x.min(axis=0)[None], x.max(axis=0)[None],
        np.zeros(1), np.array([np.nan]), np.zeros(1), np.array([friction]), x, faces, np.zeros(len(faces), np.int32),
    )  # fmt: skip


def loose(x: Float, v: Float | None = None, mass: float = 0.01) -> Fabric:
    v = np.zeros_like(x) if v is None else v
    return Fabric("points", x, v, np.full(len(x), mass), np.zeros(len(x), bool), np.zeros((0, 3), np.int32))


class World:
    """A fabric, one body and an integrator."""

    def __init__(
        self, fabric: Fabric, geometry: Geometry, gravity: Float, name: str = "symplectic_euler", gap: float = GAP
    ) -> None:
        self.geometry = geometry
        term = Sliding().prepare(SlidingConfig(gap=gap), fabric, geometry, gravity)
        self.system = System(fabric, gravity, 0.0, (term,))
        self.plugin = registry.load("nuno.integrators", name)
        self.state = State(fabric.position.copy(), fabric.velocity.copy())
        self.memory: Memory = self.plugin.prepare(self.plugin.Config(), self.system, self.state)

    def go(self, steps: int, dt: float, start: Poses | None = None, end: Poses | None = None) -> None:
        t = self.state.t
        start = start or Poses(t, STILL, np.zeros((1, 3)))
        end = end or Poses(t + steps * dt, start.rotation, start.translation)
        report = self.plugin.advance(self.system, self.state, self.memory, (start, end), steps, dt)
        assert report.status == "ok", report.message

    @property
    def slides(self):
        return self.memory.work.packed.bodies[0]
