"""The cache of compiled kernels between runs: keyed by all that they reach, checked when read, and optional.

By itself numba runs old code where a callee or a constant of another module has changed, fails a run for good where one
of its files was cut short (a power cut, a full disk), fails it where one cannot be written, and where the folder cannot
be made turns to others; and of two processes that compile at once one may be left with the other's code.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import dispatcher as numba_dispatcher
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from nuno_kernels.compile.calling_convention import called_by_address, load_called
from nuno_kernels.compile.dependency_hash import digest_of, is_hashed_by_folder

LOGGER = logging.getLogger("nuno.kernels")
CHECKSUM = 16
"""bytes of the checksum at the end of each file"""


class _Files(IndexDataCacheFile):  # type: ignore[misc]
    """Machine code of one kernel, a file for each kind of arguments, with a checksum at its end; a damaged one is
    ignored.

    A file's name is a hash of all that its code depends on. numba numbers them and keeps an index of the numbers, which
    two processes that compile at once write over each other: one's arguments are then given to the other's code.
    """

    def load(self, key: object) -> Any:
        """Return None if there is none."""
        name = self._name(key)
        return self._load_data(name) if _is_whole(self._data_path(name)) else None

    def save(self, key: object, data: object) -> None:
        """Write atomically. Raises OSError."""
        self._save_data(self._name(key), data)

    def _name(self, key: object) -> str:
        return f"{Path(self._index_name).stem}.{_checksum(repr(key).encode()).hex()}.nbc"

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as stream:
            stream.write(content.getvalue() + _checksum(content.getvalue()))


class _Results(CompileResultCacheImpl):  # type: ignore[misc]
    """Machine code with what it calls by address (nuno_kernels.compile.calling_convention)."""

    def reduce(self, compiled: Any) -> Any:
        return called_by_address(compiled), super().reduce(compiled)

    def rebuild(self, context: Any, saved: Any) -> Any:
        called, payload = saved
        return super().rebuild(context, payload) if load_called(called) else None


class _Cache(FunctionCache):  # type: ignore[misc]
    """The cached signatures of one kernel."""

    _impl_class = _Results
    version = ""
    """which of the kernel's versions"""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, source_stamp=None)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load machine code, by the dependencies before compilation; numba compiles and saves what is not found."""
        self._dependencies = dependencies_of(self._py_func, sig)
        return super().load_overload(sig, target_context)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """Return text, which is the same in each process."""
        names = tuple(f"{kind.__module__}.{kind.__qualname__}" for kind in _classes(sig))
        return (str(sig), names, self.version, *super()._index_key(sig, codegen)[1:], self._dependencies)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save machine code; a kernel that cannot be saved is compiled again by the next run."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _say(self._cache_path, str(error.strerror))


# Functions of third parties with numba's own `cache=True` are in the same folder, and may call kernels, too.
numba_dispatcher.FunctionCache = _Cache  # type: ignore[attr-defined]


def dependencies_of(function: Any, types: Any) -> str:
    """Return the digest of all that a kernel reaches, called with arguments of these types."""
    return digest_of((function, *_called_by_type(types)))


def _called_by_type(types: Any) -> Iterator[Any]:
    """Yield the kernels that are called by arguments' types: those of other packages' terms (nuno_kernels.terms)."""
    for term_class in _classes(types):
        if hasattr(term_class, "kernels") and not is_hashed_by_folder(term_class.__module__):
            yield from term_class.kernels.all()


def _classes(types: Any) -> Iterator[Any]:
    """Yield the classes of named tuples among types, also inside of others."""
    for kind in types:
        if hasattr(kind, "instance_class"):
            yield kind.instance_class
        yield from _classes(getattr(kind, "types", ()))


def keep(dispatcher: Any, folder: Path, version: str = "Python") -> Any:
    """Cache a compiled function in numba's present folder, which is `folder`, as one of a kernel's versions."""
    if _can_be_written(folder):
        dispatcher.enable_caching()
        dispatcher._cache.version = version
    return dispatcher


@cache
def _can_be_written(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        _say(str(folder), str(error.strerror))
        return False
    return True


@cache
def _say(folder: str, why: str) -> None:
    LOGGER.warning("compiled kernels cannot be kept in %s (%s): each run compiles them again", folder, why)


def _is_whole(path: str) -> bool:
    try:
        content = Path(path).read_bytes()
    except OSError:
        return False
    return content[-CHECKSUM:] == _checksum(content[:-CHECKSUM])


def _checksum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=CHECKSUM).digest()
