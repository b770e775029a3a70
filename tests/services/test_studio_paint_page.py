"""Painting in the studio, in a browser: what a person does there by mouse and keyboard is in the cells of the scene."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import Page
from PIL import Image
from studio_desk import NEEDS_BROWSER, look_at_scene, studio

import nuno
from nuno.scene import scene_file, shipped
from nuno.studio import scenes
from nuno.studio.dye import at_start
from nuno.studio.live_view import see_objects
from nuno.studio.server import Server
from nuno_schemas.dye import Cells
from nuno_schemas.fabric import Float

pytestmark = [pytest.mark.full, NEEDS_BROWSER]
PATIENCE = 300.0
"""The first run on a machine compiles kernels [s]."""
FILE = "drops.yaml"
CELL = 5e-5
DONE = "nuno.scene.cloth.paint.flat.waiting.length === 0 && nuno.scene.cloth.paint.shown === nuno.scene.text.value"


def paint(page: Page, server: Server, name: str) -> None:
    """Open a scene in the mode for painting."""
    look_at_scene(page, server, name)
    assert page.value("document.getElementById('verdict').textContent") == "No mistakes"
    page.click("cloth-paint")
    page.wait("nuno.scene.cloth.paint.on && document.getElementById('paint').clientWidth > 400")
    assert page.value("document.getElementById('cloth-flat').clientWidth") == 0  # one picture, which is painted on


@pytest.fixture
def painting(page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """The scene dye/drops as one's own, open in the mode for painting."""
    monkeypatch.chdir(tmp_path)
    Path(FILE).write_text(shipped.find("dye/drops").read_text())
    with studio() as (_, server):
        paint(page, server, FILE)
        yield server


def pixels(page: Page, *places: tuple[float, float]) -> list[tuple[float, float]]:
    """Where places of the cloth [mm] are on the screen."""
    box = page.value("(({ x, y }) => [x, y])(document.getElementById('paint').getBoundingClientRect())")
    frame = page.value("nuno.scene.cloth.paint.flat.frame")
    return [
        (box[0] + frame["left"] + frame["scale"] * x * 1e-3, box[1] + frame["top"] + frame["scale"] * y * 1e-3)
        for x, y in places
    ]


def begin(page: Page) -> tuple[Cells, Float]:
    """Cells and mobile dye that a run of the page's text begins with."""
    cells, phi, _ = at_start(scenes.load(page.value("document.getElementById('text').value"), Path(FILE)))
    return cells, phi


def away(ends: list[tuple[float, float]], shape: tuple[int, int]) -> Float:
    """(ny, nx) distance [m] of cells' middles from a line between two places [mm]."""
    (ax, ay), (bx, by) = ((x * 1e-3, y * 1e-3) for x, y in ends)
    y, x = (np.indices(shape) + 0.5) * CELL
    long = (bx - ax) ** 2 + (by - ay) ** 2
    share = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / (long or 1.0), 0.0, 1.0)
    return np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay))


def set_width(page: Page, mm: float) -> None:
    page.value(f"""(() => {{ const width = document.getElementById('paint-width'); width.value = {mm};
        width.dispatchEvent(new Event('change')); }})()""")


def test_a_drag_is_a_stroke_of_its_width_where_it_was_drawn(page: Page, painting: Server) -> None:
    """Paste, then dye beside it, each undone by a key: within a pixel of the screen and a cell of what was drawn."""
    before, (_, dry) = page.value("nuno.scene.text.value"), begin(page)
    set_width(page, 0.8)
    ends = [(2.0, 8.5), (14.0, 8.5)]
    (x0, y), (x1, _) = pixels(page, *ends)
    pixel = 12.0 / (x1 - x0)
    page.click("paint-paste")
    page.drag([(x0 + (x1 - x0) * k / 30, y) for k in range(31)])
    page.wait(f"/kind: paste/.test(nuno.scene.text.value) && {DONE}")
    covered, distance = begin(page)[0].resist[0] > 0.5, away(ends, (200, 320))
    near = CELL + pixel * 1e-3
    assert covered[distance < 4e-4 - near].all() and not covered[distance > 4e-4 + near].any()
    page.click("paint-dye")
    page.value("document.getElementById('paint-which').value = 'weld'")
    ends = [(2.0, 1.0), (2.0, 7.0)]
    (x, y0), (_, y1) = pixels(page, *ends)
    page.drag([(x, y0 + (y1 - y0) * k / 30) for k in range(31)])
    page.wait(f"/kind: stroke/.test(nuno.scene.text.value) && {DONE}")
    given = begin(page)[1][2, 0] > dry[2, 0]
    distance = away(ends, (200, 320))
    assert given[distance < 4e-4 - near].all() and not given[distance > 4e-4 + near].any()
    assert re.search(r"\{kind: stroke, dye: weld, points: \[\[[\d.]+ mm, ", page.value("nuno.scene.text.value"))
    for _ in range(2):
        page.press("z", control=True)
    page.wait(f"nuno.scene.text.value === {before!r} && {DONE}")


def test_the_picture_shows_the_cells_that_the_solver_has(page: Page, painting: Server) -> None:
    page.click("paint-paste")
    set_width(page, 2.0)
    ((x, y),) = pixels(page, (13.5, 8.0))
    bare = page.picture()[round(y), round(x)].astype(int)
    page.drag([(x, y)])
    page.wait(f"/kind: paste/.test(nuno.scene.text.value) && {DONE}")
    page.drag([(x - 200, y + 500)], "right")  # the brush's ring is elsewhere
    seen = page.picture()
    colour = seen[round(y), round(x)].astype(int)
    assert np.abs(colour - bare).sum() > 60 and colour[0] > colour[2] + 40  # the colour of paste


def test_arrows_and_enter_paint_without_a_mouse(page: Page, painting: Server) -> None:
    """From the middle a width to the right: half of a brush, put down and taken up."""
    page.click("paint-paste")
    set_width(page, 1.0)
    page.value("nuno.scene.cloth.paint.flat.at = null; document.getElementById('paint').focus()")
    page.press("Enter")
    for _ in range(8):
        page.value("""document.getElementById('paint').dispatchEvent(new KeyboardEvent('keydown',
            { key: 'ArrowRight', bubbles: true, cancelable: true }))""")
    page.press("Enter")
    page.wait(f"/kind: paste/.test(nuno.scene.text.value) && {DONE}")
    distance = away([(8.0, 5.0), (10.0, 5.0)], (200, 320))
    covered = begin(page)[0].resist[0] > 0.5
    assert covered[distance < 5e-4 - CELL].all() and not covered[distance > 5e-4 + CELL].any()
    page.press("Escape")
    page.wait("!nuno.scene.cloth.paint.on")


def test_a_stencil_is_put_by_a_click(page: Page, painting: Server) -> None:
    out = io.BytesIO()
    Image.fromarray(np.full((40, 80), 255, np.uint8)).save(out, "PNG")
    data = base64.b64encode(out.getvalue()).decode()
    page.click("paint-stencil")
    set_width(page, 4.0)
    page.value(f"""nuno.scene.cloth.paint.load(new File([Uint8Array.from(atob('{data}'), (c) => c.charCodeAt(0))],
        'mine.png', {{ type: 'image/png' }}))""")
    ((x, y),) = pixels(page, (8.0, 5.0))
    page.drag([(x, y)])
    page.wait(f"/drops-stencil.png/.test(nuno.scene.text.value) && {DONE}")
    resist = begin(page)[0].resist[0]
    rows, columns = np.nonzero(resist > 0.5)
    near = 2  # cells: a pixel of the screen, and a rim
    found = [columns.min(), columns.max() + 1, rows.min(), rows.max() + 1]
    assert np.abs(np.array(found) - [120, 200, 80, 120]).max() <= near
    assert resist.sum() == pytest.approx(80 * 40, rel=0.01)


def test_a_stroke_goes_into_the_run_that_goes_on_and_not_into_the_text(page: Page, painting: Server) -> None:
    before = page.value("nuno.scene.text.value")
    page.click("run-step")
    page.wait(
        "nuno.dock.now.state === 'paused' && /goes on/.test(document.getElementById('paint-said').textContent)",
        PATIENCE,
    )
    page.click("paint-dye")
    set_width(page, 1.0)
    page.drag(pixels(page, (2.0, 9.0), (8.0, 9.0), (14.0, 9.0)))
    page.wait("/supply.3/.test(document.querySelector('#toast p').textContent)")
    assert page.value("nuno.scene.text.value") == before
    page.click("stop")
    page.wait("document.querySelector('#run-said .rows') !== null", PATIENCE)
    with nuno.open("last") as recording:
        (event,) = [one for one in recording.events() if one.kind == "control" and "stroke" in str(one)]
    assert "width: 1 mm" in str(event)
    page.click("dismiss")


def test_a_dab_on_a_garment_is_where_the_solver_has_that_place_of_it(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A vertex that faces the eye is clicked on: its texture coordinates say which cells it is."""
    monkeypatch.chdir(tmp_path)
    loaded = scene_file.read(shipped.find("skirt-dyed"))
    text = shipped.find("skirt-dyed").read_text()
    resist = "    resist:\n      - {kind: shibori, pattern: {pattern: seigaiha, radius: 1.8 mm}}\n"
    assert resist in text
    Path("skirt.yaml").write_text(text.replace(resist, ""))
    fabric = see_objects(loaded)[1]
    with studio() as (_, server):
        paint(page, server, "skirt.yaml")
        page.click("paint-garment")
        page.wait("nuno.scene.cloth.paint.worn", PATIENCE)
        page.click("paint-paste")
        set_width(page, 0.7)
        # One that faces the eye, and whose own triangle is what its pixel shows.
        vertex = page.value("""(() => {
            const { stage } = nuno.scene.cloth, { x, faces } = stage.cloth, { eye } = stage.camera, axes = [0, 1, 2];
            const faced = (v) => {
              const d = axes.map((k) => eye[k] - x[3 * v + k]);
              return Math.abs(axes.reduce((sum, k) => sum + d[k] * stage.normals[3 * v + k], 0)) / Math.hypot(...d);
            };
            for (let v = 1200; v < x.length / 3; v++) {
              if (faced(v) < 0.9) continue;
              const at = stage.camera.project([...x.slice(3 * v, 3 * v + 3)]), hit = at && stage.pick(at.x, at.y);
              const shares = hit && [1 - hit.u - hit.v, hit.u, hit.v];
              if (shares?.some((share, k) => share > 0.97 && faces[3 * hit.face + k] === v)) return [v, at.x, at.y];
            } })()""")
        number, x, y = vertex
        left, top = page.value("(({ x, y }) => [x, y])(document.getElementById('cloth').getBoundingClientRect())")
        page.drag([(left + round(x), top + round(y))])
        page.wait(f"/kind: paste/.test(nuno.scene.text.value) && {DONE}")
        cells, _, _ = at_start(scenes.load(page.value("nuno.scene.text.value"), Path("skirt.yaml")))
        rows, columns = np.nonzero(cells.resist[0] > 0.5)
        assert fabric.corners is not None
        (uv,) = fabric.corners.points[fabric.corners.vertex == number]
        expected = uv * [36e-3, -7.2e-3] + [0.0, 7.2e-3]
        found = (np.array([columns.mean(), rows.mean()]) + 0.5) * cells.size
        pixel = 6e-5  # of the screen on the flat cloth, less than 3 mm on the skirt, which is 0.45 m for 7.2 mm of it
        assert np.abs(found - expected).max() < cells.size + pixel
        assert len(rows) * cells.size**2 == pytest.approx(np.pi * 0.35e-3**2, abs=np.pi * 0.7e-3 * cells.size)
