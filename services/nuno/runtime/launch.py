"""Launch of a run's services: as threads of this process, or as separate processes."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import zenoh

from nuno.bus.health import Watch
from nuno.runtime.plan import Plan
from nuno.runtime.service import Options, run_service
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput, RunFailed

LINGER = 0.3
"""Longest wait for the end of services that are not ready, once they are no longer needed [s]."""
FINISH_TIMEOUT = 30.0
"""Longest wait for a service's end after the query to finish [s]."""


@contextlib.contextmanager
def threads(
    loaded: Loaded, options: Options, plan: Plan, session: zenoh.Session, run: str, watch: Watch
) -> Iterator[Callable[[], dict[str, str]]]:
    """Run all services as threads of this process. One that was never alive may be compiling; nothing waits for it."""
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
    for thread in threads:
        thread.start()
    try:
        yield lambda: dict(ended)
    finally:
        # The session closes after this, and no thread may use it then.
        stop.set()
        end = time.monotonic() + LINGER
        for thread in threads:
            ready = thread.name in watch.alive() or watch.gone(thread.name)
            thread.join(FINISH_TIMEOUT if ready else max(0.0, end - time.monotonic()))


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
        for name, child in started.items():
            if name not in watch.alive() and not watch.gone(name):
                child.terminate()  # it may still import or compile, and has nothing to finish
        _end(list(started.values()))


def _end(children: Sequence[subprocess.Popen[bytes]]) -> None:
    """Wait until all have ended, the recorder with its file closed; kill the rest after the timeout."""
    try:
        # A service that was ready only after the run's failure has never seen a supervisor, and would wait for one.
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
