"""Named tuples of arrays that kernels hand on by reference.

numba hands on a named tuple item by item, and each array as its pointer, shape and strides: of cloth contact's sixty
arrays more than five hundred numbers at every call, a third of what it took to compile contact, and a tenth of its
steps. A tuple of a class that is named here stays in the memory of the kernel that Python called, and others are given
its address; an array is loaded where it is named. Threads can be given it as well, which they cannot a tuple of tuples.

What a kernel itself makes of such a class is numba's tuple, as ever.
"""

from __future__ import annotations

import hashlib
from typing import Any, TypeVar

from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate
from numba.core.typing.typeof import typeof_impl
from numba.extending import NativeValue, infer_getattr, lower_getattr_generic, models, register_model, unbox

T = TypeVar("T", bound=type)


class Reference(types.Type):  # type: ignore[misc]
    """The type of a tuple that is handed on so."""

    def __init__(self, held: types.NamedTuple) -> None:
        self.held, self.instance_class, self.types = held, held.instance_class, held.types
        # Short: it is a part of the names of all that is compiled for it.
        told = hashlib.blake2b(str(held).encode(), digest_size=8).hexdigest()
        super().__init__(f"{held.instance_class.__qualname__}@{told}")

    @property
    def key(self) -> Any:
        """What tells it from others: the class itself, for another may have its name and fields."""
        return self.held


@register_model(Reference)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, own: Reference) -> None:
        super().__init__(manager, own, manager[own.held].get_value_type().as_pointer())


@unbox(Reference)  # type: ignore[untyped-decorator]
def _unbox(own: Reference, value: Any, c: Any) -> Any:
    native = c.unbox(own.held, value)
    place = cgutils.alloca_once_value(c.builder, native.value)

    def give_back() -> None:
        if native.cleanup is not None:
            native.cleanup()
        # Which numba does itself for what it hands on as a tuple.
        c.context.nrt.decref(c.builder, own.held, native.value)

    return NativeValue(place, is_error=native.is_error, cleanup=give_back)


@infer_getattr
class _Typed(AttributeTemplate):  # type: ignore[misc]
    key = Reference

    def generic_resolve(self, own: Reference, name: str) -> Any:
        return own.types[own.held.fields.index(name)] if name in own.held.fields else None


@lower_getattr_generic(Reference)  # type: ignore[untyped-decorator]
def _load(context: Any, builder: Any, own: Reference, value: Any, name: str) -> Any:
    at = own.held.fields.index(name)
    item = builder.load(cgutils.gep_inbounds(builder, value, 0, at))
    return impl_ret_borrowed(context, builder, own.types[at], item)


def by_reference(kind: T) -> T:
    """Have kernels hand on tuples of a class by reference."""

    @typeof_impl.register(kind)  # type: ignore[untyped-decorator]
    def _(value: Any, c: Any) -> Reference | None:
        items = [typeof_impl(one, c) for one in value]
        return None if None in items else Reference(types.NamedTuple(items, kind))

    return kind
