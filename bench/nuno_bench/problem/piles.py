"""Pieces of cloth that meet under cloth contact, made by hand: what tests and laws of cloth contact are measured on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from nuno import registry
from nuno.cloth.join import join_fabrics
from nuno.scene.files import SceneFiles
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.system import System

G = 9.81
DOWN = np.array([0.0, -G, 0.0])
"""Gravity [m/s^2], as scenes have it."""
CLOTH = "jacket"
THICKNESS = 1e-3
"""Of the contact, unless it is given another [m]."""
REST = 1.01 * THICKNESS
"""How far apart pieces begin that are to lie on each other [m]."""
STRAY = 0.3
"""Vertices inside are this part of a spacing off the grid at most, along each axis."""


def build_model(name: str, fields: Mapping[str, Any], folder: Path | None = None, seed: int = 0) -> Fabric:
    """The cloth of a model of this name, as its fields in a scene say, with files from a folder."""
    plugin = registry.load("nuno.models", name)
    fabric: Fabric = plugin.build(plugin.Config.model_validate(fields), SceneFiles(folder or Path(), ()), seed)
    return fabric


def sheet(
    side: int = 8,
    size: float = 0.1,
    at: Float | None = None,
    v: Float | None = None,
    pinned: bool = False,
    name: str = "sheet",
    irregular: bool = False,
) -> Fabric:
    """A level square of cloth, its middle at a place, moving at v: of quads, or of triangles in no order."""
    level = {"size": [size, size], "resolution": [side, side], "plane": "xz", "fabric": CLOTH}
    fabric = _irregular(side, size) if irregular else build_model("sheet", level)
    x = fabric.position - fabric.position.mean(axis=0) + (np.zeros(3) if at is None else at)
    moving = np.zeros_like(x) + (np.zeros(3) if v is None else v)
    return replace(fabric, name=name, position=x, velocity=moving, pinned=np.full(len(x), pinned))


def _irregular(side: int, size: float) -> Fabric:
    with TemporaryDirectory(prefix="nuno-") as folder:
        write_obj(Path(folder) / "sheet.obj", *irregular_square(side, size, side))
        return build_model("mesh", {"file": "sheet.obj", "warp": [1, 0, 0], "fabric": CLOTH}, Path(folder))


def pile(
    *pieces: Fabric, gravity: Float = DOWN, threads: int = 1, contact: bool = True,
    bodies: tuple[Geometry, Poses] | None = None, **settings: Any,
) -> System:  # fmt: skip
    """Pieces under cloth contact of these settings, with bodies or without, or under none. Raises BadInput."""
    fabric = join_fabrics(list(pieces), "pile")
    stops = np.cumsum([0, *(piece.number for piece in pieces)])
    objects = {str(i): np.arange(a, b, dtype=np.int32) for i, (a, b) in enumerate(pairwise(stops))}
    meet, plugin = np.ones((len(pieces), len(pieces)), bool), registry.load("nuno.cloth_contacts", "offset")
    config = plugin.Config(**settings)
    terms = (plugin.prepare(config, fabric, objects, meet, gravity, *(bodies or ())),) if contact else ()
    return System(fabric, gravity, 0.0, terms, threads)


def incline(irregular: bool = False) -> tuple[Fabric, Fabric]:
    """A held sheet, and one that lies on it and has room to slide towards +x."""
    lower = sheet(24, 0.3, pinned=True, irregular=irregular)
    return lower, sheet(8, 0.1, at=np.array([-0.05, REST, 0.003]), irregular=irregular)


def tilted(slope: float) -> Float:
    """Gravity [m/s^2] of a level sheet that stands for one at this slope [rad] down towards +x."""
    return G * np.array([math.sin(slope), -math.cos(slope), 0.0])


def stack(irregular: bool = False) -> list[Fabric]:
    """Four sheets that lie on a held one, each a little aside."""
    return [sheet(pinned=k == 0, at=np.array([0.002 * k, REST * k, 0.001 * k]), irregular=irregular) for k in range(5)]


def collision(irregular: bool = False) -> tuple[Fabric, Fabric]:
    """Two free sheets that fly at each other."""
    other, apart = np.array([0.0, -0.3, 0.0]), np.array([0.003, 0.004, 0.002])
    return sheet(v=np.array([0.1, 0.5, 0.0]), irregular=irregular), sheet(at=apart, v=other, irregular=irregular)


def heap(seed: int, irregular: bool = False) -> list[Fabric]:
    """Three uneven sheets that fly at each other at up to 16 m/s, one of them held, faster than a step can see."""
    rng = np.random.default_rng(seed)
    speeds = [np.array([0.0, (1.0 - k) * rng.uniform(2.0, 8.0), 0.0]) for k in range(3)]
    places = [np.array([0.0, 0.02 * k, 0.0]) for k in range(3)]
    pieces = [sheet(at=places[k], v=speeds[k], pinned=k == 1, irregular=irregular) for k in range(3)]
    for piece in pieces:
        piece.position[:] += 2e-3 * rng.standard_normal(piece.position.shape)
    return pieces


def swinging(irregular: bool = False) -> list[Fabric]:
    """Two sheets far apart, held at one side, which swing."""
    pieces = [sheet(at=np.array([0.0, 0.3 * k, 0.0]), v=np.array([0.3, 0.0, 0.1]), irregular=irregular) for k in (0, 1)]
    for piece in pieces:
        piece.pinned[:8] = True
    return pieces


def irregular_square(side: int, size: float, seed: int) -> tuple[Float, Int]:
    """(n, 3) vertices [m] of a square of so many vertices a side, its middle at the origin and its outside up, and its
    Delaunay triangles (f, 3): edges of 0.4 to about 2 spacings.
    """
    from scipy.spatial import Delaunay  # half a second to import

    rng, spacing = np.random.default_rng(seed), size / (side - 1)
    across = spacing * np.arange(side) - 0.5 * size
    grid = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1)
    grid[1:-1, 1:-1] += spacing * rng.uniform(-STRAY, STRAY, (side - 2, side - 2, 2))
    flat = grid.reshape(-1, 2)
    faces = Delaunay(flat).simplices.astype(np.int32)
    (ax, ay), (bx, by) = ((flat[faces[:, k]] - flat[faces[:, 0]]).T for k in (1, 2))
    faces = np.where((ax * by < ay * bx)[:, None], faces, faces[:, ::-1])
    return np.ascontiguousarray(np.insert(flat, 1, 0.0, axis=1)), np.ascontiguousarray(faces)


def write_obj(path: Path, x: Float, faces: Int) -> None:
    """Vertices (n, 3), with all their digits, and triangles (f, 3)."""
    lines = [f"v {a!r} {b!r} {c!r}" for a, b, c in x.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
