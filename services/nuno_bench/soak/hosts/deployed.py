"""One run on several hosts: every service in a namespace of its own, mutual TLS, a relay on each way to the router."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nuno.access import folder
from nuno.supervision import runs
from nuno.wire.sessions import free_port, spoke
from nuno_bench.soak.hosts.relay import Relay, relay
from nuno_bench.soak.namespaces import Host

SERVICES = ("collision", "simulation", "recorder")
ROLES = (*SERVICES, "supervisor")
READY, END = 300.0, 600.0
"""How long the first frame, and the end of a run, are waited for [s]."""


@dataclass
class Line:
    """What lies between the hosts: seconds each way, and bytes a second (None: all that there is)."""

    delay: float = 0.0
    rate: float | None = None

    def __str__(self) -> str:
        rate = f", {8e-6 * self.rate:g} Mbit/s" if self.rate else ""
        return f"{1e3 * self.delay:g} ms each way{rate}"


@dataclass
class Deployed:
    """A run on hosts while it goes on. `ways` are the relays by role."""

    run: str
    recording: Path
    processes: dict[str, subprocess.Popen[str]]
    ways: dict[str, Relay]
    frame: int = -1
    changed: threading.Condition = field(default_factory=threading.Condition)
    ended: dict[str, float] = field(default_factory=dict)
    """When each process ended (time.monotonic)."""
    words: dict[str, str] = field(default_factory=dict)

    def note(self, sample: Any) -> None:
        """Take in a status of the simulation."""
        with self.changed:
            self.frame += 1
            self.changed.notify_all()

    def wait_for_frame(self, frame: int) -> None:
        """Until the simulation has finished it. Raises TimeoutError."""
        with self.changed:
            if not self.changed.wait_for(lambda: self.frame >= frame, READY):
                raise TimeoutError(f"frame {frame} did not come")

    def wait(self) -> dict[str, int]:
        """Exit codes of all but the router, whose words are then kept. Raises TimeoutError."""
        end = time.monotonic() + END
        running = {name: process for name, process in self.processes.items() if name != "router"}
        while running:
            for name in [name for name, process in running.items() if process.poll() is not None]:
                self.ended[name] = time.monotonic()
                self.words[name] = running.pop(name).communicate()[0]
            if time.monotonic() > end:
                raise TimeoutError(f"still there: {', '.join(running)}")
            time.sleep(0.02)
        return {name: process.returncode for name, process in self.processes.items() if name != "router"}

    @property
    def forwarded(self) -> int:
        """Bytes that went over all ways."""
        return sum(way.forwarded for way in self.ways.values())


@contextmanager
def deployed(where: Path, scene: Path, hosts: list[Host], line: Line) -> Iterator[Deployed]:
    """Start a run of a scene, the router on the first host, a role on each other. Nothing of it is left behind."""
    where.mkdir()
    certs, run, port = where / "certs", runs.new_id("hosts"), free_port()
    first, others = hosts[0], dict(zip(ROLES, hosts[1:], strict=True))
    reached = sorted({first.address, *(host.ours for host in others.values())})
    folder.make(certs, tuple(reached), ["router", *ROLES, "observer"], 1)
    with ExitStack() as stack:
        ways, endpoints = {}, {}
        for role, host in others.items():
            way, (address,) = stack.enter_context(
                relay((first.address, port), [host.ours], line.delay, line.rate),
            )
            ways[role], endpoints[role] = way, f"tls/{address[0]}:{address[1]}"
        state = Deployed(run, where / "hosts.mcap", {}, ways)
        stack.callback(_end_all, state)
        listens = f"tls/{first.address}:{port}"
        _start(state, "router", first, certs, ["serve", "router", "--listen", listens])
        output = state.processes["router"].stdout
        assert output is not None
        if not output.readline().startswith("router at"):
            raise RuntimeError(f"the router did not begin: {output.read()}")
        session = stack.enter_context(spoke(listens, str(certs / "observer.json5")))
        state_of = session.declare_subscriber(f"nuno/{run}/sim/status", state.note)
        for role, host in others.items():
            _start(state, role, host, certs, _words(role, scene, state, endpoints[role]))
        yield state
        state_of.undeclare()


def _words(role: str, scene: Path, state: Deployed, endpoint: str) -> list[str]:
    to = [str(scene), "--run", state.run, "--connect", endpoint]
    record = ["--record", str(state.recording)]
    if role == "supervisor":
        return ["run", *to, *record, "--no-view"]
    more = {"simulation": ["--must-see", "collision", "--must-see", "recorder"], "recorder": record}
    return ["serve", role, *to, *more.get(role, [])]


def _start(state: Deployed, role: str, host: Host, certs: Path, words: list[str]) -> None:
    command = host.command([sys.executable, "-m", "nuno", *words, "--config", str(certs / f"{role}.json5")])
    state.processes[role] = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def _end_all(state: Deployed) -> None:
    for process in state.processes.values():
        process.terminate()
    for process in state.processes.values():
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(10.0)
        if process.poll() is None:
            process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()
