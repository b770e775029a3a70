"""Wind and air drag on triangles and on particles: the laws, their kernels, and the force plugins."""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import BaseModel, Field

from nuno_cloth.models.placement import Velocity
from nuno_cloth.quantities import AirDensity, Angle, Newtons, Ratio, Time
from nuno_kernels import kernel
from nuno_kernels.forces.vertex import vertex_force
from nuno_kernels.lanes import (
    WIDTH,
    Triple,
    add_at,
    alternate,
    cross,
    dot,
    gather_triple,
    load,
    magnitude,
    minus,
    plus,
    read,
    read_triple,
    root,
    splat,
    store,
    times,
    where_not_zero,
    write,
)
from nuno_kernels.step.blocks import Long, assign_runs, block_count, cut_runs, list_copies
from nuno_kernels.terms import register
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term
from nuno_schemas.vectors import face_areas

# Wind on triangles and on particles.
#
# A triangle of area A and unit normal n that moves at v (the mean of its corners) meets the air at
# u = wind - v. The law of a flat plate, normal pressure and skin friction apart:
#
#     F = rho A / 2 (Cn |u.n| (u.n) n + Ct |u_t| u_t),    u_t = u - (u.n) n
#
# It is the same for either sign of n, never pushes against u, and needs no square root if Ct = 0: with m = (x1 - x0) x
# (x2 - x0) = 2 A n, |u.n| (u.n) A n = |u.m| (u.m) m / (2 m.m). Each corner gets a third. A triangle without area has no
# force.
#
# Triangles are computed eight at a time, in runs or by lists like springs, once in every block that owns a corner. A
# grid's triangles have edges (i, i + d) along its columns. If the diagonals alternate, so does the third corner: a run
# has one for even i and another for odd i.

SHORTEST = 6
"""Runs with fewer triangles than this become lists."""

LONGEST = 256
"""The most triangles of a piece of a run, whose forces are in a buffer of 6 kB."""


class WindRuns(NamedTuple):
    """Runs of triangles with consecutive vertices, and the air round them.

    start  (blocks + 1,) int64  tasks of each block
    task   (m, 7) int64         first vertices: the edge's two, the third corner where the first
                                vertex is even, and where it is odd; triangles; a column that is not
                                used; and the corners to add to (bit c for corner c)
    velocity    (3,)            of the air [m/s]; (k, 3) in GustRuns, at times (k,) [s]
    normal      rho Cn / 12 [kg/m^3]: halves of the law and of m, a third per corner
    tangential  rho Ct / 12 [kg/m^3]
    """

    start: Long
    task: Long
    velocity: Float
    normal: float
    tangential: float


class WindLists(NamedTuple):
    """Triangles by index, padded to whole vectors with triangles without area, and the air as in WindRuns.

    start    (blocks + 1,) int64  places of each block's triangles
    corners  (6, p) int32         vertices, then their columns in the block's forces
    """

    start: Long
    corners: Int
    velocity: Float
    normal: float
    tangential: float


class GustRuns(NamedTuple):
    """WindRuns whose air changes over time."""

    start: Long
    task: Long
    velocity: Float
    normal: float
    tangential: float
    times: Float


class GustLists(NamedTuple):
    """WindLists whose air changes over time."""

    start: Long
    corners: Int
    velocity: Float
    normal: float
    tangential: float
    times: Float


@vertex_force("particle_wind")
class ParticleWind(NamedTuple):
    """The same force (3,) [N] on every particle."""

    push: Float

    def force(self) -> tuple[float, float, float]:
        return self.push[0], self.push[1], self.push[2]


Air = tuple[tuple[float, float, float], float, float]
"""Velocity [m/s], and the coefficients normal and tangential to a triangle as in WindRuns."""


@kernel
def read_air(wind: WindRuns | WindLists) -> Air:
    """Return the air as numbers: inside a loop, reading a tuple's array counts a reference."""
    return (wind.velocity[0], wind.velocity[1], wind.velocity[2]), wind.normal, wind.tangential


@kernel
def air_at(gust: GustRuns | GustLists, t: float) -> Air:
    """Return the air at the time t [s]: linear between its times, and held before and after."""
    i, at, u = 1, gust.times, gust.velocity
    while i + 1 < at.shape[0] and at[i] < t:
        i += 1
    s = min(1.0, max(0.0, (t - at[i - 1]) / (at[i] - at[i - 1])))
    a, b = (u[i - 1, 0], u[i - 1, 1], u[i - 1, 2]), (u[i, 0], u[i, 1], u[i, 2])
    return plus(times(1.0 - s, a), times(s, b)), gust.normal, gust.tangential


@kernel
def wind_forces(x0: Triple, x1: Triple, x2: Triple, v0: Triple, v1: Triple, v2: Triple, air: Air) -> Triple:
    """Return a third of the force [N] on each of eight triangles."""
    velocity, normal, tangential = air
    m = cross(minus(x1, x0), minus(x2, x0))
    u = minus(velocity, times(1.0 / 3.0, plus(plus(v0, v1), v2)))
    mm, um = dot(m, m), dot(u, m)
    along = where_not_zero(mm, um / mm)
    f = times(normal * magnitude(um) * along, m)
    if tangential != 0.0:
        t = minus(u, times(along, m))
        f = plus(f, times(tangential * root(mm * dot(t, t)), t))
    return f


@kernel
def third_corner(x: Float, even: int, odd: int, m: int, i: int) -> Triple:
    """Return positions or velocities of the third corner of up to eight triangles from vertex i."""
    a, b = read_triple(x, 0, even, m), read_triple(x, 0, odd, m)
    return alternate(a[0], b[0], i), alternate(a[1], b[1], i), alternate(a[2], b[2], i)


@kernel
def add_runs(air: Air, start: Long, task: Long, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add the wind on a block's runs to its forces (3, w), in the way of add_hinge_runs."""
    buffer = np.empty((3, LONGEST + WIDTH))
    for t in range(start[block], start[block + 1]):
        i, j, even, odd, count, mark = task[t, 0], task[t, 1], task[t, 2], task[t, 3], task[t, 4], task[t, 6]
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            f = wind_forces(
                read_triple(x, 0, i + q, m), read_triple(x, 0, j + q, m), third_corner(x, even + q, odd + q, m, i),
                read_triple(v, 0, i + q, m), read_triple(v, 0, j + q, m), third_corner(v, even + q, odd + q, m, i),
                air,
            )  # fmt: skip
            for row in range(3):
                store(buffer, row, q, f[row])
        for c in range(4):
            if (mark >> c) & 1:
                for q in range(0, count, WIDTH):
                    m, p = min(WIDTH, count - q), task[t, c] + q - origin
                    for row in range(3):
                        f = load(buffer, row, q)
                        if c == 2:
                            f = alternate(f, splat(0.0), i)
                        elif c == 3:
                            f = alternate(splat(0.0), f, i)
                        write(force, row, p, m, read(force, row, p, m) + f)


@kernel
def add_lists(air: Air, start: Long, corners: Int, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add the wind on a block's listed triangles to its forces (3, w)."""
    for p in range(start[block], start[block + 1], WIDTH):
        f = wind_forces(
            gather_triple(x, corners, 0, p), gather_triple(x, corners, 1, p), gather_triple(x, corners, 2, p),
            gather_triple(v, corners, 0, p), gather_triple(v, corners, 1, p), gather_triple(v, corners, 2, p),
            air,
        )  # fmt: skip
        for row in range(3):
            for c in range(3):
                add_at(force, row, corners, 3 + c, p, f[row])


@kernel
def add_wind_runs(wind: WindRuns, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    add_runs(read_air(wind), wind.start, wind.task, block, origin, x, v, force)


@kernel
def add_wind_lists(wind: WindLists, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    add_lists(read_air(wind), wind.start, wind.corners, block, origin, x, v, force)


@kernel
def add_gust_runs(gust: GustRuns, block: int, origin: int, x: Float, v: Float, force: Float, t: float) -> None:
    add_runs(air_at(gust, t), gust.start, gust.task, block, origin, x, v, force)


@kernel
def add_gust_lists(gust: GustLists, block: int, origin: int, x: Float, v: Float, force: Float, t: float) -> None:
    add_lists(air_at(gust, t), gust.start, gust.corners, block, origin, x, v, force)


register(WindRuns, "wind", reads_velocity=lambda wind: True, block=add_wind_runs)
register(WindLists, "wind", reads_velocity=lambda wind: True, block=add_wind_lists)
register(GustRuns, "wind", reads_velocity=lambda wind: True, block=add_gust_runs)
register(GustLists, "wind", reads_velocity=lambda wind: True, block=add_gust_lists)


def prepare_wind(
    faces: Int, vertices: int, velocity: Float, density: float, normal: float, tangential: float,
    times: Float | None = None,
) -> tuple[WindRuns | WindLists | GustRuns | GustLists, ...]:  # fmt: skip
    """Return the wind on faces (f, 3) of a mesh of `vertices`, for air of velocity (3,) [m/s], or (k, 3) at `times`
    (k,) [s], and density [kg/m^3] and the two drag coefficients.
    """
    on_edge, runs_found = _find_runs(np.asarray(faces, np.int64), vertices)
    air: Any = np.array(velocity, np.float64), density * normal / 12, density * tangential / 12
    of_runs: Any = WindRuns if times is None else partial(GustRuns, times=times)
    of_lists: Any = WindLists if times is None else partial(GustLists, times=times)
    runs = (of_runs(*_pack_runs(runs_found, vertices), *air),) if runs_found.size else ()
    if on_edge.all():
        return runs
    rest = faces[~on_edge].astype(np.int64)
    in_order = np.ascontiguousarray(rest[np.lexsort((rest.max(axis=1), rest.min(axis=1)))].T)
    return *runs, of_lists(*list_copies(in_order, vertices)[1:], *air)


def _find_runs(faces: Long, vertices: int) -> tuple[Bool, Long]:
    """Return which faces (f,) are in runs, and the runs (r, 5): first vertices of four corners, number of triangles.

    Faces that have an edge (i, i + d) of the commonest offset d, d > 1, are sorted by their side of it, then by i. A
    run continues while i does and its third corner's offset equals the one before last.
    """
    none = np.zeros(faces.shape[0], bool), np.zeros((0, 5), np.int64)
    offset = np.roll(faces, -1, axis=1) - faces
    offsets = np.abs(offset)[np.abs(offset) > 1]
    if offsets.size == 0:
        return none
    values, times = np.unique(offsets, return_counts=True)
    d = values[np.argmax(times)]
    selected = np.flatnonzero((np.abs(offset) == d).any(axis=1))
    edge = np.argmax(np.abs(offset[selected]) == d, axis=1)
    a, b, third = (faces[selected, (edge + c) % 3] for c in range(3))
    i, side, third_offset = np.minimum(a, b), a < b, third - np.minimum(a, b)
    order = np.lexsort((i, side))
    i, side, third_offset, selected = i[order], side[order], third_offset[order], selected[order]
    follows = np.concatenate([[False], (np.diff(i) == 1) & (side[1:] == side[:-1])])
    alternates = np.ones(i.shape[0], bool)
    alternates[2:] = (third_offset[2:] == third_offset[:-2]) | ~follows[1:-1]
    first = np.flatnonzero(~(follows & alternates))
    count = np.diff(np.concatenate([first, [i.shape[0]]]))
    this, after = third_offset[first], third_offset[np.minimum(first + 1, i.shape[0] - 1)]
    start = i[first]
    swapped = start % 2 == 1
    even, odd = start + np.where(swapped, after, this), start + np.where(swapped, this, after)
    inside = (np.minimum(even, odd) >= 0) & (np.maximum(even, odd) + count <= vertices)
    chosen = (count >= SHORTEST) & inside
    covered = np.zeros(faces.shape[0], bool)
    covered[selected[np.repeat(chosen, count)]] = True
    return covered, np.column_stack([start, start + d, even, odd, count])[chosen]


def _pack_runs(runs: Long, vertices: int) -> tuple[Long, Long]:
    """Return bounds and tasks of runs (r, 5) cut at the blocks' borders, one task per block that owns a corner."""
    cut = cut_runs(np.column_stack([runs, np.zeros(runs.shape[0], np.int64)]), LONGEST)
    task, start = assign_runs(cut[:, :6], block_count(vertices))
    return start, task


class Gusts(Config):
    """A velocity over time: linear between the times, and held before and after them."""

    times: list[Time] = Field(min_length=2, description="at which it is given [s], increasing")
    values: list[Velocity] = Field(description="the velocity at each of them [m/s]")


class WindConfig(Config):
    """The air, and the drag coefficients of a flat plate in it.

    normal 1.17 is a square plate across the flow (Hoerner, Fluid-Dynamic Drag, 1965); tangential
    0.01 is laminar skin friction on two sides at a Reynolds number of about 10^5 (2 x 1.328 /
    sqrt(Re), Blasius).
    """

    velocity: Velocity | Gusts = Field(
        default=(0.0, 0.0, 0.0),
        description="of the air [m/s]; zero is still air: drag alone; or {times, values}: over time",
        examples=[[1.0, 0.0, 0.0], {"times": [0.0, 1.0], "values": [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]}],
    )
    density: AirDensity = Field(default=1.2, description="of the air [kg/m^3]")
    normal: Ratio = Field(default=1.17, description="drag coefficient of cloth across the flow")
    tangential: Ratio = Field(
        default=0.01, description="friction coefficient of cloth along the flow, both sides together"
    )


class Wind:
    """Wind and drag on every triangle, by the angle between its normal and the relative wind."""

    name: ClassVar[str] = "wind"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = WindConfig

    def prepare(self, config: WindConfig, fabric: Fabric, seed: int) -> Term:
        """Return the wind's term. Raises BadInput for a fabric without faces, and for times that do not increase."""
        if fabric.faces.shape[0] == 0:
            raise BadInput(
                f"wind blows on triangles, and {fabric.name!r} has none",
                remedy="use particle_wind, which pushes particles",
            )
        air = config.density, config.normal, config.tangential
        if not isinstance(gusts := config.velocity, Gusts):
            return Term("wind", prepare_wind(fabric.faces, fabric.number, np.asarray(gusts, np.float64), *air))
        times, values = np.asarray(gusts.times, np.float64), np.asarray(gusts.values, np.float64)
        if len(values) != len(times):
            raise BadInput(f"{len(values)} values for {len(times)} times", field="velocity.values",
                           limit="one for each time")  # fmt: skip
        if (late := np.flatnonzero(np.diff(times) <= 0.0)).size:
            k = int(late[0]) + 1
            raise BadInput("times must increase", field=f"velocity.times[{k}]", value=times[k],
                           limit=f"> {times[k - 1]:g} s")  # fmt: skip
        data = prepare_wind(fabric.faces, fabric.number, values, *air, times)
        # Steps are chosen at the start, where the air may be still. The law's rate at a vertex is rho A Cn |u| / m.
        area = np.bincount(fabric.faces.reshape(-1), np.repeat(face_areas(fabric.position[fabric.faces]), 3),
                           fabric.number) / 3.0  # fmt: skip
        heavy = np.where(fabric.pinned, np.inf, fabric.mass)
        drag = config.density * max(config.normal, config.tangential) * float((area / heavy).max())
        return Term("wind", data, damping_rate=drag * float(np.linalg.norm(values, axis=1).max()))


class ParticleWindConfig(Config):
    """The direction is (cos beta sin gamma, sin beta sin gamma, cos gamma)."""

    strength: Newtons = Field(description="the skirt paper's alpha, on each particle [N]")
    beta: Angle = Field(default=0.0, description="angle of the wind's direction about z, from x [rad]")
    gamma: Angle = Field(default=0.0, description="angle of the wind's direction from z [rad]")


class ParticleWindForce:
    """The skirt paper's wind: the same force on every particle, whatever its velocity or area. Its sum grows with the
    number of vertices, so it suits fabrics set by hand.
    """

    name: ClassVar[str] = "particle_wind"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = ParticleWindConfig

    def prepare(self, config: ParticleWindConfig, fabric: Fabric, seed: int) -> Term:
        return Term("particle_wind", (ParticleWind(direction(config.beta, config.gamma) * config.strength),))


def direction(beta: float, gamma: float) -> Float:
    """Return the unit vector (3,) of the skirt paper's angles."""
    return np.array([np.cos(beta) * np.sin(gamma), np.sin(beta) * np.sin(gamma), np.cos(gamma)])
