"""Runs of this user: their names, where their recordings go, and which are going on, for `nuno control`."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import secrets
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from nuno_schemas.errors import BadInput, nearest

ATTEMPTS, LOOK_SECONDS = 10, 0.01
"""How often a run tries to hold its note: whoever looks which runs go on may hold it for a moment."""


def new_id(scene: str) -> str:
    """A run's name: the scene's, when it began, and four hexadecimal digits that no other has."""
    return f"{scene}-{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(2)}"


def check_id(run: str) -> str:
    """The same id. Raises BadInput where it could not be part of a key and a file's name."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,127}", run):
        remedy = "use letters, digits, and - _ . after the first; at most 128"
        raise BadInput("not a run's name", field="--run", value=run, remedy=remedy)
    return run


def record_path(folder: Path, run: str) -> Path:
    """Where a run's recording goes. Raises BadInput if the folder cannot be written."""
    try:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "it is a file")
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".{run}.probe"
        probe.write_text(json.dumps(run))
        probe.unlink()
    except OSError as error:
        raise BadInput(
            f"the recordings folder cannot be written: {error.strerror}",
            value=str(folder),
            remedy="name another file with --record FILE, or use --no-record",
        ) from None
    return folder / f"{run}.mcap"


def folder() -> Path:
    """Where runs are noted: readable by this user only. Raises BadInput where there is none."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    try:
        path = (
            Path(base) / "nuno"
            if base and os.access(base, os.W_OK)
            else Path(tempfile.gettempdir()) / f"nuno-{os.getuid()}"
        )
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        problem = f"there is no folder for running runs: {error.strerror}"
        raise BadInput(problem, remedy="name one that can be written in XDG_RUNTIME_DIR") from None
    state = path.lstat()
    if path.is_symlink() or state.st_uid != os.getuid() or state.st_mode & 0o077:
        raise BadInput("the folder for running runs is not this user's alone", value=str(path), remedy="remove it")
    return path


@contextmanager
def announced(run: str, endpoint: str, scene: Path | None = None) -> Iterator[None]:
    """Note a run while it goes on, and the file of its scene where that is the user's.

    The note is locked meanwhile. Its process's number would not do: once that has been killed, it may be another's.
    Raises BadInput where a run of that name goes on, or the note cannot be written.
    """
    note: dict[str, object] = {"endpoint": endpoint}
    if scene is not None:
        note["scene"] = str(scene.resolve())
    path = folder() / f"{run}.json"
    with _hold(path, json.dumps(note)):
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _hold(path: Path, text: str) -> FileIO:
    """A run's note, written and held by this process alone. Raises BadInput."""
    stream = None
    try:
        stream = _lock(path)
        stream.truncate(0)
        stream.write(text.encode())
    except OSError as error:
        if stream is not None:
            path.unlink(missing_ok=True)
            stream.close()
        remedy = "make room there, or name another folder in XDG_RUNTIME_DIR"
        raise BadInput(f"the run cannot be noted: {error.strerror}", value=str(path), remedy=remedy) from None
    return stream


def _lock(path: Path) -> FileIO:
    """The note of a run that begins, held by this process alone. Raises BadInput where another run holds it."""
    for _ in range(ATTEMPTS):
        stream = path.open("ab", buffering=0)
        with suppress(BlockingIOError, FileNotFoundError):
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # In between it may have been taken for a dead run's and removed.
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                return stream
        stream.close()
        time.sleep(LOOK_SECONDS)
    raise goes_on(path.stem)


def goes_on(run: str) -> BadInput:
    """What is said where another run has that name."""
    remedy = "wait for its end, or give this one another name with --run"
    return BadInput("a run of that name is going on", field="--run", value=run, remedy=remedy)


def _holds(path: Path) -> bool:
    """Whether the run of a note goes on; the note of a dead one is removed."""
    with path.open() as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        # Only whoever holds it alone may remove it, and only while it is this note that stands there: another's look
        # may have removed it, and a run of that name begun since.
        with suppress(BlockingIOError, FileNotFoundError):
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                path.unlink()
    return False


def running() -> dict[str, str]:
    """Run id -> endpoint of the runs that are alive, oldest first; notes of dead ones are removed."""
    found = {}
    notes = []
    for path in folder().glob("*.json"):
        with suppress(FileNotFoundError):
            notes.append((path.stat().st_mtime_ns, path))
    for _, path in sorted(notes):
        try:
            if _holds(path):
                found[path.stem] = str(json.loads(path.read_text())["endpoint"])
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return found


def scene_path(run: str) -> Path | None:
    """The file that a run going on has its scene from; None where there is none, or no such run."""
    try:
        path = Path(json.loads((folder() / f"{run}.json").read_text())["scene"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return path if path.is_file() else None


def find(run: str) -> tuple[str, str]:
    """A running run by id, unique prefix, or "last". Raises BadInput."""
    alive = running()
    matches = [run] if run in alive else [name for name in alive if name.startswith(run)]
    if run == "last":
        matches = list(alive)[-1:]
    if len(matches) != 1:
        problem = "no such run is going on" if not matches else "several runs begin with that"
        raise BadInput(problem, value=run, remedy=nearest(run, alive) if alive else "start one: nuno run SCENE")
    return matches[0], alive[matches[0]]
