"""The cloth in the page of `nuno studio`, in a browser: its start, a run that goes on, and what is asked for then."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Page
from live_run import wait_until
from PIL import Image
from studio_desk import FILE, NEEDS_BROWSER, SHEET, look_at_scene

from nuno.scene import scene_file
from nuno.studio import cloth
from nuno.studio.desk import Desk
from nuno.studio.live_view import see_objects
from nuno.studio.server import Server

pytestmark = [pytest.mark.full, NEEDS_BROWSER]
PATIENCE = 300.0
"""The first run on a machine compiles kernels [s]."""
VIEW = "nuno.scene.cloth"
BOX = "(({x, y, width, height}) => [x, y, width, height])(document.getElementById('cloth').getBoundingClientRect())"
CAMERA = f"(({{azimuth, elevation, distance}}) => [azimuth, elevation, distance])({VIEW}.stage.camera)"


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """What nobody looks at any more is left soon."""
    monkeypatch.setattr(cloth, "LEAVE", 0.3)


def look_at_cloth(page: Page, server: Server, name: str = FILE) -> None:
    look_at_scene(page, server, name)
    page.wait(f"Boolean({VIEW}?.frame)")


def shown(page: Page) -> np.ndarray[Any, Any]:
    """(n, 3) where the page has the cloth, about its origin."""
    return np.array(page.value(f"[...{VIEW}.stage.cloth.x]"), np.float32).reshape(-1, 3)


def size(page: Page, width: int) -> None:
    more: dict[str, Any] = {"deviceScaleFactor": 1, "mobile": False}
    page.call("Emulation.setDeviceMetricsOverride", width=width, height=820, **more)


def painted(page: Page) -> int:
    """How many pixels of the canvas are not its background's."""
    page.wait(f"!{VIEW}.stage.asked")
    x, y, w, h = (round(value) for value in page.value(BOX))
    seen = page.picture()[y + 60 : y + h - 4, x + 4 : x + w - 4].astype(int)
    return int((np.abs(seen - seen[0, 0]).sum(axis=2) > 20).sum())


def test_the_start_of_the_text_is_shown_without_a_run_and_changes_with_it(
    page: Page, served: tuple[Desk, Server]
) -> None:
    look_at_cloth(page, served[1])
    sight = see_objects(scene_file.read(Path(FILE)))[0]
    assert np.allclose(shown(page), sight.x, atol=1e-6) and painted(page) > 5000
    number = page.value(f"{VIEW}.built.length")
    page.value("document.getElementById('text').focus(); document.getElementById('text').setSelectionRange(0, 1e6)")
    page.type(text := SHEET.replace("[9, 9]", "[5, 7]"))
    page.wait(f"{VIEW}.stage.cloth.x.length === {3 * 5 * 7}")
    page.value("document.getElementById('text').setSelectionRange(0, 1e6)")
    page.type(text.replace("silk", "sillk"))
    page.wait("nuno.scene.mistakes.length === 1")
    assert len(shown(page)) == 35 and page.value(f"{VIEW}.built.length") == number
    assert not Path("recordings").exists()


def test_the_view_is_turned_by_mouse_and_keys_and_coloured_by_stretch(page: Page, served: tuple[Desk, Server]) -> None:
    look_at_cloth(page, served[1])
    first = page.value(CAMERA)
    x, y, _, _ = page.value(BOX)
    x, y = x + 60, y + 300
    page.drag([(x, y), (x + 50, y + 20)])
    turned = page.value(CAMERA)
    assert turned[0] == pytest.approx(first[0] - 0.35) and turned[1] == pytest.approx(first[1] + 0.14)
    assert page.value("document.activeElement.id") == "cloth"
    for key, which in [("ArrowLeft", 0), ("-", 2)]:
        before = page.value(CAMERA)
        page.press(key)
        after = page.value(CAMERA)
        assert after[which] > before[which], key
    page.press("f")
    assert page.value(CAMERA)[2] == pytest.approx(first[2], rel=0.2)
    page.press("s")
    assert page.value("!document.querySelector('.scale').hidden")
    page.press("l")
    assert page.value("document.querySelector('.text').offsetParent === null")
    page.press("l")


PRINTED = """\
nuno: 1
name: printed
duration: 0.1 s
objects:
  - name: skirt
    model: {plugin: skirt, waist_radius: 13 cm, hem_radius: 31 cm, length: 45 cm, fabric: jacket, texture: two.png}
"""
SEEN = """(() => { const { stage } = nuno.scene.cloth, { x, faces } = stage.cloth, found = [];
  for (let v = 0; v < x.length / 3; v += 7) {
    const at = stage.camera.project([...x.slice(3 * v, 3 * v + 3)]), hit = at && stage.pick(at.x, at.y);
    const shares = hit ? [1 - hit.u - hit.v, hit.u, hit.v] : [];
    if (shares.some((s, k) => s > 0.9 && faces[3 * hit.face + k] === v)) found.push([v, at.x, at.y]);
  }
  return found; })()"""
"""Vertices whose own triangles are what their pixels show, and where these are."""


def test_a_print_lies_on_the_cloth_as_its_texture_coordinates_say(page: Page, served: tuple[Desk, Server]) -> None:
    picture = np.zeros((40, 40, 3), np.uint8)
    picture[:, :20, 0] = picture[:, 20:, 1] = 230  # left red, right green
    Image.fromarray(picture).save("two.png")
    Path(FILE).write_text(PRINTED)
    look_at_cloth(page, served[1])
    page.wait(f"{VIEW}.stage.worn?.corners.length > 0 && !{VIEW}.stage.asked", PATIENCE)
    fabric = see_objects(scene_file.read(Path(FILE)))[1]
    assert fabric.laid_out is not None
    uv = dict(zip(fabric.laid_out.vertex.tolist(), fabric.laid_out.points.tolist(), strict=True))
    for side in ("front", "back"):
        page.click(f"from-{side}")
        page.wait(f"!{VIEW}.stage.asked")
        assert page.value(CAMERA)[0] == pytest.approx({"front": 0.0, "back": np.pi}[side])
        left, top, _, _ = page.value(BOX)
        seen, checked, beside = page.picture().astype(int), 0, 0
        for v, x, y in page.value(SEEN):
            share, along = uv[v][0] % 1.0, uv[v][1]
            if y < 70 or min(abs(share - edge) for edge in (0.0, 0.5, 1.0)) < 0.03 or not 0.05 < along < 0.95:
                continue  # below the buttons, at an edge of the print, or at one of the cloth
            red, green, _ = seen[round(top + y), round(left + x)]
            beside += abs(red - green) < 20  # the next pixel is another one of the cloth's, or none of it
            assert abs(red - green) < 20 or bool(red > green) is (share < 0.5), (v, share)
            checked += 1
        assert checked > 10 and beside < 0.1 * checked
    page.click("cloth-stretch")  # colours of stretch are not printed over
    page.wait(f"!{VIEW}.stage.asked")
    (v, x, y), *_ = [one for one in page.value(SEEN) if one[2] > 120]
    assert page.picture()[round(top + y), round(left + x)].astype(int)[2] > 40
    page.click("cloth-stretch")


def test_the_cloth_has_a_shadow_on_the_floor_below_it(page: Page, served: tuple[Desk, Server]) -> None:
    """Where the light through the middle of the sheet meets the floor it is darker than as far on the other side."""
    look_at_cloth(page, served[1])
    page.value(f"Object.assign({VIEW}.stage.camera, {{ azimuth: 0, elevation: 1.1 }}); {VIEW}.stage.camera.changed()")
    page.wait(f"!{VIEW}.stage.asked")
    floor, (x, y, z) = page.value(f"{VIEW}.stage.painter.floor"), shown(page)[40]
    height = float(y) - floor
    assert height > 0.15 and floor < shown(page)[:, 1].min()
    left, top, _, _ = page.value(BOX)
    seen = page.picture().astype(int).sum(axis=2)
    shades = []
    for side in (1, -1):
        place = [float(x) + 0.4 * height * side, floor, float(z) - 0.25 * height * side]
        at = page.value(f"{VIEW}.stage.camera.project({place})")
        shades.append(seen[round(top + at["y"]), round(left + at["x"])])
    assert shades[0] < 0.9 * shades[1]


def test_a_run_is_shown_while_it_is_on_the_screen_and_not_followed_else(
    page: Page, served: tuple[Desk, Server]
) -> None:
    desk = served[0]
    Path(FILE).write_text(SHEET.replace("0.4 s", "400 s"))
    look_at_cloth(page, served[1])
    start = shown(page)
    page.click("run")
    page.wait(f"{VIEW}.frame.frame > 5", PATIENCE)
    page.wait(f"/pictures/.test({VIEW}.figures.textContent)")
    assert not np.allclose(shown(page), start, atol=1e-4)
    own = desk._own
    assert own is not None and own.live is not None
    size(page, 700)  # where the text is in front of the cloth
    wait_until(lambda: own.live.follower is None)
    frame = page.value(f"{VIEW}.frame.frame")
    page.click("side-cloth")
    page.wait(f"{VIEW}.frame.frame > {frame + 3}")
    page.value("Object.defineProperty(document, 'hidden', {value: true, configurable: true})")
    page.value("document.dispatchEvent(new Event('visibilitychange'))")
    wait_until(lambda: own.live.follower is None)
    page.value("delete document.hidden; document.dispatchEvent(new Event('visibilitychange'))")
    wait_until(lambda: own.live.follower is not None)
    size(page, 1300)
    check_set(page)
    page.click("pause")
    page.wait("nuno.dock.now.state === 'paused'")
    page.wait(f"{VIEW}.frame.frame === nuno.dock.now.frame")
    now = own.live.board.now
    assert np.array_equal(shown(page), (now.x - now.origin).astype(np.float32))
    page.click("stop")
    page.wait("nuno.dock.now.state === 'over'", PATIENCE)
    wait_until(lambda: own.live.follower is None)
    page.click("cloth-back")
    page.wait(f"{VIEW}.frame.state === 'start'")
    assert np.array_equal(shown(page), start)


def check_set(page: Page) -> None:
    """A field is set in the dock, and what cannot be is refused beside it."""
    for item, words in [("damping=0.75", "damping 0.5 → 0.75 at frame"), ("duration=1 s", "cannot change while")]:
        page.value("document.getElementById('set-item').select()")
        page.type(item)
        page.press("Enter")
        page.wait(f"document.getElementById('set-said').textContent.includes({words!r})")


def test_cloth_of_yarns_is_shown_as_lines_and_what_is_not_shown_is_said(
    page: Page, served: tuple[Desk, Server]
) -> None:
    look_at_cloth(page, served[1], "knit/stitch-10x10")
    page.wait("document.getElementById('cloth-said').textContent.includes('links are shown as lines')")
    assert painted(page) > 300
    look_at_cloth(page, served[1], "skirt-dyed")
    page.wait("document.getElementById('cloth-said').textContent.includes('Dye')")
    page.value("location.hash = '#scene=dye%2Fdrops'")
    page.wait("document.getElementById('cloth-said')?.textContent.includes('lies flat and does not move')")
    image = "document.getElementById('cloth-flat')"
    page.wait(f"{image}.naturalWidth > 100 && {image}.clientWidth > 100")
    assert page.value("document.getElementById('cloth-stretch').clientWidth") == 0
