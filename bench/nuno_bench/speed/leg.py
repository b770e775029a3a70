"""Cases of a stocking on a leg: closest points, a distance field, the fit, a picture of its yarns by rays."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nuno.collision.bodies import build_bodies
from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped
from nuno.scene.files import SceneFiles
from nuno.simulation.run import Simulation
from nuno_bench import options
from nuno_bench.piles import build_model
from nuno_bench.report.page import Result
from nuno_bench.speed.timing import measure, watch_compiler
from nuno_schemas.fabric import Float, Int, State
from nuno_schemas.operation import Surface
from nuno_schemas.pictures import Mesh, Worn, frame
from nuno_schemas.vectors import face_areas

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
BARS = {"stocking-150": 15.0, "stocking-300": 90.0}
"""Seconds of a fit, on two cores."""
FITTED_LEGS = {"13,728": ("bodies.leg.collider.resolution=48",), "51,840": ()}
"""Triangles of a coarse leg, and of the one that scenes have."""
MOST = 3
"""Samples: fits take long, and always the same steps."""
AROUND = 96
"""Vertices round the leg of a picture."""
NET = 300
"""Points of its stocking, along and round the leg."""
CURVE = 4
"""Pieces of a curve to a link."""
SIDE, SAMPLES = 1024, 4
SLOWEST = 10.0
"""Seconds of a picture, on two cores."""
CUT = 0.06
"""Share of the leg's rings that the stocking leaves free at either end."""
RADIUS = 1.5e-4
"""Of its yarns [m]."""


def leg(around: int) -> tuple[Float, Int]:
    """Vertices and triangles of the leg that comes with nuno."""
    plugin = registry.load("nuno.colliders", "mesh")
    shape = plugin.build(plugin.Config(shape="leg", resolution=around), None, SceneFiles(Path(), ()))
    return shape.vertices, shape.faces


def points_near(x: Float, faces: Int, count: int) -> Float:
    """(count, 3) points about OFF from the surface, in the order of the triangles they are near."""
    rng = np.random.default_rng(0)
    area = face_areas(x[faces])
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
            if not options.missing_package(package)
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


def fit(name: str, *overrides: str, frames: int | None = None) -> tuple[float, int]:
    """Seconds from reading the scene to rest, or for so many frames, and steps. Raises RuntimeError without rest."""
    began = time.perf_counter()
    loaded = scene_file.read(shipped.find(f"knit/{name}"), overrides)
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    simulation = Simulation(loaded, bodies.geometry, poses, 0)
    while not simulation.finished and simulation.frame != frames:
        simulation.advance(poses, poses)
    if frames is None and not simulation.balanced:
        raise RuntimeError(f"{name} did not come to rest in {simulation.t:g} s")
    return time.perf_counter() - began, simulation.frame * (simulation.steps or 0)


def fits(repeats: int) -> list[Result]:
    """Both stockings on the leg that scenes have, of over 50,000 triangles, and on a coarser one."""
    results = []
    for name, bar in BARS.items():
        for triangles, leg in FITTED_LEGS.items():
            with watch_compiler() as compiler:
                first, _ = fit(name, *leg, frames=1)
            taken, steps = zip(*(fit(name, *leg) for _ in range(min(repeats, MOST))), strict=True)
            note = f"{steps[0]:,} steps; {compiler.number} functions compiled"
            what = f"{name}, {triangles} triangles"
            results.append(Result("fit", what, "s", taken, bar=bar, at_most=True, compile_seconds=first, note=note))
    return results


def over_leg(x: Float, rows: int, columns: int) -> Float:
    """(rows columns, 3) points of a net on the leg: its rings, drawn finer. Such a stocking is worn, not fitted."""
    rings = x[: (len(x) - 2) // AROUND * AROUND].reshape(-1, AROUND, 3)[::-1]
    row = np.linspace(CUT, 1.0 - CUT, rows) * (len(rings) - 1)
    column = np.arange(columns) * AROUND / columns
    i, j = row.astype(int), column.astype(int)
    s, t = (row - i)[:, None, None], (column - j)[None, :, None]
    after = (j + 1) % AROUND
    low = rings[i][:, j] * (1.0 - t) + rings[i][:, after] * t
    high = rings[i + 1][:, j] * (1.0 - t) + rings[i + 1][:, after] * t
    return np.asarray((low * (1.0 - s) + high * s).reshape(-1, 3))


def stocking(points: int = NET) -> tuple[Worn, int]:
    """A stocking of plain knit on the leg, z up, as curves; and how many links it has."""
    fabric = build_model("knit", {"form": "tube", "wales": points // 2, "courses": points - 1})
    x, faces = leg(AROUND)
    x = np.ascontiguousarray(x[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))
    on = over_leg(x, points, points)
    smooth: Any = registry.load("nuno.operations", "smooth")
    options = smooth.Config.model_validate({"radius": RADIUS, "samples": CURVE})
    curves = smooth.apply(options, fabric, State(on, np.zeros_like(on)), Surface(x, faces)).curves
    assert fabric.springs is not None
    return Worn((Mesh(x, faces, two_sided=False),), on, fabric.springs.pairs(), curves), fabric.springs.number


def render(repeats: int) -> list[Result]:
    """A picture with shadows and occlusion, and how many rays from the eye that is a second."""
    worn, links = stocking()
    plugin = registry.load("nuno.yarn_pictures", "yarns")
    config = plugin.Config.model_validate({"samples": SAMPLES})
    draw = partial(plugin.draw, config, worn, frame(worn.points, size=(SIDE, SIDE)))
    assert worn.yarns is not None
    note = f"{len(worn.yarns.segments()):,} capsules, shadows and occlusion, the tree made each time"
    what = f"{SIDE} x {SIDE}, {SAMPLES} samples a pixel, {links:,} links"
    taken = measure("render", what, "s", draw, repeats, bar=SLOWEST, at_most=True, note=note)
    rates = tuple(1e-6 * SAMPLES * SIDE * SIDE / seconds for seconds in taken.samples)
    return [taken, Result("render", "rays from the eye", "M rays/s", rates, note="each with what it sends on")]


PEERS: dict[str, tuple[str, Callable[[Float, Int, Float], Callable[[], object]], str]] = {
    "trimesh": ("rtree", trimesh_peer, "boxes in an R-tree; without the sign, which takes a ray a point more"),
    "igl": ("igl", igl_peer, "a tree of boxes and pseudonormals, made in every call"),
    "open3d": ("open3d", open3d_peer, "in single precision"),
}
"""Package, query of signed distance and triangle, and note of each peer."""
