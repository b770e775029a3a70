"""A kind of scenes for `nuno gallery`: their files, how one is run and measured, and the differences they must show."""

from __future__ import annotations

import base64
import io
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import nuno
from nuno.recording.reader import Recording, open_recording
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno_bench.report.page import Table, number
from nuno_schemas.errors import RunFailed
from nuno_schemas.pictures import Picture

EFFECT = 1.2
"""Least ratio by which a difference counts as shown."""
DIFFERENCE_HEADINGS = ("what must show", "of", "against", "ratio", "verdict")


class Difference(NamedTuple):
    """A measure of one scene that must be above a measure of the same or of another scene."""

    says: str
    high: tuple[str, str]
    low: tuple[str, str]


@dataclass(frozen=True)
class ShownScene:
    """A scene that has been run: its pictures, each with what it shows beside the scene's own, what was measured, by
    name and unit, why it failed, if it did, and whether it would not start.
    """

    name: str
    description: str
    pictures: list[tuple[str, Picture]] = field(default_factory=list)
    measured: Mapping[str, float] = field(default_factory=dict)
    failed: str = ""
    refused: bool = False


def list_measured(shown: Sequence[ShownScene]) -> Table:
    """A row a measure of each scene."""
    rows = [[one.name, what, number(value)] for one in shown for what, value in one.measured.items()]
    return Table(("scene", "measure", "value"), rows)


@dataclass(frozen=True)
class Gallery:
    """Scenes that are shown on one page.

    scenes       their files by name, in the page's order
    run_scene    runs one to its end, or to where it fails; raises BadInput
    differences  what must show
    measures     a sentence above what was measured
    table        of what was measured
    section      heading under which a scene's pictures stand, by its name
    apart        label of pictures that stand after the others of a section
    alike        whether the scenes take about as long, so that none is tried beforehand
    """

    title: str
    lead: str
    scenes: Callable[[], dict[str, Path]]
    run_scene: Callable[[Path], ShownScene]
    differences: Sequence[Difference]
    measures: str
    section: Callable[[str], str] = str
    apart: str = ""
    alike: bool = False
    table: Callable[[Sequence[ShownScene]], Table] = list_measured


Look = Callable[[Loaded, Recording, Path], tuple[list[tuple[str, Picture]], Mapping[str, float]]]
"""Takes a scene, its recording and a folder to work in; gives pictures by label, and what is measured."""


def show_scene(path: Path, look: Look, whole: bool = False) -> ShownScene:
    """Run a scene's file to its end, or to where it fails, and look at its recording, of a `whole` run alone if asked.

    Raises BadInput.
    """
    loaded = scene_file.read(path)
    shown = ShownScene(loaded.scene.name, loaded.scene.description)
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        target = Path(folder) / f"{path.stem}.mcap"
        try:
            nuno.run(path, record=target)
        except RunFailed as error:
            shown = replace(shown, failed=str(error).removesuffix(f"; recording kept in {target}"))
        if not target.is_file() or (whole and shown.failed):
            return shown
        with open_recording(target) as recording:
            if not recording.marks():
                return shown
            pictures, measured = look(loaded, recording, Path(folder))
            return replace(shown, pictures=pictures, measured=measured)


def find_scenes(folder: str) -> dict[str, Path]:
    """Files of a folder's shipped scenes by name."""
    return {path.stem: path for path in shipped.scenes(folder).values()}


def read_picture(path: Path) -> Picture:
    """(height, width, 3) sRGB."""
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def embed(picture: Picture) -> str:
    """A picture as a data URL."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def compare(differences: Sequence[Difference], shown: Mapping[str, ShownScene]) -> list[list[str]]:
    """Rows under DIFFERENCE_HEADINGS, of those differences whose scenes have all been run.

    A difference shows where the ratio is EFFECT at least. A first value above 0 is infinitely many times a second one
    that is not; any other is no multiple of anything, and misses, as does a value that could not be measured.
    """
    rows = []
    for says, *sides in differences:
        if all(scene in shown for scene, _ in sides):
            more, less = (shown[scene].measured.get(measure, math.nan) for scene, measure in sides)
            ratio = math.nan if not more > 0.0 or math.isnan(less) else more / less if less > 0.0 else math.inf
            texts = [
                f"{scene}, {measure}: {number(x)}" for (scene, measure), x in zip(sides, (more, less), strict=True)
            ]
            rows.append([says, *texts, number(ratio), "bar met" if ratio >= EFFECT else "missed"])
    return rows
