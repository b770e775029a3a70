"""How kernels call kernels: as a part of them, or by address.

By itself numba optimises a function anew within every function that calls it, and those within what calls them. A
step's machine code is then made once for each level of calls, and for each solver. A kernel that works on a block of
vertices or on a whole mesh gains nothing by that: such ones are compiled once, and known to those that call them by
their addresses alone, like C's translation units. What is called for each vertex becomes a part of its callers.

Neither of the two has code that takes Python's arrays apart, which of a scene's many takes as long to compile as the
kernel itself; Python calls a version of its own.

The symbol of an address tells what the kernel reaches and for which types, so that kept machine code means the same in
every process; what a kept function calls is loaded before it is (nuno_kernels.compile.cache).
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any

import llvmlite.binding as llvm

PREFIX = "nuno.apart."
Place = tuple[str, str, tuple[Any, ...]]
"""Module and name of a kernel, and the types of its arguments."""
KNOWN: dict[str, tuple[Place, Any]] = {}
"""Where each that was compiled or loaded so far is from, by its symbol; and its machine code, which must stay."""


def by_address(kernel: Any) -> Any:
    """The version of a kernel that is called by address; another compiled function as it is."""
    return kernel.by_address() if hasattr(kernel, "by_address") else kernel


def call_from_kernels(outer: Any, version: Callable[[], Any]) -> Any:
    """The compiled function `outer`, in whose place kernels call `version`, which is made where it is needed."""
    outer.get_call_template = lambda args, kws: version().get_call_template(args, kws)
    outer.get_overload = lambda signature: version().get_overload(signature)
    return outer


def call_by_address(dispatcher: Any, content: Callable[[Any], str]) -> Any:
    """Let callers know a compiled function by an address alone.

    content(types)  tells apart what has the same name and arguments of the same types, but other source.
    """
    add = dispatcher.add_overload

    def add_overload(compiled: Any) -> None:
        add(compiled)
        symbol, context = _symbol(compiled, content(compiled.signature.args)), dispatcher.targetctx
        llvm.add_symbol(symbol, compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))
        function, known = dispatcher.py_func, copy.copy(compiled.fndesc)
        known.mangled_name = symbol
        KNOWN[symbol] = (function.__module__, function.__qualname__, tuple(compiled.signature.args)), compiled
        context.remove_user_function(compiled.entry_point)
        context.insert_user_function(compiled.entry_point, known)

    dispatcher.add_overload = add_overload
    return dispatcher


def _symbol(compiled: Any, content: str) -> str:
    descriptor = compiled.fndesc
    what = repr((descriptor.modname, descriptor.qualname, str(compiled.signature), content))
    return f"{PREFIX}{descriptor.qualname}.{hashlib.blake2b(what.encode(), digest_size=12).hexdigest()}"


def hands_over(symbol: str) -> bool:
    """Whether a function is a kernel known by its address that hands back an array, which is its caller's to let go."""
    if symbol not in KNOWN:
        return False
    compiled = KNOWN[symbol][1]
    model = compiled.target_context.data_model_manager[compiled.signature.return_type]
    return bool(model.contains_nrt_meminfo())


def called_by_address(compiled: Any) -> dict[str, Place]:
    """What a function that was just compiled calls so, itself or by what became a part of it."""
    functions = compiled.library._final_module.functions
    return {one.name: KNOWN[one.name][0] for one in functions if one.name.startswith(PREFIX)}


def load_called(called: dict[str, Place]) -> bool:
    """Have what a kept function calls by address; False where one of them is gone, or not what it was."""
    for symbol, (module, name, types) in called.items():
        if symbol not in KNOWN:
            with contextlib.suppress(ImportError, AttributeError):
                by_address(resolve_name(f"{module}:{name}")).compile(types)
        if symbol not in KNOWN:
            return False
    return True
