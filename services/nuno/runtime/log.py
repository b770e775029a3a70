"""The log of a run, by Python's logging: JSON, a line for each record, for other programs.

A record has time (UTC), level, run, service, message and fields. The logger is `nuno.run`: a program
that runs scenes with `nuno.run` can add its own handlers.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from io import TextIOWrapper
from logging.handlers import MemoryHandler
from pathlib import Path
from typing import Any, TextIO

from nuno.process import check_unprotected
from nuno.runtime.outcome import Outcome
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import Event

LOGGER = logging.getLogger("nuno.run")
LOGGER.addHandler(logging.NullHandler())
SUFFIX = ".log.jsonl"
READY = "all services are ready"
LEVELS = {"error": logging.ERROR, "warning": logging.WARNING}


class JsonLines(logging.Formatter):
    """A record as a line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record as JSON, as logging.Formatter."""
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "run": getattr(record, "run", ""),
            "service": getattr(record, "service", ""),
            "message": record.getMessage(),
            "fields": getattr(record, "fields", {}),
        }
        return json.dumps(line, default=str)


def note(
    run: str,
    message: str,
    fields: Mapping[str, Any] | None = None,
    level: int = logging.INFO,
    service: str = "supervisor",
) -> None:
    """Log a message about a run."""
    LOGGER.log(level, "%s", message, extra={"run": run, "service": service, "fields": dict(fields or {})})


def note_start(run: str, loaded: Loaded, services: Sequence[str]) -> None:
    """Log the start of a run: version, scene and its hash, services."""
    data = json.dumps(loaded.data, sort_keys=True, default=str).encode()
    scene: dict[str, Any] = {
        "scene": loaded.scene.name,
        "file": loaded.file,
        "scene_hash": hashlib.sha256(data).hexdigest(),
    }
    note(run, "start", {"version": version("nuno"), "services": services} | scene)


def note_event(run: str, event: Event) -> None:
    """Log an event of a service: control, warning, error, end."""
    fields = {name: value for name, value in event.args.items() if name != "summary"}
    fields |= {"frame": event.frame, "t": event.t}
    note(run, f"{event.kind}: {event.message}", fields, LEVELS.get(event.kind, logging.INFO), event.service)


def note_end(run: str, outcome: Outcome) -> None:
    """Log the end of a run: state, reason, digests."""
    missing = {name: answer["missing"] for name, answer in outcome.services.items() if answer.get("missing")}
    level = logging.ERROR if outcome.problem else logging.INFO
    digests = {name: a["summary"]["digest"] for name, a in outcome.services.items() if "summary" in a}
    facts: dict[str, Any] = {"state": outcome.state, "reason": outcome.problem, "digests": digests, "missing": missing}
    frame = {name: outcome.summary[name] for name in ("frame", "t") if name in outcome.summary}
    note(run, f"end: {outcome.state}", facts | frame | {"seconds": outcome.seconds}, level)


class _Once(logging.StreamHandler[TextIO]):
    """A handler that reports only its first failure: the run needs its recording, not its log."""

    named = "standard output"
    _broken = False

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Report an OSError once, and pass others to logging.Handler."""
        error = sys.exception()
        if not isinstance(error, OSError):
            return super().handleError(record)
        if self._broken:
            return
        self._broken = True
        sys.stderr.write(f"{self.named} is not whole: {error.strerror}\n")


class _File(_Once, logging.FileHandler):
    """A run's log, opened at its first record, and appended to: lines of earlier runs stay, and after logrotate's
    copytruncate the file has no hole.
    """

    def __init__(self, target: Path) -> None:
        self.named = str(target)
        super().__init__(target, "a", "utf-8", delay=True)

    def _open(self) -> TextIOWrapper:
        stream = super()._open()
        if stream.seekable() and stream.tell():  # a full disk may have cut the last line
            with open(self.baseFilename, "rb") as written:
                written.seek(-1, os.SEEK_END)
                stream.write("" if written.read() == b"\n" else "\n")
        return stream

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record; report a file that cannot be opened."""
        try:
            super().emit(record)
        except OSError:  # the file can no longer be opened
            self.handleError(record)

    def close(self) -> None:
        """Close the file; records that could not be written are lost."""
        with contextlib.suppress(OSError):
            super().close()


class _UntilReady(MemoryHandler):
    """Buffers records until the services are ready: a refused run writes no log."""

    ready = False

    def shouldFlush(self, record: logging.LogRecord) -> bool:  # noqa: N802
        """Return whether the services are ready."""
        self.ready = self.ready or record.getMessage() == READY
        return self.ready


def _is_log(path: Path) -> bool:
    with contextlib.suppress(OSError, ValueError, TypeError, RecursionError), path.open("rb") as stream:
        line = stream.readline(2**16)
        return not line or {"time", "level", "run", "message"} <= dict(json.loads(line)).keys()
    return False


@contextlib.contextmanager
def written(run: str, target: Path | None, others: Iterable[Path] = ()) -> Iterator[None]:
    """Append a run's records to a file, or write them to standard output for -, nowhere for None.

    A refused run leaves no file. Raises BadInput where the file cannot be written, is no log, or is one of `others`.
    """
    if target is None:
        yield
        return
    output = _Once(sys.stdout) if str(target) == "-" else _File(target)
    output.setFormatter(JsonLines())
    handler: logging.Handler = output
    if str(target) != "-" and (target.is_file() or not target.exists()):  # a pipe is written immediately
        itself = target.resolve() in [path.resolve() for path in others]
        if itself or (target.is_file() and not _is_log(target)):
            problem = "the run itself uses that file" if itself else "what is there is no log of runs"
            raise BadInput(problem, field="--log", value=str(target), remedy="choose another name with --log FILE")
        check_unprotected(target, "--log")
        try:
            tempfile.TemporaryFile(dir=target.resolve().parent).close()
        except OSError as error:
            remedy = "choose a folder that exists and can be written"
            raise BadInput(f"cannot write there: {error.strerror}", "--log", value=str(target), remedy=remedy) from None
        handler = _UntilReady(0, target=output)
    handler.addFilter(lambda record: getattr(record, "run", "") == run)
    level = LOGGER.level
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.INFO)
    try:
        yield
    except BadInput:
        if isinstance(handler, _UntilReady):
            handler.buffer.clear()
        raise
    finally:
        LOGGER.removeHandler(handler)
        LOGGER.setLevel(level)
        handler.close()
        output.close()
