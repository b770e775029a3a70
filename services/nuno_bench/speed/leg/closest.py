"""Closest points of a leg and its distance field: how many are asked for a second, beside other libraries."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nuno import registry
from nuno.scene.files import SceneFiles
from nuno_bench import extras
from nuno_bench.report.result import Result
from nuno_bench.speed.timing import measure
from nuno_schemas.fabric import Float, Int

UNIT = "M queries/s"
LEGS = {"20,000": 58, "330,000": 244}
"""About how many triangles a leg of so many vertices round it has."""
FIELD = 95
"""The same of the leg whose field is made: about 50,000 triangles."""
POINTS = 200_000
OFF, MOVED = 2e-3, 2e-4
"""Points lie about so far from the surface [m], and have moved by so much since the last triangle was found."""
BAR, AIM = 3.5, 5.0
FEWER = 10
"""Peers are asked for so many times fewer points."""


def leg(around: int) -> tuple[Float, Int]:
    """Vertices and triangles of the leg that comes with nuno."""
    plugin = registry.load("nuno.colliders", "mesh")
    shape = plugin.build(plugin.Config(shape="leg", resolution=around), None, SceneFiles(Path(), ()))
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
    search_of = registry.load("nuno.colliders", "mesh").search
    timed = partial(measure, "closest point", unit=UNIT, repeats=repeats)
    results = []
    for name, around in LEGS.items():
        x, faces = leg(around)
        points = points_near(x, faces, POINTS)
        moved = points + MOVED * np.random.default_rng(1).normal(size=points.shape)
        search, fewer = search_of(x, faces), moved[::FEWER]
        start, work, note = search(points).face, 1e-6 * POINTS, f"{len(faces):,} triangles"
        warm, cold = partial(search, moved, start), partial(search, moved)
        results.append(timed(f"{name} triangles, last as start", call=warm, work=work, bar=BAR, aim=AIM, note=note))
        results.append(timed(f"{name} triangles, without start", call=cold, work=work))
        results += [
            timed(f"{name} triangles, {peer}", call=make(x, faces, fewer), work=1e-6 * len(fewer), note=what)
            for peer, (package, make, what) in PEERS.items()
            if not extras.missing(package)
        ]
    return results


def sdf(repeats: int) -> list[Result]:
    """Time to build a leg's distance field of 1 mm, and how many distances with gradients it gives a second."""
    plugin: Any = registry.load("nuno.colliders", "sdf")
    x, faces = leg(FIELD)
    what, build = f"{len(faces):,} triangles, 1 mm", partial(plugin.field, x, faces, 1e-3)
    built = measure("sdf", f"{what}: build", "s", build, min(repeats, 3), bar=10.0, at_most=True)
    ask, note = partial(plugin.sampler(build()), points_near(x, faces, POINTS)), "as vertices of cloth lie"
    order = f"{what}: in the order of the surface"
    return [built, measure("sdf", order, "M samples/s", ask, repeats, 1e-6 * POINTS, bar=20.0, note=note)]


def trimesh_peer(x: Float, faces: Int, points: Float) -> Callable[[], object]:
    """Of trimesh, which comes with nuno, given rtree."""
    import trimesh

    return partial(trimesh.proximity.closest_point, trimesh.Trimesh(x, faces, process=False), points)


def igl_peer(x: Float, faces: Int, points: Float) -> Callable[[], object]:
    """Of libigl, which builds its tree in every call."""
    import igl

    return partial(igl.signed_distance, points, x, faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)


def open3d_peer(x: Float, faces: Int, points: Float) -> Callable[[], object]:
    """Of Open3D, by Embree."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.core.Tensor(x.astype(np.float32)), open3d.core.Tensor(faces.astype(np.uint32)))
    return partial(scene.compute_signed_distance, open3d.core.Tensor(points.astype(np.float32)))


PEERS: dict[str, tuple[str, Callable[[Float, Int, Float], Callable[[], object]], str]] = {
    "trimesh": ("rtree", trimesh_peer, "boxes in an R-tree; without the sign, which takes a ray a point more"),
    "igl": ("igl", igl_peer, "a tree of boxes and pseudonormals, made in every call"),
    "open3d": ("open3d", open3d_peer, "in single precision"),
}
"""What each needs beside nuno, how its question is asked, signed distance and triangle, and what is to say of it."""
