"""Files dropped on the page of `nuno studio`: what it says of them, and what is made of them, in a browser."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from browser import Page
from studio_desk import FILE, NEEDS_BROWSER, look

from nuno.scene import scene_file, shipped
from nuno.studio.desk import Desk
from nuno.studio.server import Server

pytestmark = [pytest.mark.full, NEEDS_BROWSER]
PATIENCE = 300.0
"""The first run on a machine compiles kernels [s]."""
MOST_CLICKS = 5


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
