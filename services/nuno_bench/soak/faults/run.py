"""A run in processes of their own, which may be killed, one by one."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

from nuno.supervision import runs
from nuno.wire.sessions import free_port
from nuno_schemas.errors import RunFailed

SERVICES = ("simulation", "collision", "dye", "render", "recorder", "viewer")
HUNG = 40.0
"""A run that has not ended this long after a fault hangs [s]."""
POLL = 0.01


def nuno(*words: str | Path) -> list[str]:
    """The command line of one `nuno` command."""
    return [sys.executable, "-m", "nuno", *map(str, words)]


class FaultRun:
    """One run of a scene in a folder: `nuno run`, with threads or processes, or each service started by hand.

    run      its name, by which all its processes can be told from others
    lines    what `nuno run` has said so far, with the time when [s]
    """

    def __init__(
        self, folder: Path, by_hand: bool, services: tuple[str, ...] = SERVICES, threads: bool = False
    ) -> None:
        self.folder, self.by_hand, self.services, self.threads = folder, by_hand, services, threads
        self.run = runs.new_id("faults")
        self.record = folder / f"{self.run}.mcap"
        self.lines: list[tuple[float, str]] = []
        self._hand: list[subprocess.Popen[bytes]] = []
        self.router = f"tcp/127.0.0.1:{free_port()}"

    def start(self) -> None:
        """Start all processes; what the supervisor says is read by a thread."""
        view: list[str | Path] = (
            ["--save", self.folder / f"{self.run}.rrd"] if "viewer" in self.services else ["--no-view"]
        )
        common: list[str | Path] = [
            self.folder / "scene.yaml",
            "--run",
            self.run,
            "--record",
            self.record,
            "--threads",
            "1",
        ]
        if self.by_hand:
            self.start_router()
            common += ["--connect", self.router]
            seen = [n for n in ("dye", "collision", "recorder", "viewer") if n in self.services]
            for name in self.services:
                acks = [word for other in seen for word in ("--must-see", other)]
                more = acks if name in ("simulation", "viewer") else []
                more += [*map(str, view)] if name == "viewer" else []
                self._spawn(nuno("serve", name, *common, *more))
        elif not self.threads:
            common += ["--processes"]
        self.supervisor = subprocess.Popen(
            nuno("run", *common, *view), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def start_router(self) -> None:
        """The hub of a run by hand, at the same port each time."""
        words = nuno("serve", "router", "--listen", self.router)
        router = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True)
        assert router.stdout is not None
        if not router.stdout.readline().startswith(b"router at"):
            raise RunFailed("the router did not start")
        self._hand.append(router)

    def _spawn(self, command: list[str]) -> None:
        quiet = subprocess.DEVNULL
        self._hand.append(subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True))

    def _read(self) -> None:
        assert self.supervisor.stderr is not None
        for line in self.supervisor.stderr:
            self.lines.append((time.monotonic(), line.decode(errors="replace").strip()))

    @property
    def said(self) -> str:
        """All that the supervisor has said."""
        return "\n".join(line for _, line in self.lines)

    def wait_for(self, text: str, patience: float = HUNG) -> bool:
        """Whether a line that begins so comes before the run ends. Raises RunFailed if neither happens in time."""
        end = time.monotonic() + patience
        while not any(line.startswith(text) for _, line in list(self.lines)):
            if self.supervisor.poll() is not None:
                return False
            if time.monotonic() > end:
                raise RunFailed(f"no {text!r} within {patience:g} s: {self.said[-300:]}")
            time.sleep(POLL)
        return True

    def find(self, name: str) -> psutil.Process | None:
        """The process of a service, of the router or of the supervisor; None where it is over, or not yet there."""
        return next((p for p in self.processes() if _role(p) == name), None)

    def processes(self) -> list[psutil.Process]:
        """All processes of this run that are alive."""
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                words = process.cmdline()
                ours = self.run in words or (self.router in words and "router" in words)
                if ours and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
        return found

    def wait_end(self, patience: float = HUNG) -> float:
        """Seconds until no process of the run is left but the router; `patience` where some remain."""
        begin = time.monotonic()
        left = [p for p in self.processes() if _role(p) != "router"]
        while time.monotonic() < begin + patience:
            left = [p for p in left if _alive(p)]
            if not left:
                self._reader.join(1.0)
                return time.monotonic() - begin
            time.sleep(POLL)
        return patience

    @property
    def code(self) -> int | None:
        """The supervisor's exit code; None where it goes on. Its threads may outlive its main one by a moment."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.supervisor.wait(2.0)
        return None

    def stop(self) -> list[str]:
        """End whatever is left; the roles of what was, but for the router."""
        left = self.processes()
        for process in left:
            with contextlib.suppress(psutil.Error):
                process.kill()
        for child in (*self._hand, self.supervisor):
            child.wait(10.0)
            for stream in (child.stdout, child.stderr):
                if stream is not None and child is not self.supervisor:
                    stream.close()
        return [role for role in map(_role, left) if role not in ("router", "gone")]


@contextlib.contextmanager
def started(
    folder: Path, by_hand: bool, services: tuple[str, ...] = SERVICES, threads: bool = False
) -> Iterator[FaultRun]:
    """A run that leaves nothing behind, however the block ends."""
    run = FaultRun(folder, by_hand, services, threads)
    try:
        run.start()
        yield run
    finally:
        run.stop()


def _alive(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


def _role(process: psutil.Process) -> str:
    try:
        words = process.cmdline()
    except psutil.Error:
        return "gone"
    if "serve" in words:
        return words[words.index("serve") + 1]
    return "supervisor" if "run" in words else "other"


def kill(process: psutil.Process) -> None:
    """SIGKILL, which nothing can be done about."""
    with contextlib.suppress(psutil.Error):
        os.kill(process.pid, signal.SIGKILL)


def shared_bytes() -> int:
    """Bytes of shared memory of the bus that no process has open: what killed ones left (0 where there is none)."""
    folder = Path("/dev/shm")
    if not folder.is_dir():
        return 0
    held: set[str] = set()
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            held |= {line.split()[-1] for line in Path(f"/proc/{process.pid}/maps").read_text().splitlines()}
    total = 0
    for path in folder.glob("*.zenoh"):
        with contextlib.suppress(OSError):
            total += path.stat().st_size if str(path) not in held else 0
    return total
