"""The cache of compiled kernels between runs: keyed by all functions, constants and sources that they reach, checked
when read, and optional.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import logging
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core import dispatcher as numba_dispatcher
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from nuno_kernels.compilation.calling_convention import called_by_address, load_called

# A compiled function's dependencies, all functions, constants and sources that it reaches, as one digest.
#
# Compiling freezes callees and globals into the machine code. By itself numba knows a kept function by its own file
# alone, and goes on with old code where a callee in another module, or a constant from there, has changed.

SOLVERS = ("nuno_kernels", "nuno_geometry", "nuno_integrators", "nuno_contact", "nuno_dye", "nuno_wrinkle")
"""packages whose kernels call each other throughout: the cache's folder carries a hash of all their sources"""
HASHED_BY_FOLDER = frozenset(sys.stdlib_module_names) | {"numpy", "numba", "llvmlite"} | frozenset(SOLVERS)
"""packages that this folder stands for; it carries the versions of libraries"""
PLAIN = (int, float, complex, str, bytes, type(None), type(...))


def digest_of(function: Any) -> str:
    """Return a digest of the code of `function`, of each function and constant that it reaches by a global name, an
    attribute of a module or a closure, and of the sources in the folders that those are defined in.

    The sources cover what no name leads to: overloads, and the compilation of types of one's own. Those that lie in a
    folder of their own, away from all functions that use them, are not seen.
    """
    digest = hashlib.sha256()
    seen: dict[int, object] = {}  # keeps them alive, so that no two have one id
    waiting: list[tuple[object, tuple[str, ...]]] = [(function, ())]
    while waiting:
        value, names = waiting.pop()
        if isinstance(value, ModuleType):
            if not is_hashed_by_folder(value.__name__):
                waiting += [(vars(value)[name], names) for name in names if name in vars(value)]
        elif isinstance(value, PLAIN):
            digest.update(repr(value).encode() + b"\0")
        elif id(value) not in seen:
            seen[id(value)] = value
            text, more = _parts(value)
            digest.update(text + b"\0")
            waiting += more
    return digest.hexdigest()


def _parts(value: Any) -> tuple[bytes, list[tuple[object, tuple[str, ...]]]]:
    """Return one object's content to digest, and the objects that it leads to, with names to look up in modules."""
    if isinstance(value, np.ndarray | np.generic):
        return repr((value.dtype, value.shape)).encode() + value.tobytes(), []
    if isinstance(value, tuple | list):
        return repr((type(value).__qualname__, len(value))).encode(), [(item, ()) for item in value]
    python = _python_of(value)
    module = getattr(python, "__module__", None) or type(python).__module__
    if is_hashed_by_folder(module):
        name = getattr(python, "__qualname__", None) or repr(python)
        return f"{module}.{name}".encode(), []
    text = _sources(getattr(sys.modules.get(module), "__file__", None))
    if not isinstance(python, FunctionType):
        return text, []
    codes = list(_codes(python.__code__))
    names = tuple(dict.fromkeys(name for code in codes for name in code.co_names))
    cells = [cell.cell_contents for cell in python.__closure__ or ()]
    defaults = [*(python.__defaults__ or ()), *(python.__kwdefaults__ or {}).values()]
    more = [(python.__globals__[name], names) for name in names if name in python.__globals__]
    more += [(one, names) for one in (*cells, *defaults)]
    return text + b"".join(map(_text, codes)) + _options(value), more


def _python_of(value: Any) -> Any:
    """Return the Python function that a compiled function, a ufunc or an intrinsic was made of; others unchanged."""
    value = getattr(value, "_dispatcher", value)  # a ufunc's
    for name in ("py_func", "_defn"):
        value = getattr(value, name, value)
    return value


def _options(value: Any) -> bytes:
    options = getattr(value, "targetoptions", {})
    return repr(sorted((name, _constant(one)) for name, one in options.items() if not callable(one))).encode()


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _text(code: CodeType) -> bytes:
    constants = [_constant(one) for one in code.co_consts if not isinstance(one, CodeType)]
    return repr((code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars)).encode()


def _constant(value: object) -> str:
    # The order of a set differs between processes.
    return repr(sorted(map(repr, value))) if isinstance(value, set | frozenset) else repr(value)


def is_hashed_by_folder(module: str) -> bool:
    return module.partition(".")[0] in HASHED_BY_FOLDER


@functools.cache
def _sources(file: str | None) -> bytes:
    """Return a digest of a file and of all Python sources in its folder."""
    digest = hashlib.sha256()
    if file is not None:
        for source in sorted({Path(file), *Path(file).parent.glob("*.py")}):
            if source.is_file():
                digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.digest()


# The cache of compiled kernels between runs: keyed by all that they reach, checked when read, and optional.
#
# By itself numba runs old code where a callee or a constant of another module has changed, fails a run for good where
# one of its files was cut short (a power cut, a full disk), fails it where one cannot be written, and where the folder
# cannot be made turns to others; and of two processes that compile at once one may be left with the other's code.

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
    """Machine code with what it calls by address (nuno_kernels.compilation.calling_convention)."""

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
