"""The page for drawing, in a browser: what is drawn by mouse is what arrives, and follows the cloth."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Page
from draw_desk import FILE, SHEET, write_sheet
from live_run import Run
from numpy.typing import NDArray
from studio_desk import NEEDS_BROWSER, served

import nuno
from nuno.cli.studio import open_desk
from nuno.recording.reader import control_events
from nuno.runtime import runs
from nuno.scene import scene_file
from nuno.studio.desk import Desk
from nuno.studio.draw import positions, read_strokes
from nuno.studio.live_view import Sight
from nuno_schemas.fabric import Float

pytestmark = [pytest.mark.full, NEEDS_BROWSER]

PATH = [(560 + 14 * i, 400 + 40 * np.sin(i / 2.5)) for i in range(13)]
VIEW = "nuno.scene.cloth"
BOX = "(({x, y}) => [x, y])(document.getElementById('cloth').getBoundingClientRect())"
TEXT = "nuno.scene.text.value"
RIDGE = np.array([217, 72, 28])


def look(page: Page, address: str) -> None:
    # A page with changes that are not saved asks whether to leave.
    page.value("window.nuno?.scene?.cloth.lines.clear()")
    page.value("if (window.nuno?.scene?.text) nuno.scene.saved = nuno.scene.text.value")
    page.open("about:blank")
    page.open(address)
    page.wait("window.nuno?.scene?.cloth?.draw.on")
    page.wait(f"!{VIEW}.stage.asked")


def opened(scene: str) -> tuple[Desk, str]:
    return open_desk(Namespace(scene=scene, overrides=[], root=[], config=None))


def drawn(page: Page) -> list[dict[str, Any]]:
    """The page's lines as it would send them."""
    return list(
        page.value(
            "nuno.scene.cloth.lines.list.map((l) => ({points: nuno.scene.cloth.lines.placesOf(l.id).points, "
            "height: l.kind == 'ridge' ? l.height : -l.height}))"
        )
    )


def pixels(page: Page, x: Float) -> NDArray[np.float64]:
    """(p, 2) where the page's camera shows points (p, 3), by a pinhole's own rule, from the page's corner."""
    seen_by = "(({eye, target, width, height, slope}) => ({eye, target, width, height, slope}))"
    camera = page.value(f"{seen_by}({VIEW}.stage.camera)")
    eye, target = np.array(camera["eye"]), np.array(camera["target"])
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    seen = (x - eye) @ np.stack([right, np.cross(back, right), back], axis=1)
    scale = camera["height"] / 2 / camera["slope"] / -seen[:, 2]
    shown = np.column_stack([camera["width"] / 2 + scale * seen[:, 0], camera["height"] / 2 - scale * seen[:, 1]])
    return shown + np.array(page.value(BOX))


def far(points: NDArray[np.float64], line: NDArray[np.float64]) -> float:
    """The largest distance of points from a polyline, both (p, 2)."""
    a, d = line[:-1], np.diff(line, axis=0)
    s = np.clip(np.einsum("pak,ak->pa", points[:, None] - a, d) / (d**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(points[:, None] - a - s[:, :, None] * d, axis=2).min(axis=1).max())


def check_under_mouse(page: Page, sight: Sight, line: dict[str, Any]) -> None:
    """The line lies on the cloth, which need not be flat, within a pixel of where the mouse went, all along."""
    way, seen = np.array(PATH), pixels(page, places(sight, line))
    assert far(way, seen) < 1.0 and far(seen, way) < 1.0


def places(sight: Sight, line: dict[str, Any]) -> Float:
    """(p, 3) where the points of a line are, as the page counts [m]."""
    (stroke,) = read_strokes([line], sight)
    return positions(stroke, sight) - sight.origin


def test_a_line_is_drawn_undone_and_saved(page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_sheet(tmp_path)
    desk, place = opened(FILE)
    with served(desk) as server:
        look(page, server.guard.address + place)
        sight = desk._starts.kept[page.value(f"{VIEW}.number")].sight
        page.drag(PATH)
        (line,) = drawn(page)
        assert line["height"] > 0
        check_under_mouse(page, sight, line)
        x, y = np.round(PATH[6]).astype(int)
        page.wait(f"!{VIEW}.stage.asked")
        assert np.abs(page.picture()[y - 1 : y + 2, x - 1 : x + 2].astype(int) - RIDGE).sum(axis=2).min() < 30
        page.press("v")
        page.drag([(580, 500), (620, 520), (700, 510)])
        assert [line["height"] > 0 for line in drawn(page)] == [True, False]
        page.press("z", control=True)
        assert drawn(page) == [line] and page.value(TEXT) == SHEET
        check_kept(page, line)
        page.drag([(640, 350), (650, 470)])  # a valley, across the ridge
        page.wait("document.querySelector('#draw-labels div')?.textContent.includes('one triangle')")
        assert page.value("document.querySelectorAll('#draw-list li')[1].querySelector('.error') != null")
        page.click("draw-clear")
        assert drawn(page) == [] and not page.value("document.getElementById('draw-labels').childElementCount")
    assert page.said == []


def check_kept(page: Page, line: dict[str, Any]) -> None:
    """What goes into the text is the line that was drawn, once however often it is, and all else as it was."""
    for height in (0.04, line["height"]):
        page.value(f"nuno.scene.cloth.lines.alter(1, {{height: {height}}})")
        page.value("document.getElementById('toast').hidden = true")
        page.click("draw-save")
        page.wait("!document.getElementById('toast').hidden")
    assert Path(FILE).read_text() == SHEET
    page.press("s", control=True)
    page.wait("document.getElementById('unsaved').textContent === ''")
    text = Path(FILE).read_text()
    assert [row for row in text.splitlines() if not row.startswith(("operations", "  - {plugin: wrinkle"))] == [
        *SHEET.splitlines()
    ]
    (operation,) = scene_file.read(Path(FILE)).scene.operations
    (kept,) = operation.config["lines"]
    at = np.array([[row["face"], *row["at"][1:]] for row in kept["on_faces"]])
    assert np.allclose(at, line["points"], atol=1e-5) and kept["height"] == pytest.approx(line["height"])
    page.value("nuno.scene.cloth.lines.past = nuno.scene.cloth.lines.past.slice(0, 1)")


def test_a_scene_is_run_with_its_lines_and_they_are_in_it_once(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_sheet(tmp_path)
    desk, place = opened(FILE)
    with served(desk) as server:
        look(page, server.guard.address + place)
        count = page.value(f"{VIEW}.stage.cloth.x.length")
        page.drag(PATH)
        page.click("draw-save")
        page.wait(f"{TEXT}.includes('wrinkle')")
        page.click("draw-apply")
        page.wait(f"{VIEW}.frame.frame > 3", 300.0)
        assert page.value(f"{VIEW}.lines.applied.size") == 1
        more = page.value(f"{VIEW}.stage.cloth.x.length")
        assert more > count
        page.click("stop")
        page.wait("nuno.dock.now.state === 'over'", 60.0)
        page.click("cloth-back")
        page.wait(f"{VIEW}.frame.state === 'start' && {VIEW}.lines.open.length === 1")
        assert page.value(f"{VIEW}.stage.cloth.x.length") == count
    with nuno.open("last") as recording:
        assert len(recording.scene["operations"]) == 1 and 3 * len(list(recording.frames())[-1].x) == more
    assert page.said == []


def test_cloth_that_needs_a_width_has_one_suggested_and_its_lines_are_taken_back(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_sheet(tmp_path).write_text(SHEET.replace("cells: triangles, ", ""))
    desk, place = opened(FILE)
    with served(desk) as server:
        look(page, server.guard.address + place)
        width, edge = page.value(f"{VIEW}.draw.width"), page.value(f"{VIEW}.draw.needs.edge")
        assert width >= 5.9 * edge and page.value("document.getElementById('draw-passes').disabled")
        page.drag(PATH)
        page.drag([(580, 500), (620, 520), (700, 510)])
        page.click("draw-apply")
        page.wait(f"{VIEW}.frame.frame > 3", 300.0)
        for left in (1, 0):
            page.tap("#draw-list li .link")
            page.wait(f"{VIEW}.lines.list.length === {left}")
        page.click("stop")
        page.wait("nuno.dock.now.state === 'over'", 60.0)
    with nuno.open("last") as recording:
        items = [event.args["item"] for event in control_events(recording) if event.text == "add"]
        assert [item.partition("take_back")[2] for item in items] == ['": [1]}', '": [2]}']
    assert page.said == []


def test_the_page_follows_a_run_and_gives_it_lines(page: Page, tmp_path: Path) -> None:
    scene = write_sheet(tmp_path)
    run = Run(scene, tmp_path / "run.mcap")
    assert run.moved.wait(120)
    desk, place = opened(run.run)
    with served(desk) as server:
        look(page, server.guard.address + place)
        page.wait(f"{VIEW}.live === '{run.run}' && {VIEW}.frame.state === 'running'")
        own = desk._own
        assert own is not None and own.live is not None
        board = own.live.board
        frame = page.value(f"{VIEW}.frame.frame")
        page.wait(f"{VIEW}.frame.frame > {frame} + 5")
        page.click("pause")
        page.wait("nuno.dock.now.state === 'paused'")
        frame = run.control("status")["frame"]
        page.wait(f"{VIEW}.frame.frame == {frame}")
        page.click("cloth-fit")
        page.drag(PATH)
        (line,) = drawn(page)
        check_under_mouse(page, board.now, line)
        before = board.now
        page.value("nuno.scene.cloth.lines.alter(1, {height: 50})")
        page.click("draw-apply")
        page.wait("document.querySelector('#draw-labels div')?.textContent.includes('smaller')")
        assert board.now.shape == before.shape and len(drawn(page)) == 1
        page.click("draw-undo")
        page.click("draw-apply")
        page.wait("nuno.scene.cloth.lines.applied.size == 1")
        after = board.now
        split = len(after.x) - len(before.x)
        assert split > 5 and len(after.faces) == len(before.faces) + 2 * split
        page.wait(f"{VIEW}.stage.cloth.x.length == {after.x.size} && {VIEW}.frame.frame == {frame}")
        assert far(np.array(PATH), pixels(page, places(board.now, drawn(page)[0]))) < 30.0  # on the raised cloth
        page.click("draw-save")
        page.wait(f"{TEXT}.includes('wrinkle')")
        page.click("pause")
        page.wait(f"{VIEW}.frame.frame > {frame} + 5")
    run.stop()
    with nuno.open(run.record) as recording:
        assert [event.text for event in control_events(recording)] == ["pause", "add", "resume", "stop"]
        assert len(list(recording.frames())[-1].x) == len(after.x)
    assert page.said == []


def test_a_run_of_an_unknown_scene_is_shown_by_its_cloth_alone(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(write_sheet(tmp_path), tmp_path / "run.mcap")
    assert run.moved.wait(120)
    monkeypatch.setattr(runs, "scene_path", lambda name: None)
    desk, place = opened(run.run)
    with served(desk) as server:
        look(page, server.guard.address + place)
        page.click("pause")
        page.wait(f"nuno.dock.now.state === 'paused' && {VIEW}.frame.frame === nuno.dock.now.frame")
        count = page.value(f"{VIEW}.stage.cloth.x.length")
        page.click("cloth-fit")
        page.drag(PATH)
        page.click("draw-save")
        page.wait("document.getElementById('toast').textContent.includes('Export')")
        page.click("draw-apply")
        page.wait(f"{VIEW}.lines.applied.size === 1 && {VIEW}.stage.cloth.x.length > {count}")
    run.stop()
    assert page.said == []
