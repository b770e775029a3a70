"""What people do to the page of `nuno studio` who are in a hurry: nothing is lost, covered or changed by itself."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest
from browser import Page
from studio_desk import FILE, NEEDS_BROWSER, SHEET, look, look_at_scene

from nuno.studio.desk import Desk
from nuno.studio.server import Server

pytestmark = [pytest.mark.full, NEEDS_BROWSER]
PATIENCE = 300.0
"""The first run on a machine compiles kernels [s]."""
SHIRT = "sewn/shirt"
FABRICS = ("canvas", "chiffon", "denim", "leather", "linen", "polyester", "silk")
EDGE = "objects[0].model.edge"
LIST = "document.getElementById('text').value"
VIEW = "nuno.scene.cloth"
CHECKED = "document.getElementById('verdict')?.textContent"


def size(page: Page, width: int) -> None:
    page.call("Emulation.setDeviceMetricsOverride", width=width, height=820, deviceScaleFactor=1, mobile=False)


def focus(page: Page, name: str) -> None:
    page.value(f"document.getElementById({name!r}).focus()")


def write(page: Page, name: str, text: str) -> None:
    """Type over what stands in an input."""
    focus(page, name)
    page.value("document.activeElement.select()")
    page.type(text)


def rewrite(page: Page, text: str) -> None:
    """Type another text over the scene's."""
    page.value("nuno.scene.side('text')")
    page.value("(t => { t.focus(); t.setSelectionRange(0, 1e6); })(document.getElementById('text'))")
    page.type(text)
    page.wait(f"{LIST} === {text!r} && nuno.scene.checked === {LIST}")


def choose(page: Page, name: str, value: str) -> None:
    page.value(
        f"(() => {{ const s = document.getElementById({name!r}); s.value = {value!r}; "
        "s.dispatchEvent(new Event('change', { bubbles: true })); })()"
    )


def test_fabrics_are_clicked_while_fine_cloth_is_built_and_all_else_is_answered(
    page: Page, served: tuple[Desk, Server]
) -> None:
    desk, server = served
    look_at_scene(page, server, SHIRT)
    rewrite(page, page.value(LIST).replace("edge: 2 cm", "edge: 1 mm"))
    page.wait(f"{VIEW}.building !== null && {VIEW}.building !== undefined")
    for fabric in FABRICS:
        choose(page, "field:objects[0].model.fabric", fabric)
        page.wait(f"{LIST}.includes('fabric: {fabric}')")
        page.wait(f"{VIEW}.wanted?.includes('fabric: {fabric}')")
        start = time.monotonic()
        alive = "Promise.all([...Array(6)].map(() => fetch('schema'))).then((all) => all.every((one) => one.ok))"
        assert page.value(alive) and time.monotonic() - start < 10.0
    page.wait("document.getElementById('cloth-said').textContent === 'Building the cloth …'")
    page.value("document.getElementById('save').click()")
    page.wait("document.getElementById('asked').open")
    write(page, "asked-input", "fine")
    page.press("Enter")
    page.wait("location.hash === '#scene=fine.yaml'")
    page.wait("nuno.scene?.name === 'fine.yaml'", PATIENCE)
    page.value("location.hash = '#scenes'")
    page.wait("document.querySelectorAll('.cards li').length > 5")
    start = time.monotonic()
    desk.act({"do": "see", "scene": FILE, "text": SHEET, "page": "another"})
    page.open("about:blank")
    assert time.monotonic() - start < 30.0  # what nobody waits for any more is not built


def test_a_field_keeps_what_was_typed_or_says_what_is_wrong_there(page: Page, served: tuple[Desk, Server]) -> None:
    look_at_scene(page, served[1], SHIRT)
    field, slide = f"field:{EDGE}", f"slide:field:{EDGE}"
    unit = f"document.getElementById('{field}').parentElement.querySelector('.unit').hidden"
    assert page.value(unit)  # 2 cm has its own
    for text, mistakes in (("3 cm", 0), ("3", 1), ("-1", 1), ("0.0123", 0), ("27.5 mm", 0)):
        write(page, field, text)
        assert page.value(unit) == ("m" in text)
        page.press("Tab")  # onto the slider, before the text has it
        page.wait(f"{LIST}.includes('edge: {text},') && nuno.scene.checked === {LIST}")
        time.sleep(0.8)  # nothing comes after it
        assert page.value("document.activeElement.id") == slide
        assert page.value(f"document.getElementById('{field}').value") == text
        assert page.value(f"{LIST}.includes('edge: {text},')")
        assert page.value(f"document.querySelectorAll('[data-path=\"{EDGE}\"] .mistake').length") == mistakes
    page.press("Home")
    page.wait(f"{LIST}.includes('edge: 1 mm')")
    write(page, "field:objects[0].name", "")
    page.press("Tab")
    page.wait("document.querySelector('[data-path=\"objects[0].name\"] .refused') !== null")


def test_a_colours_name_stays_and_what_is_typed_while_the_text_is_checked(
    page: Page, served: tuple[Desk, Server]
) -> None:
    Path(FILE).write_text(SHEET.replace("name: cloth ", "name: cloth\n    colour: red "))
    look_at_scene(page, served[1])
    write(page, "field:objects[0].colour", "steelblue")
    page.press("Tab")
    page.wait(f"{LIST}.includes('colour: steelblue')")
    time.sleep(0.8)
    assert page.value(f"{LIST}.includes('colour: steelblue')")
    page.value("(t => { t.focus(); t.setSelectionRange(0, 0); })(document.getElementById('text'))")
    page.type("# mine\n")
    write(page, "field:damping", "0.75")
    page.wait(f"{LIST}.includes('# mine') && {LIST}.includes('damping: 0.75 ')")


def test_a_scene_is_saved_under_another_name_and_a_refused_one_stays_in_the_box(
    page: Page, served: tuple[Desk, Server]
) -> None:
    Path("other.yaml").write_text(SHEET)
    look_at_scene(page, served[1])
    rewrite(page, SHEET.replace("0.5 ", "0.6 "))
    page.click("save-as")
    for name, word in (("my sheet", "letters"), ("other.yaml", "there already"), ("other", "there already")):
        write(page, "asked-input", name)
        page.press("Enter")
        page.wait("!document.getElementById('asked-yes').disabled")
        page.wait(f"document.getElementById('asked-said').textContent.includes({word!r})")
        assert page.value("document.getElementById('asked').open")
        assert page.value("document.getElementById('asked-input').value") == name
    write(page, "asked-input", "mine")
    page.press("Enter")
    page.wait(f"nuno.scene?.name === 'mine.yaml' && {CHECKED}")
    assert Path("mine.yaml").read_text() == SHEET.replace("0.5 ", "0.6 ").replace("name: sheet", "name: mine")
    assert Path(FILE).read_text() == SHEET


def test_the_text_is_kept_where_the_server_has_gone(page: Page, served: tuple[Desk, Server], tmp_path: Path) -> None:
    server = served[1]
    page.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path / "kept"))
    look_at_scene(page, server)
    rewrite(page, text := SHEET.replace("0.5 ", "0.6 "))
    server.guard = type(server.guard)(server.guard.port)  # as one that was started anew at the same port
    page.press("s", control=True)
    page.wait("document.getElementById('asked').open")
    page.press("Tab")
    page.press("Enter")
    kept = tmp_path / "kept" / FILE
    end = time.monotonic() + 20.0
    while not kept.is_file() and time.monotonic() < end:
        time.sleep(0.05)
    assert kept.read_text() == text
    look(page, server, "", "document.querySelectorAll('.cards li').length > 5")
    page.drop(kept)
    page.wait("document.querySelector('.file[data-file=\"sheet-2.yaml\"] .offer') !== null", PATIENCE)
    assert Path("sheet-2.yaml").read_text() == text
    page.said.clear()  # what was refused with 403


def test_a_scene_is_left_as_it_was_saved_given_up_or_not_at_all(page: Page, served: tuple[Desk, Server]) -> None:
    look(page, served[1], "", "document.querySelectorAll('.cards li').length > 5")
    page.value(f"location.hash = '#scene={FILE}'")
    page.wait(f"nuno.scene?.name === '{FILE}' && {CHECKED}")
    rewrite(page, first := SHEET.replace("0.5 ", "0.6 "))
    for leave in ("history.back()", "location.hash = '#runs'"):
        page.value(leave)
        page.wait("document.getElementById('asked').open")
        assert page.value("document.querySelector('#asked .main').textContent") == "Save"
        page.press("Escape")
        page.wait(f"!document.getElementById('asked').open && location.hash === '#scene={FILE}'")
        time.sleep(0.5)
        assert not page.value("document.getElementById('asked').open")
        assert page.value(LIST) == first
    page.value("history.back()")
    page.wait("document.getElementById('asked').open")
    page.click("asked-yes")
    page.wait("location.hash !== '#scene=" + FILE + "' && document.querySelectorAll('.cards li').length > 5")
    assert Path(FILE).read_text() == first
    page.value("history.forward()")
    page.wait(f"nuno.scene?.name === '{FILE}' && {CHECKED}")
    rewrite(page, SHEET)
    page.value("location.hash = '#runs'")
    page.wait("document.getElementById('asked').open")
    page.click("asked-other")
    page.wait("document.querySelector('h1')?.textContent === 'Runs'")
    assert Path(FILE).read_text() == first


def test_files_that_are_refused_are_told_together_and_late_ones_take_nobody_away(
    page: Page, served: tuple[Desk, Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = tmp_path / "away"
    away.mkdir()
    (away / "good.yaml").write_text(SHEET)
    for name in ("one.obj", "two.obj"):
        (away / name).write_text("nothing")
    look(page, served[1], "", "document.querySelectorAll('.cards li').length > 5")
    page.drop(away / "one.obj", away / "good.yaml", away / "two.obj")
    page.wait(
        "location.hash === '#files' && document.querySelector('.file[data-file=\"good.yaml\"]') !== null", PATIENCE
    )
    page.wait("!document.getElementById('toast').hidden")
    time.sleep(1.0)
    said = page.value("document.getElementById('toast').textContent")
    assert "2 files were not taken" in said and "one.obj: the mesh" in said and "two.obj: the mesh" in said
    free, take = threading.Event(), served[0].files._look_alone

    def late(path: Path) -> object:
        free.wait(30.0)
        return take(path)

    monkeypatch.setattr(served[0].files, "_look_alone", late)
    page.value("location.hash = '#scenes'")
    page.wait("document.querySelectorAll('.cards li').length > 5")
    (away / "late.yaml").write_text(SHEET)
    page.drop(away / "late.yaml")
    page.wait("/Looking at late.yaml, .* [1-9] s/.test(document.getElementById('sending-name').textContent)")
    focus(page, "search")
    page.press("a")
    free.set()
    page.wait("document.querySelector('#toast b').textContent === 'Added: late.yaml'")
    assert page.value("location.hash") == "#scenes"


def test_nothing_jumps_or_is_covered_while_a_run_goes_on(page: Page, served: tuple[Desk, Server]) -> None:
    Path(FILE).write_text(SHEET.replace("0.4 s", "400 s"))
    look_at_scene(page, served[1])
    page.click("run")
    page.wait("nuno.dock.now.state === 'running' && nuno.dock.now.factor", PATIENCE)
    page.value("import('./say.js').then(({ toast }) => toast('Saved', 'as it is', true))")
    page.wait("!document.getElementById('toast').hidden")
    for width in (500, 800, 1400):
        size(page, width)
        heights = set()
        for _ in range(8):
            heights.add(page.value("document.getElementById('view').clientHeight"))
            time.sleep(0.1)
        assert len(heights) == 1, width
        boxes = "(id => document.getElementById(id).getBoundingClientRect())"
        assert page.value(f"{boxes}('toast').bottom <= {boxes}('dock').top")
        for part in ("run-time", "stop"):
            assert page.value(f"{boxes}('{part}').right") <= width
    size(page, 800)
    page.tap("#side-form")  # and the mouse stays over it
    style = "(({color, backgroundColor}) => [color, backgroundColor])(getComputedStyle(document.getElementById('%s')))"
    assert page.value(style % "side-form") == page.value(style % "run")
    size(page, 1300)
    page.click("stop")
    page.wait("nuno.dock.now.state === 'over'", PATIENCE)
    page.click("dismiss")


def test_a_search_counts_what_it_finds_and_a_scene_has_the_focus_once_opened(
    page: Page, served: tuple[Desk, Server]
) -> None:
    look(page, served[1], "", "document.querySelectorAll('.cards li').length > 5")
    write(page, "search", "skirt")
    counted = (
        "[...document.querySelectorAll('#view section:not([hidden])')].every((one) => "
        "Number(one.querySelector('h2 span').textContent) === one.querySelectorAll('li:not([hidden])').length)"
    )
    page.wait(f"document.querySelectorAll('#view section[hidden]').length > 1 && {counted}")
    page.press("Tab")
    page.press("Enter")
    page.wait(f"nuno.scene && {CHECKED}")
    page.wait("document.activeElement === document.getElementById('view')")


def test_the_wheel_comes_nearer_to_what_is_below_the_mouse(page: Page, served: tuple[Desk, Server]) -> None:
    look_at_scene(page, served[1], "drape-over-sphere")
    page.wait(f"Boolean({VIEW}?.frame)", PATIENCE)
    stage = f"{VIEW}.stage"
    left, top = page.value("(({x, y}) => [x, y])(document.getElementById('cloth').getBoundingClientRect())")
    for x, y in ((120, 300), (260, 420)):
        point = page.value(f"{stage}.point({x}, {y})")
        before = page.value(f"{stage}.camera.distance")
        page.call("Input.dispatchMouseEvent", type="mouseWheel", x=left + x, y=top + y, deltaX=0, deltaY=-200)
        page.wait(f"{stage}.camera.distance < {before}")
        seen = page.value(f"{stage}.camera.project({point})")
        assert (seen["x"], seen["y"]) == pytest.approx((x, y), abs=0.01)
