"""A compiled function's dependencies, all functions, constants and sources that it reaches, as one digest.

Compiling freezes callees and globals into the machine code. By itself numba knows a kept function by its own file
alone, and goes on with old code where a callee in another module, or a constant from there, has changed.
"""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

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
