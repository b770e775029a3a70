"""Arrays of .npz files: their headers first, so that nothing is allocated for a lie, and never a pickle."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput

PACKED_MOST = 1032
"""Deflate makes nothing smaller than one part in so many: a member that says more of itself lies."""
SUFFIX = ".npy"


@dataclass(frozen=True)
class Header:
    """What an array says of itself, and whether the file holds as much."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    held: int
    """Bytes of values that the file holds."""

    def check(self, path: Path, name: str) -> None:
        """Raises BadInput where the file holds less than the header announces."""
        if math.prod(self.shape) * self.dtype.itemsize > self.held:
            problem, limit = "holds less than its header says", f"{self.held} bytes"
            raise BadInput(problem, file=str(path), field=name, value=self.shape, limit=limit)


class NpzFile:
    """An archive of arrays, as numpy.savez writes it."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self.path, self._archive = path, archive
        members = archive.infolist()
        self.names = [member.filename.removesuffix(SUFFIX) for member in members]
        """Of the arrays, in the file's order."""
        size = path.stat().st_size
        for name, member in zip(self.names, members, strict=True):
            if self.names.count(name) > 1 or name == member.filename:
                raise BadInput("two arrays of one name, or no array", file=str(path), field=name)
            most = PACKED_MOST * min(member.compress_size, size) + PACKED_MOST
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or member.file_size > most:
                remedy = "write it with numpy.savez or numpy.savez_compressed"
                raise BadInput("packed in a way that no array is", file=str(path), field=name, remedy=remedy)

    def header(self, name: str) -> Header:
        """Of an array that is there. Raises BadInput for what is no array."""
        with self._reading(name), self._archive.open(name + SUFFIX) as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(stream)
            if any(type(length) is not int or length < 0 for length in shape):
                raise ValueError(f"a shape of {shape}")
            return Header(shape, dtype, self._archive.getinfo(name + SUFFIX).file_size - stream.tell())

    def array(self, name: str) -> NDArray[Any]:
        """An array that is there, whose header was checked. Raises BadInput where it cannot be read."""
        with self._reading(name), self._archive.open(name + SUFFIX) as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # whatever a broken file makes of the decoders, of which there are many
            raise BadInput(f"not a numpy array: {error}", file=str(self.path), field=name) from None


@contextmanager
def open_npz(path: Path) -> Iterator[NpzFile]:
    """An open .npz file. Raises BadInput for one that is none, for two arrays of one name, and what is no array."""
    remedy = "write it with numpy.savez"
    try:
        archive = zipfile.ZipFile(path)
    except Exception as error:  # beside BadZipFile, what an odd version, name or extra field raises
        raise BadInput(f"not a readable .npz file: {error}", file=str(path), remedy=remedy) from None
    with archive:
        yield NpzFile(path, archive)
