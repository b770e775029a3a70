"""Files that are dropped on the page: taken into the folder under a name of their own, or refused."""

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
"""Of a file [bytes]."""
PIECE = 1 << 20
SPARE = 200_000_000
"""What is to be left free on the disk [bytes]."""
STEM = 60
"""Characters of a name that are kept, beside its ending."""
Made = TypeVar("Made")


class Arrivals:
    """Takes files into a folder; those of `elsewhere`, by their endings, into others."""

    def __init__(self, folder: Path, elsewhere: dict[str, Path]) -> None:
        self.folder, self.elsewhere = folder, elsewhere

    def expect(self, name: object, size: object) -> str:
        """The name that a file may have here. Raises BadInput for one that is not to be sent."""
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
        # Letters of any script; nothing that a path, a hidden file or a flag begins with.
        stem = re.sub(r"[^\w. ()+-]", "-", stem)[:STEM].strip(" .-") or "file"
        return stem + ending.lower()

    def receive(
        self, name: str, stream: BufferedIOBase, length: int, look: Callable[[Path], Made]
    ) -> tuple[Path, Made]:
        """Take a file from a stream; where it is now, and what was seen of it: what `look` refuses is not kept.

        One that is here already, byte by byte and under its name, is taken for that. Raises BadInput.
        """
        name = self.expect(name, length)
        folder = self.elsewhere.get(Path(name).suffix, self.folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # Beside its place, so that it gets there whole; by its own name, which what is said of it has.
            with tempfile.TemporaryDirectory(dir=folder, prefix=".nuno-") as aside:
                path = Path(aside) / name
                _copy(stream, path, length)
                found = _looked(look, path)
                there = reserve(folder, name, path)
                if not there.stat().st_size:
                    path.replace(there)
                return there, found
        except OSError as error:
            raise BadInput(f"cannot be written: {error.strerror}", name) from None


def _looked(look: Callable[[Path], Made], path: Path) -> Made:
    """What is seen of a file; errors call it by its name alone, since nobody knows where it lies meanwhile."""
    try:
        return look(path)
    except BadInput as error:
        said = {one.name: getattr(error, one.name) for one in fields(error)}
        for place in (str(path.resolve()), str(path)):
            said = {
                key: text.replace(place, path.name) if isinstance(text, str) else text for key, text in said.items()
            }
        raise BadInput(**said) from None


def _copy(stream: BufferedIOBase, path: Path, length: int) -> None:
    """Raises BadInput where fewer bytes come than were announced."""
    with path.open("xb") as file:
        while length:
            piece = stream.read(min(PIECE, length))
            if not piece:
                raise BadInput("it broke off on its way", path.name, remedy="drop it again")
            file.write(piece)
            length -= len(piece)


def reserve(folder: Path, name: str, like: Path | None = None) -> Path:
    """A new, empty file of a name that nothing had, with a number behind its stem where something has; or on the way
    there one that is `like` another, byte by byte. Raises OSError.
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
