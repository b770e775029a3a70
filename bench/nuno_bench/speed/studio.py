"""The studio's live view of a run: pictures a second in a browser, what it costs the solver, how soon it is there."""

from __future__ import annotations

import contextlib
import http.client
import itertools
import json
import multiprocessing
import os
import select
import shlex
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import psutil

import nuno
from nuno.runtime import runs
from nuno.scene import shipped
from nuno.studio import scenes
from nuno.studio.desk import Desk
from nuno.studio.server import Server, page_files
from nuno_bench import machine
from nuno_bench.report.page import Result
from nuno_schemas.errors import RunFailed

SCENE = "skirt-hula"
RATE, SLOWER, FIRST, WEIGHT = 30.0, 3.0, 2.0, 2.0
"""Bars: pictures a second, the solver's loss [%], the first picture of a warm studio [s], the page [MB]."""
SCREEN = 1.0 / 60.0
"""Time between two pictures of a screen [s]."""
LOOK, PATIENCE = 0.25, 1800.0
"""Time between two queries of a run, as the page has it, and longest time of a run [s]."""
WIDTH, HEIGHT = 1500, 900
VIEWER = ("gl.js", "math.js", "surface.js", "stage.js", "orbit.js", "scale.js", "drawing.js", "hand.js")
"""Files of the page that make up the 3-D viewer."""
VIEW = "nuno.scene.cloth"
COUNT = f"""(() => {{
  window.painted = [];
  const stage = {VIEW}.stage, paint = stage.paint;
  stage.paint = () => {{ paint.call(stage); if ({VIEW}.following) painted.push(performance.now()); }};
}})()"""
"""Notes when the page paints while it follows a run: nobody turns the view meanwhile, so each is another frame."""

Watch = Callable[[str], Callable[[], tuple[int, float]]]
"""From a run's name to what, at its end, tells how many frames were taken and in how many seconds."""


def studio(repeats: int) -> list[Result]:
    """skirt-hula without anybody looking, with a client that takes frames as the page does and draws none, and with the
    page in a browser, in turns.
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), _served() as (desk, server):
        _measure(desk, _alone)  # compiles what is not yet
        browser = find_browser()
        with contextlib.ExitStack() as stack:
            page = stack.enter_context(Page(Path(folder) / "browser", WIDTH, HEIGHT)) if browser else None
            ways: dict[str, Callable[[], tuple[float, float]]] = {
                "alone": lambda: _measure(desk, _alone),
                "client": lambda: _measure(desk, _client(server)),
            }
            if page is not None:
                shown = page
                ways["page"] = lambda: _measure_page(desk, server, shown)
            found: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
            for i in range(repeats):
                for name in sorted(ways, reverse=bool(i % 2)):
                    found[name].append(ways[name]())
            first = tuple(_open(server, page) for _ in range(repeats)) if page is not None else ()
    return _results(found, first)


def _results(found: dict[str, list[tuple[float, float]]], first: tuple[float, ...]) -> list[Result]:
    alone = [seconds for seconds, _ in found["alone"]]
    note = "wall time of its steps over that of the run beside which nobody looked, in the same turn"

    def slower(name: str) -> tuple[float, ...]:
        return tuple(100.0 * (own / before - 1.0) for (own, _), before in zip(found[name], alone, strict=True))

    def rates(name: str) -> tuple[float, ...]:
        return tuple(rate for _, rate in found[name])

    results = [
        Result("studio", f"{SCENE}, nobody looks", "s", tuple(alone)),
        Result("studio", "frames to a client that draws none", "frames/s", rates("client")),
        Result("studio", "solver slower by that client", "%", slower("client"), bar=SLOWER, at_most=True, note=note),
    ]
    if "page" in found:
        software = "Chromium without a graphics card draws on the cores that the solver has"
        results += [
            Result("studio", "pictures in Chromium", "pictures/s", rates("page"), bar=RATE, note=software),
            Result("studio", "solver slower by Chromium", "%", slower("page"), bar=SLOWER, at_most=True, note=note),
            Result("studio", "first picture, warm", "s", first, bar=FIRST, at_most=True),
        ]
    else:
        failure = "there is no Chromium here to open the page in (chromium or google-chrome on the PATH)"
        results.append(Result("studio", "pictures in Chromium", "pictures/s", failure=failure))
    files = {name: len(body) for name, (_, body) in page_files().items()}
    rest = sum(size for name, size in files.items() if name not in VIEWER) + len(scenes.schema())
    viewer = sum(files[name] for name in VIEWER) * 1e-6
    return [
        *results,
        Result("studio", "page without the 3-D viewer", "MB", (rest * 1e-6,), bar=WEIGHT, at_most=True,
               note="with the schema that forms are made of"),
        Result("studio", "3-D viewer", "MB", (viewer,)),
    ]  # fmt: skip


@contextlib.contextmanager
def _served() -> Iterator[tuple[Desk, Server]]:
    desk = Desk()
    server = desk.server()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield desk, server
    finally:
        server.shutdown()
        server.server_close()
        desk.close()


def _measure(desk: Desk, watch: Watch) -> tuple[float, float]:
    """Run the scene while somebody looks: wall time of its steps [s], and frames a second that were taken."""
    now = desk.act({"do": "run", "scene": SCENE, "text": shipped.find(SCENE).read_text(encoding="utf-8")})
    frames_taken = watch(str(now["run"]))
    return _ended(desk), _rate(*frames_taken())


def _rate(count: int, seconds: float) -> float:
    return count / seconds if seconds > 0.0 else 0.0


def _ended(desk: Desk) -> float:
    """Wait for the end of the run: the wall time of its steps [s]. Raises RunFailed."""
    end = time.monotonic() + PATIENCE
    while (now := desk.act({"do": "now"}))["state"] not in ("over", "failed", "refused", "stopped"):
        if time.monotonic() > end:
            raise RunFailed("the run did not come to its end")
        time.sleep(LOOK)
    if now["state"] != "over":
        raise RunFailed(f"{now['state']}: {now['said']}")
    with nuno.open(runs.RECORDINGS / now["recording"]) as recording:
        return float(recording.report()["wall_seconds"])


def _alone(run: str) -> Callable[[], tuple[int, float]]:
    return lambda: (0, 0.0)


def _client(server: Server) -> Watch:
    def watch(run: str) -> Callable[[], tuple[int, float]]:
        client = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
        taken = client.submit(take_frames, server.guard.port, server.guard.token, run)
        client.shutdown(wait=False)  # it ends with the run
        return taken.result

    return watch


def take_frames(port: int, token: str, run: str) -> tuple[int, float]:
    """Take every frame that a page would be given, no more often than a screen shows them; how many, and how long."""
    link, times = http.client.HTTPConnection("127.0.0.1", port, timeout=60.0), []
    known: dict[str, Any] = {"number": -1, "shape": -1, "place": -1, "state": "preparing"}
    while known["state"] not in ("done", "stopped", "diverged", "failed"):
        due = time.monotonic() + SCREEN
        asked = f"after={known['number']}&shape={known['shape']}&place={known['place']}"
        link.request("GET", f"/{token}/live?run={run}&{asked}", headers={"Host": f"127.0.0.1:{port}"})
        answer = link.getresponse()
        body = answer.read()
        if answer.status == 200:
            head = json.loads(body[4 : 4 + int.from_bytes(body[:4], "little")])
            if head["frame"] != known.get("frame"):
                times.append(time.monotonic())
            known = head
        elif times:
            break
        else:  # the run is not there yet, and the connection has ended with that
            link.close()
        time.sleep(max(0.0, due - time.monotonic()))
    return (len(times) - 1, times[-1] - times[0]) if times else (0, 0.0)


def _open(server: Server, page: Page) -> float:
    """From opening the page of a scene until its cloth is painted [s]."""
    page.open("about:blank")
    begin = time.monotonic()
    page.open(f"{server.guard.address}#scene={SCENE}")
    page.wait(f"window.nuno?.scene?.cloth?.frame && !{VIEW}.stage.asked", PATIENCE)
    return time.monotonic() - begin


def _measure_page(desk: Desk, server: Server, page: Page) -> tuple[float, float]:
    _open(server, page)
    page.value(COUNT)
    page.click("run")
    page.wait("nuno.dock.now.state === 'running'", PATIENCE)
    seconds = _ended(desk)
    count, milliseconds = page.value("[painted.length - 1, painted.at(-1) - painted[0]]")
    page.open("about:blank")
    return seconds, _rate(count, 1e-3 * milliseconds)


# A headless browser, driven through a pipe by the DevTools protocol: no port, no further package.

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless --no-sandbox --no-first-run --disable-extensions --disable-background-networking --mute-audio "
    "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --remote-debugging-pipe"
)


def find_browser() -> str | None:
    """Return the path of an installed browser, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Page(contextlib.AbstractContextManager["Page"]):
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

    def __exit__(self, *_: object) -> None:
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
