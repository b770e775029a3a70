"""Five squares of cloth that fall on a ball and on each other, as plain arrays, and how a second of it is judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno.collision.pairs import mesh_of
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.peers.problem import RATE
from nuno_bench.problem.oracle import Oracle
from nuno_schemas.fabric import Float, Int

SCENE = "contact/five-sheets"
SIDES = (20, 19, 18, 17, 16)
"""Vertices along each side of the squares, which come finer and of jersey in the scene."""
DENSITY, STRETCH, SHEAR, BEND = 0.2, 300.0, 100.0, 1e-5
"""Of the cloth [kg/m^2, N/m with the width held, N/m, N m]. A sheet of springs is isotropic where it is three times as
stiff in tension as in shear; its two Lame constants are then its shear stiffness, which an engine that knows only
isotropic cloth can be given.
"""
THICKNESS, FRICTION = 2e-3, 0.3
"""Distance from which on cloth pushes cloth away [m], and Coulomb's coefficient of cloth on cloth."""
CENTRE, RADIUS, RUB = (0.0, 0.5, 0.0), 0.2, 0.4
"""Of the ball [m], and Coulomb's coefficient of cloth on it."""
FABRIC = (
    f"{{density: {DENSITY}, warp: {STRETCH} N/m, weft: {STRETCH} N/m, shear: {SHEAR} N/m, bend_warp: {BEND!r} N*m, "
    f"bend_weft: {BEND!r} N*m}}"
)
OVERRIDES = (
    "damping=0",
    "forces=[]",
    f"frame_rate={RATE}",
    f"cloth_contact={{plugin: offset, thickness: {THICKNESS!r}, friction: {FRICTION}}}",
    f"bodies=[{{name: ball, friction: {RUB}, collider: {{plugin: sphere, centre: {list(CENTRE)}, radius: {RADIUS}}}}}]",
    *(f"objects.{i}.model.fabric={FABRIC}" for i in range(len(SIDES))),
    *(f"objects.{i}.model.resolution=[{side}, {side}]" for i, side in enumerate(SIDES)),
)
"""What makes the shipped scene into one that every engine can hold: no air, no floor, one isotropic cloth."""


@dataclass(frozen=True)
class Pile:
    """Cloth at rest, level along y: x (n, 3) [m], triangles (f, 3), mass (n,) [kg], gravity (3,) [m/s^2]."""

    x: Float
    faces: Int
    mass: Float
    gravity: Float

    @property
    def edges(self) -> Int:
        return mesh_of(self.faces).edges


@dataclass(frozen=True)
class Seen:
    """What the published frames of a run show.

    frames   how many there are
    crossed  numbers, from 1 on, of those in which an edge goes through a triangle, by ipctk
    stretch  the largest elongation of any edge in any frame
    height   of the centre of mass in the last frame [m]
    """

    frames: int
    crossed: tuple[int, ...]
    stretch: float
    height: float


def five_sheets(*overrides: str) -> Pile:
    """The pile as plain arrays."""
    simulation = Simulation.with_bodies(scene_file.read(shipped.find(SCENE), (*OVERRIDES, *overrides)), 1)
    fabric = simulation.fabric
    return Pile(fabric.position.copy(), fabric.faces, fabric.mass, np.asarray(simulation.system.gravity, np.float64))


def look(pile: Pile, frames: Float) -> Seen:
    """At the positions (frames, n, 3) [m] that any engine has published. Needs ipctk."""
    oracle, ends = Oracle(pile.x, pile.faces), pile.edges
    crossed = tuple(number for number, x in enumerate(frames, 1) if oracle.crossed(x))
    longest = max(float((_lengths(x, ends) / _lengths(pile.x, ends)).max()) for x in frames)
    height = float(pile.mass @ frames[-1, :, 1] / pile.mass.sum())
    return Seen(len(frames), crossed, longest - 1.0, height)


def _lengths(x: Float, ends: Int) -> Float:
    return np.asarray(np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1))
