"""Runs in processes of their own: started in one way, killed, waited for, gone on from, compared by digests."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

import psutil

from nuno.bus.sessions import free_port
from nuno.recording.reader import open_recording
from nuno.recording.writer import part_of
from nuno.runtime import runs
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import DYE_STATUS, STATUS

SEEING = ("dye", "collision", "recorder", "viewer")
"""Services whose acknowledgements a simulation started by hand waits for, where they take part."""
HUNG = 40.0
"""A run that has not ended this long after a fault hangs [s]."""
COLD = 400.0
"""Longest that a command may take that has to compile its kernels [s]."""
POLL = 0.01
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path[1:]])}
"""In which `python -m soak.MODULE` is found."""
Digests = list[tuple[str, int, str]]
"""Topic, frame and digest of every status that a recording holds."""


class Processes:
    """Processes of one run, by role, of which nothing is left when the block ends.

    run     its name, by which all its processes are told from others
    record  where its recording goes
    lines   what they have said: when [s], who, what
    ended   when each has closed its output [s]
    """

    def __init__(self, folder: Path) -> None:
        self.run = runs.new_id("soak")
        self.record = folder / f"{self.run}.mcap"
        self.children: dict[str, subprocess.Popen[str]] = {}
        self.lines: list[tuple[float, str, str]] = []
        self.ended: dict[str, float] = {}
        self._readers: dict[str, threading.Thread] = {}

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def start(self, role: str, *words: object, module: str = "nuno") -> subprocess.Popen[str]:
        """`python -m MODULE WORDS`; what it says is read by a thread."""
        command = [sys.executable, "-m", module, *map(str, words)]
        child = self.children[role] = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            errors="replace", start_new_session=True, env=ENVIRONMENT,
        )  # fmt: skip
        self._readers[role] = threading.Thread(target=self._read, args=(role, child), daemon=True)
        self._readers[role].start()
        return child

    def _read(self, role: str, child: subprocess.Popen[str]) -> None:
        assert child.stdout is not None
        for line in child.stdout:
            self.lines.append((time.monotonic(), role, line.strip()))
        self.ended[role] = time.monotonic()

    def supervise(self, scene: Path, *words: object) -> None:
        """`nuno run`, recorded."""
        self.start("supervisor", "run", scene, "--run", self.run, "--record", self.record, *words)

    def serve(self, scene: Path, services: Sequence[str], *words: object, viewer: Sequence[object] = ()) -> None:
        """A router, each service and the supervisor by hand; `viewer` is for it alone. Raises RunFailed."""
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.start("router", "serve", "router", "--listen", endpoint)
        if not self.wait_for("router at", "router"):
            raise RunFailed(f"the router did not start: {self.said('router')}")
        common = (scene, "--run", self.run, "--record", self.record, "--connect", endpoint, *words)
        seen = [word for name in SEEING if name in services for word in ("--must-see", name)]
        for name in services:
            more = seen if name in ("simulation", "viewer") else []
            self.start(name, "serve", name, *common, *more, *(viewer if name == "viewer" else ()))
        self.start("supervisor", "run", *common, *viewer)

    def said(self, *roles: str) -> str:
        """All that processes of these roles have said; of all, where none is named."""
        return "\n".join(line for _, role, line in list(self.lines) if not roles or role in roles)

    def wait_for(self, text: str, role: str = "supervisor", patience: float = COLD) -> bool:
        """Whether a line that begins so comes before the process ends. Raises RunFailed if neither happens in time."""
        end = time.monotonic() + patience
        while not any(who == role and line.startswith(text) for _, who, line in list(self.lines)):
            if role in self.ended:
                return any(who == role and line.startswith(text) for _, who, line in list(self.lines))
            if time.monotonic() > end:
                raise RunFailed(f"no {text!r} within {patience:g} s: {self.said(role)[-300:]}")
            time.sleep(POLL)
        return True

    def processes(self) -> list[tuple[str, psutil.Process]]:
        """Role and process of all that are alive, also of those whose supervisor was killed."""
        own, found = {child.pid: role for role, child in self.children.items()}, []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                words = process.cmdline()
                if (process.pid in own or self.run in words) and process.status() != psutil.STATUS_ZOMBIE:
                    serving = words[words.index("serve") + 1] if "serve" in words else "other"
                    found.append((own.get(process.pid, serving), process))
        return found

    def find(self, role: str) -> psutil.Process | None:
        """The process of a role; None where it is over, or not yet there."""
        return next((process for name, process in self.processes() if name == role), None)

    def wait_end(self, patience: float = HUNG) -> float:
        """Seconds until no process of the run is left but the router; `patience` where some remain."""
        begin = time.monotonic()
        while left := [process for role, process in self.processes() if role != "router"]:
            while any(map(alive, left)):  # to look through all of a machine's processes takes longer
                if time.monotonic() > begin + patience:
                    return patience
                time.sleep(POLL)
        for role, reader in self._readers.items():
            reader.join(0.0 if role == "router" else 1.0)
        return time.monotonic() - begin

    def code(self, role: str = "supervisor", patience: float = 2.0) -> int | None:
        """Its exit code; None where it goes on. Its threads may outlive its main one by a moment."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.children[role].wait(patience)
        return None

    def stop(self) -> list[str]:
        """Kill whatever is left, the stopped as well; the roles of what was, but for the router."""
        left = self.processes()
        family = [other for _, process in left for other in children_of(process)]  # a viewer has a group of its own
        for process in (*(process for _, process in left), *family):
            kill(process)
        for role, child in self.children.items():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait(10.0)
            self._readers[role].join(10.0)
        return [role for role, _ in left if role != "router"]


def alive(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False


def children_of(process: psutil.Process) -> list[psutil.Process]:
    with contextlib.suppress(psutil.Error):
        return list(process.children(recursive=True))
    return []


def kill(process: psutil.Process) -> None:
    """SIGKILL, which nothing can be done about."""
    with contextlib.suppress(psutil.Error):
        os.kill(process.pid, signal.SIGKILL)


def digests(path: Path) -> Digests:
    """Of every frame of the cloth and of the dye that a recording, whole or cut, holds."""
    with open_recording(path) as recording:
        return [(topic.name, *mark) for topic in (STATUS, DYE_STATUS) for mark in recording.marks(topic.name).values()]


def differing(found: Digests, wanted: Digests) -> int:
    """Frames that are not the same, or missing."""
    return sum(a != b for a, b in zip_longest(found, wanted))


def kept(record: Path) -> Path:
    """The recording, or what there is of it where its recorder could not close it."""
    return record if record.exists() else part_of(record)


def resume(record: Path, target: Path) -> tuple[int, str]:
    """Go on from what was kept, in one process: the exit code, and what it said."""
    words = ["run", "--resume", str(kept(record)), "--record", str(target), "--no-view", "--threads", "1"]
    command = [sys.executable, "-m", "nuno", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=COLD, check=False)
    return done.returncode, done.stderr[-300:]
