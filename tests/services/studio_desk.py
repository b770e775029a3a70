"""A folder with a scene, and the studio in it, for tests."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nuno.pages.server import Server
from nuno.studio.desk import Desk

SHEET = """\
# a sheet of silk
nuno: 1
name: sheet
description: A small sheet falls.   # as a test
duration: 0.4 s
frame_rate: 50 Hz
solver: {plugin: symplectic_euler, dt: auto}
damping: 0.5     # air

objects:
  - name: cloth   # the only one
    model: {plugin: sheet, size: [40 cm, 40 cm], resolution: [9, 9], fabric: silk, pin: [top-corners]}
# the end
"""
FILE = "sheet.yaml"


def write_sheet(folder: Path) -> Path:
    """The scene's file."""
    path = folder / FILE
    path.write_text(SHEET)
    return path


@contextmanager
def studio() -> Iterator[tuple[Desk, Server]]:
    """The page of the present folder, served meanwhile."""
    desk = Desk()
    with served(desk) as server:
        yield desk, server


@contextmanager
def served(desk: Desk) -> Iterator[Server]:
    """A desk's page, served meanwhile."""
    server = desk.server()
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        desk.close()
