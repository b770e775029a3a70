"""A kind of scenes for `nuno gallery`: their files, how one is run and measured, and the figures of a paper that
they are.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import nuno
from nuno.recording.reader import Recording, open_recording
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno_bench.report.page import Table, number
from nuno_schemas.errors import RunFailed
from nuno_schemas.pictures import Picture


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


class Finding(NamedTuple):
    """What a figure's criterion gave: its value in words, whether the paper's sentence holds here, and if not, why."""

    value: str
    holds: bool
    why: str = ""


Measures = Mapping[str, Mapping[str, float]]
"""What was measured, by name and unit, of each scene by its name."""


@dataclass(frozen=True)
class Figure:
    """A figure of a paper, and how our pictures are held against what the paper says of it.

    number     as the paper counts it, e.g. "8 (d)"
    sentence   what the paper says, in English
    criterion  what is measured, and which values make the sentence true
    scenes     names of the gallery's scenes that it is judged by, whose pictures stand under it
    judge      takes what was measured of them
    labels     beginnings of the labels of those pictures; empty for all
    reading    what the paper leaves open, and how it is read here
    sweep      runs small variants: the table shows where the sentence holds and where it does not. A figure that is
               not reproduced needs one.
    """

    number: str
    sentence: str
    criterion: str
    scenes: tuple[str, ...]
    judge: Callable[[Measures], Finding]
    labels: tuple[str, ...] = ()
    reading: str = ""
    sweep: Callable[[], Table] | None = None


@dataclass(frozen=True)
class Verdict:
    """A figure with what was found, and the table of its sweep."""

    figure: Figure
    finding: Finding
    swept: Table | None

    @property
    def word(self) -> str:
        return "reproduced" if self.finding.holds else "not reproduced"

    @property
    def stands(self) -> bool:
        """Whether it is reproduced, or a sweep shows why not."""
        return self.finding.holds or self.swept is not None


@dataclass(frozen=True)
class Gallery:
    """Scenes that are shown on one page.

    scenes       their files by name, in the page's order
    run_scene    runs one to its end, or to where it fails; raises BadInput
    measures     a sentence above what was measured
    table        of what was measured
    section      heading under which a scene's pictures stand, by its name
    apart        label of pictures that stand after the others of a section
    alike        whether the scenes take about as long, so that none is tried beforehand
    figures      of a paper; their scenes' pictures stand under them instead of under a section
    """

    title: str
    lead: str
    scenes: Callable[[], dict[str, Path]]
    run_scene: Callable[[Path], ShownScene]
    measures: str
    section: Callable[[str], str] = str
    apart: str = ""
    alike: bool = False
    table: Callable[[Sequence[ShownScene]], Table] = list_measured
    figures: Sequence[Figure] = ()


Look = Callable[[Loaded, Recording, Path], tuple[list[tuple[str, Picture]], Mapping[str, float]]]
"""Takes a scene, its recording and a folder to work in; gives pictures by label, and what is measured."""


def show_scene(path: Path, look: Look, whole: bool = False, overrides: Sequence[str] = ()) -> ShownScene:
    """Run a scene's file to its end, or to where it fails, and look at its recording, of a `whole` run alone if asked.

    Raises BadInput.
    """
    loaded = scene_file.read(path, overrides)
    shown = ShownScene(loaded.scene.name, loaded.scene.description)
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        target = Path(folder) / f"{path.stem}.mcap"
        try:
            nuno.run(path, *overrides, record=target)
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


def judge_figures(figures: Sequence[Figure], shown: Mapping[str, ShownScene]) -> list[Verdict]:
    """The verdicts on those figures whose scenes have all been run."""
    measured = {name: one.measured for name, one in shown.items()}
    return [
        Verdict(figure, figure.judge({name: measured[name] for name in figure.scenes}), figure.sweep and figure.sweep())
        for figure in figures if all(name in shown for name in figure.scenes)
    ]  # fmt: skip
