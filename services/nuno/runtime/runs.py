"""Runs of this user: names, paths of recordings, the list of active runs, and the last one."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import secrets
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from nuno.process import working_folder
from nuno.recording.writer import part_of
from nuno_schemas.errors import BadInput, nearest

LAST = "last"
"""Name of the last run that began in this folder, or in any if this has none."""
RECORDINGS = Path("recordings")
"""Default folder of recordings."""
RECORDED = "recorded"
"""Folder of notes with the last recording's path for each working folder."""
ATTEMPTS, LOOK_SECONDS = 10, 0.01
"""Attempts and pause [s] of locking a run's note: a program that lists the runs may hold it for a moment."""


def new_id(scene: str) -> str:
    """Return a run's name: the scene's, the start time, and four random hexadecimal digits."""
    return f"{scene}-{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(2)}"


def check_id(run: str) -> str:
    """Return the id. Raises BadInput if it cannot be part of a key and a file's name."""
    if run == LAST or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,127}", run):
        remedy = "use letters, digits, and - _ . after the first; at most 128"
        remedy = f"{LAST} means the last run: choose another" if run == LAST else remedy
        raise BadInput("not a run's name", field="--run", value=run, remedy=remedy)
    return run


def record_path(folder: Path, run: str) -> Path:
    """Return the path of a run's recording. Raises BadInput if the folder cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise BadInput(
            f"the recordings folder cannot be written: {error.strerror}",
            value=str(folder),
            remedy="name another file with --record FILE, or use --no-record",
        ) from None
    return folder / f"{run}.mcap"


def folder() -> Path:
    """Return the folder of notes of runs, readable by this user only. Raises BadInput where there is none."""
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
    """Keep a note of a run while it goes on, with the file of its scene if that is the user's.

    The note is locked meanwhile. Rejected: the process's number, which may be another's after that is killed.
    Raises BadInput where a run of that name goes on, or the note cannot be written.
    """
    note: dict[str, object] = {"endpoint": endpoint, "folder": working_folder()}
    if scene is not None:
        note["scene"] = str(scene.resolve())
    path = folder() / f"{run}.json"
    with _hold(path, json.dumps(note)):
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _hold(path: Path, text: str) -> FileIO:
    """Write a run's note, and lock it for this process. Raises BadInput."""
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
    """Open the note of a new run, locked for this process. Raises BadInput where another run has the lock."""
    for _ in range(ATTEMPTS):
        stream = path.open("ab", buffering=0)
        with suppress(BlockingIOError, FileNotFoundError):
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Between opening and locking, it may have been removed as a dead run's.
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                return stream
        stream.close()
        time.sleep(LOOK_SECONDS)
    raise goes_on(path.stem)


def goes_on(run: str) -> BadInput:
    """Return the error for a name that an active run has."""
    remedy = "wait for its end, or give this one another name with --run"
    return BadInput("a run of that name is going on", field="--run", value=run, remedy=remedy)


def _holds(path: Path) -> bool:
    """Return whether the run of a note goes on; the note of a dead one is removed."""
    with path.open() as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        # The exclusive lock allows the removal, and only of this same file: another program may have removed it, and a
        # run of that name begun since.
        with suppress(BlockingIOError, FileNotFoundError):
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                path.unlink()
    return False


def running() -> dict[str, str]:
    """Return the endpoints of active runs by id, oldest first; notes of dead ones are removed."""
    endpoints = {}
    notes = []
    for path in folder().glob("*.json"):
        with suppress(FileNotFoundError):
            notes.append((path.stat().st_mtime_ns, path))
    for _, path in sorted(notes):
        try:
            if _holds(path):
                endpoints[path.stem] = str(json.loads(path.read_text())["endpoint"])
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return endpoints


def scene_path(run: str) -> Path | None:
    """Return the scene file of an active run; None if it has none, or there is no such run."""
    path = Path(_noted(folder() / f"{run}.json", "scene"))
    return path if path.is_file() else None


def _noted(path: Path, name: str) -> str:
    """Return a text of a note; empty where there is none."""
    try:
        return str(json.loads(path.read_text())[name])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def find(run: str, here: bool = False) -> tuple[str, str]:
    """Return id and endpoint of an active run by id, unique prefix, or "last"; with `here`, the last of this folder.
    Raises BadInput.
    """
    alive = running()
    matches = [run] if run in alive else [name for name in alive if name.startswith(run)]
    if run == LAST:
        begun = [(_noted(folder() / f"{name}.json", "folder"), name) for name in alive]
        matches = _newest([pair for pair in begun if not here or pair[0] == working_folder()])
    if len(matches) != 1:
        problem = "no such run is going on" if not matches else "several runs begin with that"
        remedy = nearest(run, alive) if alive else "start one: nuno run SCENE"
        if not matches:  # cron, systemd and a login have different ones
            remedy += "; one with another XDG_RUNTIME_DIR or TMPDIR is reached by --connect and its endpoint"
        raise BadInput(problem, value=run, limit=f"those noted in {folder()}", remedy=remedy)
    return matches[0], alive[matches[0]]


def _newest(begun: Sequence[tuple[str, str]]) -> list[str]:
    """Return the last of pairs (folder, name) of this folder, or else of all; print which one it is."""
    of_this_folder = [pair for pair in begun if pair[0] == working_folder()]
    for place, name in (of_this_folder or begun)[-1:]:
        print(f"{LAST} is {name}{'' if of_this_folder else f', begun in {place}'}", file=sys.stderr, flush=True)
        return [name]
    return []


def note_recording(path: Path) -> None:
    """Make a recording in progress the `last` of the working folder."""
    here = working_folder()
    notes = folder() / RECORDED
    target = notes / f"{hashlib.sha256(os.fsencode(here)).hexdigest()[:32]}.json"
    new = target.with_suffix(f".{os.getpid()}")
    with suppress(OSError):  # this does not fail a run
        notes.mkdir(exist_ok=True)
        new.write_text(json.dumps({"folder": here, "recording": str(path.resolve())}))
        new.replace(target)


def find_recording(path: Path) -> Path:
    """Return the path, for `last` that of the most recently written recording. Raises BadInput if there is none."""
    if str(path) != LAST:
        return path
    files = [(working_folder(), file) for pattern in ("*.mcap", "*.mcap.part") for file in RECORDINGS.glob(pattern)]
    for note in (folder() / RECORDED).glob("*.json"):
        file = Path(_noted(note, "recording"))
        files += [(_noted(note, "folder"), each) for each in (file, part_of(file))]
    by_time = []
    for place, file in files:
        with suppress(OSError):
            by_time.append((file.stat().st_mtime_ns, place, str(file)))
    newest = _newest([(place, file) for _, place, file in sorted(by_time)])
    if not newest:
        problem, remedy = "no recording is known here", f"name one, or make one: nuno run SCENE (into {RECORDINGS}/)"
        raise BadInput(problem, value=LAST, remedy=remedy)
    return Path(newest[0])
