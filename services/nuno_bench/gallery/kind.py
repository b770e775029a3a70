"""What `nuno gallery` needs to know of a kind of scenes: which they are, how one is run, and what they must show."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

from nuno_bench.report.result import number
from nuno_schemas.dye_picture import Picture

Measured = TypeVar("Measured")

EFFECT = 1.2
"""Least ratio by which a difference counts as shown."""
DIFFERENCE_HEADINGS = ("what must show", "measure", "of", "against", "ratio", "verdict")


class Columns(NamedTuple):
    """Headings of a table, that of the scene first, and a sentence above it."""

    headings: tuple[str, ...]
    caption: str


@dataclass(frozen=True)
class Shown(Generic[Measured]):
    """A scene that has been run: its pictures, each with what it shows beside the scene's own; its parameters, a row
    for each table, and its numbers, under their headings; what the kind compares; and why it failed, if it did.
    """

    name: str
    description: str
    pictures: list[tuple[str, Picture]]
    parameters: list[list[str]]
    numbers: list[str]
    measured: Measured
    failed: str = ""


@dataclass(frozen=True)
class Kind(Generic[Measured]):
    """Scenes that are shown on one page.

    scenes       their files by name, in the page's order
    run_scene    runs one to its end, or to where it fails; raises BadInput
    compare      rows under DIFFERENCE_HEADINGS, of those differences whose scenes are all there
    differences  a sentence above these rows
    section      heading under which a scene's pictures stand, by its name
    apart        label of pictures that stand after the others of a section
    """

    title: str
    lead: str
    scenes: Callable[[], dict[str, Path]]
    run_scene: Callable[[Path], Shown[Measured]]
    compare: Callable[[Mapping[str, Shown[Measured]]], list[list[str]]]
    parameters: tuple[Columns, ...]
    numbers: Columns
    differences: str
    section: Callable[[str], str] = str
    apart: str = ""


def difference_row(says: str, measure: str, high: tuple[str, float], low: tuple[str, float]) -> list[str]:
    """A row under DIFFERENCE_HEADINGS: the first value, with where it is from, against the second.

    The difference shows where the ratio is EFFECT at least. A first value above 0 is infinitely many times a second
    one that is not; any other is no multiple of anything, and misses, as does a value that could not be measured.
    """
    (_, more), (_, less) = high, low
    ratio = math.nan if not more > 0.0 or math.isnan(less) else more / less if less > 0.0 else math.inf
    sides = [f"{name}: {number(value)}" for name, value in (high, low)]
    return [says, measure, *sides, number(ratio), "bar met" if ratio >= EFFECT else "missed"]
