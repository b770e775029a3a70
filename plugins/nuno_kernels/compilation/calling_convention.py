"""Calls between kernels: inlined, or by address with borrowed arrays."""

from __future__ import annotations

import contextlib
import copy
import hashlib
import re
from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.runtime import rtsys
from numba.core.typed_passes import NopythonTypeInference

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
# in every process; what a kept function calls is loaded before it is (nuno_kernels.compilation.cache).

PREFIX = "nuno.apart."
Place = tuple[str, str, tuple[Any, ...]]
"""module and name of a kernel, and the types of its arguments"""
BY_SYMBOL: dict[str, tuple[Place, Any]] = {}
"""the source of each kernel that was compiled or loaded so far, by its symbol; and its machine code, which must stay"""


def by_address(kernel: Any) -> Any:
    """Return the version of a kernel that is called by address; another compiled function unchanged."""
    return kernel.by_address() if hasattr(kernel, "by_address") else kernel


def call_from_kernels(outer: Any, version: Callable[[], Any]) -> Any:
    """Let kernels call `version`, which is made on demand, in place of the compiled function `outer`."""
    outer.get_call_template = lambda args, kws: version().get_call_template(args, kws)
    outer.get_overload = lambda signature: version().get_overload(signature)
    return outer


def call_by_address(dispatcher: Any, content: Callable[[Any], str]) -> Any:
    """Let callers call a compiled function by an address alone.

    content(types) distinguishes functions of the same name and types of arguments, but other source.
    """
    add = dispatcher.add_overload

    def add_overload(compiled: Any) -> None:
        add(compiled)
        symbol, context = _symbol(compiled, content(compiled.signature.args)), dispatcher.targetctx
        llvm.add_symbol(symbol, compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))
        function, descriptor = dispatcher.py_func, copy.copy(compiled.fndesc)
        descriptor.mangled_name = symbol
        BY_SYMBOL[symbol] = (function.__module__, function.__qualname__, tuple(compiled.signature.args)), compiled
        context.remove_user_function(compiled.entry_point)
        context.insert_user_function(compiled.entry_point, descriptor)

    dispatcher.add_overload = add_overload
    return dispatcher


def _symbol(compiled: Any, content: str) -> str:
    descriptor = compiled.fndesc
    what = repr((descriptor.modname, descriptor.qualname, str(compiled.signature), content))
    return f"{PREFIX}{descriptor.qualname}.{hashlib.blake2b(what.encode(), digest_size=12).hexdigest()}"


def returns_array(symbol: str) -> bool:
    """Whether a function is a kernel with an address that returns an array, which its caller must release."""
    if symbol not in BY_SYMBOL:
        return False
    compiled = BY_SYMBOL[symbol][1]
    model = compiled.target_context.data_model_manager[compiled.signature.return_type]
    return bool(model.contains_nrt_meminfo())


def called_by_address(compiled: Any) -> dict[str, Place]:
    """Return what a function that was just compiled calls by address, itself or by its inlined callees."""
    functions = compiled.library._final_module.functions
    return {one.name: BY_SYMBOL[one.name][0] for one in functions if one.name.startswith(PREFIX)}


def load_called(called: dict[str, Place]) -> bool:
    """Load what a cached function calls by address; return False if one of them is gone, or has changed."""
    for symbol, (module, name, types) in called.items():
        if symbol not in BY_SYMBOL:
            with contextlib.suppress(ImportError, AttributeError):
                by_address(resolve_name(f"{module}:{name}")).compile(types)
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
        if not any(ALLOCATES.match(name) or returns_array(name) for name in names):
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
