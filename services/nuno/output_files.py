"""Output files and folders: written next to their target, then moved there; only files of their kind are replaced."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from nuno.process import check_unprotected, scratch
from nuno_schemas.errors import BadInput

T = TypeVar("T")
Progress = Callable[[int, int], None]
"""Called with the number of finished steps and of all steps."""

RATE = 25.0
"""Default rate of an animation [pictures/s]."""
MAGIC: dict[str, tuple[int, bytes]] = {
    ".npz": (0, b"PK\x03\x04"),
    ".csv": (0, b"frame,"),
    ".obj": (0, b"# nuno"),
    ".svg": (0, b'<svg id="nuno-pattern"'),
    ".pdf": (0, b"%PDF"),
    ".ply": (0, b"ply\n"),
    ".glb": (0, b"glTF"),
    ".usdz": (0, b"PK\x03\x04"),
    ".pc2": (0, b"POINTCACHE2"),
    ".mdd": (0, b"\0"),  # the upper byte of the number of frames
    ".png": (0, b"\x89PNG"),
    ".gif": (0, b"GIF8"),
    ".mp4": (4, b"ftyp"),
    ".rrd": (0, b"RRF"),
    ".mcap": (17, b"\0\0\0\0\x0b\0\0\0nuno export"),  # no profile, and the library: a recording has others
    ".py": (0, b'"""Cloth by nuno in Blender'),
    ".yaml": (0, b"# the scene of "),
    ".json": (0, b'{\n "globalVariables": {\n  "nuno"'),
}
"""First bytes of a file of each kind: offset and bytes."""


def following(items: Iterable[T], number: int, progress: Progress | None) -> Iterator[T]:
    """Yield `number` items, and call `progress` after each."""
    for done, item in enumerate(items, 1):
        yield item
        if progress is not None:
            progress(done, number)


def load_extra(names: tuple[str, ...], needs: str, extra: str, instead: str) -> Any:
    """Import modules of an extra of nuno, and return the first. Raises BadInput if they are not installed."""
    try:
        first, *_ = [import_module(name) for name in names]
        return first
    except ImportError:
        remedy = f'install it: pip install "nuno[{extra}]"; or {instead}'
        raise BadInput(f"{needs}, which is not installed", remedy=remedy) from None


def check_target(path: Path, suffix: str) -> None:
    """Raise BadInput for a name of another kind, a missing folder, and an existing file that is not such an export."""
    if path.suffix.lower() != suffix:
        remedy = str(path.parent / f"{path.stem or 'out'}{suffix}")
        raise BadInput(f"the name must end in {suffix}", value=str(path), remedy=remedy)
    if not path.parent.is_dir():
        raise BadInput("no such folder", value=str(path.parent), remedy="make it, or choose another place")
    if path.is_dir():
        raise BadInput("a folder of that name exists", value=str(path), remedy="choose another name")
    if path.exists() and not (path.is_file() and _is_kind(path, suffix)):
        problem = f"the file there is no {suffix[1:]} export and would be lost"
        raise BadInput(problem, value=str(path), remedy="choose another name, or remove it")
    check_unprotected(path)


class _Together(ExitStack):
    """Finished files that wait for others, by their targets, and their temporary folders, by the targets' folders."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: dict[Path, Path] = {}
        self._near: dict[Path, Path] = {}

    def near(self, folder: Path) -> Path:
        """Return the temporary folder for files of a folder. Raises OSError."""
        if folder not in self._near:
            self._near[folder] = self.enter_context(scratch(folder))
        return self._near[folder]


_TOGETHER: ContextVar[_Together | None] = ContextVar("together", default=None)


@contextmanager
def together() -> Iterator[_Together]:
    """Move all files written in the block to their targets at its end, or none if any of them is refused."""
    if (outer := _TOGETHER.get()) is not None:
        yield outer
        return
    with _Together() as files:
        token = _TOGETHER.set(files)
        try:
            yield files
        finally:
            _TOGETHER.reset(token)
        for path, new in files.waiting.items():
            with _disk_errors(path):
                new.replace(path)


@contextmanager
def writing(path: Path, suffix: str) -> Iterator[Path]:
    """Yield a new file for an export of a kind, which replaces `path` if the block succeeds. Raises BadInput."""
    check_target(path, suffix)
    with replacing(path) as new:
        yield new


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a new file, which replaces `path` if the block succeeds, by `together`. Raises BadInput."""
    with together() as files, _disk_errors(path):
        yield (new := files.near(path.parent) / path.name)
        files.waiting[path] = new


def make_folder(path: Path) -> None:
    """Make a missing folder for files written `together`; remove it if it stays empty. Raises BadInput."""
    if not path.is_dir():
        with together() as files, _disk_errors(path):
            path.mkdir()
            files.callback(_remove_empty, path)


def _remove_empty(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.rmdir()


def check_folder(path: Path) -> None:
    """Raise BadInput if a new folder cannot be made: its parent is missing, or the path exists."""
    if path.exists():
        problem, remedy = "something of that name exists", "choose another name, or remove it"
        raise BadInput(problem, value=str(path), remedy=remedy)
    if not path.parent.is_dir():
        raise BadInput("no such folder", value=str(path.parent), remedy="make it, or choose another place")


@contextmanager
def writing_folder(path: Path) -> Iterator[Path]:
    """Yield the path of a new folder, which is moved to `path` if the block succeeds. Raises BadInput."""
    check_folder(path)
    with _disk_errors(path), scratch(path.parent) as near:
        yield (new := near / path.name)
        new.replace(path)


@contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    """Convert errors of the disk to BadInput."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        remedy = "choose a shorter name" if error.errno == errno.ENAMETOOLONG else "choose another place"
        raise BadInput(f"cannot write there: {reason}", value=str(path), remedy=remedy) from None


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
