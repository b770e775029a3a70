"""The form of a scene in the studio: sliders, colours and presets by what they look like, by mouse and keyboard."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from browser import Page
from studio_desk import FILE, NEEDS_BROWSER, SHEET, look_at_scene

from nuno.plugin_contract import registry
from nuno.studio.desk import Desk, swatches
from nuno.studio.pages.server import Server
from nuno_schemas.dyeing import PRESETS

pytestmark = [pytest.mark.full, NEEDS_BROWSER]
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


def wait_text(page: Page, part: str) -> None:
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
        wait_text(page, written)
        page.wait(f"nuno.scene.form.data.bodies[0].friction === {share * 100:g}")
        assert value_at(page, name) == share
    assert page.value("document.getElementById('verdict').textContent") == "No mistakes"
    # What is typed moves the slider.
    page.value(f"document.getElementById('field:{name}').select()")
    page.type("0.3")
    wait_text(page, "friction: 0.3}")
    page.wait(f"Math.abs(document.getElementById('slide:field:{name}').value / 1000 - 0.5) < 0.01")


def test_whole_numbers_go_by_one_on_the_keyboard_and_units_stay(page: Page, served: tuple[Desk, Server]) -> None:
    look_at(page, served[1], SHEET.replace(SHEET[SHEET.index("{plugin: sheet,") : SHEET.index("\n# the end")], SKIRT))
    page.value("document.getElementById('slide:field:objects[0].model.pleats').focus()")
    for key, written in (("ArrowRight", "pleats: 13"), ("ArrowRight", "pleats: 14"), ("ArrowLeft", "pleats: 13")):
        page.press(key)
        wait_text(page, written)
    # An angle that is written in degrees goes on in degrees, and not beyond the limit, 0.5 rad.
    dancer = "bodies:\n  - {name: a, collider: {plugin: skeleton}, motion: {plugin: hula, sway: 9 deg}}\n"
    look_at(page, served[1], SHEET.replace("# the end\n", dancer))
    slide(page, "bodies[0].motion.sway", 1.0)
    wait_text(page, "sway: 28.6 deg}")
    page.wait("document.querySelector('.section [data-path=\"bodies[0].motion.sway\"]') !== null")
    assert page.value("document.querySelectorAll('.mistake').length") == 0


def test_a_fabric_is_chosen_by_how_it_hangs_and_a_colour_by_eye(page: Page, served: tuple[Desk, Server]) -> None:
    look_at(page, served[1], TEXT)
    button = "swatch:field:objects[0].model.fabric"
    page.wait(f"document.getElementById('{button}:denim') !== null", 120.0)
    assert page.value(f"document.getElementById('{button}:silk').ariaPressed") == "true"
    page.value(f"document.getElementById('{button}:denim').focus()")
    page.press("Enter")
    wait_text(page, "fabric: denim")
    page.wait(f"document.activeElement.id === '{button}:denim' && document.activeElement.ariaPressed === 'true'")
    assert page.value("document.getElementById('choose:field:objects[0].colour').value") == "#4682b4"  # steelblue
    page.value("(() => { const one = document.getElementById('choose:field:objects[0].colour'); one.value = '#cd5c5c';"
               " one.dispatchEvent(new Event('input')); })()")  # fmt: skip
    wait_text(page, "#cd5c5c")


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
