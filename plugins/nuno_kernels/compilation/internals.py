"""The parts of numba that are not its public face: all that nuno uses of them is in this file.

numba 0.62 and 0.68 were tried; pyproject.toml admits no later one. Each part has a section, which says what it is for
and what is lost without it. tests/physics/test_compiled.py names what is missing when numba moves.

Tried with the public face alone: terms as a struct of addresses, their arrays by `carray`, kernels by `numba.cfunc` and
a step that calls a table of addresses. The springs of a skirt and the end of a step took 27 to 31 us either way, and to
compile 1.6 s instead of 0.5 s: each kernel makes all of its arrays anew, and counts references where it allocates.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import hashlib
import logging
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from types import CodeType, FunctionType, ModuleType, SimpleNamespace
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba import types
from numba.core import dispatcher as numba_dispatcher
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.errors import NumbaError as NumbaError  # for nuno_kernels.formula
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.core.targetconfig import TargetConfig
from numba.core.typed_passes import NopythonTypeInference
from numba.core.typing.templates import AttributeTemplate as AttributeTemplate  # for nuno_kernels.compilation.reference

# A compiled function's dependencies, all functions, constants and sources that it reaches, as one digest.
#
# Compiling freezes callees and globals into the machine code. By itself numba knows a kept function by its own file
# alone, and goes on with old code where a callee in another module, or a constant from there, has changed. A digest of
# the sources of all modules that a kernel's module names is not enough: a constant may come from a file or from the
# environment; and too much: it has all of pydantic, which changes nothing.

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


def dependencies_of(function: Any, kinds: Any) -> str:
    """Return the digest of all that a kernel reaches, called with arguments of these types: also the kernels of other
    packages' terms (nuno_kernels.terms).
    """
    terms = (one.kernels for one in term_classes(kinds) if not is_hashed_by_folder(one.__module__))
    return digest_of((function, *(kernel for kernels in terms for kernel in kernels.all())))


def term_classes(kinds: Any) -> Iterator[Any]:
    """Yield the classes of terms among types, also inside of others."""
    return (one for one in _classes(kinds) if hasattr(one, "kernels"))


def _classes(kinds: Any) -> Iterator[Any]:
    """Yield the classes of named tuples among types, also inside of others."""
    for kind in kinds:
        if hasattr(kind, "instance_class"):
            yield kind.instance_class
        yield from _classes(getattr(kind, "types", ()))


# The cache of compiled kernels between runs, in place of numba's for the whole process: keyed by all that they reach,
# checked when read, and optional.
#
# By itself numba runs old code where a callee or a constant of another module has changed, fails a run for good where
# one of its files was cut short (a power cut, a full disk), fails it where one cannot be written, and where the folder
# cannot be made turns to others. It numbers its files, and keeps an index of the numbers, which two processes that
# compile at once write over each other: one's arguments are then given to the other's code.

LOGGER = logging.getLogger("nuno.kernels")
CHECKSUM = 16
"""bytes of the checksum at the end of each file"""


class _Cache(FunctionCache):  # type: ignore[misc]
    """Machine code of one kernel with what it calls by address, a file for each kind of arguments: its name is a hash
    of all that the code depends on, and a checksum is at its end. A damaged one is ignored.
    """

    _impl_class = CompileResultCacheImpl
    version = ""
    """which of the kernel's versions"""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._paths: dict[Any, Path] = {}

    def path(self, kinds: Any, codegen: Any) -> Path:
        """Return the file for arguments of these types."""
        # As text, which is the same in each process.
        names = tuple(f"{kind.__module__}.{kind.__qualname__}" for kind in _classes(kinds))
        key = (str(kinds), names, self.version, *super()._index_key(kinds, codegen)[1:])
        name = _checksum(repr((key, dependencies_of(self._py_func, kinds))).encode()).hex()
        return Path(self._cache_path) / f"{self._impl.filename_base}.{name}.nbc"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load machine code; numba compiles and saves what is not found."""
        # The name is by the dependencies before compilation, also when it is saved.
        target_context.refresh()
        self._paths[sig] = self.path(sig, target_context.codegen())
        try:
            content = self._paths[sig].read_bytes()
        except OSError:
            return None
        if content[-CHECKSUM:] != _checksum(content[:-CHECKSUM]):
            return None
        called, saved = self._cache_file._load_data(self._paths[sig].name)
        return self._impl.rebuild(target_context, saved) if load_called(called) else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save machine code; a kernel that cannot be saved is compiled again by the next run."""
        if not self._impl.check_cachable(data):
            return
        # What it calls by address, itself or by its inlined callees.
        names = (one.name for one in data.library._final_module.functions)
        called = {name: BY_SYMBOL[name][0] for name in names if name.startswith(PREFIX)}
        content, path = dumps((called, self._impl.reduce(data))), self._paths[sig]
        partial = path.with_suffix(f".{os.getpid()}")  # one thread compiles at a time
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            partial.write_bytes(content + _checksum(content))
            os.replace(partial, path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            _say(self._cache_path, str(error.strerror))


# Functions of third parties with numba's own `cache=True` are in the same folder, and may call kernels, too.
numba_dispatcher.FunctionCache = _Cache  # type: ignore[attr-defined]


def keep(dispatcher: Any, folder: Path, version: str = "Python") -> Any:
    """Cache a compiled function in numba's present folder, which is `folder`, as one of a kernel's versions."""
    if _can_be_written(folder):
        with contextlib.suppress(RuntimeError):  # of source that is in no file, as what Python reads from a pipe
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


def _checksum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=CHECKSUM).digest()


# Calls between kernels: inlined, or by address.
#
# By itself numba optimises a function anew within every function that calls it, and those within what calls them. A
# step's machine code is then made once for each level of calls, and for each solver. A kernel that works on a block of
# vertices or on a whole mesh gains nothing by that: such ones are compiled once, and known to those that call them by
# their addresses alone, like C's translation units. What is called for each vertex becomes a part of its callers.
#
# Neither of the two has code that takes Python's arrays apart, which of a scene's many takes as long to compile as the
# kernel itself; Python calls a version of its own.
#
# The symbol of an address tells what the kernel reaches and for which types, so that kept machine code means the same
# in every process; what a kept function calls is loaded before it is.

PREFIX = "nuno.apart."
Place = tuple[str, str, tuple[Any, ...]]
"""module and name of a kernel, and the types of its arguments"""
BY_SYMBOL: dict[str, tuple[Place, bool]] = {}
"""the source of each kernel that is called by address, by its symbol, and whether it returns an array"""


RESULTS = {"None": types.none, "bool": types.boolean, "int": types.int64, "float": types.float64}
"""types of what kernels return, by their annotations"""


def by_address(kernel: Any) -> Any:
    """Return the version of a kernel that is called by address; another compiled function unchanged."""
    return kernel.by_address() if hasattr(kernel, "by_address") else kernel


def address_of(dispatcher: Any, kinds: tuple[Any, ...]) -> int:
    """Return the address of a compiled function for arguments of these types. Raises TypeError if it returns what steps
    do not take.
    """
    compiled = dispatcher.overloads[kinds]
    if (result := compiled.signature.return_type) != types.none:
        raise TypeError(f"{dispatcher.py_func.__qualname__} returns {result}: a kernel that steps call returns nothing")
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def call_from_kernels(outer: Any, version: Callable[[], Any]) -> Any:
    """Let kernels call `version`, which is made on demand, in place of the compiled function `outer`."""
    outer.get_call_template = lambda args, kws: version().get_call_template(args, kws)
    outer.get_overload = lambda signature: version().get_overload(signature)
    return outer


class ByAddress:
    """A compiled function that callers call by an address alone.

    content(types) distinguishes functions of the same name and types of arguments, but other source.
    """

    def __init__(self, dispatcher: Any, content: Callable[[Any], str]) -> None:
        self.dispatcher, self.content, self.add = dispatcher, content, dispatcher.add_overload
        dispatcher.add_overload = self.add_overload
        function = dispatcher.py_func
        self.module, self.name = function.__module__, function.__qualname__
        self.result = RESULTS.get(str(function.__annotations__.get("return", "")))
        """the type of what it returns, None if its annotation does not say"""

    def add_overload(self, compiled: Any) -> None:
        """Add what was compiled or loaded, and publish its address."""
        kinds, result = tuple(compiled.signature.args), compiled.signature.return_type
        self.add(compiled)
        address = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
        compiled.target_context.remove_user_function(compiled.entry_point)
        self._publish(kinds, result, compiled.entry_point, address)

    def declare(self, kinds: tuple[Any, ...]) -> None:
        """Let others call it that are compiled here, but not run, though it is not compiled. If it returns another type
        than it says they have a symbol that nothing has, and are compiled again where they are loaded.
        """
        entry = object()
        self._publish(kinds, self.result, entry, _NOWHERE)
        declared = SimpleNamespace(signature=self.result(*kinds), entry_point=entry, objectmode=False)  # type: ignore[misc]
        self.dispatcher.overloads[kinds] = declared

    def _publish(self, kinds: tuple[Any, ...], result: Any, entry: Any, address: int) -> None:
        what = repr((self.module, self.name, str(kinds), str(result), self.content(kinds)))
        symbol = f"{PREFIX}{self.name}.{hashlib.blake2b(what.encode(), digest_size=12).hexdigest()}"
        context = self.dispatcher.targetctx
        array = context.data_model_manager[result].contains_nrt_meminfo()
        BY_SYMBOL[symbol] = (self.module, self.name, kinds), bool(array)
        llvm.add_symbol(symbol, address)
        names = [f"arg.{i}" for i in range(len(kinds))]
        called = SimpleNamespace(
            mangled_name=symbol, restype=result, argtypes=kinds, args=names, noalias=False, inline=False
        )
        context.insert_user_function(entry, called)


_NOWHERE = 1
"""address of what is never called"""


def load_called(called: dict[str, Place]) -> bool:
    """Load what a cached function calls by address; return False if one of them is gone, or has changed."""
    for symbol, (module, name, kinds) in called.items():
        if symbol not in BY_SYMBOL:
            with contextlib.suppress(ImportError, AttributeError):
                by_address(resolve_name(f"{module}:{name}")).compile(kinds)
        if symbol not in BY_SYMBOL:
            return False
    return True


# Kernels that borrow their arrays without counting references.
#
# numba counts up and down, by an atomic instruction each, wherever a kernel takes an array from a tuple, and finds few
# of the pairs to be needless: of a step of a skirt on a dancer they were a quarter of the time. The caller of a kernel
# by address keeps the arguments alive; if the kernel and all its inlined callees allocate nothing, get no array from
# their callees, and return none, there is nothing to count.

NOTHING = "".join(
    f"define linkonce_odr void @{name}(i8* %array) alwaysinline {{ ret void }}\n"
    for name in ("NRT_incref", "NRT_decref")
)
ALLOCATES = re.compile("NRT_(Allocate|MemInfo_(alloc|new|varsize))")


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """Machine code without reference counts if there is nothing to release."""

    def finalize(self) -> None:
        """See numba. What a module has already takes precedence over what is linked into it."""
        parts = [one._get_module_for_linking() for one in self._linking_libraries if one is not rtsys.library]
        names = [function.name for part in (self._final_module, *parts) for function in part.functions]
        if not any(ALLOCATES.match(name) or (name in BY_SYMBOL and BY_SYMBOL[name][1]) for name in names):
            self._final_module.link_in(llvm.parse_assembly(NOTHING))
        super().finalize()


@register_pass(mutates_CFG=True, analysis_only=False)
class _Borrow(FunctionPass):  # type: ignore[misc]
    """Compile a function that returns no array that way."""

    _name = "nuno_borrow"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        model = state.targetctx.data_model_manager[state.return_type]
        if not model.contains_nrt_meminfo():
            state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
            state.library.enable_object_caching()
        return False


class Borrowing(CompilerBase):  # type: ignore[misc]
    """numba's compiler for kernels that are called by address."""

    def define_pipelines(self) -> list[Any]:
        """See numba."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_Borrow, NopythonTypeInference)
        passes.finalize()
        return [passes]


# Compilation without passes over functions that are only declared.
#
# numba makes a pass manager for each function of a module, also for those that are defined elsewhere, which has nothing
# to do: 7 % of a first run's compilation.


def _optimize_functions(library: Any, module: Any) -> None:
    module.data_layout = library.codegen._data_layout
    for function in module.functions:
        if not function.is_declaration:
            passes, builder = library.codegen._function_pass_manager()
            passes.run(function, builder)


JITCodeLibrary._optimize_functions = _optimize_functions

# Compilation without comparing flags one by one.
#
# numba looks overloads up by the types of their arguments and by its flags, which are nearly always the same ones, and
# makes two tables of them each time: 5 % of a first run's compilation.

_equal_in_all = TargetConfig.__eq__


def _equal(flags: Any, other: Any) -> bool:
    return bool(isinstance(other, TargetConfig) and flags._values == other._values) or bool(_equal_in_all(flags, other))


TargetConfig.__eq__ = _equal
TargetConfig.__hash__ = lambda flags: hash(type(flags))  # numba's own is of the names alone, likewise


# Compilation without garbage collection.
#
# Python looks for cycles of objects whenever many have been made, and the compiler makes millions that are wanted until
# it is done: of a first run's compilation that took a seventh. Without, the process has a sixth more memory at its end.


COMPILER = logging.getLogger("nuno.kernels.compiler")
"""logs that a compilation begins"""
COMPILER.propagate = False


class _Quiet(event.Listener):  # type: ignore[misc]
    """Stops collection from a compilation's start, through nested ones, to its end. One thread compiles at a time."""

    def __init__(self) -> None:
        self.compilations, self.number, self.looked, self.seconds = 0, 0, False, 0.0

    def on_start(self, event: Any) -> None:
        """See numba."""
        if self.compilations == 0:
            COMPILER.info("compiling")
            self.began, self.looked = time.perf_counter(), gc.isenabled()
            gc.disable()
        self.compilations += 1
        self.number += 1

    def on_end(self, event: Any) -> None:
        """See numba."""
        self.compilations -= 1
        if self.compilations == 0:
            self.seconds += time.perf_counter() - self.began
            if self.looked:
                gc.enable()


_QUIET = _Quiet()
event.register("numba:compile", _QUIET)


def compiled_here() -> tuple[int, float]:
    """Return how many functions this process has compiled so far, and for how long [s]."""
    return _QUIET.number, _QUIET.seconds + (time.perf_counter() - _QUIET.began if _QUIET.compilations else 0.0)
