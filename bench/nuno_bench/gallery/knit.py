"""Shipped knits: run, drawn as the knit paper's figures are, and measured against what they must show."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno.exports.cloth import read_frame, read_pieces
from nuno.exports.pictures import Colour, export_picture
from nuno.exports.yarns import export_yarn_picture
from nuno.recording.reader import Recording
from nuno.scene.scene_file import Loaded
from nuno.simulation.yarns import named_heights
from nuno_bench.gallery.kind import Difference, Gallery, find_scenes, read_picture, show_scene
from nuno_schemas.fabric import Float, Int
from nuno_schemas.pictures import Picture

BAND = 0.02
"""Height of the band around a place that is averaged over [m], as the report's pressure has it."""
RIM = 0.3
"""Share of a panel's columns at either side that is left out: its edges are held, or curl."""
SIZE = (480, 640)
"""Pixels of a picture of a knit on a body; those of a panel are as wide as they are high."""
WALES = 75
"""Of a knit on a body whose lines are a pixel wide: of more they are thinner."""
RADIUS = 2.5e-4
"""Radius of the yarns of a knit with WALES wales on a body [m]."""
PANEL: tuple[tuple[str, Colour], ...] = (
    ("each yarn in its colour", "cloth"),
    ("its links by their stretch", "stretch"),
)
WORN = (
    ("straight links, as in the paper's figure 14", "lines", ()),
    ("yarns, as in the paper's figure 17", "yarns", ("view.yarns.samples=16", "view.yarns.colour=#1e1715")),
    ("density of points, as in the paper's figure 18", "density", ()),
    ("pressure on the skin", "map", ("view.yarns.low=0", "view.yarns.radius=15mm")),
)
"""Pictures of a knit on a body: what each shows, its style and its settings."""
CLOSE = {"stocking-leg": ("view.target=[0,0.33,0.03]", "view.distance=0.16", "view.yarns.radius=0.2mm")}
"""Scenes whose yarns are shown from near, too, and where."""

COURSE, WALE, COMPRESSION = "stitch-stretch-course", "stitch-stretch-wale", "stocking-compression"
ZIGZAG, OPENING = "zigzag of wales", "most open course over the least"
STRETCH, DENSITY, PRESSURE = "stretch of {}", "stitches at the {} [1/m2]", "pressure at the {} [Pa]"
"""Measures of a yarn's links, or at a named place."""


def _between(says: str, scene: str, measure: str, high: str, low: str) -> Difference:
    """One measure of one scene at two places, or of two yarns."""
    return Difference(says, (scene, measure.format(high)), (scene, measure.format(low)))


DIFFERENCES = (
    Difference("along the courses wales zigzag, along the wales they stay straight", (COURSE, ZIGZAG), (WALE, ZIGZAG)),
    Difference("along the wales whole courses open, along the courses alike", (WALE, OPENING), (COURSE, OPENING)),
    _between("stiff yarn stretches less", COURSE, STRETCH, "nylon arcs", "support arcs"),
    _between("stiff yarn stretches less", WALE, STRETCH, "nylon legs", "support legs"),
    *(
        _between("stitches are closer at the ankle", name, DENSITY, "ankle", "knee")
        for name in ("stocking-150", "stocking-300", "stocking-leg")
    ),
    _between("pressure falls from ankle to calf", COMPRESSION, PRESSURE, "ankle", "calf"),
    _between("pressure falls from calf to thigh", COMPRESSION, PRESSURE, "calf", "thigh"),
)


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
    return _draw(loaded, recording, folder), _measure(loaded, knit, report)


def _measure(loaded: Loaded, knit: Knitted, report: Mapping[str, Any]) -> dict[str, float]:
    """Of panels how they stretch; of knits on bodies density and pressure at every place with a name."""
    found = {STRETCH.format(part): value for part, value in stretch(knit).items()}
    if not loaded.scene.bodies:
        return found | {ZIGZAG: zigzag(knit), OPENING: unevenness(knit)}
    places = named_heights(loaded)
    pressure = {place: value for place, value in report.get("pressure", {}).items() if place in places}
    found |= {DENSITY.format(place): density_at(knit, height) for place, height in places.items()}
    return found | {PRESSURE.format(place): value for place, value in pressure.items()}


def _draw(loaded: Loaded, recording: Recording, folder: Path) -> list[tuple[str, Picture]]:
    """The last frame in all its ways, by way of files in a folder."""
    target = folder / "picture.png"
    if not loaded.scene.bodies:
        square = (SIZE[0], SIZE[0])
        return [
            (label, read_picture(export_picture(recording, target, None, square, colour))) for label, colour in PANEL
        ]
    ways = [(label, style, (*settings, *_fine(loaded, style))) for label, style, settings in WORN]
    if loaded.scene.name in CLOSE:
        label, style, settings = WORN[1]
        ways.append((f"{label}, from near", style, (*settings, *CLOSE[loaded.scene.name])))
    return [
        (label, read_picture(export_yarn_picture(recording, target, style, None, SIZE, settings)))
        for label, style, settings in ways
    ]


def _fine(loaded: Loaded, style: str) -> tuple[str, ...]:
    """Yarns as much thinner than RADIUS as stitches are more than WALES; so are lines thinner than a pixel, which
    would fill in.
    """
    wales = loaded.models[0].config.model_dump()["wales"]
    if style == "yarns":
        return (f"view.yarns.radius={RADIUS * WALES / wales:g}",)
    return (f"view.yarns.width={WALES / wales:g}",) if style == "lines" and wales > WALES else ()


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


KIND = Gallery(
    title="Knits",
    lead="The knits that come with nuno: the knit paper's stitches, stretched, and its stocking on a leg, at rest; the "
    "pictures follow its figures.",
    scenes=partial(find_scenes, "knit"),
    run_scene=partial(show_scene, look=look),
    differences=DIFFERENCES,
    measures="Links by mean elongation; stitches over their area and pressure as means of 2 cm at each place.",
)
