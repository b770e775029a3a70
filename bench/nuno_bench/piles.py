"""Pieces of cloth that meet: made by hand for tests and laws, or at random by a seed; and ipctk's check of them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from nuno.collision.crossings import mesh_of
from nuno.plugin_contract import registry
from nuno.scene.files import SceneFiles
from nuno.simulation.cloth import join_fabrics
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.system import System

G = 9.81
DOWN = np.array([0.0, -G, 0.0])
"""Gravity [m/s^2], as scenes have it."""
CLOTH = "jacket"
THICKNESS = 1e-3
"""Thickness of the contact by default [m]."""
REST = 1.01 * THICKNESS
"""Distance at the start of pieces that lie on each other [m]."""
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
    if irregular:
        with TemporaryDirectory(prefix="nuno-") as folder:
            write_obj(Path(folder) / "sheet.obj", *irregular_square(side, size, side))
            mesh = {"file": "sheet.obj", "warp": [1, 0, 0], "fabric": CLOTH}
            fabric = build_model("mesh", mesh, Path(folder))
    else:
        fabric = build_model("sheet", level)
    x = fabric.position - fabric.position.mean(axis=0) + (np.zeros(3) if at is None else at)
    moving = np.zeros_like(x) + (np.zeros(3) if v is None else v)
    return replace(fabric, name=name, position=x, velocity=moving, pinned=np.full(len(x), pinned))


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


class Oracle:
    """Whether cloth passes through cloth, as ipc-toolkit sees it, by none of our own code.

    Of a mesh x (n, 3) [m] of triangles (f, 3); the last `body` vertices are a body's, which may pass through itself.
    """

    def __init__(self, x: Float, faces: Int, body: int = 0) -> None:
        import ipctk

        self._ipctk, self._mesh = ipctk, ipctk.CollisionMesh(x, mesh_of(faces).edges, faces)
        if body:
            self._mesh.can_collide = ipctk.make_static_obstacle_filter(len(x) - body)

    def crossed(self, x: Float) -> bool:
        """Whether an edge goes through a triangle that it shares no vertex with, of vertices at x (n, 3) [m]."""
        return bool(self._ipctk.has_intersections(self._mesh, x))


# Scenes by a seed that nobody tuned a step for: a sheet of cloth, or pieces that fly at each other and at a body.

FABRICS = ("denim", "interlock", "rib-knit", "polyester", "jacket", "trousers")
PINS: tuple[list[str], ...] = (["top-corners"], ["top-row"], ["top-left"], ["left-column"], [])
SOLVERS = ("symplectic_euler", "respa", "leapfrog", "rk4", "dopri5", "xpbd", "implicit_euler")
"""One of each kind."""
BODIES = ("none", "sphere", "box", "capsule", "plane", "mesh", "sdf", "skeleton", "wearer")
"""Bodies that the cloth falls on; a wearer is a capsule that one of the pieces, a skirt, is attached to."""
CLOTHS = ("quads", "triangles", "irregular")
PILE_PINS: tuple[list[str], ...] = ([], [], [], ["top-corners"], ["top-row"], ["top-left"], ["corners"])
RATES = (30, 60, 240)
"""Frames a second: how long a step of an implicit solver may be."""
HIGH = 1.4
"""Height of the lowest piece [m], which is that of a dancer."""
MOTION = 1.0
"""Bodies move for so long [s]; how much of it is seen is up to the duration."""


def random_fabric(rng: np.random.Generator) -> Any:
    """The name of a preset, or springs of stiffness 10 to 10,000 N/m."""
    if rng.random() < 0.5:
        return str(rng.choice(FABRICS))
    structural = float(f"{10 ** rng.uniform(1.0, 4.0):.3g}")
    shear, bending = (float(f"{structural * rng.uniform(low, high):.3g}") for low, high in ((0.05, 0.5), (0, 0.05)))
    fabric = {"density": round(float(rng.uniform(0.1, 0.4)), 3), "structural": structural, "shear": shear}
    return fabric | {"bending": bending, "damping_ratio": round(float(rng.uniform(0, 0.1)), 3)}


def random_scene(seed: int) -> dict[str, Any]:
    """A scene's data: a preset or springs of stiffness 10 to 10,000 N/m, with or without wind, ball and damping."""
    rng = np.random.default_rng(seed)
    side = int(rng.integers(12, 33))
    width = round(float(rng.uniform(0.3, 1.5)), 3)
    fabric = random_fabric(rng)
    pins = PINS[int(rng.integers(len(PINS)))]
    angle = round(float(rng.uniform(-90, 90)), 1)
    model = {"plugin": "sheet", "size": [width, width], "resolution": [side, side], "fabric": fabric, "pin": pins}
    model |= {"centre": [0.02, 1.0, 0.01], "rotate": {"axis": [1, 0, 0], "angle": f"{angle} deg"}}
    scene: dict[str, Any] = {"nuno": 1, "name": f"random-{seed}", "duration": 0.5, "frame_rate": 60}
    scene |= {"damping": round(float(rng.uniform(0, 1)), 2), "objects": [{"name": "cloth", "model": model}]}
    if rng.random() < 0.5 or not pins:
        reach = round(0.3 * width, 3)
        ball = {"plugin": "sphere", "centre": [0.0, round(0.9 - width / 2 - reach, 3), 0.0], "radius": reach}
        scene["bodies"] = [{"name": "ball", "collider": ball}]
    if rng.random() < 0.5:
        scene["forces"] = [{"plugin": "wind"}]
    return scene


def _round(values: Any, digits: int = 4) -> Any:
    return np.round(np.asarray(values, np.float64), digits).tolist()


def random_pile(seed: int, duration: float, folder: Path) -> Path:
    """Write a scene of a duration [s], and its meshes, into a folder; the scene's path.

    Pieces begin flat, in parallel planes that lie from four thicknesses to a hand apart; a body, and a skirt that it
    wears, begin below all of them. So nothing meets as it starts.
    """
    rng = np.random.default_rng([seed, 20])
    solver = str(rng.choice(SOLVERS))
    body, thickness = str(rng.choice(BODIES)), float(rng.choice([1e-3, 2e-3, 3e-3]))
    pieces = int(rng.integers(2, 4)) - (body == "wearer")
    sizes = rng.uniform(0.2, 0.5, pieces)
    axis, angle = rng.standard_normal(3), float(rng.choice([0.0, 90.0, rng.uniform(-90.0, 90.0)]))
    axis /= np.linalg.norm(axis)
    normal, radius = _turned(axis, np.radians(angle)), float(sizes.max()) * 0.75
    gaps = np.cumsum([0.0, *(thickness * rng.uniform(4.0, 40.0, pieces - 1))])
    middle, objects = np.array([0.0, HIGH + radius, 0.0]), []
    for k, (size, gap) in enumerate(zip(sizes, gaps - gaps.mean(), strict=True)):
        aside = np.cross(normal, rng.standard_normal(3)) * 0.15 * size
        speed = -np.sign(gap) * normal * rng.uniform(0.0, 4.0) + 0.3 * rng.standard_normal(3)
        model = {"centre": _round(middle + gap * normal + aside), "velocity": _round(speed, 3)}
        model |= {"rotate": {"axis": _round(axis, 6), "angle": f"{angle:.6f} deg"}, "fabric": random_fabric(rng)}
        model |= _cloth(rng, f"piece-{k}", float(f"{size:.3f}"), folder)
        objects.append({"name": f"piece-{k}", "model": model, "roughness": float(rng.choice([0.0, 1e-4]))})
    scene: dict[str, Any] = {"nuno": 1, "name": f"pile-{seed}", "duration": duration}
    scene |= {"frame_rate": int(rng.choice(RATES)), "damping": round(float(rng.uniform(0, 1)), 2), "seed": seed}
    scene["solver"] = {"plugin": solver, "dt": "auto"}
    scene["cloth_contact"] = {
        "plugin": "offset", "thickness": thickness, "friction": round(float(rng.uniform(0.0, 1.0)), 2),
        "damping": round(float(rng.uniform(0.0, 1.0)), 2),
    }  # fmt: skip
    if body == "wearer":
        objects.append(_skirt(rng))
    scene["objects"] = objects
    if body != "none":
        scene["bodies"] = [_body(rng, body, folder)]
    if rng.random() < 0.5:
        scene["forces"] = [{"plugin": "wind", "velocity": _round(3.0 * rng.standard_normal(3), 2)}]
    path = folder / f"pile-{seed}.yaml"
    path.write_text(json.dumps(scene, indent=1), encoding="utf-8")
    return path


def _turned(axis: Any, angle: float) -> Any:
    """The unit vector of y, turned about a unit axis (Rodrigues)."""
    y = np.array([0.0, 1.0, 0.0])
    return np.cos(angle) * y + np.sin(angle) * np.cross(axis, y) + (1.0 - np.cos(angle)) * axis[1] * axis


def _cloth(rng: np.random.Generator, name: str, size: float, folder: Path) -> dict[str, Any]:
    """A square of 10 to 18 vertices a side; its shortest edge is longer than 4 mm."""
    kind, side, pins = str(rng.choice(CLOTHS)), int(rng.integers(10, 19)), PILE_PINS[int(rng.integers(len(PILE_PINS)))]
    if kind != "irregular":
        return {"plugin": "sheet", "cells": kind, "size": [size, size], "resolution": [side, side], "plane": "xz",
                "pin": pins}  # fmt: skip
    write_obj(folder / f"{name}.obj", *irregular_square(side, size, int(rng.integers(1 << 30))))
    held = {
        "top-left": [0], "top-corners": [0, side - 1], "top-row": list(range(side)),
        "corners": [0, side - 1, side * (side - 1), side * side - 1],
    }  # fmt: skip
    vertices = [vertex for pin in pins for vertex in held[pin]]
    return {"plugin": "mesh", "file": f"{name}.obj", "pin": vertices, "warp": [1, 0, 0]}


def _skirt(rng: np.random.Generator) -> dict[str, Any]:
    """A skirt that a capsule wears, with or without folds; its cells are nearly square from waist to hem."""
    model = {"plugin": "skirt", "waist_radius": 0.11, "hem_radius": round(float(rng.uniform(0.13, 0.18)), 3)}
    model |= {"length": 0.288, "columns": 48, "rows": 17, "centre": [0, HIGH - 0.4, 0], "fabric": random_fabric(rng)}
    model |= {"fullness": float(rng.choice([1.0, 1.4])), "pleats": 6, "attach": {"body": "body", "frame": "body"}}
    return {"name": "skirt", "model": model}


def _body(rng: np.random.Generator, kind: str, folder: Path) -> dict[str, Any]:
    """Below the cloth; most move up into it, aside, and turn."""
    made: dict[str, Any] = {"name": "body", "friction": round(float(rng.uniform(0.0, 1.0)), 2)}
    reach = round(float(rng.uniform(0.08, 0.2)), 3)
    colliders: dict[str, dict[str, Any]] = {
        "sphere": {"radius": reach},
        "box": {"size": _round(rng.uniform(0.05, 0.4, 3), 3)},
        "capsule": {"a": [-0.2, 0, 0], "b": [0.2, 0, 0], "radius": round(0.5 * reach, 3)},
        "plane": {},
        "mesh": {"file": "stone.obj"},
        "sdf": {"file": "stone.obj", "tolerance": "2 mm"},
        "skeleton": {},
        "wearer": {"plugin": "capsule", "a": [0, -0.7, 0], "b": [0, -0.4, 0], "radius": 0.1},
    }
    made["collider"] = {"plugin": kind} | colliders[kind]
    if kind in ("mesh", "sdf"):
        import trimesh

        # An icosahedron whose faces are cut in four twice, a little flat.
        ball = trimesh.creation.icosphere(subdivisions=2, radius=reach)
        write_obj(folder / "stone.obj", np.asarray(ball.vertices) * [1.0, 0.7, 1.0], np.asarray(ball.faces))
    if kind == "mesh":
        made["contact"] = {"plugin": "sliding"}
    if kind == "skeleton":
        return made | {"motion": {"plugin": "hula", "tempo": f"{rng.uniform(0.5, 2.0):.2f} Hz", "height": 1.4}}
    # A wearer's top is a good way below its middle already.
    lowered = {"plane": 0.15, "wearer": 0.0}.get(kind, 0.3)
    start = np.array([0.0, HIGH - lowered, 0.0])
    way = rng.uniform([-0.3, 0.0, -0.3], [0.3, 1.2, 0.3]) * float(rng.random() < 0.8)
    turn = rng.uniform(-90.0, 90.0, 3) * (kind != "plane")
    made["motion"] = {"plugin": "keyframes", "times": [0.0, MOTION], "positions": _round([start, start + way * MOTION])}
    made["motion"]["rotations"] = [["0 deg"] * 3, [f"{angle:.3f} deg" for angle in turn]]
    return made
