"""The process between a run and a live viewer: it may hang or die without harm to the run.

It reads frames from its standard input, each a JSON line {topic, frame, t, size} and `size` bytes,
and writes JSON lines about its status to its standard output. It also starts the viewer, unless one is
open, which stays open when the run is over.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import psutil
from pydantic import BaseModel

from nuno.bus.sessions import free_port
from nuno.runtime.runs import folder
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
PORT = 9876
"""Where rerun's viewer listens."""


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


PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
SETTINGS, GOODBYE = 4, 7
"""Types of HTTP/2's frames (RFC 9113): each begins with a length of 3 bytes, a type, flags, and a stream of 4 bytes."""


def is_viewer(port: int, host: str = LOOPBACK) -> bool:
    """Return whether what listens on a port speaks HTTP/2, as rerun's viewer does. A connection that says nothing would
    make the viewer show an error.
    """
    settings, goodbye = (bytes([0, 0, size, kind, 0, 0, 0, 0, 0]) for size, kind in ((0, SETTINGS), (8, GOODBYE)))
    try:
        with socket.create_connection((host, port), timeout=1.0) as probe:
            probe.sendall(PREFACE + settings)
            answer = probe.recv(9)
            probe.sendall(goodbye + bytes(8))
    except OSError:
        return False
    return len(answer) == 9 and answer[3] == SETTINGS


@dataclass(frozen=True)
class OpenViewer:
    """A viewer of this user: its process, the address to stream to, its page ("" for a window), and whether it was open
    before.
    """

    pid: int
    address: str
    page: str
    reused: bool = False


def find_viewer(mode: str) -> OpenViewer:
    """Return the viewer of this kind that an earlier command has opened, else a new one. Raises OSError if none starts.

    Only viewers that are noted in the user's own folder are used again: on a machine with several users, what listens
    on the port may be another's.
    """
    note = folder() / f"viewer-{mode}"
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError, psutil.Error):
        known = json.loads(note.read_text())
        port = int(known["port"])
        if psutil.Process(known["pid"]).create_time() == known["started"] and is_viewer(port):
            return OpenViewer(known["pid"], _address(port), known["page"], reused=True)
    viewer, port, page = start_viewer(mode)
    started = psutil.Process(viewer.pid).create_time()
    note.write_text(json.dumps({"pid": viewer.pid, "started": started, "port": port, "page": page}))
    return OpenViewer(viewer.pid, _address(port), page)


def _address(port: int) -> str:
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def start_viewer(mode: str) -> tuple[subprocess.Popen[bytes], int, str]:
    """Start rerun on loopback; return the process, the port to stream to, and the page ("" for a window).
    Raises OSError if it does not start.

    It starts the binary, because the console script would leave it running on a signal, in a new
    session, so that an interrupt of the run does not close the window.
    """
    import rerun_cli

    binary = os.path.join(rerun_cli.__path__[0], "rerun.exe" if os.name == "nt" else "rerun")
    port = port_or_free(PORT)
    command, page = [binary, "--bind", LOOPBACK, "--port", str(port)], ""
    if mode == "web":
        web = port_or_free(9090)
        command += ["--serve-web", "--web-viewer-port", str(web)]
        page = f"http://{LOOPBACK}:{web}/?url=rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"
    else:
        command += ["--hide-welcome-screen", "--expect-data-soon", "--memory-limit", "25%"]
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    end = time.monotonic() + START_SECONDS
    while not is_viewer(port):
        if viewer.poll() is not None or time.monotonic() > end:
            viewer.kill()
            raise OSError("the viewer did not start")
        time.sleep(0.05)
    return viewer, port, page


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


class Subject(BaseModel):
    """What a live view shows, as its process needs to know it."""

    run: str
    """The run's name, and id in rerun."""
    view: View = View()
    """The scene's view."""
    layout: str = APPLICATION
    """Application id, as `application` returns it."""
    scene: str = ""
    """Source of a dyed scene, as `scene_of` writes it."""
    properties: dict[str, str] = {}
    """Properties of the recording in rerun, as `properties` returns them."""


def properties(scene: Mapping[str, Any], versions: Mapping[str, str]) -> dict[str, str]:
    """Return what rerun says of a recording: its scene, cloth, solver, step and versions, from the scene's data."""
    found: dict[str, str] = {"scene": str(scene.get("name", ""))}
    models = [_fields(piece.get("model")) for piece in scene.get("objects") or ()]
    found["cloth"] = ", ".join(str(model.get("fabric") or model.get("plugin", "")) for model in models)
    solver = _fields(scene.get("solver"))
    found |= {"solver": str(solver.get("plugin", "")), "dt": str(solver.get("dt", ""))}
    found["versions"] = ", ".join(f"{name} {version}" for name, version in versions.items())
    return {name: text for name, text in found.items() if text}


def _fields(choice: Any) -> dict[str, Any]:
    """Return the fields of a choice of a plugin, which may be its name alone."""
    return choice if isinstance(choice, dict) else {"plugin": choice or ""}


def describe(recording: Any, subject: Subject) -> None:
    """Name a recording stream by its run, and give its properties."""
    import rerun as rr

    recording.send_recording_name(subject.run)
    if subject.properties:
        # Typed: rerun imports pandas, which takes as long as all of nuno, to find a plain value's type.
        texts = {name: rr.components.TextBatch(text) for name, text in subject.properties.items()}
        recording.send_property("nuno", rr.DynamicArchetype("nuno", components=texts))


def connect(address: str, subject: Subject) -> Any:
    """Return a recording stream to a viewer. Raises OSError if none listens."""
    import rerun as rr

    place = address.split("//", 1)[1].split("/", 1)[0]
    host, _, port = place.rpartition(":")
    if not port.isdigit() or not is_viewer(int(port), host.strip("[]")):
        raise OSError(f"no viewer listens at {address}")
    if (version := viewer_version(address)) not in ("", rr.__version__):
        say(warning=f"the viewer at {address} is of rerun {version}, this is {rr.__version__}: it may not show all")
    recording = rr.RecordingStream(subject.layout, recording_id=subject.run)
    recording.connect_grpc(address)
    return recording


def viewer_version(address: str) -> str:
    """Return the version of the viewer at an address; "" for a server of pages or a viewer that hangs: neither says."""
    from rerun.experimental import ViewerClient

    versions: list[str] = []

    def ask() -> None:
        # Of an experimental part of rerun: any error is as good as no answer.
        with contextlib.suppress(Exception), ViewerClient.connect(address) as client:
            versions.append(str(client.get_state().viewer_version))

    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    asking.join(GOODBYE_SECONDS)
    return versions[0] if versions else ""


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


def main(mode: str, text: str) -> None:
    """Show the frames of standard input in a viewer of this user ("window", "web") or the one at an address; `text` is
    the Subject as JSON.
    """
    if hasattr(os, "nice"):
        # The viewer inherits it: on a machine with few cores the solver has priority.
        os.nice(5)
    subject, viewer = Subject.model_validate_json(text), None
    try:
        address = mode
        if mode in ("window", "web"):
            viewer = find_viewer(mode)
            address = viewer.address
            say(pid=None if viewer.reused else viewer.pid, address=address, page=viewer.page, reused=viewer.reused)
        recording = connect(address, subject)
        describe(recording, subject)
        say(connected=True)
        pump(sys.stdin.buffer, recording, subject.view, read_painter(subject.scene))
        # Without a disconnect the viewer shows an error; a viewer that hangs is not waited for.
        goodbye = threading.Thread(target=recording.disconnect, daemon=True)
        goodbye.start()
        goodbye.join(GOODBYE_SECONDS)
    except (EOFError, BrokenPipeError):  # the run was killed
        if viewer is not None and not viewer.reused:
            psutil.Process(viewer.pid).kill()
    except Exception as error:
        say(error=str(error) or type(error).__name__)
    # A normal exit would wait for a viewer that may never answer.
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:3])
