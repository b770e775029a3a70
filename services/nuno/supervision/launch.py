"""Where a run's services run: threads of this process, or processes of their own."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import zenoh

from nuno.bus.liveliness import Watch
from nuno.scene.scene_file import Loaded
from nuno.service import Options, run_service
from nuno.supervision.plan import Plan
from nuno_schemas.errors import BadInput, RunFailed

LINGER = 0.3
"""How long services that are not ready may take to end once they are not needed any more [s]."""
FINISH_TIMEOUT = 30.0
"""How long a service may take to end when it is asked to [s]."""


@contextlib.contextmanager
def threads(
    loaded: Loaded, options: Options, plan: Plan, session: zenoh.Session, run: str, watch: Watch
) -> Iterator[Callable[[], dict[str, str]]]:
    """All services as threads of this process. One that was never alive may be compiling, and is not waited for."""
    over: dict[str, str] = {}
    stop = threading.Event()

    def body(name: str) -> None:
        try:
            run_service(name, loaded, session, run, options, stop)
            over[name] = ""
        except (BadInput, RunFailed) as error:
            over[name] = str(error)
        except BaseException as error:  # whatever it is, the supervisor waits for a word
            over[name] = f"{type(error).__name__}: {error}"

    threads = [threading.Thread(target=body, args=(name,), name=name, daemon=True) for name in plan.services]
    for thread in threads:
        thread.start()
    try:
        yield lambda: dict(over)
    finally:
        # The session closes after this; a thread must not be using it then.
        stop.set()
        end = time.monotonic() + LINGER
        for thread in threads:
            ready = thread.name in watch.alive() or watch.gone(thread.name)
            thread.join(FINISH_TIMEOUT if ready else max(0.0, end - time.monotonic()))


@contextlib.contextmanager
def processes(
    loaded: Loaded, options: Options, plan: Plan, endpoint: str, run: str, config: str | None = None
) -> Iterator[Callable[[], dict[str, str]]]:
    """One process per service. `config` is the zenoh configuration of the hub at `endpoint`, for its spokes.

    Each holds the other end of a pipe: however this process ends, the system closes it, and the service knows.
    """
    children: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name in plan.services:
            command = serve_command(name, loaded, options, endpoint, run, config)
            children[name] = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
        yield lambda: {name: _exit(code) for name, child in children.items() if (code := child.poll()) is not None}
    finally:
        _end(list(children.values()))


def _end(children: Sequence[subprocess.Popen[bytes]]) -> None:
    """Wait until all have ended, the recorder with its file closed; kill what is left when their time is over."""
    try:
        # Whoever was ready only after the run had failed has never seen a supervisor, and would wait for one.
        for child in children:
            assert child.stdin is not None
            child.stdin.close()
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
    """How a process ended, in words."""
    return f"exit code {code}" if code >= 0 else f"ended by {signal.Signals(-code).name}"


def serve_command(
    name: str, loaded: Loaded, options: Options, endpoint: str, run: str, config: str | None = None
) -> list[str]:
    """The command line that runs one service; a module of the working folder must not stand in for one of ours (-P)."""
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
