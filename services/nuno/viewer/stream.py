"""The process between a run and a live viewer: it may hang or die without harm to the run.

It reads frames from its standard input, each a JSON line {topic, frame, t, size} and `size` bytes,
and writes JSON lines about its status to its standard output. It also starts the viewer, which stays
open when the run is over.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from nuno.bus.sessions import free_port
from nuno_schemas.scene import View

if TYPE_CHECKING:
    from nuno.dye.painter import DyePainter
    from nuno.scene.scene_file import Loaded

START_SECONDS = 20.0
"""Longest wait until a viewer listens [s]."""
FLUSH_SECONDS = 10.0
"""Longest wait until a viewer accepts one frame [s]."""
GOODBYE_SECONDS = 2.0
END, LOOP = "end", "loop"
"""Topics of the last message, after which the viewer stays open, or plays all frames again and again: without it the
run was killed."""
LOOPBACK = "127.0.0.1"
APPLICATION = "nuno"


def say(**status: Any) -> None:
    """Send a status to the run."""
    sys.stdout.write(json.dumps(status) + "\n")
    sys.stdout.flush()


def port_or_free(port: int) -> int:
    """Return `port` if nothing listens on it, so that addresses do not change; else any free one."""
    return free_port() if listens(port) else port


def listens(port: int, host: str = LOOPBACK) -> bool:
    """Return whether a port accepts connections."""
    try:
        socket.create_connection((host, port), timeout=1.0).close()
    except OSError:
        return False
    return True


def start_viewer(mode: str) -> tuple[subprocess.Popen[bytes], str, str]:
    """Start rerun on loopback; return the process, the address to stream to, and the page ("" for a window).

    It starts the binary, because the console script would leave it running on a signal, in a new
    session, so that an interrupt of the run does not close the window.
    """
    import rerun_cli

    binary = os.path.join(rerun_cli.__path__[0], "rerun.exe" if os.name == "nt" else "rerun")
    port = port_or_free(9876)
    command = [binary, "--bind", LOOPBACK, "--port", str(port)]
    address, page = f"rerun+http://{LOOPBACK}:{port}/proxy", ""
    if mode == "web":
        web = port_or_free(9090)
        command += ["--serve-web", "--web-viewer-port", str(web)]
        page = f"http://{LOOPBACK}:{web}/?url=rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"
    else:
        command += ["--hide-welcome-screen", "--expect-data-soon", "--memory-limit", "25%"]
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    end = time.monotonic() + START_SECONDS
    while not listens(port):
        if viewer.poll() is not None or time.monotonic() > end:
            viewer.kill()
            raise OSError("the viewer did not start")
        time.sleep(0.05)
    return viewer, address, page


def application(scene: Mapping[str, Any]) -> str:
    """Return the application id of a scene's recordings, from its data. rerun has one layout for each id: it fits the
    scene of this name, with these parts.
    """
    view, record, dye = (scene.get(name) or {} for name in ("view", "record", "dye"))
    parts = {
        "bodies": scene.get("bodies"), "contact": scene.get("cloth_contact") not in (None, "none"),
        "forces": record.get("contact_forces"), "dye": dye, "tension": view.get("links") == "tension",
        "pictures": view.get("pictures"),
    }  # fmt: skip
    return " ".join([APPLICATION, str(scene.get("name", "")), *(name for name, there in parts.items() if there)])


def connect(address: str, run: str, layout: str = APPLICATION) -> Any:
    """Return a recording stream to a viewer, whose `layout` is an application id. Raises OSError if none listens."""
    import rerun as rr

    place = address.split("//", 1)[1].split("/", 1)[0]
    host, _, port = place.rpartition(":")
    if not port.isdigit() or not listens(int(port), host.strip("[]")):
        raise OSError(f"no viewer listens at {address}")
    recording = rr.RecordingStream(layout, recording_id=run)
    recording.connect_grpc(address)
    return recording


def pump(source: BinaryIO, recording: Any, view: View, painter: DyePainter | None = None) -> int:
    """Log messages until the input ends; return the number of shown frames. Raises EOFError without END or LOOP.

    Each frame is flushed with a time limit: so a slow viewer slows the run's ring, which then
    skips frames, and this process does not accumulate frames.
    """
    from nuno.bus.encodings import BadMessage
    from nuno.viewer.bridge import Bridge
    from nuno_schemas.messages import FRAMES

    bridge = Bridge(recording, view, live=True, painter=painter)
    topic = ""
    while line := source.readline():
        head = json.loads(line)
        payload = source.read(head["size"])
        topic = head["topic"]
        try:
            bridge.feed(topic, head["frame"], head["t"], payload)
        except BadMessage:
            continue
        if topic in FRAMES:
            recording.flush(timeout_sec=FLUSH_SECONDS)
            say(shown=bridge.frames)
    if topic not in (END, LOOP):
        raise EOFError
    bridge.flush()
    if topic == LOOP:
        bridge.loop()
    recording.flush(timeout_sec=FLUSH_SECONDS)
    return bridge.frames


def read_painter(scene: str) -> DyePainter | None:
    """Return the painter of a dyed scene in the form of `scene_of`; None for "". Raises BadInput."""
    if not scene:
        return None
    from nuno.scene import scene_file
    from nuno.viewer.dyed import viewer_painter

    source = json.loads(scene)
    roots = [Path(root) for root in source["roots"]]
    return viewer_painter(scene_file.read(Path(source["path"]), source["overrides"], roots))


def scene_of(loaded: Loaded) -> str:
    """Return the source of a scene of dye, from which it can be read again; "" for any other scene."""
    if loaded.dye is None:
        return ""
    roots = [str(root) for root in loaded.files.roots]
    return json.dumps({"path": str(loaded.path), "overrides": list(loaded.overrides), "roots": roots})


def main(mode: str, run: str, view: str, layout: str, scene: str) -> None:
    """Show the frames of standard input in a new viewer ("window", "web") or the one at an address."""
    if hasattr(os, "nice"):
        # The viewer inherits it: on a machine with few cores the solver has priority.
        os.nice(5)
    viewer = None
    try:
        address = mode
        if mode in ("window", "web"):
            viewer, address, page = start_viewer(mode)
            say(pid=viewer.pid, address=address, page=page)
        recording = connect(address, run, layout)
        say(connected=True)
        pump(sys.stdin.buffer, recording, View.model_validate_json(view), read_painter(scene))
        # Without a disconnect the viewer shows an error; a viewer that hangs is not waited for.
        goodbye = threading.Thread(target=recording.disconnect, daemon=True)
        goodbye.start()
        goodbye.join(GOODBYE_SECONDS)
    except (EOFError, BrokenPipeError):  # the run was killed
        if viewer is not None:
            viewer.kill()
    except Exception as error:
        say(error=str(error) or type(error).__name__)
    # A normal exit would wait for a viewer that may never answer.
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:6])
