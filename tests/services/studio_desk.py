"""A folder with a scene, the studio in it, and its page in a browser, for tests."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from browser import Page

from nuno.studio.desk import Desk
from nuno.studio.server import Server
from nuno_bench.speed.studio import find_browser

NEEDS_BROWSER = pytest.mark.skipif(find_browser() is None, reason="no chromium to open the page in")

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


def ask(desk: Desk, name: str, /, **more: object) -> dict[str, Any]:
    """What the page asks for."""
    return desk.act({"do": name} | more)


def look(page: Page, server: Server, place: str, ready: str) -> None:
    """Open a place of the studio, such as `#scene=NAME`, anew, until an expression holds; what is not saved is lost."""
    page.value(
        "if (window.nuno?.scene?.text) nuno.scene.saved = nuno.scene.text.value"
    )  # else it asks whether to leave
    page.open("about:blank")
    page.open(server.guard.address + place)
    page.wait(f"window.nuno !== undefined && Boolean({ready})")


def look_at_scene(page: Page, server: Server, name: str = FILE) -> None:
    """Open a scene with its text and form, until it is checked."""
    place = f"#scene={name.replace('/', '%2F')}"
    look(page, server, place, f"nuno.scene?.name === '{name}' && document.getElementById('verdict')?.textContent")
    page.value("nuno.scene.side('text')")


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
