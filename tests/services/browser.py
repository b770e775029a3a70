"""A page in a headless browser, with a person's hands: mouse, keyboard, files, and eyes."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nuno_bench.speed import studio as chromium

KEYS = {"Tab": 9, "Enter": 13, "Escape": 27, "End": 35, "Home": 36, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39}
KEYS |= {"ArrowDown": 40, ",": 188, "-": 189, ".": 190}


class Page(chromium.Page):
    """One page of a browser of its own."""

    clicks = 0

    def tap(self, selector: str) -> None:
        """Press the mouse on an element and let it go, as a person does: it is scrolled to, and must be what is seen
        there; `clicks` counts.
        """
        found = f"document.querySelector({json.dumps(selector)})"
        place = self.wait(
            f"(() => {{ const one = {found}; if (!one) return null; one.scrollIntoView({{ block: 'nearest' }}); "
            "const box = one.getBoundingClientRect(), x = box.x + box.width / 2, y = box.y + box.height / 2; "
            "return one.contains(document.elementFromPoint(x, y)) ? [x, y] : null; })()"
        )
        self.drag([place])
        self.clicks += 1

    def drop(self, *paths: Path) -> None:
        """Drop files onto the middle of the page."""
        data = {"items": [], "files": [str(path) for path in paths], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            self.call("Input.dispatchDragEvent", type=kind, x=400, y=300, data=data)

    def choose_files(self, selector: str, *paths: Path) -> None:
        """What a person chooses in the browser's own window of files, which a headless one does not open."""
        root = self.call("DOM.getDocument")["root"]["nodeId"]
        node = self.call("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.call("DOM.setFileInputFiles", files=[str(path) for path in paths], nodeId=node)

    def type(self, text: str) -> None:
        """What a keyboard puts where the cursor is."""
        self.call("Input.insertText", text=text)

    def press(self, key: str, control: bool = False) -> None:
        """One key, such as Tab, Enter, Escape or z; with Control held."""
        held = {
            "key": key,
            "code": key if len(key) > 1 else f"Key{key.upper()}",
            "windowsVirtualKeyCode": KEYS.get(key) or ord(key.upper()),
            "modifiers": 2 if control else 0,
        }
        text = {"text": "\r"} if key == "Enter" and not control else {}
        self.call("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", **held, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **held)

    def drag(self, points: Sequence[tuple[float, float]], button: str = "left") -> None:
        """Press the mouse at the first point [pixels], move it along, and let it go at the last."""
        held = {"button": button, "buttons": 1 if button == "left" else 2, "clickCount": 1}
        x, y = points[0]
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **held)
        for x, y in points[1:]:
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, **held)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, **held | {"buttons": 0})

    def picture(self, path: Path | None = None) -> NDArray[np.uint8]:
        """The page as it is seen, (height, width, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
