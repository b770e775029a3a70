"""Plan of a run's services, and their launch: as threads of this process, or as separate processes."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import zenoh

from nuno.bus.health import Watch
from nuno.plugin_contract import containment
from nuno.runtime.service import Options, run_service
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput, RunFailed

LINGER = 0.3
"""Longest wait for the end of services that are not ready, once they are no longer needed [s]."""
PARTING = 1.0
"""Longest wait for processes that are not ready to end by themselves, in which they name what holds them [s]."""
SWITCH_INTERVAL = 5e-4
"""Longest time that a thread keeps Python's lock while others wait for it [s]. By Python's own 5 ms a run of 5 s takes
7 % longer; a tenth of this gains nothing more."""
USUAL_INTERVAL = sys.getswitchinterval()
"""The same between runs: of two at once, the one that began later would otherwise leave the other's behind."""
FINISH_TIMEOUT = 30.0
"""Longest wait for a service's end after the query to finish [s]."""


@contextlib.contextmanager
def threads(
    loaded: Loaded, options: Options, plan: Plan, session: zenoh.Session, run: str, watch: Watch
) -> Iterator[Callable[[], dict[str, str]]]:
    """Run all services as threads of this process. One that was never alive may be compiling; nothing waits for it.

    Meanwhile threads hand over Python's lock sooner than usual: the solver needs it a few times in each frame, and
    another service that measures bodies or writes would keep it each time.
    """
    ended: dict[str, str] = {}
    stop = threading.Event()

    def run_one(name: str) -> None:
        try:
            run_service(name, loaded, session, run, options, stop)
            ended[name] = ""
        except (BadInput, RunFailed) as error:
            ended[name] = str(error)
        except BaseException as error:  # the supervisor waits for any error's text
            ended[name] = f"{type(error).__name__}: {error}"

    threads = [threading.Thread(target=run_one, args=(name,), name=name, daemon=True) for name in plan.services]
    sys.setswitchinterval(min(USUAL_INTERVAL, SWITCH_INTERVAL))
    for thread in threads:
        thread.start()
    try:
        yield lambda: dict(ended)
    finally:
        sys.setswitchinterval(USUAL_INTERVAL)
        # The session closes after this, and no thread may use it then.
        stop.set()
        end = time.monotonic() + LINGER
        for thread in threads:
            ready = thread.name in watch.alive() or watch.gone(thread.name)
            thread.join(FINISH_TIMEOUT if ready else max(0.0, end - time.monotonic()))
        containment.end_calls(run, LINGER)


@contextlib.contextmanager
def processes(
    loaded: Loaded, options: Options, plan: Plan, endpoint: str, run: str, watch: Watch, config: str | None = None
) -> Iterator[Callable[[], dict[str, str]]]:
    """Run each service as a process. `config` is the zenoh configuration of the hub at `endpoint`, for its spokes.

    Each has the other end of a pipe: the system closes it at any end of this process, which the service notices.
    """
    started: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name in plan.services:
            command = serve_command(name, loaded, options, endpoint, run, config)
            started[name] = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
        yield lambda: {name: _exit(code) for name, child in started.items() if (code := child.poll()) is not None}
    finally:
        unready = started.keys() - watch.alive()
        _end(list(started.values()), [started[name] for name in unready if not watch.gone(name)])


def _end(children: Sequence[subprocess.Popen[bytes]], unready: Sequence[subprocess.Popen[bytes]]) -> None:
    """Wait until all have ended, the recorder with its file closed; kill the rest after the timeout."""
    try:
        # A service that was ready only after the run's failure has never seen a supervisor, and would wait for one.
        for child in children:
            assert child.stdin is not None
            child.stdin.close()
        end = time.monotonic() + PARTING
        for child in unready:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(max(0.0, end - time.monotonic()))
            child.terminate()  # it may still import or compile, and has nothing to finish
        end = time.monotonic() + FINISH_TIMEOUT
        for child in children:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(max(0.0, end - time.monotonic()))
    finally:
        for child in children:
            if child.poll() is None:
                child.kill()
            child.wait()


def _exit(code: int) -> str:
    """Return how a process ended, in words."""
    return f"exit code {code}" if code >= 0 else f"ended by {signal.Signals(-code).name}"


def serve_command(
    name: str, loaded: Loaded, options: Options, endpoint: str, run: str, config: str | None = None
) -> list[str]:
    """Return the command that runs one service; -P keeps the working folder's modules from shadowing others."""
    command = [sys.executable, "-P", "-m", "nuno", "serve", name, str(loaded.path), "--run", run, "--connect", endpoint]
    flags: list[tuple[str, object]] = [("--set", item) for item in loaded.overrides]
    flags += [("--root", root) for root in loaded.files.roots]
    flags += [("--must-see", service) for service in options.must_see]
    flags += [(f"--{name}", getattr(options, name)) for name in ("record", "save", "view", "resume")]
    flags += [("--config", config), ("--named", loaded.file)]
    for flag, value in flags:
        if value is not None:
            command += [flag, str(value)]
    command += ["--real-time"] if options.real_time else []
    return [*command, "--threads", str(options.threads), "--quiet", "--lifeline"]


# The services of a scene's run, and the features left out with their reasons, decided before anything starts.


@dataclass(frozen=True)
class Plan:
    """Services of a run, and features left out."""

    services: tuple[str, ...]
    must_see: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def leader(self) -> str:
        """The stepping service that sets the pace, answers control requests and ends the run."""
        return self.services[0]


def make_plan(loaded: Loaded, options: Options) -> Plan:
    """Choose the services for a scene and the user's options."""
    scene = loaded.scene
    # Each with whether it is needed, and the text if it is not.
    services = [
        ("simulation", scene.moves, "simulation and collision services: nothing in the scene moves"),
        ("dye", scene.dye is not None, ""),
        (
            "collision",
            bool(scene.bodies or scene.meets),
            "collision service and contact force: the scene has no bodies",
        ),
        ("render", scene.view.pictures is not None, "render service: view.pictures is not given"),
        ("recorder", options.record is not None, "recorder: not asked for"),
        ("viewer", bool(options.view or options.save), "viewer: no screen, or not asked for"),
    ]
    parts = [
        ("cloth", bool(scene.objects), "cloth, and all that acts on it: the scene has no objects"),
        ("forces", bool(scene.forces), "wind and other forces: the scene names none"),
        ("damping", bool(scene.damping), "viscous damping: 0"),
        ("bodies", bool(scene.bodies) or not scene.meets, "contact with bodies: the scene has none"),
        ("cloth", scene.meets, "contact of cloth with cloth, which passes through: cloth_contact is not given"),
        ("gravity", any(scene.gravity), "gravity: 0"),
        ("dye", bool(scene.dye), "dye: the scene has none"),
        ("operations", bool(scene.operations), "wrinkles: the scene has none"),
    ]
    if not scene.moves:  # nothing acts on cloth that is only dyed
        services, parts = [service for service in services if service[0] != "collision"], []
    chosen = tuple(name for name, needed, _ in services if needed)
    # A window may skip frames; a file may not. No service waits for the leader.
    lockstep = {"dye", "collision", "recorder", *(["viewer"] if options.save else [])}
    must_see = tuple(name for name in chosen[1:] if name in lockstep)
    return Plan(chosen, must_see, tuple(text for _, needed, text in (*services, *parts) if not needed and text))
