"""A page's server on a sheet of triangles, for tests."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nuno.draw.desk import Desk
from nuno.draw.shown import see_scene
from nuno.pages.server import Server
from nuno.scene import scene_file
from nuno.seen.sight import Board

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


def write_sheet(folder: Path) -> Path:
    """The scene's file."""
    path = folder / "sheet.yaml"
    path.write_text(SHEET)
    return path


@contextmanager
def served(desk: Desk) -> Iterator[Server]:
    """The desk's page, served meanwhile."""
    server = desk.server()
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        desk.close()


def scene_desk(path: Path) -> Desk:
    """On a scene."""
    loaded = scene_file.read(path)
    return Desk(loaded, Board(see_scene(loaded)))
