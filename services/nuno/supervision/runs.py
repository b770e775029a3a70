"""Runs of this user: their names, where their recordings go, and which are going on, for `nuno control`."""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from nuno_schemas.errors import BadInput, nearest


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
    """Where runs are noted: readable by this user only."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    path = (
        Path(base) / "nuno"
        if base and os.access(base, os.W_OK)
        else Path(tempfile.gettempdir()) / f"nuno-{os.getuid()}"
    )
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    state = path.lstat()
    if path.is_symlink() or state.st_uid != os.getuid() or state.st_mode & 0o077:
        raise BadInput("the folder for running runs is not this user's alone", value=str(path), remedy="remove it")
    return path


@contextmanager
def announced(run: str, endpoint: str, scene: Path | None = None) -> Iterator[None]:
    """Note a run while it goes on, and the file of its scene where that is the user's."""
    path = folder() / f"{run}.json"
    note: dict[str, object] = {"endpoint": endpoint, "pid": os.getpid()}
    path.write_text(json.dumps(note | ({"scene": str(scene.resolve())} if scene is not None else {})))
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def running() -> dict[str, str]:
    """Run id -> endpoint of the runs that are alive, oldest first; notes of dead ones are removed."""
    found = {}
    notes = [(path.stat().st_mtime_ns, path) for path in folder().glob("*.json")]
    for _, path in sorted(notes):
        try:
            note = json.loads(path.read_text())
            pid, endpoint = int(note["pid"]), str(note["endpoint"])
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if psutil.pid_exists(pid):
            found[path.stem] = endpoint
        else:
            path.unlink(missing_ok=True)
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
