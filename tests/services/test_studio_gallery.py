"""The first page of `nuno studio`: how much it weighs, how soon it shows a picture, and how scenes are found in it."""

from __future__ import annotations

import json
import time

import pytest
from browser import Page
from studio_desk import FILE, NEEDS_BROWSER, look

from nuno.scene import shipped
from nuno.studio.desk import Desk
from nuno.studio.server import Server, page_files

MOST = 2_000_000
"""Bytes of all that the page may load, but for the view in 3-D."""
SOON = 2.0
"""How soon a warm studio shows its first picture [s]."""
VIEWER = ("gl.js", "stage.js", "surface.js", "math.js", "orbit.js", "scale.js", "link.js", "cloth.js", "cloth.css")
"""Files of the view in 3-D."""


def test_all_that_the_page_can_load_is_light(served: tuple[Desk, Server]) -> None:
    desk, server = served
    files = {name: len(body) for name, (_, body) in page_files().items() if name not in VIEWER}
    listed = desk.act({"do": "scenes"})
    told = {"schema": len(server.resources["schema"]({})[1]), "scenes": len(json.dumps(listed))}
    drawn = [one["name"] for one in listed["scenes"] if one["drawn"]]
    pictures = {name: desk.scenes.picture_of(name).stat().st_size for name in drawn}
    assert len(pictures) > 80 and {"main.js", "page.css", "form.js"} <= files.keys()
    assert sum(files.values()) + sum(told.values()) + sum(pictures.values()) <= MOST


WEIGHT = """
performance.getEntries().filter((one) => one.entryType === "resource" || one.entryType === "navigation")
  .map((one) => [one.name.split("/").at(-1), one.transferSize])
"""


@pytest.mark.full
@NEEDS_BROWSER
def test_what_the_page_loads_is_light_and_its_first_picture_comes_soon(page: Page, served: tuple[Desk, Server]) -> None:
    address = served[1].guard.address
    took = []
    for _ in range(3):  # the first warms what the browser keeps; the machine may have other work now and then
        page.open("about:blank")
        start = time.monotonic()
        page.open(address)
        page.wait("[...document.querySelectorAll('.cards img:not(.blank)')].some((one) => one.naturalWidth > 100)")
        took.append(time.monotonic() - start)
    assert min(took) <= SOON, took
    # All cards are looked at, and a scene is opened, which needs the schema.
    page.value("document.querySelectorAll('.cards img').forEach((one) => { one.loading = 'eager'; })")
    page.wait("[...document.querySelectorAll('.cards img')].every((one) => one.complete)")
    page.value(f"location.hash = '#scene={FILE}'")
    page.wait("document.getElementById('verdict')?.textContent")
    loaded = [(name, size) for name, size in page.value(WEIGHT) if name not in VIEWER]
    assert any(name == "schema" and size > 100_000 for name, size in loaded) and len(loaded) > 90
    assert sum(size for _, size in loaded) <= MOST


@pytest.mark.full
@NEEDS_BROWSER
def test_scenes_stand_under_headings_and_a_search_leaves_those_with_all_words(
    page: Page, served: tuple[Desk, Server]
) -> None:
    look(page, served[1], "", "document.querySelectorAll('.cards li').length > 5")
    heads = page.value("[...document.querySelectorAll('section')].map((one) => one.querySelectorAll('li').length)")
    assert sum(heads) == len(shipped.scenes()) + 1 and len(heads) == len(shipped.FOLDERS) + 2
    page.tap("#search")
    page.type("dye indigo")
    shown = "[...document.querySelectorAll('section:not([hidden]) li:not([hidden])')].map((li) => li.textContent)"
    found = page.value(shown)
    assert 0 < len(found) < 30 and all("dye" in one.lower() and "indigo" in one.lower() for one in found)
    page.type(" nosuchword")
    page.wait("!document.querySelector('.none').hidden")
    assert page.value(shown) == []
