"""The page for drawing, in a browser: what is drawn by mouse is what arrives, and follows the cloth."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Page, find_browser
from draw_desk import SHEET, scene_desk, served, write_sheet
from live_run import Run
from numpy.typing import NDArray

import nuno
from nuno.cli.draw import open_desk
from nuno.draw.desk import Desk
from nuno.draw.lines import positions, read_strokes
from nuno.recording.restore import control_events
from nuno.scene import scene_file
from nuno_schemas.fabric import Float

pytestmark = [pytest.mark.full, pytest.mark.skipif(find_browser() is None, reason="no chromium to open the page in")]

PATH = [(380 + 14 * i, 270 + 40 * np.sin(i / 2.5)) for i in range(13)]
RIDGE = np.array([217, 72, 28])


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with Page(tmp_path_factory.mktemp("browser")) as one:
        yield one


def look(page: Page, address: str) -> None:
    page.open(address)
    page.wait("window.nuno?.stage?.shape >= 0 && document.getElementById('name').textContent != 'nuno'")


def drawn(page: Page) -> list[dict[str, Any]]:
    """The page's lines as it would send them."""
    return list(
        page.value(
            "nuno.lines.list.map((l) => ({points: nuno.lines.placesOf(l.id).points, "
            "height: l.kind == 'ridge' ? l.height : -l.height}))"
        )
    )


def pixels(page: Page, x: Float) -> NDArray[np.float64]:
    """(p, 2) where the page's camera shows points (p, 3), by a pinhole's own rule."""
    camera = page.value(
        "(({eye, target, width, height, slope}) => ({eye, target, width, height, slope}))(nuno.stage.camera)"
    )
    eye, target = np.array(camera["eye"]), np.array(camera["target"])
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    seen = (x - eye) @ np.stack([right, np.cross(back, right), back], axis=1)
    scale = camera["height"] / 2 / camera["slope"] / -seen[:, 2]
    return np.column_stack([camera["width"] / 2 + scale * seen[:, 0], camera["height"] / 2 - scale * seen[:, 1]])


def far(points: NDArray[np.float64], line: NDArray[np.float64]) -> float:
    """The largest distance of points from a polyline, both (p, 2)."""
    a, d = line[:-1], np.diff(line, axis=0)
    s = np.clip(np.einsum("pak,ak->pa", points[:, None] - a, d) / (d**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(points[:, None] - a - s[:, :, None] * d, axis=2).min(axis=1).max())


def check_under_mouse(page: Page, desk: Desk, line: dict[str, Any]) -> None:
    """The line lies on the cloth, which need not be flat, within a pixel of where the mouse went, all along."""
    way, seen = np.array(PATH), pixels(page, places(desk, line))
    assert far(way, seen) < 1.0 and far(seen, way) < 1.0


def places(desk: Desk, line: dict[str, Any]) -> Float:
    """(p, 3) where the points of a line are, as the page counts [m]."""
    (stroke,) = read_strokes([line], desk.board.now)
    return positions(stroke, desk.board.now) - desk.board.now.origin


def test_a_line_is_drawn_undone_and_saved(page: Page, tmp_path: Path) -> None:
    scene = write_sheet(tmp_path)
    desk = scene_desk(scene)
    with served(desk) as server:
        look(page, server.guard.address)
        page.drag(PATH)
        (line,) = drawn(page)
        assert line["height"] > 0
        check_under_mouse(page, desk, line)
        x, y = np.round(PATH[6]).astype(int)
        page.wait("!nuno.stage.asked")
        assert np.abs(page.picture()[y - 1 : y + 2, x - 1 : x + 2].astype(int) - RIDGE).sum(axis=2).min() < 30
        page.click("valley")
        page.drag([(400, 380), (440, 400), (520, 390)])
        assert [line["height"] > 0 for line in drawn(page)] == [True, False]
        page.click("undo")
        assert drawn(page) == [line]
        check_saved(page, desk, scene, line)
        page.drag([(460, 230), (470, 330)])  # a valley, across the ridge
        page.wait("document.querySelector('#labels div')?.textContent.includes('one triangle')")
        assert page.value("document.querySelectorAll('#list li')[1].querySelector('.error') != null")
        page.click("clear")
        assert drawn(page) == [] and not page.value("document.getElementById('labels').childElementCount")
    assert page.said == []


def check_saved(page: Page, desk: Desk, scene: Path, line: dict[str, Any]) -> None:
    """What is saved is the line that was drawn, once however often it is saved, and all else as it was."""
    for _ in range(2):
        page.value("document.getElementById('toast').hidden = true")
        page.click("save")
        page.wait("!document.getElementById('toast').hidden")
    text = scene.read_text()
    assert [row for row in text.splitlines() if not row.startswith(("operations", "  - {plugin: wrinkle"))] == [
        *SHEET.splitlines()
    ]
    (operation,) = scene_file.read(scene).scene.operations
    (kept,) = operation.config["lines"]
    at = np.array([[row["face"], *row["at"][1:]] for row in kept["on_faces"]])
    assert np.allclose(at, line["points"], atol=1e-5) and kept["height"] == pytest.approx(line["height"])


def test_the_page_follows_a_run_and_gives_it_lines(page: Page, tmp_path: Path) -> None:
    scene = write_sheet(tmp_path)
    run = Run(scene, tmp_path / "run.mcap")
    assert run.moved.wait(120)
    desk = open_desk(Namespace(scene=run.run, overrides=[], root=[], config=None))
    with served(desk) as server:
        look(page, server.guard.address)
        frame = page.value("nuno.frame")
        page.wait(f"nuno.frame > {frame} + 5 && nuno.state == 'running'")
        page.click("play")
        page.wait("nuno.state == 'paused'")
        frame = run.control("status")["frame"]
        page.wait(f"nuno.frame == {frame}")
        page.click("fit")
        page.drag(PATH)
        (line,) = drawn(page)
        check_under_mouse(page, desk, line)
        before = desk.board.now
        page.value("nuno.lines.alter(1, {height: 50})")
        page.click("apply")
        page.wait("document.querySelector('#labels div')?.textContent.includes('smaller')")
        assert desk.board.now.shape == before.shape and len(drawn(page)) == 1
        page.click("undo")
        page.click("apply")
        page.wait("nuno.lines.applied.size == 1")
        after = desk.board.now
        split = len(after.x) - len(before.x)
        assert split > 5 and len(after.faces) == len(before.faces) + 2 * split
        page.wait(f"nuno.stage.cloth.x.length == {after.x.size} && nuno.frame == {frame}")
        assert far(np.array(PATH), pixels(page, places(desk, drawn(page)[0]))) < 30.0  # on the raised cloth
        page.click("play")
        page.wait(f"nuno.frame > {frame} + 5")
    run.stop()
    with nuno.open(run.record) as recording:
        assert [event.text for event in control_events(recording)] == ["pause", "add", "resume", "stop"]
        assert len(list(recording.frames())[-1].x) == len(after.x)
    assert page.said == []
