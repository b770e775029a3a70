"""A folder with a sheet of triangles to be drawn on, and what a page asks for about lines, for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nuno.studio.desk import Desk

SHEET = """\
nuno: 1
name: sheet        # to be drawn on
duration: 400 s
frame_rate: 50 Hz
damping: 2
solver: {plugin: leapfrog, dt: auto}   # as the wrinkle paper
objects:
  - name: cloth
    model: {plugin: sheet, size: [1 m, 1 m], resolution: [13, 13], cells: triangles, fabric: denim, pin: [top-corners]}
# the end
"""
FILE = "sheet.yaml"


def write_sheet(folder: Path) -> Path:
    """The scene's file."""
    path = folder / FILE
    path.write_text(SHEET)
    return path


def see(desk: Desk, text: str = SHEET, scene: str = FILE) -> int:
    """The number of a text's start."""
    return int(desk.act({"do": "see", "scene": scene, "text": text})["number"])


def draw(desk: Desk, does: str, **more: object) -> dict[str, Any]:
    """What the page asks for about lines."""
    return desk.act({"do": "draw", "does": does} | more)


def keep(desk: Desk, start: int, lines: list[dict[str, Any]], text: str = SHEET, scene: str = FILE) -> str:
    """The text with lines in it."""
    return str(draw(desk, "keep", start=start, lines=lines, text=text, scene=scene)["text"])
