"""What `nuno bench peers skirt` found, as values for a page, the screen, the documentation and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nuno import registry
from nuno.collision.surfaces import surface
from nuno.exports.camera import place_camera, z_up
from nuno.exports.cloth import ShownPiece
from nuno.exports.paint import BODY, INSET, STRETCH, paint_stretch
from nuno.exports.pictures import RENDERER, ROOM
from nuno_bench.gallery.kind import embed
from nuno_bench.peers.page import Measured, against, compose, plain
from nuno_bench.peers.problem import RATE
from nuno_bench.peers.process import Point, fastest, is_ours, times_ours
from nuno_bench.peers.skirt.problem import DEEP, SCENE, Seen, Skirt
from nuno_bench.report.page import Figure, Image, Pictures, Report, Sections, Table, number, spread_of
from nuno_bench.report.plots import Curve, Panel, draw
from nuno_schemas.colour import parse_hex
from nuno_schemas.drawing import Mesh
from nuno_schemas.fabric import Float
from nuno_schemas.view import View

HEADINGS = (
    "peer", "setting", "off [%]", "hem height [mm]", "hem radius [mm]", "stretch [%]", "crossed", "by ipctk",
    "edges in body", "vertices in body", "depth [mm]", "time [s]", "min - max", "start [s]", "times ours", "verdict",
)  # fmt: skip
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
class Found(Measured[Seen]):
    """Of the skirt, the points of the converged run and its check first; and what was posed."""

    skirt: Skirt

    @property
    def seconds(self) -> float:
        """What is simulated [s]."""
        return self.skirt.frames / RATE

    def nearest(self) -> list[Point[Seen]]:
        """Of the converged run and every kind that has a score, the point that ends nearest to it."""
        names = ["converged", *(kind.name for kind in self.kinds)]
        scored = [[p for p in self.points if p.kind == name and p.score is not None] for name in names]
        return [min(own, key=lambda point: end_of(point.score)) for own in scored if own]


def end_of(seen: Seen | None) -> float:
    """How far the end is off, as a share of the cloth's size."""
    return seen.off[-1] if seen is not None else np.inf


def ratio(found: Found, point: Point[Seen]) -> float | None:
    """How many times as long another engine takes as our fastest that is no farther off: see times_ours."""
    return times_ours(found.points, point, lambda seen: end_of(seen) <= end_of(point.score))


def settings(found: Found) -> Table:
    """One row of text per point."""
    return Table(HEADINGS, [_row(found, point) for point in found.points], JUDGED)


def _row(found: Found, point: Point[Seen]) -> list[str]:
    start, seen = number(round(point.start, 2)) if point.start is not None else "", point.score
    if seen is None:
        return [point.kind, point.setting, *[""] * 11, start, "", "failed"]
    known = any(point.kind == kind.name for kind in found.kinds)
    compared = against(found.points, point, ratio(found, point)) if known else ["", ""]
    figures = (100 * seen.off[-1], 1e3 * seen.hem, 1e3 * seen.radius, 100 * seen.stretch, len(seen.crossed))
    inside = [f"{each[-1]}, {max(each)}" for each in (seen.edges, seen.vertices)]
    rates = [seconds / found.seconds for seconds in point.seconds]
    return [
        point.kind, point.setting, *map(number, figures), "" if seen.ipctk is None else str(seen.ipctk), *inside,
        number(1e3 * seen.depth), number(point.median / found.seconds), spread_of(rates), start, *compared,
    ]  # fmt: skip


def tables(found: Found) -> list[Table]:
    """What is shown on the screen."""
    return [settings(found)]


def verdicts(found: Found) -> list[str]:
    """Our fastest, and the nearest of each other kind beside ours that is no farther off."""
    texts = []
    own = fastest(filter(is_ours, found.points), lambda seen: True)
    if own is not None:
        took = own.median / found.seconds
        texts.append(f"Ours: {own.kind} ({own.setting}) takes {number(took)} s for a second.")
    for point in found.nearest():
        if is_ours(point) or point.kind == "converged" or point.score is None:
            continue
        times, far = ratio(found, point), number(100 * end_of(point.score))
        beside = f", {number(times)} times as long as ours that is no farther off" if times is not None else ""
        texts.append(f"{point.kind} ({point.setting}): {number(point.median / found.seconds)} s{beside}, {far}% off.")
    scored = {point.kind for point in found.points if point.score is not None}
    never = [kind.name for kind in found.kinds if kind.name not in scored and not kind.missing]
    return texts + ([f"Without an end at any setting shown: {', '.join(never)}."] if never else [])


def error_over_time(found: Found) -> Panel:
    """A curve of each kind that has come to the end; and of the check."""
    t = np.arange(1, found.skirt.frames + 1) / RATE
    shown = [p for p in found.points if p.kind == "check"] + [p for p in found.nearest() if p.kind != "converged"]
    curves = [
        Curve(point.kind, t, 100 * np.array(point.score.off), i, not is_ours(point))
        for i, point in enumerate(shown) if point.score is not None
    ]  # fmt: skip
    return Panel("", curves, "time since the lead-in [s]", "vertices off by [% of the cloth's size]", log="y")


def lead(found: Found) -> str:
    """What is compared."""
    skirt = found.skirt
    return (
        f"{found.seconds:.3g} s of the scene {SCENE} after its lead-in of {skirt.begin:.3g} s, which our own solver "
        f"steps: all engines go on from the same places and velocities. {len(skirt.mass):,} vertices, "
        f"{len(skirt.k):,} springs, {len(skirt.bend):,} hinges, {len(skirt.geometry.kind)} capsules of a dancer; no "
        "air but its drag on all motion. Each engine in a process of its own, on the processor."
    )


def report(found: Found, about: Mapping[str, str]) -> Report:
    """The page, the data and the documentation's section."""
    table, intro = settings(found), lead(found)
    ends = {f"{point.kind}, {point.setting}": point.score.frames[-1] for point in found.nearest() if point.score}
    sections: Sections = [
        ("", [" ".join(verdicts(found))]),
        ("Where they end", [SHOWN, draw_ends(found.skirt, ends)]),
        ("All settings", [table, Figure(draw([error_over_time(found)], height=4.0), CAPTION)]),
    ]
    title, points = "A skirt on a dancer in other engines", [_without_frames(point) for point in found.points]
    return compose(found, title, intro, sections, [intro, table, JUDGED], about, points=points,
                   size_m=found.skirt.size, begin_s=found.skirt.begin)  # fmt: skip


def _without_frames(point: Point[Seen]) -> dict[str, object]:
    """A point for JSON."""
    score = point.score and {name: value for name, value in vars(point.score).items() if name != "frames"}
    return plain(point) | {"score": score}


def draw_ends(skirt: Skirt, ends: Mapping[str, Float]) -> Pictures:
    """Places (n, 3) [m] at the end by what they are, the first of which the camera is fitted to."""
    renderer = registry.load("nuno.renderers", RENDERER)
    pairs = skirt.pairs.astype(np.int32)
    piece = ShownPiece("skirt", 0, len(skirt.mass), skirt.faces, pairs, skirt.rest, None, None, None)
    shape = surface(skirt.geometry, INSET)
    points = shape.at(skirt.poses[-1])
    body = _up(Mesh(points, shape.faces, np.tile(parse_hex(BODY), (len(points), 1)), two_sided=False))
    cloths = {name: _up(Mesh(x, piece.faces, paint_stretch(piece.stretch(x)))) for name, x in ends.items()}
    camera = place_camera(View(), list(cloths.values())[:1], SIZE, ROOM)
    images = []
    for name, cloth in cloths.items():
        config = renderer.Config.model_validate({"legend": LEGEND, "ground": float(body.vertices[:, 2].min())})
        images.append(Image(embed(renderer.render(config, [cloth, body], camera)), name))
    return Pictures(images)


def _up(mesh: Mesh) -> Mesh:
    return replace(mesh, vertices=z_up(mesh.vertices))
