"""Arrays of .npz files: their headers first, so that nothing is allocated for a false one, and never a pickle."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput, nearest

PACKED_MOST = 1032
"""Deflate's largest compression: a member that claims more is false."""
SUFFIX = ".npy"
DTYPES = {"fiu": "float64", "iu": "int32", "b": "bool"}
"""types that arrays are read as, by the kinds of dtype that they may have in the file"""

Spec = tuple[tuple[int | str, ...], str]
"""an array's shape, unknown lengths as letters, and the kinds of dtype that it may have"""


@dataclass(frozen=True)
class Header:
    """An array's shape and type by its header, and whether the file holds as much."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    held: int
    """bytes of values that the file holds"""

    def check(self, path: Path, name: str) -> None:
        """Raise BadInput if the file holds less than the header announces."""
        if math.prod(self.shape) * self.dtype.itemsize > self.held:
            problem, limit = "holds less than its header says", f"{self.held} bytes"
            raise BadInput(problem, file=str(path), field=name, value=self.shape, limit=limit)


class NpzFile:
    """An archive of arrays, as numpy.savez writes it."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self.path, self._archive = path, archive
        members = archive.infolist()
        self.names = [member.filename.removesuffix(SUFFIX) for member in members]
        """names of the arrays, in the file's order"""
        size = path.stat().st_size
        for name, member in zip(self.names, members, strict=True):
            if self.names.count(name) > 1 or name == member.filename:
                raise BadInput("two arrays of one name, or no array", file=str(path), field=name)
            most = PACKED_MOST * min(member.compress_size, size) + PACKED_MOST
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or member.file_size > most:
                remedy = "write it with numpy.savez or numpy.savez_compressed"
                raise BadInput("packed in a way that no array is", file=str(path), field=name, remedy=remedy)

    def header(self, name: str) -> Header:
        """Return the header of an array. Raises BadInput for another kind of member."""
        with self._reading(name), self._archive.open(name + SUFFIX) as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(stream)
            if any(type(length) is not int or length < 0 for length in shape):
                raise ValueError(f"a shape of {shape}")
            return Header(shape, dtype, self._archive.getinfo(name + SUFFIX).file_size - stream.tell())

    def require(self, needed: Iterable[str], known: Iterable[str]) -> None:
        """Raise BadInput for a missing array, and for one that is neither required nor optional."""
        needed, known = list(needed), list(known)
        for name in needed:
            if name not in self.names:
                remedy = f"the file needs {', '.join(needed)}"
                raise BadInput("an array is missing", file=str(self.path), field=name, remedy=remedy)
        for name in self.names:
            if name not in known:
                raise BadInput("unknown array", file=str(self.path), field=name, remedy=nearest(name, known))

    def sizes(self, specs: Mapping[str, Spec]) -> dict[str, int]:
        """Return the values of the letters in the shapes of the arrays, from the headers alone.

        Raises BadInput for a wrong dtype or shape, and a header that announces more than the file holds.
        """
        sizes: dict[str, int] = {}
        for name in (name for name in specs if name in self.names):
            (wanted, kinds), header = specs[name], self.header(name)
            shape = header.shape
            if header.dtype.kind not in kinds and 0 not in shape:
                limit = DTYPES[kinds]
                raise BadInput("wrong dtype", file=str(self.path), field=name, value=str(header.dtype), limit=limit)
            known = tuple(sizes.get(str(length), length) for length in wanted)
            if len(shape) != len(known) or any(a != b for a, b in zip(known, shape, strict=True) if isinstance(a, int)):
                limit = f"({', '.join(map(str, known))}{',' if len(known) == 1 else ''})"
                raise BadInput("wrong shape", file=str(self.path), field=name, value=shape, limit=limit)
            header.check(self.path, name)
            sizes |= {str(a): b for a, b in zip(known, shape, strict=True) if not isinstance(a, int)}
        return sizes

    def arrays(
        self, specs: Mapping[str, Spec], below: Mapping[str, tuple[int, str]] | None = None
    ) -> dict[str, NDArray[Any]]:
        """Return the arrays, whose headers were checked, C-contiguous and of the types in DTYPES; pickles are never
        read. `below` gives the bound of an array of indices, and the problem beyond it.

        Raises BadInput for an array that cannot be read, and an index out of range.
        """
        found: dict[str, NDArray[Any]] = {}
        for name in (name for name in specs if name in self.names):
            with self._reading(name), self._archive.open(name + SUFFIX) as stream:
                array = np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
            kinds, (number, problem) = specs[name][1], (below or {}).get(name, (2**31, "not an index"))
            if kinds == "iu" and array.dtype.kind in kinds:
                limit = f"0 to {number - 1}" if number else "there is none"
                require_values(self.path, name, array, (array >= 0) & (array < number), problem, limit)
            found[name] = np.ascontiguousarray(array, DTYPES[kinds])
        return found

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # broken files make the many decoders raise anything
            raise BadInput(f"not a numpy array: {error}", file=str(self.path), field=name) from None


def require_values(
    path: Path, name: str, values: NDArray[Any], good: NDArray[np.bool_], problem: str, limit: str,
    remedy: str | None = None,
) -> None:  # fmt: skip
    """Raise BadInput that names the array and the index of the first bad value."""
    bad = np.argwhere(~good)
    if bad.size:
        index = tuple(int(i) for i in bad[0])
        field, value = f"{name}[{', '.join(map(str, index))}]", values[index].item()
        raise BadInput(problem, file=str(path), field=field, value=value, limit=limit, remedy=remedy)


@contextmanager
def open_npz(path: Path) -> Iterator[NpzFile]:
    """Open an .npz file. Raises BadInput for another file, two arrays of one name, and a member that is no array."""
    remedy = "write it with numpy.savez"
    try:
        archive = zipfile.ZipFile(path)
    except Exception as error:  # BadZipFile, and the errors of an odd version, name or extra field
        raise BadInput(f"not a readable .npz file: {error}", file=str(path), remedy=remedy) from None
    with archive:
        yield NpzFile(path, archive)
