"""Wind on triangles and on particles.

A triangle of area A and unit normal n that moves at v (the mean of its corners) meets the air at
u = wind - v. The law of a flat plate, normal pressure and skin friction apart:

    F = rho A / 2 (Cn |u.n| (u.n) n + Ct |u_t| u_t),    u_t = u - (u.n) n

It is the same for either sign of n, never pushes against u, and needs no square root unless Ct is
used: with m = (x1 - x0) x (x2 - x0) = 2 A n, |u.n| (u.n) A n = |u.m| (u.m) m / (2 m.m). Each corner
gets a third. A triangle without area feels nothing.

Forces of faces are written first, then each vertex gathers those of its own faces in their order,
so both loops may be split over threads and the sums stay the same to the last bit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import kernel
from nuno_schemas.fabric import Float, Int


class Wind(NamedTuple):
    """Wind prepared for one fabric of n vertices and f faces.

    faces       (3, f) int32       corners
    start       (n + 1,) int64     where each vertex's faces begin in `incident`
    incident    (3 f,) int32       faces at each vertex, ascending
    velocity    (3,)               of the air [m/s]
    normal      rho Cn / 12        [kg/m^3]: halves of the law and of m, a third per corner
    tangential  rho Ct / 12        [kg/m^3]
    face_force  (3, f)             scratch: a third of each face's force [N]
    """

    faces: Int
    start: NDArray[np.int64]
    incident: Int
    velocity: Float
    normal: float
    tangential: float
    face_force: Float


class ParticleWind(NamedTuple):
    """The same force (3,) [N] on every particle."""

    force: Float


def prepare_wind(faces: Int, vertices: int, velocity: Float, density: float, normal: float, tangential: float) -> Wind:
    """Wind from faces (f, 3), the number of vertices, the air's velocity (3,) [m/s] and density
    [kg/m^3], and the two coefficients."""
    flat = faces.reshape(-1)
    incident = (np.argsort(flat, kind="stable") // 3).astype(np.int32)
    start = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=vertices))]).astype(np.int64)
    corners = np.ascontiguousarray(faces.T, np.int32)
    scratch = np.zeros((3, faces.shape[0]))
    wind = np.ascontiguousarray(velocity, np.float64)
    return Wind(corners, start, incident, wind, density * normal / 12, density * tangential / 12, scratch)


@kernel
def measure_wind(x: Any, v: Any, wind: Any, first: int, last: int) -> None:
    """Write a third of the force on each of the faces first..last - 1 to wind.face_force."""
    third = 1.0 / 3.0
    for face in range(first, last):
        i, j, k = wind.faces[0, face], wind.faces[1, face], wind.faces[2, face]
        ax, ay, az = x[0, j] - x[0, i], x[1, j] - x[1, i], x[2, j] - x[2, i]
        bx, by, bz = x[0, k] - x[0, i], x[1, k] - x[1, i], x[2, k] - x[2, i]
        mx, my, mz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        mm = mx * mx + my * my + mz * mz
        ux = wind.velocity[0] - third * (v[0, i] + v[0, j] + v[0, k])
        uy = wind.velocity[1] - third * (v[1, i] + v[1, j] + v[1, k])
        uz = wind.velocity[2] - third * (v[2, i] + v[2, j] + v[2, k])
        um = ux * mx + uy * my + uz * mz
        along = um / mm if mm != 0.0 else 0.0
        push = wind.normal * abs(um) * along
        drag = 0.0
        if wind.tangential != 0.0:
            ux, uy, uz = ux - along * mx, uy - along * my, uz - along * mz
            drag = wind.tangential * math.sqrt(mm * (ux * ux + uy * uy + uz * uz))
        wind.face_force[0, face] = push * mx + drag * ux
        wind.face_force[1, face] = push * my + drag * uy
        wind.face_force[2, face] = push * mz + drag * uz


@kernel
def gather_wind(wind: Any, force: Any, first: int, last: int) -> None:
    """Add the faces' forces to the vertices first..last - 1 of force (3, n)."""
    for vertex in range(first, last):
        fx, fy, fz = force[0, vertex], force[1, vertex], force[2, vertex]
        for place in range(wind.start[vertex], wind.start[vertex + 1]):
            face = wind.incident[place]
            fx += wind.face_force[0, face]
            fy += wind.face_force[1, face]
            fz += wind.face_force[2, face]
        force[0, vertex], force[1, vertex], force[2, vertex] = fx, fy, fz


@kernel
def add_wind(x: Any, v: Any, wind: Any, force: Any) -> None:
    """Add the wind's force [N] to force (3, n), for positions and velocities (3, n)."""
    measure_wind(x, v, wind, 0, wind.faces.shape[1])
    gather_wind(wind, force, 0, x.shape[1])


@kernel
def add_particle_wind(particle_wind: Any, force: Any) -> None:
    """Add the same force [N] to every column of force (3, n)."""
    for axis in range(3):
        for vertex in range(force.shape[1]):
            force[axis, vertex] += particle_wind.force[axis]
