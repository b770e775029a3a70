"""Kernels that borrow their arrays without counting references.

numba counts up and down, by an atomic instruction each, wherever a kernel takes an array from a tuple, and finds few of
the pairs to be needless: of a step of a skirt on a dancer they were a quarter of the time. The caller of a kernel by
address keeps the arguments alive; if the kernel and all its inlined callees allocate nothing, get no array from their
callees, and return none, there is nothing to count.
"""

from __future__ import annotations

import re
from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.runtime import rtsys
from numba.core.typed_passes import NopythonTypeInference

from nuno_kernels.compile.calling_convention import returns_array

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
