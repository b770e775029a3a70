"""Shipped wrinkles: run, shown at the stages of the wrinkle paper's figures, and measured while they settle."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nuno import api
from nuno.cloth import build
from nuno.collision.bodies import build_bodies
from nuno.export.cloth import Pieces, read_frame
from nuno.export.pictures import export_picture
from nuno.recording.reader import Recording, open_recording
from nuno.recording.recorded import Frame
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno_bench.gallery.kind import EFFECT, Columns, Kind, Shown, difference_row
from nuno_bench.gallery.wrinkle_measures import Drawn, Ridge
from nuno_bench.report.result import number
from nuno_schemas.dye_picture import Picture
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float, State

NAMES = ("hung-cloth-wrinkle", "bloom-skirt", "shirt-wrinkles")
"""Figures 4, 5 and 6, and 7 and 8."""
SIZE = (640, 480)
STAGES = ("as it was", "just drawn", "half way", "at the end")
PARAMETERS = ("scene", "vertices", "drawn at [s]", "lines", "heights", "springs", "smoothing passes", "friction")
NUMBERS = ("scene", "height [mm]", "width [mm]")

Measures = list[tuple[Ridge, Ridge, Ridge]]
"""Of every line: just drawn, half way, and at the end."""


class Difference(NamedTuple):
    """A line's height or width just drawn is above what it is at the end."""

    says: str
    scene: str
    line: int
    measure: str


SHIRT = "shirt-wrinkles"
DIFFERENCES = (
    Difference("the left wrinkle thins while it settles", SHIRT, 0, "width"),
    Difference("the right wrinkle fades", SHIRT, 1, "height"),
)


def scenes() -> dict[str, Path]:
    """Files of the shipped scenes with wrinkles by name."""
    known = scene_file.shipped()
    return {name: known[name] for name in NAMES if name in known}


def run_scene(path: Path) -> Shown[Measures]:
    """Run one to its end, or to where it fails, and draw its stages. Raises BadInput."""
    loaded = scene_file.read(path)
    name, description = loaded.scene.name, loaded.scene.description
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        target, failed = Path(folder) / f"{name}.mcap", ""
        try:
            api.run(path, record=target)
        except RunFailed as error:
            failed = str(error).removesuffix(f"; recording kept in {target}")
        if failed or not target.is_file():
            return Shown(name, description, [], [_parameters(loaded, 0)], _numbers(name, []), [], failed)
        with open_recording(target) as recording:
            frames = _stages(recording, _operations(loaded), loaded.scene.frame_rate)
            pictures = _draw(recording, frames, Path(folder) / "picture.png")
            found = _measure(recording, frames, loaded)
            parameters = _parameters(loaded, len(frames[STAGES[0]].x) if STAGES[0] in frames else 0)
    return Shown(name, description, pictures, [parameters], _numbers(name, found), found)


def _operations(loaded: Loaded) -> list[dict[str, Any]]:
    """What the scene does to its cloth: the time of each and its own fields."""
    return [{"at": float(one.at), **one.config} for one in loaded.scene.operations if one.plugin == "wrinkle"]


def _stages(recording: Recording, operations: list[dict[str, Any]], rate: float) -> dict[str, Frame]:
    """Frames by stage: the last before any line, where there is one, the next, one half way, and the last."""
    last = read_frame(recording)
    first = round(min((one["at"] for one in operations), default=0.0) * rate)
    before = read_frame(recording, first)
    found = {STAGES[0]: before} if len(before.x) < len(last.x) else {}
    drawn = first + len(found)
    half = (drawn + last.number) // 2
    return found | {STAGES[1]: read_frame(recording, drawn), STAGES[2]: read_frame(recording, half), STAGES[3]: last}


def _draw(recording: Recording, frames: dict[str, Frame], target: Path) -> list[tuple[str, Picture]]:
    from PIL import Image

    found = []
    for label, frame in frames.items():
        with Image.open(export_picture(recording, target, frame.number, SIZE, "cloth")) as image:
            found.append((f"{label}, {frame.t:.3g} s", np.asarray(image.convert("RGB"))))
    return found


def _raise(loaded: Loaded, before: Frame) -> Float:
    """(n, 3) [m] where the scene's lines raise the cloth, before any step: a frame later it has sunk already."""
    bodies = build_bodies(loaded) if loaded.scene.bodies else None
    poses = bodies.poses(0.0) if bodies else None
    fabric, _ = build.build_fabric(loaded, bodies.geometry if bodies else None, poses)
    state = State(before.x.astype(np.float64), np.zeros(before.x.shape), before.t)
    for operation in loaded.operations:
        changed = operation.plugin.apply(operation.config, fabric, state, None).changed
        fabric, state = changed.fabric, changed.state
    return np.asarray(state.x)


def _measure(recording: Recording, frames: dict[str, Frame], loaded: Loaded) -> Measures:
    """Of every line that is given by points and drawn while the scene goes on; else none."""
    operations = _operations(loaded)
    lines = [np.array(line["points"], float) for one in operations for line in one["lines"] if "points" in line]
    if not lines or STAGES[0] not in frames:
        return []
    fabric, drawn = recording.last_checkpoint().fabric, frames[STAGES[1]]
    crests = np.concatenate([fabric[f"fabric/crests/{i}"] for i in range(len(operations))], axis=1)
    raised = _raise(loaded, frames[STAGES[0]])
    found = Drawn(raised, Pieces(recording).at(drawn.t)[0].faces, crests, lines)
    stages = (raised, frames[STAGES[2]].x, frames[STAGES[3]].x)
    return list(zip(*(found.measure(x) for x in stages), strict=True))


def _parameters(loaded: Loaded, vertices: int) -> list[str]:
    """A row under PARAMETERS."""
    operations = _operations(loaded)
    lines = [line for one in operations for line in one["lines"]]
    return [
        loaded.scene.name, f"{vertices:,}" if vertices else "", ", ".join(f"{one['at']:g}" for one in operations),
        str(len(lines)), ", ".join(dict.fromkeys(str(line["height"]) for line in lines)),
        ", ".join(dict.fromkeys(one.get("springs", "paper") for one in operations)),
        ", ".join(dict.fromkeys(str(one.get("smoothing", {}).get("passes", "")) or "8" for one in operations)),
        ", ".join(f"{body.friction:g}" for body in loaded.scene.bodies),
    ]  # fmt: skip


def _numbers(name: str, found: Measures) -> list[str]:
    """A row under NUMBERS: of each line in turn, how it went through the stages."""

    def told(measure: str) -> str:
        ways = ([number(1e3 * float(getattr(ridge, measure))) for ridge in line] for line in found)
        return "; ".join(" → ".join(way) for way in ways)

    return [name, told("height"), told("width")]


def compare(shown: Mapping[str, Shown[Measures]]) -> list[list[str]]:
    """Rows under DIFFERENCE_HEADINGS, of scenes that were measured."""
    rows = []
    for one in DIFFERENCES:
        if one.scene in shown and len(shown[one.scene].measured) > one.line:
            first, _, last = shown[one.scene].measured[one.line]
            sides = [(stage, 1e3 * float(getattr(ridge, one.measure))) for stage, ridge in
                     ((STAGES[1], first), (STAGES[3], last))]  # fmt: skip
            rows.append(difference_row(one.says, f"{one.measure} [mm]", sides[0], sides[1]))
    if SHIRT in shown and len(shown[SHIRT].measured) > 1:
        left, right = (last.height / first.height for first, _, last in shown[SHIRT].measured[:2])
        sides = [("left", left), ("right", right)]
        rows.append(difference_row("the left one stays where the right one fades", "height kept", *sides))
    return rows


KIND = Kind(
    title="Wrinkles",
    lead="Ridges and valleys drawn on cloth, at the stages of the wrinkle paper's figures 4 to 8.",
    scenes=scenes,
    run_scene=run_scene,
    compare=compare,
    parameters=(Columns(PARAMETERS, "Lines with their heights, the rule of new springs, and friction on the body."),),
    numbers=Columns(
        NUMBERS,
        "Height: over the chord across the wrinkle, from cloth to cloth where nothing was smoothed. Width: along that "
        "chord, at half the height. Of each line that is given by points and drawn while the scene goes on: as it is "
        "raised, before any step, half way, and at the end.",
    ),
    differences=f"What the paper says of its figure 8, as a ratio of two measures; at least {EFFECT:g} is asked for.",
)
