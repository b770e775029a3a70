"""A headless browser, driven through a pipe by the DevTools protocol: no port, no further package."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import select
import shlex
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from nuno_bench import machine

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless --no-sandbox --no-first-run --disable-extensions --disable-background-networking --mute-audio "
    "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --remote-debugging-pipe"
)


def find_browser() -> str | None:
    """Return the path of an installed browser, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Page:
    """A page in a separate browser."""

    def __init__(self, folder: Path, width: int = 960, height: int = 600, flags: str = "") -> None:
        browser = find_browser()
        assert browser is not None
        browser_in, page_out = os.pipe()
        page_in, browser_out = os.pipe()
        command = f"{shlex.quote(browser)} {FLAGS} {flags} --user-data-dir={shlex.quote(str(folder))}"
        self._process = subprocess.Popen(
            ["bash", "-c", f"exec {command} 3<&{browser_in} 4>&{browser_out}"],
            pass_fds=(browser_in, browser_out),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(browser_in)
        os.close(browser_out)
        self._in, self._out, self._buffer = page_in, page_out, bytearray()
        self._numbers, self._session = itertools.count(1), ""
        self.said: list[str] = []
        """Errors of the page's scripts, and refused requests."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def __enter__(self) -> Page:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        os.close(self._out)
        os.close(self._in)
        browser = psutil.Process(self._process.pid)
        for process in browser.children(recursive=True):
            with contextlib.suppress(psutil.Error):
                machine.OtherLoad.besides += sum(process.cpu_times()[:2])
        self._process.kill()
        self._process.wait()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol, and return its result."""
        number = next(self._numbers)
        session = {"sessionId": self._session} if self._session else {}
        os.write(self._out, json.dumps({"id": number, "method": method, "params": params} | session).encode() + b"\0")
        while True:
            message = self._read(30.0)
            if message.get("id") == number:
                assert "error" not in message, message
                return dict(message["result"])
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        if message.get("method") == "Runtime.exceptionThrown":
            self.said.append(json.dumps(message["params"]["exceptionDetails"])[:600])
        if message.get("method") == "Log.entryAdded" and message["params"]["entry"]["level"] == "error":
            entry = message["params"]["entry"]
            self.said.append(f"{entry['text']}: {entry.get('url', '')}")

    def _read(self, patience: float) -> dict[str, Any]:
        end = time.monotonic() + patience
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], max(0.0, end - time.monotonic()))
            piece = os.read(self._in, 1 << 16) if ready else b""
            assert piece, "the browser does not answer"
            self._buffer += piece
        text, _, rest = bytes(self._buffer).partition(b"\0")
        self._buffer = bytearray(rest)
        return dict(json.loads(text))

    def open(self, address: str) -> None:
        self.call("Page.navigate", url=address)

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, expression: str, patience: float = 30.0) -> Any:
        """Return the value of an expression once it is true."""
        end = time.monotonic() + patience
        while not (value := self.value(expression)):
            assert time.monotonic() < end, f"not within {patience} s: {expression}; {self.said}"
            time.sleep(0.02)
        return value

    def click(self, name: str) -> None:
        """Click the button with an id."""
        self.value(f"document.getElementById({json.dumps(name)}).click()")
