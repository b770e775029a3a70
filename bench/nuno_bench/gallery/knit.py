"""The knit paper's figures and other shipped knits: run, drawn, and held against what the paper says."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nuno.collision.bodies import build_bodies, surface
from nuno.collision.distance import signed_distance
from nuno.exports.cloth import read_frame, read_pieces
from nuno.exports.pictures import Colour, export_picture
from nuno.exports.yarns import export_yarn_picture, find_camera, make_yarns, read_worn, styled
from nuno.recording.reader import Recording
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno.simulation.run import Simulation
from nuno.simulation.yarns import edge_yarns, named_heights
from nuno_bench.gallery.kind import Figure, Finding, Gallery, Measures, find_scenes, show_scene
from nuno_bench.report.page import Table, number
from nuno_bench.report.plots import pyplot
from nuno_render.rays.yarns import radiance
from nuno_schemas.colour import read_rgb
from nuno_schemas.fabric import Float, Int
from nuno_schemas.pictures import Picture

BAND = 0.02
"""Height of the band around a place that is averaged over [m], as the report's pressure has it."""
RIM = 0.3
"""Share of a panel's columns at either side that is left out: its edges are held, or curl."""
SIZE = (480, 640)
"""Pixels of a picture of a knit on a body; those of a panel are as wide as they are high."""
COVERED = (240, 320)
"""Pixels of the picture whose share of yarn is measured."""
WALES = 75
"""Of a knit on a body whose yarns have RADIUS and lines LINE: of more they are thinner."""
LINE = 0.5
"""Width of a straight link [pixels]."""
RADIUS = 2.5e-4
"""Radius of the yarns of a knit with WALES wales on a body [m]."""
PANEL: tuple[tuple[str, Colour], ...] = (
    ("each yarn in its colour", "cloth"),
    ("its links by their stretch", "stretch"),
)
WORN = (
    ("straight links, as in the paper's figure 14", "lines", ()),
    ("yarns, as in the paper's figure 17", "yarns", ("view.yarns.samples=16", "view.yarns.colour=#6b4a38")),
    ("density of points, as in the paper's figure 18", "density", ()),
    ("pressure on the skin", "map", ("view.yarns.low=0", "view.yarns.radius=15mm")),
)
"""Pictures of a knit on a body: what each shows, its style and its settings."""
CLOSE = {"stocking-leg": ("view.target=[0,0.33,0.03]", "view.distance=0.16", "view.yarns.radius=0.2mm")}
"""Scenes whose yarns are shown from near, too, and where."""

COURSE, WALE = "stitch-stretch-course", "stitch-stretch-wale"
CHECK, COARSE, FINE = "stitch-10x10", "stocking-150", "stocking-300"
STEPS = 100
"""The paper's steps of figure 8, each a frame."""
REACH = 0.04
"""How near points count in figure 18 [m]."""
LAST, HALF = "way of the last tenth of the steps over the whole", "way of the last half of the steps over the whole"
INSIDE = "deepest point in the body [m]"
REPAIR = "the link that cuts deepest into the leg, and its repair"
CUT, REPAIRED = "links through the body", "deepest yarn after the repair [m]"
EDGE, MIDDLE = "share of yarn at the silhouette", "share of yarn in the middle"
MOST, LEAST = "most points within 40 mm", "fewest points within 40 mm, off the edges"
ZIGZAG, OPENING = "zigzag of wales", "most open course over the least"
STRETCH, DENSITY, PRESSURE = "stretch of {}", "stitches at the {} [1/m2]", "pressure at the {} [Pa]"
"""Measures of a yarn's links, or at a named place."""


def look(loaded: Loaded, recording: Recording, folder: Path) -> tuple[list[tuple[str, Picture]], dict[str, float]]:
    """Draw what a recording ends with, and measure its first object; nothing of one that is not finite."""
    report, frame = recording.report(), read_frame(recording)
    if not np.isfinite(frame.x).all():
        return [], {}
    config, piece = loaded.models[0].config.model_dump(), read_pieces(recording)[0]
    x = frame.x[piece.start : piece.stop].reshape(config["courses"] + 1, 2 * config["wales"], 3)
    kind = np.full(len(piece.edges), -1, np.int8) if piece.yarns is None else piece.yarns
    # A recording names its kinds of yarn in its report alone.
    knit = Knitted(x, piece.edges, piece.rest, kind, tuple(report.get("yarns", {})), config["form"] == "tube")
    pictures = _draw(loaded, recording, folder)
    pictures += [(REPAIR, draw_repair(loaded, recording))] if loaded.scene.name == COARSE else []
    return pictures, _measure(loaded, recording, knit, report)


def _measure(loaded: Loaded, recording: Recording, knit: Knitted, report: Mapping[str, Any]) -> dict[str, float]:
    """Of panels how they stretch; of knits on bodies density and pressure at every place with a name, and of the
    paper's what its figures need.
    """
    found = {STRETCH.format(part): value for part, value in stretch(knit).items()}
    if not loaded.scene.bodies:
        settled = last_ways(recording) if loaded.scene.name == CHECK else {}
        return found | {ZIGZAG: zigzag(knit), OPENING: unevenness(knit)} | settled
    places = named_heights(loaded)
    pressure = {place: value for place, value in report.get("pressure", {}).items() if place in places}
    found |= {DENSITY.format(place): density_at(knit, height) for place, height in places.items()}
    found |= {PRESSURE.format(place): value for place, value in pressure.items()}
    if loaded.scene.name in (COARSE, FINE):
        bodies = build_bodies(loaded)
        skin = surface(bodies.geometry).at(bodies.poses(read_frame(recording).t))
        found |= {INSIDE: float(report["last_penetration"])} | count_near(knit, skin)
        repair = make_yarns(recording, read_frame(recording), "straight").facts
        found |= {CUT: float(repair["repaired"]), REPAIRED: float(repair["deepest"])} | measure_shares(
            loaded, recording
        )
    return found


def last_ways(recording: Recording) -> dict[str, float]:
    """The longest way of a point in the last tenth and half of the paper's steps, over the longest since the start."""
    places = [read_frame(recording, frame).x for frame in (0, STEPS // 2, STEPS - STEPS // 10, STEPS)]
    start, half, last = (float(np.linalg.norm(places[-1] - one, axis=1).max()) for one in places[:-1])
    return {LAST: last / start, HALF: half / start}


def count_near(knit: Knitted, skin: Float) -> dict[str, float]:
    """The largest number of points within REACH of a vertex of the skin (v, 3) [m], and the smallest of those as far
    from the knit's edges.
    """
    near = cKDTree(knit.x.reshape(-1, 3)).query_ball_point(skin, REACH, return_length=True)
    low, high = knit.x[0, :, 1].max() + REACH, knit.x[-1, :, 1].min() - REACH
    inner = (skin[:, 1] > low) & (skin[:, 1] < high)
    return {MOST: float(near.max()), LEAST: float(near[inner].min())}


def draw_repair(loaded: Loaded, recording: Recording) -> Picture:
    """Of the repaired link that goes deepest into the leg the distance from the skin along it, before and after."""
    frame, bodies = read_frame(recording), build_bodies(loaded)
    made, poses = make_yarns(recording, frame, "straight"), bodies.poses(frame.t)
    assert made.curves is not None
    points, own = made.curves.points, np.flatnonzero(made.arrays["vertex"] >= 0)
    first, last = (ends[np.diff(own) > 1] for ends in (own[:-1], own[1:]))
    deepest = signed_distance(0.5 * (points[first] + points[last]), bodies.geometry, poses).argmin()
    bent = points[first[deepest] : last[deepest] + 1]
    figure, axis = pyplot().subplots(figsize=(SIZE[0] / 100, SIZE[0] / 100), dpi=100)
    axis.axhspan(-1e3, 0.0, color="0.85", label="inside the leg")
    for way, name in ((bent[[0, -1]], "the straight link"), (bent, "repaired")):
        along = np.append(0.0, np.linalg.norm(np.diff(way, axis=0), axis=1).cumsum())
        at = np.linspace(0.0, along[-1], 400)
        places = np.stack([np.interp(at, along, way[:, k]) for k in range(3)], axis=1)
        off = 1e6 * signed_distance(places, bodies.geometry, poses)
        axis.plot(1e3 * at, off, label=name)
    axis.set(xlabel="along the link [mm]", ylabel="distance from the skin [um]")
    axis.set_ylim(*(1.2 * np.array([min(line.get_ydata().min() for line in axis.lines), 25.0])))
    axis.legend()
    figure.canvas.draw()
    picture = np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()
    pyplot().close(figure)
    return picture


def measure_shares(loaded: Loaded, recording: Recording) -> dict[str, float]:
    """The share of yarn, opaque, in pixels of the picture that is shown: in the outer tenth of the knit's width on
    either side, and in its middle half, in the mean of all rows.
    """
    settings = ("view.yarns.samples=16", "view.yarns.translucency=0", *_fine(loaded, "yarns"))
    with styled(recording, "yarns", settings) as (loaded, chosen):
        worn = read_worn(recording, loaded, read_frame(recording), chosen)
        config: Any = chosen.config
        share = radiance(config, worn, find_camera(loaded.scene.view, worn, COVERED))[..., 3]
    edge, middle = list[float](), list[float]()
    for row in share:
        seen = np.flatnonzero(row > 0.0)
        if len(seen) >= 20:
            inner = row[seen[0] + 1 : seen[-1]]  # its outermost pixels are partly beyond the knit
            outer, quarter = len(inner) // 10, len(inner) // 4
            edge.append(float(np.concatenate([inner[:outer], inner[-outer:]]).mean()))
            middle.append(float(inner[quarter:-quarter].mean()))
    return {EDGE: float(np.mean(edge)), MIDDLE: float(np.mean(middle))}


def _draw(loaded: Loaded, recording: Recording, folder: Path) -> list[tuple[str, Picture]]:
    """The last frame in all its ways, by way of files in a folder."""
    target = folder / "picture.png"
    if not loaded.scene.bodies:
        square = (SIZE[0], SIZE[0])
        return [(label, read_rgb(export_picture(recording, target, None, square, colour))) for label, colour in PANEL]
    ways = [(label, style, (*settings, *_fine(loaded, style))) for label, style, settings in WORN
            if (loaded.scene.name, style) != (FINE, "density")]  # fmt: skip
    if loaded.scene.name in CLOSE:
        label, style, settings = WORN[1]
        ways.append((f"{label}, from near", style, (*settings, *CLOSE[loaded.scene.name])))
    return [
        (label, read_rgb(export_yarn_picture(recording, target, style, None, SIZE, settings)))
        for label, style, settings in ways
    ]


def _fine(loaded: Loaded, style: str) -> tuple[str, ...]:
    """Yarns as much thinner than RADIUS as stitches are more than WALES, and lines than LINE: wider ones fill in."""
    wales = loaded.models[0].config.model_dump()["wales"]
    if style == "yarns":
        return (f"view.yarns.radius={RADIUS * WALES / wales:g}",)
    return (f"view.yarns.width={LINE * WALES / max(wales, WALES):g}",) if style == "lines" else ()


class Knitted(NamedTuple):
    """A knit of rows of points, from the bottom, and its links.

    x (rows, columns, 3) [m]; edges (e, 2) of points row by row, rest (e,) [m], kind (e,) of `names`, -1 for none;
    a ring's last column is joined to its first.
    """

    x: Float
    edges: Int
    rest: Float
    kind: NDArray[np.int8]
    names: tuple[str, ...]
    ring: bool


def stretch(knit: Knitted) -> dict[str, float]:
    """Mean |d| / L - 1 of the arcs and of the legs of each yarn that has any, e.g. of `nylon arcs`."""
    points = knit.x.reshape(-1, 3)
    length = np.linalg.norm(points[knit.edges[:, 1]] - points[knit.edges[:, 0]], axis=1)
    own, leg = length / knit.rest - 1.0, np.diff(knit.edges, axis=1)[:, 0] == knit.x.shape[1]
    found = {}
    for index, name in enumerate(knit.names):
        for part, there in (("arcs", ~leg), ("legs", leg)):
            mine = there & (knit.kind == index)
            if mine.any():
                found[f"{name} {part}"] = float(own[mine].mean())
    return found


def zigzag(knit: Knitted) -> float:
    """How far the middle wales run to and fro: mean second difference to the side along a column, in rest lengths."""
    return float(np.abs(np.diff(_middle(knit)[..., 0], n=2, axis=0)).mean() / knit.rest.mean())


def unevenness(knit: Knitted) -> float:
    """Height of the most open course over that of the least, between the first and the last row, in the middle."""
    heights = np.diff(_middle(knit)[1:-1, :, 1], axis=0).mean(axis=1)
    return float(heights.max() / heights.min())


def density_at(knit: Knitted, height: float) -> float:
    """Stitches over area [1/m^2] in the band around a height [m]; NaN where the knit is not."""
    area, level = _cells(knit)
    there = np.abs(level - height) <= 0.5 * BAND
    return float(0.5 * there.sum() / area[there].sum()) if there.any() else float("nan")


def _middle(knit: Knitted) -> Float:
    """(rows, columns in the middle, 3)."""
    side = int(RIM * knit.x.shape[1])
    return knit.x[:, side : knit.x.shape[1] - side]


def _cells(knit: Knitted) -> tuple[Float, Float]:
    """(courses, cells) area [m^2] of each cell, half the cross product of its diagonals, and height of its middle."""
    right = np.roll(knit.x, -1, axis=1)
    if not knit.ring:
        right = right[:, :-1]
    left = knit.x[:, : right.shape[1]]
    a, b, c, d = left[:-1], right[:-1], right[1:], left[1:]
    area = 0.5 * np.linalg.norm(np.cross(c - a, d - b), axis=-1)
    return np.asarray(area), np.asarray(0.25 * (a + b + c + d)[..., 1])


def judge_steps(measured: Measures) -> Finding:
    """Figure 8: the stitches have converged after 100 steps, and not after 50."""
    last, half = measured[CHECK][LAST], measured[CHECK][HALF]
    value = f"{100.0 * last:.2g} % of their way in the last ten steps, {100.0 * half:.2g} % in the last fifty"
    return Finding(value, last < 0.02 < half)


def judge_direction(measured: Measures) -> Finding:
    """Figure 9: wales zigzag along the courses far more than along the wales."""
    course, wale = measured[COURSE], measured[WALE]
    value = (
        f"zigzag {number(course[ZIGZAG])} along the courses, {number(wale[ZIGZAG])} along the wales; the most open "
        f"course over the least {number(course[OPENING])} and {number(wale[OPENING])}"
    )
    return Finding(value, course[ZIGZAG] > 2.0 * wale[ZIGZAG])


def sweep_direction() -> Table:
    """Figure 9 with other stiffness and continuity: whose is the difference of direction?"""
    rows = []
    for ratio in (10.0, 1.0):
        for mu in (0.2, 0.0):
            both = [run_panel(name, ratio, mu) for name in (COURSE, WALE)]
            rows.append(
                [
                    f"1 : {ratio:g}",
                    f"{mu:g}",
                    *(number(value) for knit in both for value in (zigzag(knit), unevenness(knit))),
                ]
            )
    heads = ("k of nylon : support", "mu", "zigzag along the courses", "opening", "zigzag along the wales", "opening")
    remark = (
        "The difference comes from the contrast of stiffness, not from the yarn's continuity (equation 2): it stays "
        "without that, mu = 0, and vanishes with one stiffness."
    )
    return Table(heads, rows, remark)


def run_panel(name: str, ratio: float, mu: float) -> Knitted:
    """A stretched panel at rest, with its stiff yarn `ratio` times as stiff as the other."""
    yarns = "objects.0.model.yarns"
    overrides = (f"{yarns}.1.k={ratio:g} N/m", *(f"{yarns}.{kind}.mu={mu:g}" for kind in (0, 1)))
    loaded = scene_file.read(shipped.find(f"knit/{name}"), overrides)
    simulation = Simulation(loaded, None, None, 1)
    while not simulation.finished:
        simulation.advance(None, None)
    config, fabric = loaded.models[0].config.model_dump(), simulation.fabric
    springs, threads, kind = fabric.springs, fabric.yarns, edge_yarns(fabric)
    assert springs is not None and threads is not None and kind is not None
    x = simulation.state.x.reshape(config["courses"] + 1, 2 * config["wales"], 3)
    return Knitted(x, springs.pairs(), springs.per_spring(springs.rest), kind, tuple(threads.names), False)


def judge_fit(measured: Measures) -> Finding:
    """Figure 14: both tubes come to rest on the leg, denser toward the silhouette; sliding keeps points out."""
    depth = max(measured[name][INSIDE] for name in (COARSE, FINE))
    ratios = [measured[name][EDGE] / measured[name][MIDDLE] for name in (COARSE, FINE)]
    times = " and ".join(f"{ratio:.2f}" for ratio in ratios)
    value = f"at rest; deepest point {number(1e3 * depth)} mm; {times} times as much yarn at the silhouette"
    return Finding(value, min(ratios) >= 1.2)


def judge_repair(measured: Measures) -> Finding:
    """Figure 15: links that cut through the leg lie on it after the repair."""
    cut, deep = measured[COARSE][CUT], measured[COARSE][REPAIRED]
    return Finding(
        f"{cut:.0f} links cut through the leg; {1e6 * deep:.2g} um after the repair", cut > 0 and deep <= 2e-6
    )


def judge_density(measured: Measures) -> Finding:
    """Figure 18: far more points near some places than near others."""
    most, least = measured[COARSE][MOST], measured[COARSE][LEAST]
    return Finding(f"{most:.0f} at most, {least:.0f} at least", most > 2.0 * least)


FIGURES = (
    Figure(
        "8", "With 10 x 10 points, and with steps of 0.1, the stitches take about 100 steps to converge.",
        "In the last tenth of 100 steps no point goes more than 2 % of the longest way since the start; in the last "
        "half one does.",
        (CHECK,), judge_steps, reading="Mass and damper are not printed: unit mass and 2 /s.",
    ),
    Figure(
        "9", "Stitches deform differently as the knit is stretched along (a) the wales or (b) the courses.",
        "Wales zigzag at least twice as much along the courses as along the wales, in rest lengths.",
        (COURSE, WALE), judge_direction, sweep=sweep_direction,
        reading="The paper gives one yarn along the courses, equation 2, as the reason; the table shows another.",
    ),
    Figure(
        "14 and 17", "Tubes of 150 x 150 and 300 x 300 points fit to the leg; the density of yarns acts like "
        "transparency, and stresses the silhouette.",
        "Near the silhouette yarns, opaque, cover at least 1.2 times as much as in the middle. That no point is "
        "inside the leg is no criterion: points that slide on a body are kept out of it.",
        (COARSE, FINE), judge_fit, labels=WORN[0][0:1] + WORN[1][0:1],
        reading="Figure 17 shades each yarn by its normal; ours scatters light as clear nylon does, which the paper "
        "leaves for later.",
    ),
    Figure(
        "15", "Where a link between two points cuts through the leg, points are added, and it no longer does.",
        "Some links cut through the leg, and no sample of the repaired yarns is deeper than 2 um.",
        (COARSE,), judge_repair, labels=(REPAIR,),
    ),
    Figure(
        "18", "The number of points near each place of the skin shows how close stitches are: 800 at most.",
        "The largest number within 40 mm of 150 x 150 points is more than twice the smallest, off the edges.",
        (COARSE,), judge_density, labels=WORN[2][0:1],
        reading="The paper prints neither how near a point is to count nor which knit it is. 40 mm is chosen to give "
        "about its number with 150 x 150 points; with 300 x 300 it takes 20 mm.",
    ),
)  # fmt: skip


KIND = Gallery(
    title="Knits",
    lead="The knits that come with nuno: the knit paper's stitches, stretched, and its stocking on a leg, at rest; the "
    "pictures follow its figures.",
    scenes=partial(find_scenes, "knit"),
    run_scene=partial(show_scene, look=look),
    figures=FIGURES,
    measures="Links by mean elongation; stitches over their area and pressure as means of 2 cm at each place.",
)
