"""Make the pictures of the studio in docs/pictures: python docs/make_studio_pictures.py [NAME ...]

Each is of the page in a headless Chromium, with a shipped scene in it: studio, fit, sewing, painting.
"""

from __future__ import annotations

import base64
import contextlib
import io
import sys
import tempfile
import threading
import time
from pathlib import Path

from PIL import Image

from nuno.studio.desk import Desk
from nuno_bench.speed.studio import Page

PICTURES = Path(__file__).resolve().parent / "pictures"
SIZE = 1280, 800
PATIENCE = 1800.0
"""The first run on a machine compiles kernels [s]."""
MOVE = "Input.dispatchMouseEvent"


POINT = """(() => {
  const { values, screen } = nuno.run.fit, { stage } = screen, p = values.pressure;
  let best = null;
  for (let v = 0; v < p.length; v++) {
    const at = stage.camera.project([...stage.cloth.x.slice(3 * v, 3 * v + 3)]);
    const seen = at && stage.pick(at.x, at.y) && stage.normals[3 * v + 2] > 0.5;
    if (seen && (!best || p[v] > p[best.v])) best = { v, ...at };
  }
  nuno.run.fit.point({ offsetX: best.x, offsetY: best.y, buttons: 0 });
})()"""
"""Puts the mouse where the pressure in front is largest."""


def studio(page: Page) -> str:
    """skirt-hula while it runs."""
    open_scene(page, "skirt-hula")
    page.click("run")
    page.wait("nuno.scene.cloth.frame.frame > 90 && nuno.dock.now.factor", PATIENCE)
    return "studio"


def fit(page: Page) -> str:
    """The pressure of sewn/shirt, and the table of its ease."""
    open_scene(page, "sewn/shirt")
    page.click("run")
    page.wait("nuno.dock.now.state === 'over' && document.getElementById('to-fit') !== null", PATIENCE)
    page.click("to-fit")
    page.wait("Boolean(nuno.run?.fit?.values)", PATIENCE)
    page.click("map-pressure")
    page.wait("!nuno.run.screen.stage.asked")
    page.value(POINT)
    return "studio-fit"


def sewing(page: Page) -> str:
    """sewn/shirt again, 10 cm longer at its sides."""
    fit(page)
    former, side = page.value("nuno.run.name"), "document.querySelector('[aria-label=\"front, edge 1\"]')"
    for _ in range(2):
        page.value(f"{side}.dispatchEvent(new Event('click'))")
        page.wait("document.querySelector('.sewing:not([hidden])') !== null", PATIENCE)
        if page.value("nuno.run.name") == former:
            page.value("(one => { one.value = Number(one.value) + 10; one.dispatchEvent(new Event('input')); })"
                       "(document.getElementById('edge-length'))")  # fmt: skip
            page.click("sew-again")
            page.wait(f"nuno.run && nuno.run.name !== '{former}' && Boolean(nuno.run.fit?.values)", PATIENCE)
    page.click("dismiss")
    page.value("document.querySelector('.sewing').scrollIntoView({ block: 'center' })")
    page.wait("!nuno.run.screen.stage.asked")
    return "studio-sewing"


def painting(page: Page) -> str:
    """Dye and paste on the flat cloth of dye/drops."""
    open_scene(page, "dye/drops")
    page.click("cloth-paint")
    page.wait("nuno.scene.cloth.paint.on", PATIENCE)
    page.value("(one => { one.value = 0.8; one.onchange({ target: one }); })(document.getElementById('paint-width'))")
    for tool, line in (("dye", [(0.08, 0.15), (0.13, 0.35), (0.06, 0.6), (0.12, 0.8)]),
                       ("paste", [(0.2, 0.9), (0.4, 0.8), (0.6, 0.92), (0.8, 0.78), (0.94, 0.86)])):  # fmt: skip
        page.click(f"paint-{tool}")
        before = page.value("nuno.scene.text.value.length")
        x, y, w, h = page.value("(({ left, top, scale }, [w, h], r) => [r.x + left, r.y + top, w * scale, h * scale])"
                                "(nuno.scene.cloth.paint.flat.frame, nuno.scene.cloth.paint.size, "
                                "document.getElementById('paint').getBoundingClientRect())")  # fmt: skip
        for kind, (u, v) in zip(["mousePressed", *["mouseMoved"] * (len(line) - 1)], line, strict=True):
            page.call(MOVE, type=kind, x=x + u * w, y=y + v * h, button="left", buttons=1, clickCount=1)
        page.call(MOVE, type="mouseReleased", x=x + line[-1][0] * w, y=y + line[-1][1] * h, button="left", clickCount=1)
        page.wait(f"nuno.scene.text.value.length > {before} && nuno.scene.cloth.paint.shown === nuno.scene.text.value")
    return "painting"


def open_scene(page: Page, name: str) -> None:
    page.value(f"location.hash = '#scene={name.replace('/', '%2F')}'")
    page.wait(f"nuno.scene?.name === '{name}' && document.getElementById('verdict')?.textContent", PATIENCE)
    page.wait("nuno.scene.cloth.frame || nuno.scene.cloth.flat.src", PATIENCE)


def main(names: list[str]) -> None:
    known = {"studio": studio, "fit": fit, "sewing": sewing, "painting": painting}
    for name in names or known:
        with tempfile.TemporaryDirectory(prefix="nuno-") as folder, contextlib.chdir(folder):
            desk = Desk()
            server = desk.server()
            threading.Thread(target=server.serve_forever, daemon=True).start()
            with Page(Path(folder) / "browser", *SIZE) as page:
                page.open(server.guard.address)
                page.wait("window.nuno !== undefined")
                drawn = known[name](page)
                time.sleep(0.5)  # what is painted by the next frame of the browser
                save(page, PICTURES / f"{drawn}.png")
            server.shutdown()
            desk.close()


def save(page: Page, path: Path) -> None:
    data = base64.b64decode(page.call("Page.captureScreenshot", format="png")["data"])
    Image.open(io.BytesIO(data)).convert("RGB").save(path, optimize=True)
    print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
