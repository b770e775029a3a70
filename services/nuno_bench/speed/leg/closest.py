"""Closest points of a leg: how many a second, from the last triangle on and without it, beside other libraries."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from nuno import registry
from nuno_bench.report.result import Result
from nuno_bench.speed.timing import seconds, watch_compiler
from nuno_schemas.fabric import Float, Int

CASE = "closest point"
UNIT = "M queries/s"
LEGS = {"20,000": 58, "330,000": 244}
"""About how many triangles a leg of so many vertices round it has."""
POINTS = 200_000
OFF, MOVED = 2e-3, 2e-4
"""Points lie about so far from the surface [m], and have moved by so much since the last triangle was found."""
BAR = 3.0
PEERS = ("trimesh", "igl", "open3d")
PEER_POINTS = 20_000


class NoFiles:
    """The leg needs none."""

    def resolve(self, name: str) -> Any:
        raise FileNotFoundError(name)


def leg(around: int) -> tuple[Float, Int]:
    """Vertices and triangles of the leg that comes with nuno."""
    plugin = registry.load("nuno.colliders", "mesh")
    shape = plugin.build(plugin.Config(shape="leg", resolution=around), None, NoFiles())
    return shape.vertices, shape.faces


def points_near(x: Float, faces: Int, count: int) -> Float:
    """(count, 3) points about OFF from the surface, in the order of the triangles they are near."""
    rng = np.random.default_rng(0)
    a, b, c = (x[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = np.sort(rng.choice(len(faces), count, p=area / area.sum()))
    weights = rng.dirichlet(np.ones(3), count)
    return np.asarray(np.einsum("nk,nkj->nj", weights, x[faces[chosen]]) + OFF * rng.normal(size=(count, 3)))


def closest(repeats: int) -> list[Result]:
    """Rates on legs of 20,000 and 330,000 triangles, and of the peers that are installed."""
    plugin = registry.load("nuno.colliders", "mesh")
    results = []
    for name, around in LEGS.items():
        x, faces = leg(around)
        points = points_near(x, faces, POINTS)
        moved = points + MOVED * np.random.default_rng(1).normal(size=points.shape)
        began = time.perf_counter()
        search = plugin.search(x, faces)
        taken = time.perf_counter() - began
        with watch_compiler() as compiler:
            first = seconds(partial(search, points))
        start = search(points).face
        about = f"{len(faces):,} triangles, tree made in {taken:.2g} s, {compiler.number} functions compiled"
        warm = [rate(partial(search, moved, start), POINTS) for _ in range(repeats)]
        cold = [rate(partial(search, moved), POINTS) for _ in range(repeats)]
        what = f"{name} triangles"
        results.append(Result(CASE, f"{what}, last as start", UNIT, tuple(warm), BAR, None, False, first, None, about))
        results.append(Result(CASE, f"{what}, without start", UNIT, tuple(cold)))
        results += peers(x, faces, moved[:: POINTS // PEER_POINTS], what, repeats)
    return results


def rate(call: Callable[[], object], count: int) -> float:
    """Millions a second."""
    return count / seconds(call) * 1e-6


def peers(x: Float, faces: Int, points: Float, what: str, repeats: int) -> list[Result]:
    """The same question, signed distance and triangle, to each library that is there; one that is not says so."""
    results = []
    for name in PEERS:
        if importlib.util.find_spec(name) is None or (name == "trimesh" and importlib.util.find_spec("rtree") is None):
            continue
        call = PREPARE[name](x, faces, points)
        call()
        samples = tuple(rate(call, len(points)) for _ in range(repeats))
        results.append(Result(CASE, f"{what}, {name}", UNIT, samples, note=f"{len(points):,} of the points"))
    return results


def prepare_trimesh(x: Float, faces: Int, points: Float) -> Callable[[], object]:
    """Bounding boxes in an R-tree; without the sign, which takes a ray a point more."""
    import trimesh

    mesh: Any = trimesh.Trimesh(x, faces, process=False)
    return lambda: trimesh.proximity.closest_point(mesh, points)


def prepare_igl(x: Float, faces: Int, points: Float) -> Callable[[], object]:
    """A tree of boxes and pseudonormals, built in every call."""
    import igl

    return lambda: igl.signed_distance(points, x, faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)


def prepare_open3d(x: Float, faces: Int, points: Float) -> Callable[[], object]:
    """Embree, in single precision."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.core.Tensor(x.astype(np.float32)), open3d.core.Tensor(faces.astype(np.uint32)))
    asked = open3d.core.Tensor(points.astype(np.float32))
    return lambda: scene.compute_signed_distance(asked)


PREPARE: dict[str, Callable[[Float, Int, Float], Callable[[], object]]] = {
    "trimesh": prepare_trimesh,
    "igl": prepare_igl,
    "open3d": prepare_open3d,
}
