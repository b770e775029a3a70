"""Tables of a page are within reach: in a window of any width, and on paper."""

from __future__ import annotations

from pathlib import Path

import pytest
from browser import Page
from studio_desk import NEEDS_BROWSER

from nuno_bench.report import page

pytestmark = [pytest.mark.full, NEEDS_BROWSER]

POINTS = page.Table(
    ("solver", "setting", "outcome", "time [s]", *(f"quantity {i}" for i in range(8))),
    [["symplectic_euler", "dt 0.6897 ms, 0.0968 of limit", "done", "0.00275", *["1.43e-08"] * 8]] * 4,
    "numbers",
)
REACH = """(() => {
  const boxes = [...document.querySelectorAll('.wide')].map(box => box.getBoundingClientRect());
  const cells = [...document.querySelectorAll('td, th')].map(cell => cell.getBoundingClientRect());
  return {
    page: document.documentElement.scrollWidth,
    left: Math.min(...boxes.map(box => box.left)), right: Math.max(...boxes.map(box => box.right)),
    cells: Math.max(...cells.map(cell => cell.right)),
    scrolls: [...document.querySelectorAll('.wide')].every(box => getComputedStyle(box).overflowX == 'auto'),
  };
})()"""
PAPER = 210 - 2 * 18
"""Width of a page of A4 inside its margins [mm]."""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    path: Path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(page.render("t", "l", [("", [POINTS])]))
    return path.as_uri()


@pytest.mark.parametrize(("width", "whole"), [(1300, True), (700, False), (400, False)])
def test_a_wide_table_takes_the_window_and_scrolls_beyond_it(
    tmp_path: Path, address: str, width: int, whole: bool
) -> None:
    with Page(tmp_path, width, 800) as browser:
        browser.open(address)
        browser.wait("document.readyState == 'complete' && document.querySelector('table') != null")
        found = browser.value(REACH)
    assert found["page"] <= width and found["left"] >= 0 and found["right"] <= width
    assert found["scrolls"] and (found["cells"] <= found["right"] + 1) == whole


def test_no_column_runs_off_the_paper(tmp_path: Path, address: str) -> None:
    width = round(PAPER / 25.4 * 96)
    with Page(tmp_path, width, 800) as browser:
        browser.call("Emulation.setEmulatedMedia", media="print")
        browser.open(address)
        browser.wait("document.readyState == 'complete' && document.querySelector('table') != null")
        found = browser.value(REACH)
    assert found["page"] <= width and found["cells"] <= width + 1
