"""Shipped knits: run, drawn as the knit paper's figures are, and measured against what they must show."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nuno import api
from nuno.cloth.pressure import named_heights
from nuno.export.cloth import read_frame, read_pieces
from nuno.export.pictures import Colour, export_picture
from nuno.export.yarns import export_yarn_picture
from nuno.recording.reader import Recording, open_recording
from nuno.recording.recorded import Frame
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno_bench.gallery.kind import EFFECT, Columns, Kind, Shown, difference_row
from nuno_bench.gallery.knit_measures import Knitted, density_at, stretch, unevenness, zigzag
from nuno_bench.gallery.knit_rows import NUMBER_HEADINGS, PARAMETER_HEADINGS, number_row, parameter_row
from nuno_schemas.dye_picture import Picture
from nuno_schemas.errors import RunFailed

SIZE = (480, 640)
"""Pixels of a picture of a knit on a body; those of a panel are as wide as they are high."""
WALES = 75
"""Of a knit on a body whose lines are a pixel wide: of more they are thinner."""
RADIUS = 2.5e-4
"""Of the yarns of a knit of so many wales on a body [m]."""
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

Measures = Mapping[tuple[str, str], float]
"""What was measured, by measure and part: ("stretch", "nylon arcs")."""
COURSE, WALE, COMPRESSION = "stitch-stretch-course", "stitch-stretch-wale", "stocking-compression"
STRETCH, ZIGZAG, OPENING = "stretch of links", "zigzag of wales", "most open course over the least"
DENSITY, PRESSURE = "stitches [1/m2]", "pressure [Pa]"


class Difference(NamedTuple):
    """A measure of one part of a scene is above that of another, or of another scene's."""

    says: str
    measure: str
    high: tuple[str, str]
    low: tuple[str, str]


DIFFERENCES = (
    Difference("along the courses wales zigzag, along the wales they stay straight", ZIGZAG, (COURSE, ""), (WALE, "")),
    Difference("along the wales whole courses open, along the courses alike", OPENING, (WALE, ""), (COURSE, "")),
    Difference("stiff yarn stretches less", STRETCH, (COURSE, "nylon arcs"), (COURSE, "support arcs")),
    Difference("stiff yarn stretches less", STRETCH, (WALE, "nylon legs"), (WALE, "support legs")),
    *(
        Difference("stitches are closer at the ankle", DENSITY, (name, "ankle"), (name, "knee"))
        for name in ("stocking-150", "stocking-300", "stocking-leg")
    ),
    *(
        Difference(f"pressure falls from {high} to {low}", PRESSURE, (COMPRESSION, high), (COMPRESSION, low))
        for high, low in (("ankle", "calf"), ("calf", "thigh"))
    ),
)


def scenes() -> dict[str, Path]:
    """Files of the shipped knits by name."""
    return {path.stem: path for path in scene_file.shipped("knit").values()}


def run_scene(path: Path) -> Shown[Measures]:
    """Run one to its end, or to where it fails, and draw what its recording ends with. Raises BadInput."""
    loaded = scene_file.read(path)
    name, description, parameters = loaded.scene.name, loaded.scene.description, [parameter_row(loaded)]
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        target, failed = Path(folder) / f"{name}.mcap", ""
        try:
            api.run(path, record=target)
        except RunFailed as error:
            failed = str(error).removesuffix(f"; recording kept in {target}")
        if not target.is_file():
            return Shown(name, description, [], parameters, number_row(loaded, {}, None), {}, failed)
        with open_recording(target) as recording:
            report, frame = recording.report(), read_frame(recording) if recording.marks() else None
            whole = frame is not None and bool(np.isfinite(frame.x).all())
            knit = _knitted(loaded, recording, frame, report) if frame is not None and whole else None
            pictures = _draw(loaded, recording, Path(folder)) if whole else []
    measured = {} if knit is None else _measure(loaded, knit, report)
    return Shown(name, description, pictures, parameters, number_row(loaded, report, knit), measured, failed)


def _knitted(loaded: Loaded, recording: Recording, frame: Frame, report: Mapping[str, Any]) -> Knitted:
    """The scene's first object at a frame; a recording names its kinds of yarn in its report alone."""
    config, piece = loaded.models[0].config.model_dump(), read_pieces(recording)[0]
    x = frame.x[piece.start : piece.stop].reshape(config["courses"] + 1, 2 * config["wales"], 3)
    kind = np.full(len(piece.edges), -1, np.int8) if piece.yarns is None else piece.yarns
    return Knitted(x, piece.edges, piece.rest, kind, tuple(report.get("yarns", {})), config["form"] == "tube")


def _measure(loaded: Loaded, knit: Knitted, report: Mapping[str, Any]) -> Measures:
    """Of panels how they stretch; of knits on bodies density and pressure at every place with a name."""
    found = {(STRETCH, part): value for part, value in stretch(knit).items()}
    if not loaded.scene.bodies:
        return found | {(ZIGZAG, ""): zigzag(knit), (OPENING, ""): unevenness(knit)}
    found |= {(DENSITY, place): density_at(knit, height) for place, height in named_heights(loaded).items()}
    return found | {(PRESSURE, place): value for place, value in report.get("pressure", {}).items()}


def _draw(loaded: Loaded, recording: Recording, folder: Path) -> list[tuple[str, Picture]]:
    """The last frame in all its ways, by way of files in a folder."""
    target = folder / "picture.png"
    if not loaded.scene.bodies:
        square = (SIZE[0], SIZE[0])
        return [(told, _read(export_picture(recording, target, None, square, colour))) for told, colour in PANEL]
    ways = [(told, style, (*settings, *_fine(loaded, style))) for told, style, settings in WORN]
    if loaded.scene.name in CLOSE:
        told, style, settings = WORN[1]
        ways.append((f"{told}, from near", style, (*settings, *CLOSE[loaded.scene.name])))
    return [
        (told, _read(export_yarn_picture(recording, target, style, None, SIZE, settings)))
        for told, style, settings in ways
    ]


def _fine(loaded: Loaded, style: str) -> tuple[str, ...]:
    """Yarns as much thinner than RADIUS as stitches are more than WALES; so are lines thinner than a pixel, which
    would fill in.
    """
    wales = loaded.models[0].config.model_dump()["wales"]
    if style == "yarns":
        return (f"view.yarns.radius={RADIUS * WALES / wales:g}",)
    return (f"view.yarns.width={WALES / wales:g}",) if style == "lines" and wales > WALES else ()


def _read(path: Path) -> Picture:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def compare(shown: Mapping[str, Shown[Measures]]) -> list[list[str]]:
    """Rows under DIFFERENCE_HEADINGS; a part that is not there measures NaN, and misses."""
    rows = []
    for one in DIFFERENCES:
        sides = (one.high, one.low)
        if all(scene in shown for scene, _ in sides):
            high, low = (
                (f"{scene}, {part}" if part else scene, shown[scene].measured.get((one.measure, part), float("nan")))
                for scene, part in sides
            )
            rows.append(difference_row(one.says, one.measure, high, low))
    return rows


KIND = Kind(
    title="Knits",
    lead="The knits that come with nuno: the knit paper's stitches, stretched, and its stocking on a leg, at rest; the "
    "pictures follow its figures.",
    scenes=scenes,
    run_scene=run_scene,
    compare=compare,
    parameters=(
        Columns(
            PARAMETER_HEADINGS,
            "Yarns of the courses in turn; a panel is wider and higher than at rest by `stretched by`; a tube lies "
            "between two shares of the limb's axis, its girth and height at rest are ratios of the limb's.",
        ),
    ),
    numbers=Columns(
        NUMBER_HEADINGS,
        "Stitches: least and most of a course over its area. Course over rest: all courses, and the shortest and the "
        "longest. Pressure: mean, least and most, and the mean of 2 cm at each place. Deepest: of a point in the body.",
    ),
    differences="Every difference that must show, as a ratio of two measures, links by mean elongation; at least "
    f"{EFFECT:g} is asked for.",
)
