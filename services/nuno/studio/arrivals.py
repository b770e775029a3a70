"""Files that are dropped on the page: stored in the folder under an unused name, or refused."""

from __future__ import annotations

import filecmp
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import fields
from io import BufferedIOBase
from pathlib import Path
from typing import TypeVar

from nuno.studio.file_summary import KINDS
from nuno_schemas.errors import BadInput

MOST = 2_000_000_000
"""Largest file [bytes]."""
PIECE = 1 << 20
SPARE = 200_000_000
"""Space that must stay free on the disk [bytes]."""
STEM = 60
"""Largest number of characters of a name, without its ending."""
Made = TypeVar("Made")


class Arrivals:
    """Stores files in a folder; those with an ending in `elsewhere` in the folder given there."""

    def __init__(self, folder: Path, elsewhere: dict[str, Path]) -> None:
        self.folder, self.elsewhere = folder, elsewhere

    def expect(self, name: object, size: object) -> str:
        """Return the name that a file will get. Raises BadInput for a file that will be refused."""
        if not isinstance(name, str) or not isinstance(size, int):
            raise BadInput("a file has a name and a size", field="name")
        stem, ending = os.path.splitext(name.replace("\\", "/").rpartition("/")[2])
        if ending.lower() not in KINDS:
            kinds = ", ".join(sorted(KINDS))
            raise BadInput("nuno reads no files of this kind", value=name[:100], limit=kinds)
        if not 0 < size <= MOST:
            raise BadInput("empty, or too large", name[:100], value=f"{size} bytes", limit=f"1 to {MOST} bytes")
        free = shutil.disk_usage(self.folder).free
        if size > free - SPARE:
            raise BadInput("there is no room for it on the disk", name[:100], value=f"{size} bytes",
                           limit=f"{max(0, free - SPARE)} bytes")  # fmt: skip
        # Letters of any script; not the first characters of a path, a hidden file or a flag.
        stem = re.sub(r"[^\w. ()+-]", "-", stem)[:STEM].strip(" .-") or "file"
        return stem + ending.lower()

    def receive(
        self, name: str, stream: BufferedIOBase, length: int, look: Callable[[Path], Made]
    ) -> tuple[Path, Made]:
        """Store a file from a stream, and return its path and the result of `look`, which may refuse it.

        A file that exists already, with the same name and bytes, is not stored again. Raises BadInput.
        """
        name = self.expect(name, length)
        folder = self.elsewhere.get(Path(name).suffix, self.folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # In the same folder, so that the move is atomic; under its own name, which errors mention.
            with tempfile.TemporaryDirectory(dir=folder, prefix=".nuno-") as temporary:
                path = Path(temporary) / name
                _copy(stream, path, length)
                result = _look_at(look, path)
                target = reserve(folder, name, path)
                if not target.stat().st_size:
                    path.replace(target)
                return target, result
        except OSError as error:
            raise BadInput(f"cannot be written: {error.strerror}", name) from None


def _look_at(look: Callable[[Path], Made], path: Path) -> Made:
    """Return `look(path)`; errors name the file without its temporary folder."""
    try:
        return look(path)
    except BadInput as error:
        values = {one.name: getattr(error, one.name) for one in fields(error)}
        for place in (str(path.resolve()), str(path)):
            values = {
                key: text.replace(place, path.name) if isinstance(text, str) else text for key, text in values.items()
            }
        raise BadInput(**values) from None


def _copy(stream: BufferedIOBase, path: Path, length: int) -> None:
    """Copy `length` bytes of a stream to a file. Raises BadInput if the stream ends before."""
    with path.open("xb") as file:
        while length:
            piece = stream.read(min(PIECE, length))
            if not piece:
                raise BadInput("it broke off on its way", path.name, remedy="drop it again")
            file.write(piece)
            length -= len(piece)


def reserve(folder: Path, name: str, like: Path | None = None) -> Path:
    """Create an empty file of an unused name, if necessary with a number after its stem; or return an existing file of
    such a name with the same bytes as `like`. Raises OSError.
    """
    stem, ending = os.path.splitext(name)
    number = 1
    while True:
        path = folder / (name if number == 1 else f"{stem}-{number}{ending}")
        try:
            path.open("xb").close()
            return path
        except FileExistsError:
            if like is not None and path.is_file() and filecmp.cmp(path, like, shallow=False):
                return path
            number += 1
