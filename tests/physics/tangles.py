"""Cloth that passes through itself and other cloth: grids and irregular triangles, pushed into each other at random."""

from __future__ import annotations

from collections.abc import Callable

import ipctk
import numpy as np
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from nuno_geometry.normals import edge_numbers
from nuno_schemas.fabric import Bool, Fabric, Float, Int

SIDE = 12
EDGE = 0.01
"""Of the grids' squares [m]; irregular triangles have about as long edges."""
WIDE = (SIDE - 1) * EDGE
Sheet = tuple[Float, Int]
Random = np.random.Generator


def sheet(random: Random | None, side: int = SIDE) -> Sheet:
    """A level square around the origin: a grid, or irregular triangles where there is something to draw them from."""
    along = np.linspace(-0.5, 0.5, side) * EDGE * (side - 1)
    if random is None:
        u, w = (values.ravel() for values in np.meshgrid(along, along, indexing="ij"))
        at = np.arange(side * side).reshape(side, side)
        a, b, c, d = (corner.ravel() for corner in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    else:
        ends = (along[0], along[-1])
        points = [(one, two) for one in along for two in (along if one in ends else ends)]
        for place in random.uniform(0.94 * ends[0], 0.94 * ends[1], (6 * side * side, 2)):
            if np.hypot(*(np.array(points) - place).T).min() > 0.75 * EDGE:
                points.append(tuple(place))
        u, w = np.array(points).T
        faces = Delaunay(np.array(points)).simplices
        one, two = (np.array(points)[faces[:, k]] - np.array(points)[faces[:, 0]] for k in (1, 2))
        area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
        faces = np.where(area[:, None] < 0.0, faces[:, ::-1], faces)[np.abs(area) > 1e-3 * EDGE**2]
    return np.stack([u, 0.0 * u, w], axis=1), faces.astype(np.int32)


def turned(one: Sheet, *angles: float) -> Sheet:
    """Turned about x, y and z [rad]."""
    return Rotation.from_euler("xyz", angles).apply(one[0]), one[1]


def moved(one: Sheet, *way: float) -> Sheet:
    """Moved [m]."""
    return one[0] + way, one[1]


def lowered(one: Sheet, depth: float) -> Sheet:
    """Moved up or down until its lowest vertex is so deep [m]."""
    return moved(one, 0.0, -depth - one[0][:, 1].min(), 0.0)


def bump(random: Random, draw: Random | None) -> list[Sheet]:
    """A dent of the upper sheet that comes out below the lower one."""
    upper, lower = sheet(draw), sheet(draw)
    place = [random.uniform(-2.0, 2.0) * EDGE, 0.0, random.uniform(-2.0, 2.0) * EDGE]
    far = ((upper[0] - place) ** 2).sum(axis=1)
    upper[0][:, 1] += 0.4 * EDGE - random.uniform(1.0, 4.0) * EDGE * np.exp(-far / (2.0 * EDGE) ** 2)
    return [upper, lower]


def poke(random: Random, draw: Random | None) -> list[Sheet]:
    """The lower end of a small upright sheet, less than half of it, through a level one."""
    angles = 0.5 * np.pi + random.uniform(-0.3, 0.3), random.uniform(0.0, 1.0), 0.0
    upright = lowered(turned(sheet(draw, 7), *angles), random.uniform(0.5, 2.5) * EDGE)
    return [moved(upright, random.uniform(-0.01, 0.01), 0.0, random.uniform(-0.01, 0.01)), sheet(draw)]


def corner(random: Random, draw: Random | None) -> list[Sheet]:
    """A corner through a level sheet."""
    hung = turned(turned(sheet(draw), 0.0, 0.25 * np.pi, 0.0), 0.0, 0.0, random.uniform(0.6, 1.2))
    hung = lowered(hung, random.uniform(0.5, 4.0) * EDGE)
    x, z = random.uniform(-0.02, 0.02, 2) - hung[0][hung[0][:, 1].argmin()][[0, 2]]
    return [moved(hung, x, 0.0, z), sheet(draw)]


def slope(random: Random, draw: Random | None) -> list[Sheet]:
    """A sheet that leans, one side of it below a level one."""
    leaning = turned(sheet(draw), random.uniform(0.2, 0.5), random.uniform(0.0, 0.5), 0.0)
    return [lowered(leaning, random.uniform(0.5, 2.0) * EDGE), sheet(draw)]


def across(random: Random, draw: Random | None) -> list[Sheet]:
    """Half of an upright sheet on either side of a level one."""
    angles = 0.5 * np.pi + random.uniform(-0.4, 0.4), random.uniform(0.0, 0.5), 0.0
    return [moved(turned(sheet(draw), *angles), *random.uniform(-0.01, 0.01, 3)), sheet(draw)]


def slit(random: Random, draw: Random | None) -> list[Sheet]:
    """Two sheets that have slid into each other from their sides: neither is cut in two."""
    upright = turned(sheet(draw), 0.5 * np.pi, random.uniform(0.0, 0.3), 0.0)
    return [moved(upright, random.uniform(8.0, 10.0) * EDGE, random.uniform(-0.02, 0.02), 0.001), sheet(draw)]


def layers(random: Random, draw: Random | None) -> list[Sheet]:
    """Three wavy layers, each through the others."""
    made = [moved(sheet(draw), 0.0, 0.8 * EDGE * k, 0.0) for k in range(3)]
    for x, _ in made:
        a, b = (np.sin(x[:, k] * random.uniform(20.0, 60.0) + random.uniform(0.0, 6.0)) for k in (0, 2))
        x[:, 1] += 1.5 * EDGE * a * b
    return made


def crumple(random: Random, draw: Random | None) -> list[Sheet]:
    """Two sheets in nearly one place, uneven by a third of an edge."""
    made = [moved(sheet(draw), 0.0, 0.3 * EDGE * k, 0.0) for k in range(2)]
    for x, _ in made:
        x += 0.3 * EDGE * random.standard_normal(x.shape)
    return made


def fold(random: Random, draw: Random | None) -> list[Sheet]:
    """A sheet folded over whose upper half goes down through the lower one."""
    x, faces = sheet(draw, 18)
    s, radius = x[:, 0].copy(), random.uniform(0.7, 1.1) * EDGE
    end = np.pi * radius
    x[:, 0] = np.where(s < 0.0, s, np.where(s < end, radius * np.sin(s / radius), end - s))
    x[:, 1] = np.where(s < 0.0, 0.0, np.where(s < end, radius - radius * np.cos(s / radius), 2.0 * radius))
    x[:, 1] -= np.maximum(s - end, 0.0) * random.uniform(0.35, 0.6)
    return [(x + 0.02 * EDGE * random.standard_normal(x.shape), faces)]


KINDS: dict[str, Callable[[Random, Random | None], list[Sheet]]] = {
    made.__name__: made for made in (bump, poke, corner, slope, across, slit, layers, crumple, fold)
}


def tangle(kind: str, seed: int, irregular: bool) -> tuple[Fabric, dict[str, Int]]:
    """Cloth of a kind, and the vertices of each of its pieces."""
    random = np.random.default_rng(seed)
    return cloth_of(KINDS[kind](random, random if irregular else None))


def cloth_of(sheets: list[Sheet], pinned: Bool | None = None) -> tuple[Fabric, dict[str, Int]]:
    """Sheets as one fabric, and the vertices of each."""
    stops = np.cumsum([0, *(len(x) for x, _ in sheets)])
    x = np.concatenate([x for x, _ in sheets])
    faces = np.concatenate([f + at for (_, f), at in zip(sheets, stops, strict=False)]).astype(np.int32)
    held = np.zeros(len(x), bool) if pinned is None else pinned
    objects = {f"sheet{k}": np.arange(stops[k], stops[k + 1], dtype=np.int32) for k in range(len(sheets))}
    return Fabric("cloth", x, 0.0 * x, np.full(len(x), 1e-4), held, faces), objects


def crosses(fabric: Fabric, x: Float) -> bool:
    """Whether cloth passes through cloth at x (n, 3), as ipc-toolkit sees it."""
    mesh = ipctk.CollisionMesh(fabric.position, edge_numbers(fabric.faces)[1], fabric.faces)
    return bool(ipctk.has_intersections(mesh, x))
