"""Drawing a weave in the studio, in a browser: what is drawn by mouse and keys is the weave of the saved draft."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import Page
from studio_desk import NEEDS_BROWSER, look, studio

from nuno.scene import shipped
from nuno.studio.files import MOST_YARNS
from nuno.studio.server import Server
from nuno_dye.weaving_drafts.weaves import draw_plain, draw_satin, draw_twill
from nuno_dye.weaving_drafts.wif import find_loom, read_wif
from nuno_schemas.fabric import Bool

pytestmark = [pytest.mark.full, NEEDS_BROWSER]
SCENE = "drops.yaml"
DRAWN = "Boolean(document.getElementById('weave-place')?.textContent)"

PICTURED = """(() => {
  const image = document.querySelector('#weave-saved img');
  if (!image?.complete || !image.naturalWidth) return null;
  const { naturalWidth: width, naturalHeight: height } = image;
  const pen = Object.assign(document.createElement('canvas'), { width, height }).getContext('2d');
  pen.drawImage(image, 0, 0);
  return pen.getImageData(0, 0, width, height).data.reduce((sum, value, i) => (31 * sum + value) % 1000003, 1);
})()"""
"""A checksum of the pixels of the saved draft's picture."""


def begin(page: Page, server: Server, place: str = "#weave") -> None:
    """Open the grid anew; what is not saved is lost."""
    page.value("if (window.nuno?.scene?.rows) nuno.scene.saved = String(nuno.scene.rows)")
    look(page, server, place, DRAWN)


@pytest.fixture
def weaving(page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """The grid, in a folder with a draft and a scene of one's own."""
    monkeypatch.chdir(tmp_path)
    Path(SCENE).write_text(shipped.find("dye/drops").read_text())
    Path("rosepath.wif").write_bytes((shipped.folder() / "dye" / "draft.wif").read_bytes())
    with studio() as (_, server):
        begin(page, server)
        yield server
        page.value("if (window.nuno?.scene?.rows) nuno.scene.saved = String(nuno.scene.rows)")


def rows(page: Page) -> Bool:
    return np.array(page.value("nuno.scene.rows"), bool)


def start(page: Page, value: str) -> None:
    page.value(f"""(() => {{ const one = document.getElementById('weave-start'); one.value = {value!r};
        one.dispatchEvent(new Event('change')); }})()""")


def place(page: Page, end: int, pick: int) -> tuple[float, float]:
    """Where the middle of a crossing, numbered from 0, is on the screen."""
    x, y = page.value("(({ x, y }) => [x, y])(document.getElementById('weave-grid').getBoundingClientRect())")
    side, rim = page.value("nuno.scene.side"), 26
    return x + rim + side * (end + 0.5), y + rim + side * (pick + 0.5)


def save(page: Page, name: str) -> None:
    page.click("weave-save")
    page.wait("document.getElementById('asked').open")
    page.value(f"document.getElementById('asked-input').value = {name!r}")
    page.click("asked-yes")


def facts(page: Page) -> dict[str, str]:
    found = page.value(
        "[...document.querySelectorAll('#weave-facts dt')].map((dt) => [dt.textContent, dt.nextSibling.textContent])"
    )
    return dict(found)


def test_starts_are_the_weaves_of_scenes_in_whole_repeats(page: Page, weaving: Server) -> None:
    for value, repeat, size in (
        ("0", draw_plain(), 8), ("1", draw_twill(2, 2), 8), ("2", draw_satin(5, 2), 10), ("1", draw_twill(2, 2), 12),
    ):  # fmt: skip
        start(page, value)
        n = size // len(repeat)
        assert np.array_equal(rows(page), np.tile(repeat, (n, n)))
    start(page, "rosepath.wif")
    page.wait("nuno.scene.rows.length === 8")
    assert np.array_equal(rows(page), read_wif(Path("rosepath.wif")).drawdown)
    weaves = [({"plugin": "twill", "over": over, "under": under, "direction": side}, draw_twill(over, under, side))
              for over, under in ((1, 3), (3, 2)) for side in ("right", "left")]  # fmt: skip
    weaves += [({"plugin": "satin", "ends": 8, "step": 3, "face": face}, draw_satin(8, 3, face))
               for face in ("warp", "weft")]  # fmt: skip
    page.value("import('./drawdown.js').then((one) => { window.lines = one; })")
    page.wait("window.lines")
    for config, expected in weaves:
        assert page.value(f"lines.drawdownOf({json.dumps(config)})") == expected.astype(int).tolist()


def test_a_drag_sets_what_a_click_turns_over_and_undo_brings_it_back(page: Page, weaving: Server) -> None:
    """Fast drags, whose events are crossings apart, leave none out."""
    before = rows(page)
    page.drag([place(page, 3, 2)])
    clicked = before.copy()
    clicked[2, 3] ^= True
    assert np.array_equal(rows(page), clicked)
    value = not clicked[1, 1]
    page.drag([place(page, 1, 1), place(page, 6, 6), place(page, 6, 1)])
    dragged = clicked.copy()
    for k in range(1, 7):
        dragged[k, k] = dragged[k, 6] = value
    assert np.array_equal(rows(page), dragged)
    assert page.value("document.getElementById('weave-unsaved').textContent") == "not saved"
    page.press("z", control=True)
    assert np.array_equal(rows(page), clicked)
    page.click("weave-undo")
    assert np.array_equal(rows(page), before)
    page.click("weave-redo")
    assert np.array_equal(rows(page), clicked)


def test_a_drag_may_leave_the_grid_and_come_back(page: Page, weaving: Server) -> None:
    before = rows(page)
    page.drag([place(page, 6, 0), place(page, 9, 0), place(page, 9, 3), place(page, 7, 3)])
    expected = before.copy()
    expected[0, 6:] = expected[3, 7] = not before[0, 6]
    assert np.array_equal(rows(page), expected)
    assert page.value("nuno.scene.past.length") == 1


def test_keys_move_turn_over_and_carry_on(page: Page, weaving: Server) -> None:
    def arrow(key: str, shift: bool = False) -> None:
        page.value(f"""document.getElementById('weave-grid').dispatchEvent(new KeyboardEvent('keydown',
            {{ key: '{key}', shiftKey: {str(shift).lower()}, bubbles: true, cancelable: true }}))""")

    expected = rows(page)
    for key in ("ArrowRight", "ArrowRight", "ArrowDown", " "):
        arrow(key)
    expected[1, 2] ^= True
    for _ in range(20):  # also against the edge
        arrow("ArrowRight", shift=True)
    expected[1, 2:] = expected[1, 2]
    assert np.array_equal(rows(page), expected)
    page.wait("document.getElementById('weave-place').textContent.startsWith('end 8, pick 2: ')")
    page.value(f"nuno.scene.put(Array.from({{ length: {MOST_YARNS} }}, () => Array({MOST_YARNS}).fill(1)))")
    for end, pick, key in ((99, 99, "ArrowDown"), (99, 0, "ArrowUp"), (0, 0, "ArrowLeft")):
        for _ in range(MOST_YARNS):
            arrow(key)
            arrow("ArrowRight" if end else key)
        page.wait("!nuno.scene.asked && !nuno.scene.led")
        x, y = place(page, end, pick)
        assert page.value(f"document.elementFromPoint({x}, {y})?.id") == "weave-grid"


def test_sizes_go_on_with_the_repeat_and_stay_within_limits(page: Page, weaving: Server) -> None:
    start(page, "1")
    for which, typed, shape in (
        ("ends", 11, (8, 11)), ("picks", 5, (5, 11)), ("ends", 5000, (5, MOST_YARNS)), ("picks", 0, (1, MOST_YARNS)),
    ):  # fmt: skip
        page.value(f"""(() => {{ const one = document.getElementById('weave-{which}'); one.value = {typed};
            one.dispatchEvent(new Event('change')); }})()""")
        found = rows(page)
        assert found.shape == shape
        if min(shape) > 1 and max(shape) < 12:
            assert np.array_equal(found, np.tile(draw_twill(2, 2), (3, 3))[: shape[0], : shape[1]])


def longest(lines: Bool, value: bool, what: str) -> str:
    """The longest run of a value, by trying all starts and lengths."""
    best = 0
    for line in lines:
        if (line == value).all():
            return f"all {what}s"
        n = len(line)
        for first, length in itertools.product(range(n), range(1, n)):
            if (np.roll(line, -first)[:length] == value).all():
                best = max(best, length)
    return f"{best} {what}{'' if best == 1 else 's'}"


def test_facts_are_those_of_the_loom_and_of_the_cloth_without_end(page: Page, weaving: Server) -> None:
    rng = np.random.default_rng(3)
    for picks, ends in ((4, 7), (6, 6), (1, 5), (12, 3), (32, 9), (33, 9)):
        drawn = rng.random((picks, ends)) < 0.5
        if picks > 12:
            drawn = np.array([[pick >> bit & 1 for bit in range(ends)] for pick in range(1, picks + 1)], bool)
        page.value(f"nuno.scene.put({json.dumps(drawn.astype(int).tolist())})")
        loom, told = find_loom(drawn), facts(page)
        assert told["shafts"] == str(loom.threading.shape[1])
        if loom.tie_up is None:
            assert told["treadles"].startswith("a lift plan")
        else:
            assert told["treadles"] == str(len(loom.tie_up))
        warp, weft = told["longest warp float"], told["longest weft float"]
        assert warp == f"over {longest(drawn.T, True, 'pick')}, under {longest(drawn.T, False, 'pick')}"
        assert weft == f"over {longest(drawn, False, 'end')}, under {longest(drawn, True, 'end')}"


def test_the_cloth_shows_the_repeat_again_and_again(page: Page, weaving: Server) -> None:
    """In the middle of each crossing the colour of the yarn above, dark for the warp."""
    start(page, "rosepath.wif")
    page.wait("nuno.scene.rows.length === 8")
    page.wait("new Promise((then) => requestAnimationFrame(() => requestAnimationFrame(() => then(true))))")
    box = page.value("(({ x, y }) => [x, y])(document.getElementById('weave-cloth').getBoundingClientRect())")
    seen, side = page.picture().mean(axis=2), 14
    drawdown = np.tile(read_wif(Path("rosepath.wif")).drawdown, (3, 3))
    for pick, end in itertools.product(range(1, 24), repeat=2):
        dark = seen[round(box[1] + side * (pick + 0.3)), round(box[0] + side * (end + 0.3))] < 128
        assert dark == drawdown[pick, end]


def test_a_saved_weave_is_saved_over_and_read_back_as_drawn(page: Page, weaving: Server) -> None:
    page.drag([place(page, 0, 1), place(page, 5, 6)])
    save(page, "mine")
    page.wait("document.querySelector('#weave-saved img')?.naturalWidth > 100")
    drawn = rows(page)
    assert np.array_equal(read_wif(Path("mine.wif")).drawdown, drawn)
    assert page.value("document.getElementById('weave-save').disabled && !nuno.scene.unsaved")
    pictured = page.wait(PICTURED)
    page.drag([place(page, 7, 0)])
    page.press("s", control=True)
    page.wait("!nuno.scene.unsaved")
    page.wait(f"(({PICTURED}) ?? {pictured}) !== {pictured}")  # the picture of the file as it is now
    assert np.array_equal(read_wif(Path("mine.wif")).drawdown, rows(page)) and not np.array_equal(rows(page), drawn)
    begin(page, weaving, "#weave=mine.wif")
    assert np.array_equal(read_wif(Path("mine.wif")).drawdown, rows(page))
    page.drag([place(page, 7, 7)])
    page.press("s", control=True)  # it held only the weave: no name is asked for
    page.wait("!nuno.scene.unsaved")
    assert np.array_equal(read_wif(Path("mine.wif")).drawdown, rows(page))


def test_a_taken_name_is_refused_in_the_box_and_another_taken(page: Page, weaving: Server) -> None:
    before = Path("rosepath.wif").read_bytes()
    begin(page, weaving, "#weave=rosepath.wif")
    save(page, "rosepath.wif")
    page.wait("/there already/.test(document.getElementById('asked-said').textContent)")
    page.value("document.getElementById('asked-input').value = 'other'")
    page.click("asked-yes")
    page.wait("document.querySelector('[data-file=\"other.wif\"]') !== null")
    assert Path("rosepath.wif").read_bytes() == before
    assert np.array_equal(read_wif(Path("other.wif")).drawdown, read_wif(Path("rosepath.wif")).drawdown)


def test_from_a_scene_and_back_into_it(page: Page, weaving: Server) -> None:
    """Its own weave is what is begun with; the draft is put into the text, which Undo takes out again."""
    look(page, weaving, f"#scene={SCENE}", "document.getElementById('verdict')?.textContent")
    before = page.value("nuno.scene.text.value")
    page.click("cloth-weave")
    page.wait(DRAWN)
    assert np.array_equal(rows(page), draw_twill(2, 1))
    start(page, "0")
    save(page, "plain")
    page.wait("document.getElementById('weave-into') !== null")
    page.click("weave-into")
    page.wait("/weave: {plugin: wif, file: plain.wif}/.test(nuno.scene?.text?.value)")
    page.wait("document.getElementById('verdict').textContent === 'No mistakes'")
    page.press("z", control=True)
    page.wait(f"nuno.scene.text.value === {before!r}")


def test_a_drawn_weave_is_not_left_unsaved_without_being_asked(page: Page, weaving: Server) -> None:
    page.drag([place(page, 0, 1)])
    drawn = rows(page)
    page.click("to-files")
    page.wait("document.getElementById('asked').open")
    page.click("asked-no")
    page.wait("location.hash === '#weave'")
    assert np.array_equal(rows(page), drawn)
    page.click("to-files")
    page.wait("document.getElementById('asked').open")
    page.click("asked-other")
    page.wait("document.getElementById('draw-weave') !== null")
    page.tap("#draw-weave")
    page.wait(DRAWN)
    assert list(Path().glob("*.wif")) == [Path("rosepath.wif")]
