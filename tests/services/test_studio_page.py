"""The page of nuno studio, in a browser: what a person does there by mouse and keyboard."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import Page
from studio_desk import FILE, NEEDS_BROWSER, SHEET, look, look_at_scene

import nuno
from nuno.plugin_contract import registry
from nuno.python_api.plan import describe
from nuno.report.run_report import lines
from nuno.scene import scene_file, shipped
from nuno.studio.desk import Desk, swatches
from nuno.studio.server import Server
from nuno_schemas.dyeing import PRESETS
from nuno_schemas.errors import BadInput

pytestmark = [pytest.mark.full, NEEDS_BROWSER]

PATIENCE = 300.0
"""The first run on a machine compiles kernels [s]."""
SOME = ("skirt-hula", "skirt-dyed", "bloom-skirt", "towel", "contact/knot", "dye/drops", "knit/stocking-leg",
        "sewn/outfit", "extreme/far-away", "instruments/drapemeter")  # fmt: skip
"""Of each folder one, and those that have most to say."""


def text(page: Page) -> str:
    return str(page.value("document.getElementById('text').value"))


def rows(page: Page, box: str) -> list[tuple[str, str]]:
    """Headings and texts that a list shows."""
    found = page.value(
        f"[...document.querySelectorAll('{box} dt')].map((dt) => [dt.textContent, dt.nextSibling.textContent])"
    )
    return [(name, said) for name, said in found]


def focus(page: Page, name: str) -> None:
    page.value(f"document.getElementById({name!r}).focus()")


def write(page: Page, field: str, value: str) -> None:
    """Type over what stands in a field."""
    focus(page, f"field:{field}")
    page.value("document.activeElement.select()")
    page.type(value)


def choose(page: Page, name: str, value: str) -> None:
    page.value(
        f"(() => {{ const s = document.getElementById({name!r}); s.focus(); s.value = {value!r}; "
        "s.dispatchEvent(new Event('change', { bubbles: true })); })()"
    )


def wait_text(page: Page, wanted: str) -> None:
    page.wait(f"document.getElementById('text').value === {wanted!r}")


def test_a_scene_is_found_and_opened_by_keyboard(page: Page, served: tuple[Desk, Server]) -> None:
    look(page, served[1], "", "document.querySelectorAll('.cards li').length > 5")
    focus(page, "search")
    page.type("small falls")
    page.wait("document.querySelectorAll('.cards li:not([hidden])').length === 1")
    page.press("Tab")
    page.press("Enter")
    page.wait(f"nuno.scene?.name === '{FILE}' && document.getElementById('verdict')?.textContent === 'No mistakes'")
    assert text(page) == SHEET


def test_the_form_changes_one_value_of_the_text_and_undo_takes_it_back(page: Page, served: tuple[Desk, Server]) -> None:
    look_at_scene(page, served[1])
    write(page, "damping", "0.75")
    wait_text(page, once := SHEET.replace("damping: 0.5 ", "damping: 0.75 "))
    choose(page, "field:objects[0].model.fabric", "jacket")
    wait_text(page, twice := once.replace("silk, pin", "jacket, pin"))
    choose(page, "field:objects[0].model", "swatch")
    wait_text(page, twice.replace("plugin: sheet", "plugin: swatch"))
    # The fields of the other plugin are there, and those that it does not know are told apart.
    page.wait("document.querySelector('.unknown[data-path=\"objects[0].model.resolution\"] .mistake') !== null")
    for _ in range(3):
        page.press("z", control=True)
    wait_text(page, SHEET)
    page.wait(
        "document.getElementById('field:damping').value === '0.5' && document.querySelectorAll('.mistake').length === 0"
    )
    page.click("all:")
    choose(page, "add:forces", "wind")
    wait_text(page, SHEET + "forces:\n  - {plugin: wind}\n")
    page.click("remove:forces[0]")
    wait_text(page, SHEET + "forces: []\n")
    write(page, "description", "")
    page.press("Enter")
    page.wait("!document.getElementById('text').value.includes('description')")


def test_the_text_changes_the_form_and_a_mistake_stands_at_its_field(page: Page, served: tuple[Desk, Server]) -> None:
    look_at_scene(page, served[1])
    page.value(
        "(() => { const t = document.getElementById('text'); t.focus(); t.setSelectionRange(0, t.value.length); })()"
    )
    page.type(wrong := SHEET.replace("0.5 ", "2 km ").replace("40 cm, 40 cm", "30 cm, 20 cm"))
    page.wait("document.querySelector('[data-path=\"damping\"] .mistake') !== null")
    assert page.value("document.getElementById('field:objects[0].model.size').value") == "[30 cm, 20 cm]"
    Path("wrong.yaml").write_text(wrong)
    with pytest.raises(BadInput) as refused:
        scene_file.read(Path("wrong.yaml"))
    said = page.value(
        "[...document.querySelectorAll('.mistake')].map((box) => [...box.children].map((p) => p.textContent))"
    )
    words = str(refused.value).replace("wrong.yaml", FILE).splitlines()
    assert len(said) == 1 and said[0] == [refused.value.problem, *map(str.strip, words[1:]), f"{FILE}:8: damping"]
    page.click("first")
    assert page.value(
        "document.getElementById('text').value.slice(document.getElementById('text').selectionStart)"
    ).startswith("damping")
    assert page.value("[...document.querySelectorAll('.gutter .wrong')].map((row) => row.textContent)") == ["8"]
    write(page, "damping", "2")
    page.wait("document.getElementById('verdict').textContent === 'No mistakes'")
    page.press("s", control=True)
    page.wait("document.getElementById('unsaved').textContent === ''")
    assert Path(FILE).read_text() == SHEET.replace("0.5 ", "2 ").replace("40 cm, 40 cm", "30 cm, 20 cm")


@pytest.mark.parametrize("name", SOME)
def test_the_form_knows_every_field_of_shipped_scenes(page: Page, served: tuple[Desk, Server], name: str) -> None:
    look_at_scene(page, served[1], name)
    assert page.value("document.getElementById('verdict').textContent") == "No mistakes"
    assert page.value("document.querySelectorAll('.unknown').length") == 0
    shown = set(page.value("[...document.querySelectorAll('[data-path]')].map((row) => row.dataset.path)"))
    data = scene_file.read(shipped.find(name)).data
    scalars = {path for path in _scalars(data, "") if path != "nuno"}
    # What a field takes as a number or a mapping stands on one line.
    lines_of = tuple(page.value("[...document.querySelectorAll('.control input')].map((one) => one.id.slice(6) + '.')"))
    assert {path for path in scalars if not path.startswith(lines_of)} <= shown


def _scalars(value: Any, path: str) -> Iterator[str]:
    """Paths of what is written as one value: numbers, texts, lists of these."""
    if isinstance(value, dict) and value:
        for key, one in value.items():
            yield from _scalars(one, f"{path}.{key}" if path else key)
    elif isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
        for i, one in enumerate(value):
            yield from _scalars(one, f"{path}[{i}]")
    elif path:
        yield path


def test_what_a_maker_chooses_stands_beside_the_cloth_and_all_else_behind_advanced(
    page: Page, served: tuple[Desk, Server]
) -> None:
    look(page, served[1], f"#scene={FILE}", "document.getElementById('verdict')?.textContent && nuno.scene.cloth.frame")
    width = "document.querySelector('%s').getBoundingClientRect().width"
    assert page.value(width % "#cloth") > 1.5 * page.value(width % ".maker")
    assert not page.value("document.getElementById('text').checkVisibility()")
    shown = page.value("[...document.querySelectorAll('.choices label')].map((one) => one.textContent)")
    assert shown == ["Garment", "Fabric", "Colour"]
    choose(page, "maker:field:objects[0].model.fabric", "jacket")
    wait_text(page, once := SHEET.replace("silk, pin", "jacket, pin"))
    # What is wrong with it stands there, as long as the form is not seen.
    page.value(f"nuno.scene.text.set({once.replace('jacket', 'jakcet')!r}); nuno.scene.typed()")
    page.wait("document.querySelectorAll('.choices .mistake').length === 1")
    page.tap("#advanced > summary")
    page.wait(f"{width % '#text'} > 200 && document.querySelectorAll('.choices .mistake').length === 0")
    assert page.value("document.querySelectorAll('.fields .mistake').length") == 1
    look(page, served[1], f"#scene={FILE}", "document.getElementById('verdict')?.textContent")
    assert page.value("document.getElementById('advanced').open")  # as it was left


def test_a_run_tells_how_long_it_goes_on(page: Page, served: tuple[Desk, Server]) -> None:
    """What is left of a preparation falls as time passes, and of a run by its speed."""
    look_at_scene(page, served[1])
    left = []
    for waited in (1, 30, 80):
        page.value(f"nuno.dock.show({{state: 'preparing', frame: -1, waited: {waited}, said: ''}})")
        first = "document.getElementById('run-first')"
        left.append(page.value(f"{first}.hidden ? null : {first}.textContent.match(/some (\\d+) s/)?.[1]"))
    assert left == [None, "90", "40"]
    page.value("nuno.dock.show({state: 'running', frame: 9, frames: 60, t: 1, end: 6, factor: 0.05, said: ''})")
    assert "100 s left" in page.value("document.getElementById('run-time').textContent")
    assert page.value("document.getElementById('run-first').hidden")


def test_a_scene_is_planned_run_paused_and_stopped(page: Page, served: tuple[Desk, Server]) -> None:
    Path(FILE).write_text(SHEET.replace("0.4 s", "400 s"))
    look_at_scene(page, served[1])
    page.click("plan")
    page.wait("document.querySelectorAll('#planned dt').length > 3", PATIENCE)
    expected = list(describe(scene_file.read(Path(FILE))))
    assert [row for row in rows(page, "#planned") if row[0] != "time"] == [row for row in expected if row[0] != "time"]
    focus(page, "text")
    page.press("Enter", control=True)
    page.wait("nuno.dock.now.state === 'running' && nuno.dock.now.factor", PATIENCE)
    page.wait("/real time/.test(document.getElementById('run-time').textContent)")
    page.click("pause")
    page.wait("nuno.dock.now.state === 'paused' && !document.getElementById('step').disabled")
    frame = page.value("nuno.dock.now.frame")
    page.click("step")
    page.wait(f"nuno.dock.now.state === 'paused' && nuno.dock.now.frame === {frame + 1}")
    page.click("pause")
    page.wait(f"nuno.dock.now.frame > {frame + 5}")
    page.click("stop")
    page.wait("document.querySelector('#run-said img')?.complete", PATIENCE)
    with nuno.open("last") as recording:
        report = recording.report()
    assert report["state"] == "stopped" and rows(page, "#run-said") == [(name, said) for name, said in lines(report)]
    assert page.value("document.querySelector('#run-said img').naturalWidth") > 100
    # First what a maker asks; that and the picture are one click away.
    assert [name for name, _ in rows(page, "#run-ends")] == ["Fits", "Crosses", "Took"]
    page.wait("document.querySelector('#run-ends dd').textContent.startsWith('The recording has no body')")
    assert page.value("document.getElementById('run-said').hidden && document.getElementById('to-fit').hidden")
    page.tap("#more")
    assert not page.value("document.getElementById('run-said').hidden")
    page.click("dismiss")


def test_a_recording_is_opened_verified_and_deleted_once_asked(page: Page, served: tuple[Desk, Server]) -> None:
    path = Path("recordings/one.mcap")
    path.parent.mkdir()
    nuno.run(FILE, record=path)
    look(page, served[1], "#runs", "document.querySelector('tbody a') !== null")
    assert page.value("[...document.querySelectorAll('tbody td')].slice(1, 6).map((td) => td.textContent)") == [
        "one.mcap", "sheet", "symplectic_euler", "done", "0.4 s"
    ]  # fmt: skip
    page.value("document.querySelector('tbody a').focus()")
    page.press("Enter")
    page.wait("document.querySelector('.shown img')?.naturalWidth > 100", PATIENCE)
    page.click("verify")
    page.wait("document.getElementById('verdict').textContent === 'equal to the last bit: 21 frames'", PATIENCE)
    focus(page, "delete")
    page.press("Enter")
    page.wait("document.getElementById('asked').open")
    page.press("Escape")
    page.wait("!document.getElementById('asked').open")
    assert path.is_file()
    page.click("delete")
    page.press("Tab")
    page.press("Enter")
    page.wait("location.hash === '#runs' && document.querySelector('.none') !== null")
    assert not path.exists() and not path.with_suffix(".png").exists()


BALL = """\
bodies:
  - {name: ball, collider: {plugin: sphere, centre: [0, -1, 0], radius: 10 cm}, friction: 0.3}
"""
TEXT = SHEET.replace("# the end\n", BALL).replace("name: cloth ", "name: cloth\n    colour: steelblue ")
SKIRT = "{plugin: skirt, waist_radius: 13 cm, hem_radius: 31 cm, length: 45 cm, pleats: 12, fabric: silk}"


def look_at(page: Page, server: Server, text: str) -> None:
    Path(FILE).write_text(text)
    look_at_scene(page, server)
    assert page.value("document.getElementById('verdict').textContent") == "No mistakes"


def form_wait_text(page: Page, part: str) -> None:
    page.wait(f"document.getElementById('text').value.includes({part!r})")


def slide(page: Page, name: str, share: float) -> None:
    page.value(
        f"(() => {{ const one = document.getElementById({'slide:field:' + name!r}); one.value = {share} * one.max;"
        " one.dispatchEvent(new Event('input')); })()"
    )


def value_at(page: Page, name: str) -> float:
    """Where a slider stands, from 0 to 1."""
    return float(page.value(f"(() => {{ const s = document.getElementById({'slide:field:' + name!r}); "
                            "return s.value / s.max; })()"))  # fmt: skip


def test_a_slider_goes_from_limit_to_limit_with_what_is_usual_in_the_middle(
    page: Page, served: tuple[Desk, Server]
) -> None:
    look_at(page, served[1], TEXT)
    name = "bodies[0].friction"
    assert value_at(page, name) == pytest.approx(0.5, abs=0.01)  # as by default, though the limits are 0 and 100
    for share, written in ((1.0, "friction: 100}"), (0.0, "friction: 0}")):
        slide(page, name, share)
        form_wait_text(page, written)
        page.wait(f"nuno.scene.form.data.bodies[0].friction === {share * 100:g}")
        assert value_at(page, name) == share
    assert page.value("document.getElementById('verdict').textContent") == "No mistakes"
    # What is typed moves the slider.
    page.value(f"document.getElementById('field:{name}').select()")
    page.type("0.3")
    form_wait_text(page, "friction: 0.3}")
    page.wait(f"Math.abs(document.getElementById('slide:field:{name}').value / 1000 - 0.5) < 0.01")


def test_whole_numbers_go_by_one_on_the_keyboard_and_units_stay(page: Page, served: tuple[Desk, Server]) -> None:
    look_at(page, served[1], SHEET.replace(SHEET[SHEET.index("{plugin: sheet,") : SHEET.index("\n# the end")], SKIRT))
    page.value("document.getElementById('slide:field:objects[0].model.pleats').focus()")
    for key, written in (("ArrowRight", "pleats: 13"), ("ArrowRight", "pleats: 14"), ("ArrowLeft", "pleats: 13")):
        page.press(key)
        form_wait_text(page, written)
    # An angle that is written in degrees goes on in degrees, and not beyond the limit, 0.5 rad.
    dancer = "bodies:\n  - {name: a, collider: {plugin: skeleton}, motion: {plugin: hula, sway: 9 deg}}\n"
    look_at(page, served[1], SHEET.replace("# the end\n", dancer))
    slide(page, "bodies[0].motion.sway", 1.0)
    form_wait_text(page, "sway: 28.6 deg}")
    page.wait("document.querySelector('.section [data-path=\"bodies[0].motion.sway\"]') !== null")
    assert page.value("document.querySelectorAll('.mistake').length") == 0


def test_a_fabric_is_chosen_by_how_it_hangs_and_a_colour_by_eye(page: Page, served: tuple[Desk, Server]) -> None:
    look_at(page, served[1], TEXT)
    button = "swatch:field:objects[0].model.fabric"
    page.wait(f"document.getElementById('{button}:denim') !== null", 120.0)
    assert page.value(f"document.getElementById('{button}:silk').ariaPressed") == "true"
    page.value(f"document.getElementById('{button}:denim').focus()")
    page.press("Enter")
    form_wait_text(page, "fabric: denim")
    page.wait(f"document.activeElement.id === '{button}:denim' && document.activeElement.ariaPressed === 'true'")
    assert page.value("document.getElementById('choose:field:objects[0].colour').value") == "#4682b4"  # steelblue
    page.value("(() => { const one = document.getElementById('choose:field:objects[0].colour'); one.value = '#cd5c5c';"
               " one.dispatchEvent(new Event('input')); })()")  # fmt: skip
    form_wait_text(page, "#cd5c5c")


def test_strips_are_drawn_by_the_law_of_the_cantilever(page: Page, served: tuple[Desk, Server]) -> None:
    look_at(page, served[1], TEXT)
    length, gravity = 0.04, 9.81
    module = f"import('{served[1].guard.address}swatches.js')"
    for name, feel in swatches()["fabrics"].items():
        bend, density = 1e-6 * feel["bend"], 1e-3 * feel["density"]
        angle = page.value(f"{module}.then((one) => one.droop({bend!r}, {density!r}))")
        rigidity = density * gravity * length**3 * math.cos(0.5 * angle) / (8.0 * math.tan(angle))
        assert rigidity == pytest.approx(bend, rel=1e-6), name


def test_swatches_are_those_of_all_presets() -> None:
    found: dict[str, Any] = swatches()
    model = registry.load("nuno.models", "sheet")
    (names,) = (
        one["enum"] for one in model.Config.model_json_schema()["properties"]["fabric"]["oneOf"] if "enum" in one
    )
    assert set(found["fabrics"]) == set(names) and set(found["dyes"]) == set(PRESETS)
    assert found["dyes"]["madder"] == list(PRESETS["madder"].fields["colour"].values())


@pytest.mark.parametrize("name", [FILE, "skirt-dyed", "sewn/outfit"])
def test_all_that_can_be_used_has_a_name_that_is_read_out(page: Page, served: tuple[Desk, Server], name: str) -> None:
    Path(FILE).write_text(TEXT)
    look_at_scene(page, served[1], name)
    page.call("Accessibility.enable")
    used = {"button", "textbox", "combobox", "slider", "link", "searchbox", "ColorWell", "menuitem", "spinbutton"}
    nodes = page.call("Accessibility.getFullAXTree")["nodes"]
    found = [(one["role"]["value"], one.get("name", {}).get("value", "")) for one in nodes if not one.get("ignored")]
    controls = [(role, said) for role, said in found if role in used]
    assert len(controls) > 30 and [one for one in controls if not one[1].strip()] == []
    assert any(role == "slider" for role, _ in controls)
