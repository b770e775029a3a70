"""The skirt of scene skirt-hula on its dancer, as plain arrays for any engine, and how a run of it is judged."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from nuno.collision.bodies import surface
from nuno.collision.crossings import find_crossings, mesh_of
from nuno.collision.distance import penetration
from nuno.exports.camera import place_camera, z_up
from nuno.exports.cloth import BODY, STRETCH, ShownPiece, as_url, paint_stretch
from nuno.exports.pictures import RENDERER, ROOM
from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.peers.page import Comparison, fastest, is_ours, plain
from nuno_bench.peers.pile import PileSolver
from nuno_bench.peers.problem import RATE, Sheet
from nuno_bench.peers.process import EnginePoint
from nuno_bench.peers.python import plain_sheet
from nuno_bench.piles import Oracle
from nuno_bench.report.page import Figure, Image, Pictures, Report, Sections, number
from nuno_bench.report.plots import Curve, Panel, draw
from nuno_cloth.fabrics.material import resolve
from nuno_contact.motions.rotations import slerp
from nuno_schemas.bodies import Geometry, Poses, rotation_matrices
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float, Int
from nuno_schemas.pictures import Mesh
from nuno_schemas.scene import View

SCENE = "skirt-hula"
OVERRIDES = ("forces=[]", f"frame_rate={RATE}", "record={}", "contact={plugin: penalty, margin: 0 m}")
"""Changes of the shipped scene, so that every engine can hold it: no air that pushes, but the damping of all motion
that it has beside, and cloth that meets the body at its surface, as in the other engines."""
DEEP = 3e-3
"""How deep in the body cloth counts as being in it [m]: more than penalty contact lets it sink in, 0.7 mm, and than
what the longest edge, a diagonal of 35 mm, cuts off a leg, of 73 mm of radius, when both its ends lie on it, 2.1 mm."""
DIVERGED = 10.0
"""Length of a spring over its rest length from which on a run has diverged."""
DURATION = 0.25
"""Simulated time by default [s]: 15 frames; the first of them are alike in every engine."""
ALONG = np.linspace(0.0, 1.0, 7)[:, None, None]
"""Places along an edge that are looked at."""
CONVERGED, FINE = "leapfrog", (640, 320)
"""Solver of the converged run and its check, and their steps a frame: the explicit limit is near 100."""


@dataclass(frozen=True)
class Skirt(Sheet):
    """A pleated skirt that swings, and the body it hangs on. Vertices are row by row from the waist, which is held.

    flat        (n, 3) [m] its form at rest, pleated; at the start it is at `x` and moves by `v` (n, 3) [m/s]
    faces       (f, 3) triangles; columns: vertices of a row
    quads       (h, 4) vertices of hinges, flat at rest: edge start and end, both opposite; bend (h,) stiffness [N m]
    fabric      tension along warp and weft and shear [N/m]: warp runs down, weft around
    thickness   distance from which on cloth pushes cloth [m]; friction, rub: of cloth on cloth and on the body
    geometry    of the body, of capsules alone; poses: where they are at the start and at the end of every frame
    hips        number of the frame that the waist moves with
    begin       time of the start in the scene [s]; size: diagonal of the box about the cloth at rest [m]
    """

    flat: Float
    v: Float
    faces: Int
    columns: int
    quads: Int
    bend: Float
    fabric: tuple[float, float, float]
    thickness: float
    friction: float
    rub: float
    geometry: Geometry
    poses: tuple[Poses, ...]
    hips: int
    begin: float
    size: float

    @property
    def frames(self) -> int:
        return len(self.poses) - 1

    def places(self, frame: int, share: float) -> tuple[Float, Float]:
        """Rotations (f, 4) and places (f, 3) [m] of the body's frames at a share of the way through a frame."""
        one, two = self.poses[frame], self.poses[frame + 1]
        turned = slerp(one.rotation, two.rotation, share)
        return turned, (1.0 - share) * one.translation + share * two.translation

    def waist(self, turned: Float, moved: Float) -> Float:
        """(b, 3) [m] of the held vertices where the body's frames are so turned and moved."""
        start = self.poses[0]
        first, now = rotation_matrices(np.stack([start.rotation[self.hips], turned[self.hips]]))
        local = (self.x[self.pinned] - start.translation[self.hips]) @ first
        return np.asarray(local @ now.T + moved[self.hips])


@dataclass(frozen=True)
class SkirtScore:
    """Measures of the frames of a run.

    frames    (frames, n, 3) [m]
    off       after every frame, the mean distance of vertices from the converged run's, over the cloth's size
    hem       mean height of the hem's vertices, and radius: mean distance from their middle, both over all frames [m]
    stretch   the largest elongation of any spring in any frame
    crossed   numbers, from 1 on, of the frames in which an edge goes through a triangle, by our own check
    ipctk     how many those are by ipctk, None where that is not installed
    edges, vertices  after every frame, how many are deeper in the body than DEEP, but for what is held
    depth     the deepest of any free vertex in any frame [m]
    """

    frames: Float
    off: tuple[float, ...]
    hem: float
    radius: float
    stretch: float
    crossed: tuple[int, ...]
    ipctk: int | None
    edges: tuple[int, ...]
    vertices: tuple[int, ...]
    depth: float


def hula_skirt(seconds: float, lead: float | None = None, overrides: tuple[str, ...] = (), threads: int = 1) -> Skirt:
    """The skirt when our own solver has let it swing for `lead` [s], as long as the dance grows unless given.

    Raises RunFailed where it does not come there, and BadInput where less than a frame is left to see.
    """
    if (frames := round(seconds * RATE)) < 1:
        problem, limit = "the time to simulate is less than a frame", f"at least {1 / RATE:.3g} s"
        raise BadInput(problem, field="--duration", value=f"{seconds:g} s", limit=limit)
    simulation = Simulation.with_bodies(scene_file.read(shipped.find(SCENE), (*OVERRIDES, *overrides)), threads)
    scene, fabric = simulation.loaded.scene, simulation.fabric
    first = round((float(simulation.loaded.motions[0].config.ramp) if lead is None else lead) * RATE)  # type: ignore[union-attr]
    while simulation.frame < first:
        report = simulation.step().report
        if report.status != "ok":
            raise RunFailed(f"the lead-in of {SCENE}: {report.status}: {report.message}")
    sheet, hinges, geometry = plain_sheet(simulation), fabric.hinges, simulation.geometry
    poses = tuple(simulation.find_poses(first + i) for i in range(frames + 1))
    config: Any = simulation.loaded.cloth_contact and simulation.loaded.cloth_contact.config
    material: Any = resolve(scene.objects[0].model.config["fabric"])
    assert hinges is not None and geometry is not None
    (bound,) = fabric.bindings
    return Skirt(
        **vars(sheet) | {"x": simulation.state.x.copy()}, flat=sheet.x, v=simulation.state.v.copy(),
        faces=fabric.faces, columns=len(bound.vertices), quads=hinges.quads(), bend=hinges.per_hinge(hinges.k),
        fabric=(material.warp, material.weft, material.shear), thickness=config.thickness, friction=config.friction,
        rub=float(geometry.friction[0]), geometry=geometry, poses=poses,  # type: ignore[arg-type]
        hips=geometry.frames.index(f"{bound.body}/{bound.frame}"), begin=first / RATE,
        size=float(np.linalg.norm(np.ptp(sheet.x, axis=0))),
    )  # fmt: skip


def look(skirt: Skirt, frames: Float, exact: Float) -> SkirtScore:
    """At positions (frames, n, 3) [m] that any engine has published, beside those of the converged run.

    Raises RunFailed where they have diverged. Looked at all the same, cloth that is metres long crosses itself at so
    many places that to find them takes minutes.
    """
    mesh, ends = mesh_of(skirt.faces), skirt.pairs
    lengths = np.linalg.norm(frames[:, ends[:, 1]] - frames[:, ends[:, 0]], axis=2)
    longest = (lengths / skirt.rest).max(axis=1)
    if (apart := longest > DIVERGED).any():
        raise RunFailed(
            f"diverged: a spring is over {DIVERGED:g} times as long as at rest in frame {apart.argmax() + 1}"
        )
    off = np.linalg.norm(frames - exact, axis=2).mean(axis=1) / skirt.size
    hem = frames[:, -skirt.columns :]
    crossed = tuple(number for number, x in enumerate(frames, 1) if len(find_crossings(x, mesh).edges))
    oracle = Oracle(skirt.x, skirt.faces) if importlib.util.find_spec("ipctk") is not None else None
    by_ipctk = sum(oracle.crossed(x) for x in frames) if oracle is not None else None
    deep = [_in_body(skirt, x, mesh.edges, poses) for x, poses in zip(frames, skirt.poses[1:], strict=True)]
    return SkirtScore(
        frames, tuple(off.tolist()), float(hem[..., 1].mean()),
        float(np.linalg.norm((hem - hem.mean(axis=1, keepdims=True))[..., [0, 2]], axis=2).mean()),
        float(longest.max()) - 1.0, crossed, by_ipctk,
        tuple(edges for edges, _, _ in deep), tuple(n for _, n, _ in deep),
        max(depth for _, _, depth in deep),
    )  # fmt: skip


def _in_body(skirt: Skirt, x: Float, edges: Int, poses: Poses) -> tuple[int, int, float]:
    """Return the numbers of free edges and vertices in the body, and the depth of the deepest vertex [m]."""
    own = penetration(x[skirt.free], skirt.geometry, poses)
    some = edges[skirt.free[edges].any(axis=1)]
    points = (1.0 - ALONG) * x[some[:, 0]] + ALONG * x[some[:, 1]]
    depth = penetration(points.reshape(-1, 3), skirt.geometry, poses).reshape(len(ALONG), -1)
    return int((depth.max(axis=0) > DEEP).sum()), int((own > DEEP).sum()), float(own.max(initial=0.0))


class SkirtSolver(PileSolver):
    """The same, from where and how the skirt is."""

    scene, overrides = SCENE, OVERRIDES

    def __init__(self, skirt: Skirt, solver: str) -> None:
        self.skirt = skirt
        super().__init__(skirt, solver)

    def reset(self) -> None:
        super().reset()
        simulation, skirt = self.simulation, self.skirt
        simulation.state.x[:], simulation.state.v[:] = skirt.x, skirt.v
        simulation.frame = round(skirt.begin * RATE)
        simulation.state.t = simulation.t
        simulation.poses = simulation.find_poses(simulation.frame)
        self.simulation.present()


def converge(skirt: Skirt, seconds: float) -> tuple[Float, list[EnginePoint[SkirtScore]]]:
    """Frames (frames, n, 3) [m] of the converged run; it, and one of half as many steps that checks it, as points.

    Errors mean little below what the two are apart. Raises RuntimeError where one breaks down.
    """
    runs, found = list[Float](), list[EnginePoint[SkirtScore]]()
    for name, steps in zip(("converged", "check"), FINE, strict=True):
        engine, begin = SkirtSolver(skirt, f"plugin: {CONVERGED}, dt: {1.0 / RATE / steps!r}"), time.perf_counter()
        runs.append(engine.advance(seconds))
        taken = time.perf_counter() - begin
        setting = f"{CONVERGED}, {steps} steps a frame"
        found.append(EnginePoint(name, setting, seconds=(taken,), score=look(skirt, runs[-1], runs[0])))
    return runs[0], found


JUDGED = (
    "Off: the mean distance of vertices from the converged run's at the end, over the cloth's size; check is the same "
    "by steps twice as long, and below how far it is off an error says little. Hem height and hem radius: the hem's "
    "mean height, and its mean distance from its middle, over all frames. Stretch: the most of any of the skirt's "
    "springs in any frame, against its length at rest. Crossed: frames in which an edge goes through a triangle, by "
    "our own check and by ipctk, empty where that is not installed. In the body: edges and free vertices more than "
    f"{1e3 * DEEP:g} mm deep, at the end and in the worst frame. Depth: the deepest vertex of any frame. Time: the "
    "median over the repeats, over what is simulated. Start, from a fresh process to the end of the first frame with "
    "all that is compiled, is in no time. Times ours: over that of our fastest that is no farther off; the bar is met "
    "where it is above 1. A setting is not repeated once it has used a third of its limit."
)
CAPTION = "How far engines are off over time, each at the setting that ends nearest; ours are solid."
SHOWN = "The end of each engine, at its setting that is least off, and of the converged run, from one place."
SIZE = (480, 480)
LEGEND = {"label": "stretch (log scale)", "low": STRETCH[0], "high": STRETCH[1], "format": "percent"}


@dataclass(frozen=True)
class SkirtComparison(Comparison[SkirtScore]):
    """The comparison on the skirt; its first points are the converged run and its check."""

    skirt: Skirt
    title: ClassVar[str] = "A skirt on a dancer in other engines"
    judged: ClassVar[str] = JUDGED
    measures: ClassVar[tuple[str, ...]] = (
        "off [%]", "hem height [mm]", "hem radius [mm]", "stretch [%]", "crossed", "by ipctk", "edges in body",
        "vertices in body", "depth [mm]",
    )  # fmt: skip

    @property
    def seconds(self) -> float:
        return self.skirt.frames / RATE

    def cells(self, score: SkirtScore) -> list[str]:
        figures = (100 * score.off[-1], 1e3 * score.hem, 1e3 * score.radius, 100 * score.stretch, len(score.crossed))
        inside = [f"{each[-1]}, {max(each)}" for each in (score.edges, score.vertices)]
        by_ipctk = "" if score.ipctk is None else str(score.ipctk)
        return [*map(number, figures), by_ipctk, *inside, number(1e3 * score.depth)]

    def no_worse(self, one: SkirtScore, other: SkirtScore) -> bool:
        return one.off[-1] <= other.off[-1]

    def nearest(self) -> list[EnginePoint[SkirtScore]]:
        """Return the point that ends nearest to the converged run: of that run, and of every engine with a score."""
        names = ["converged", *(kind.name for kind in self.kinds)]
        scored = [[p for p in self.points if p.kind == name and p.score is not None] for name in names]
        return [min(own, key=lambda point: end_of(point.score)) for own in scored if own]

    def verdicts(self) -> list[str]:
        """Our fastest, and the nearest of each other kind beside ours that is no farther off."""
        texts = []
        own = fastest(filter(is_ours, self.points), lambda seen: True)
        if own is not None:
            took = number(own.median / self.seconds)
            texts.append(f"Ours: {own.kind} ({own.setting}) takes {took} s for a second.")
        for point in self.nearest():
            if is_ours(point) or point.kind == "converged" or point.score is None:
                continue
            times, far = self.times_ours(point), number(100 * end_of(point.score))
            beside = f", {number(times)} times as long as ours that is no farther off" if times is not None else ""
            texts.append(
                f"{point.kind} ({point.setting}): {number(point.median / self.seconds)} s{beside}, {far}% off."
            )
        scored = {point.kind for point in self.points if point.score is not None}
        never = [kind.name for kind in self.kinds if kind.name not in scored and not kind.missing]
        return texts + ([f"Without an end at any setting shown: {', '.join(never)}."] if never else [])

    def error_over_time(self) -> Panel:
        """A curve of each kind that has come to the end; and of the check."""
        t = np.arange(1, self.skirt.frames + 1) / RATE
        shown = [p for p in self.points if p.kind == "check"] + [p for p in self.nearest() if p.kind != "converged"]
        curves = [
            Curve(point.kind, t, 100 * np.array(point.score.off), i, not is_ours(point))
            for i, point in enumerate(shown) if point.score is not None
        ]  # fmt: skip
        return Panel("", curves, "time since the lead-in [s]", "vertices off by [% of the cloth's size]", log="y")

    def report(self, about: Mapping[str, str]) -> Report:
        skirt, table = self.skirt, self.settings()
        lead = (
            f"{self.seconds:.3g} s of the scene {SCENE} after its lead-in of {skirt.begin:.3g} s, which our own solver "
            f"steps: all engines go on from the same places and velocities. {len(skirt.mass):,} vertices, "
            f"{len(skirt.k):,} springs, {len(skirt.bend):,} hinges, {len(skirt.geometry.kind)} capsules of a dancer; "
            "no air but its drag on all motion. Each engine in a process of its own, on the processor."
        )
        ends = {f"{point.kind}, {point.setting}": point.score.frames[-1] for point in self.nearest() if point.score}
        figure = Figure(draw([self.error_over_time()], height=4.0), CAPTION)
        sections: Sections = [
            ("", []), ("Where they end", [SHOWN, draw_ends(skirt, ends)]), ("All settings", [table, figure])
        ]  # fmt: skip
        points = []
        for point in self.points:
            score = point.score and {name: value for name, value in vars(point.score).items() if name != "frames"}
            points.append(plain(point) | {"score": score})
        return self.compose(lead, sections, [lead, table, JUDGED], about, points=points, size_m=skirt.size,
                            begin_s=skirt.begin)  # fmt: skip


def end_of(seen: SkirtScore | None) -> float:
    """Return the error of the end as a share of the cloth's size."""
    return seen.off[-1] if seen is not None else np.inf


def draw_ends(skirt: Skirt, ends: Mapping[str, Float]) -> Pictures:
    """Draw positions (n, 3) [m] at the end, by their captions; the camera is fitted to the first."""
    renderer = registry.load("nuno.renderers", RENDERER)
    pairs = skirt.pairs.astype(np.int32)
    piece = ShownPiece("skirt", 0, len(skirt.mass), skirt.faces, pairs, skirt.rest, None, None, None)
    shape = surface(skirt.geometry)
    points = shape.at(skirt.poses[-1])
    body = _up(Mesh(points, shape.faces, np.tile(parse_hex(BODY), (len(points), 1)), two_sided=False))
    cloths = {name: _up(Mesh(x, piece.faces, paint_stretch(piece.stretch(x)))) for name, x in ends.items()}
    camera = place_camera(View(), list(cloths.values())[:1], SIZE, ROOM)
    images = []
    for name, cloth in cloths.items():
        config = renderer.Config.model_validate({"legend": LEGEND, "ground": float(body.vertices[:, 2].min())})
        images.append(Image(as_url(renderer.render(config, [cloth, body], camera)), name))
    return Pictures(images)


def _up(mesh: Mesh) -> Mesh:
    return replace(mesh, vertices=z_up(mesh.vertices))
