"""Files dropped on the page of `nuno studio`: what it says of them, and what is made of them, in a browser."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from browser import Page
from studio_desk import FILE, NEEDS_BROWSER, look

import nuno
from nuno.python_api.fit import map_fits, tables
from nuno.scene import scene_file, shipped
from nuno.studio.desk import Desk
from nuno.studio.server import Server
from nuno_schemas.errors import BadInput

pytestmark = [pytest.mark.full, NEEDS_BROWSER]
PATIENCE = 300.0
"""The first run on a machine compiles kernels [s]."""
MOST_CLICKS = 5


PRESSED = """(() => {
  const { values, screen } = nuno.run.fit, { stage } = screen, { x, faces } = stage.cloth;
  let best = null;
  for (let f = 0; f < faces.length; f += 3) {
    const corners = [0, 1, 2].map((k) => faces[f + k]);
    const value = corners.reduce((sum, v) => sum + values.pressure[v] / 3, 0);
    if (value <= best?.value) continue;
    const at = stage.camera.project([0, 1, 2].map((k) => corners.reduce((sum, v) => sum + x[3 * v + k] / 3, 0)));
    if (at && at.y > 110 && stage.pick(at.x, at.y)?.face === f / 3) best = { value, corners, ...at };
  }
  return [best.corners, best.x, best.y]; })()"""
"""The corners of the triangle with the largest pressure of those whose middles are seen, and where its middle is."""


@pytest.fixture(autouse=True)
def empty(desk: Desk) -> None:
    """The desk's folder."""
    Path(FILE).unlink()


@pytest.fixture(autouse=True)
def opened(page: Page, served: tuple[Desk, Server]) -> None:
    look(page, served[1], "", "document.querySelectorAll('.cards li').length > 5")


def dropped(page: Page, *paths: Path) -> None:
    """Drop files, and wait until all are told of."""
    page.drop(*paths)
    for path in paths:
        page.wait(f"document.querySelector('.file[open][data-file=\"{path.name}\"] dl') !== null", PATIENCE)


def rows(page: Page, name: str) -> dict[str, str]:
    found = page.value(
        f"[...document.querySelectorAll('[data-file=\"{name}\"] dt')]"
        ".map((dt) => [dt.textContent, dt.nextElementSibling.textContent])"
    )
    return {str(key): str(value) for key, value in found}


def test_from_a_body_and_a_pattern_to_a_running_drape_in_few_clicks(
    page: Page, served: tuple[Desk, Server], shared_data: Path
) -> None:
    page.clicks = 0
    dropped(page, shared_data / "body-mean.obj")
    assert rows(page, "body-mean.obj")["triangles"] == "47,500"
    dropped(page, shared_data / "patterns" / "shirt.json")
    told = rows(page, "shirt.json")
    assert told["seams"].startswith("18, of") and told["panels"].startswith("8: ")
    # The body that was dropped is chosen already.
    assert page.value('document.querySelector(\'[data-file="shirt.json"] [name="body"]\').value') == "body-mean.obj"
    page.tap("[data-file='shirt.json'] [data-offer='wear'] button")
    page.wait("nuno.scene?.name === 'shirt-worn.yaml' && document.getElementById('verdict')?.textContent", PATIENCE)
    assert page.value("document.getElementById('verdict').textContent") == "No mistakes"
    page.tap("#run")
    page.wait("nuno.dock.now.state === 'running' && nuno.dock.now.frame >= 1", PATIENCE)
    assert page.clicks == 2 <= MOST_CLICKS
    page.click("stop")
    page.wait("nuno.dock.now.state === 'over'", PATIENCE)
    scene = scene_file.read(Path("shirt-worn.yaml")).scene
    assert [body.name for body in scene.bodies] == ["wearer"] and [one.name for one in scene.objects] == ["shirt"]


def test_from_a_dropped_pattern_and_body_to_the_fit_table_in_three_clicks(
    page: Page, served: tuple[Desk, Server], shared_data: Path
) -> None:
    """The table is that of nuno fit, the maps are of the last frame, and the value under the mouse is theirs there."""
    dropped(page, shared_data / "body-mean.obj")
    dropped(page, shared_data / "patterns" / "shirt.json")
    page.clicks = 0
    page.tap("[data-file='shirt.json'] [data-offer='wear'] button")
    page.wait("nuno.scene?.name === 'shirt-worn.yaml' && document.getElementById('verdict')?.textContent", PATIENCE)
    assert page.value("!document.getElementById('text').checkVisibility()")  # what a maker need not know
    page.tap("#run")
    page.wait("nuno.dock.now.state === 'over' && document.getElementById('to-fit') !== null", 2 * PATIENCE)
    page.tap("#to-fit")
    page.wait("Boolean(nuno.run?.fit?.values)", PATIENCE)
    assert page.clicks == 3
    with nuno.open("last") as recording:
        ((fit, over),) = map_fits(recording)
        last = [frame.x for frame in recording.frames()][-1]
    shown = page.value(
        "[...document.querySelectorAll('#fit tr')].map((r) => [...r.children].map((c) => c.textContent))"
    )
    assert shown == [row for rows in tables(fit) for row in rows] and shown[1][0] == "bust"
    assert page.value("[...nuno.run.fit.values.pressure]") == pytest.approx(over.pressure, rel=2e-3, abs=1e-3)
    assert page.value("[...nuno.run.fit.values.stretch]") == pytest.approx(100.0 * over.strain, rel=2e-3, abs=1e-3)
    x = np.array(page.value("[...nuno.run.screen.stage.cloth.x]")).reshape(-1, 3)
    assert np.allclose(x + page.value("nuno.run.screen.frame.origin"), last, atol=1e-5)
    page.click("map-pressure")
    corners, x, y = page.value(PRESSED)
    left, top = page.value("(({x, y}) => [x, y])(document.getElementById('film').getBoundingClientRect())")
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=left + x, y=top + y)
    page.wait("!document.querySelector('.below-mouse').hidden")
    value, unit = page.value("document.querySelector('.below-mouse').textContent").split()
    assert unit == "Pa" and float(value) == pytest.approx(over.pressure[corners].mean(), rel=0.05)
    ticks = page.value("[...document.querySelectorAll('#map-scale b')].map((one) => Number(one.textContent))")
    assert len(ticks) > 2 and np.allclose(np.diff(ticks), ticks[1] - ticks[0]) and ticks[-1] <= over.pressure.max()
    # An edge of the flat pattern is picked there, and marked on the garment.
    panel = json.loads((shared_data / "patterns" / "shirt.json").read_text())["pattern"]["panels"]["left_ftorso"]
    ends = [panel["vertices"][i] for i in panel["edges"][1]["endpoints"]]
    pink = [(page.picture().astype(int)[..., 0] - page.picture()[..., 1] > 120).sum()]
    page.value("document.querySelector('[aria-label=\"left_ftorso, edge 1\"]').dispatchEvent(new Event('click'))")
    page.wait("!nuno.run.screen.stage.asked")
    said = page.value("document.querySelector('.panels + p').textContent").split()
    assert (
        float(said[4]) == pytest.approx(math.dist(*ends), abs=0.06) and abs(float(said[7]) / float(said[4]) - 1.0) < 0.1
    )
    pink.append((page.picture().astype(int)[..., 0] - page.picture()[..., 1] > 120).sum())
    assert pink[1] > pink[0] + 60
    # Nothing of it goes on, and a body that is not there is said.
    assert served[0].act({"do": "fit", "recording": page.value("nuno.run.name")})["garments"][0]["name"] == "shirt"
    with pytest.raises(BadInput, match="no such body"):
        served[0].act({"do": "fit", "recording": page.value("nuno.run.name"), "body": "nobody"})


def test_files_are_added_by_keyboard_and_what_is_none_is_refused(
    page: Page, served: tuple[Desk, Server], tmp_path: Path
) -> None:
    away = tmp_path / "away"
    away.mkdir()
    draft, wrong, other = (away / name for name in ("mine.wif", "wrong.obj", "notes.txt"))
    shutil.copyfile(shipped.folder() / "dye" / "draft.wif", draft)
    wrong.write_text("nothing")
    other.write_text("a")
    page.value("document.getElementById('chosen').click = () => { window.asked = true; }")
    page.value("document.getElementById('add-file').focus()")
    page.press("Enter")
    page.wait("window.asked")
    page.choose_files("#chosen", draft)
    page.wait("document.querySelector('.file[open][data-file=\"mine.wif\"] img')?.naturalWidth > 100", PATIENCE)
    assert rows(page, "mine.wif")["shafts"] == "4"
    for path, said in ((wrong, "The mesh has no triangles."), (other, "Nuno reads no files of this kind.")):
        page.drop(path)
        page.wait(f"document.querySelector('#toast b').textContent === {said!r}")
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["mine.wif"]
    page.value("document.querySelector('[data-offer=\"weave\"] button').focus()")
    page.press("Enter")
    page.wait("nuno.scene?.name === 'mine-woven.yaml' && document.getElementById('verdict')?.textContent", PATIENCE)
    assert page.value("document.getElementById('verdict').textContent") == "No mistakes"
