"""Output files and folders: written beside their place and moved there whole; only files of their kind are replaced."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from nuno.recording.reader import Recording, open_recording
from nuno_schemas.errors import BadInput

Progress = Callable[[int, int], None]
"""Called with the steps done and all steps."""

RATE = 25.0
"""Pictures a second of an animation, unless asked otherwise."""
MAGIC: dict[str, tuple[int, bytes]] = {
    ".npz": (0, b"PK\x03\x04"),
    ".csv": (0, b"frame,"),
    ".obj": (0, b"# nuno"),
    ".svg": (0, b'<svg id="nuno-pattern"'),
    ".pdf": (0, b"%PDF"),
    ".ply": (0, b"ply\n"),
    ".glb": (0, b"glTF"),
    ".usdz": (0, b"PK\x03\x04"),
    ".png": (0, b"\x89PNG"),
    ".gif": (0, b"GIF8"),
    ".mp4": (4, b"ftyp"),
    ".rrd": (0, b"RRF"),
    ".mcap": (17, b"\0\0\0\0\x0b\0\0\0nuno export"),  # no profile, and the library: a recording has others
    ".yaml": (0, b"# the scene of "),
    ".json": (0, b'{\n "globalVariables": {\n  "nuno"'),
}
"""How a file of each kind begins: offset and bytes."""


@contextmanager
def opened(source: Recording | Path | str) -> Iterator[Recording]:
    """A recording that is open already, or the one at a path."""
    if isinstance(source, Recording):
        yield source
    else:
        with open_recording(source) as recording:
            yield recording


def check_target(path: Path, suffix: str) -> None:
    """Raises BadInput for a name of another kind, a missing folder, a file that is no such export."""
    if path.suffix.lower() != suffix:
        raise BadInput(f"the name must end in {suffix}", value=str(path), remedy=str(path.with_suffix(suffix)))
    if not path.parent.is_dir():
        raise BadInput("no such folder", value=str(path.parent), remedy="make it, or choose another place")
    if path.is_dir():
        raise BadInput("a folder of that name exists", value=str(path), remedy="choose another name")
    if path.is_file() and not _is_kind(path, suffix):
        problem = f"the file there is no {suffix[1:]} export and would be lost"
        raise BadInput(problem, value=str(path), remedy="choose another name, or remove it")


_TOGETHER: ContextVar[dict[Path, Path] | None] = ContextVar("together", default=None)
"""Files that wait for others, by their places."""


@contextmanager
def together() -> Iterator[None]:
    """What is written meanwhile takes its place at the end: all of it, or none where a part of it is refused."""
    waiting: dict[Path, Path] = {}
    token = _TOGETHER.set(waiting)
    try:
        yield
        for path, new in waiting.items():
            with _told(path):
                new.replace(path)
    finally:
        _TOGETHER.reset(token)
        for new in waiting.values():
            new.unlink(missing_ok=True)


@contextmanager
def writing(path: Path, suffix: str) -> Iterator[Path]:
    """A new file beside `path`, an export of a kind, which takes its place when all went well. Raises BadInput."""
    check_target(path, suffix)
    with replacing(path, suffix) as new:
        yield new


@contextmanager
def replacing(path: Path, suffix: str = "") -> Iterator[Path]:
    """A new file beside `path`, which takes its place when all went well; see `together`. Raises BadInput."""
    waiting = _TOGETHER.get()
    new = path.with_name(f".{path.stem}.{os.getpid()}.part{suffix}")
    try:
        with _told(path):
            new.open("wb").close()
            yield new
            if waiting is None:
                new.replace(path)
            else:
                waiting[path] = new
    finally:
        if waiting is None or path not in waiting:
            with contextlib.suppress(OSError):  # where nothing can be written, nothing can be removed
                new.unlink(missing_ok=True)


def check_folder(path: Path) -> None:
    """Raises BadInput where a new folder cannot be made: another is missing, or something of its name is there."""
    if path.exists():
        problem, remedy = "something of that name exists", "choose another name, or remove it"
        raise BadInput(problem, value=str(path), remedy=remedy)
    if not path.parent.is_dir():
        raise BadInput("no such folder", value=str(path.parent), remedy="make it, or choose another place")


@contextmanager
def writing_folder(path: Path) -> Iterator[Path]:
    """Where a new folder is to be made, which takes its place when all went well. Raises BadInput."""
    check_folder(path)
    with _told(path), TemporaryDirectory(prefix=f".{path.name}.", suffix=".part", dir=path.parent) as near:
        yield (new := Path(near) / path.name)
        new.replace(path)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Errors of the disk as BadInput."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInput(f"cannot write there: {reason}", value=str(path), remedy="choose another place") from None


def write_png(path: Path, picture: NDArray[np.uint8]) -> Path:
    """Write a picture (height, width, 3) sRGB. Raises BadInput."""
    from PIL import Image

    with writing(path, ".png") as new:
        Image.fromarray(picture).save(new, optimize=True)
    return path


def _is_kind(path: Path, suffix: str) -> bool:
    offset, magic = MAGIC[suffix]
    try:
        with path.open("rb") as stream:
            head = stream.read(offset + len(magic))
    except OSError:
        return False
    return head[offset:] == magic or not head
