"""Named tuples of arrays that kernels pass by reference.

numba passes a named tuple item by item, and each array as its pointer, shape and strides: of cloth contact's ninety
arrays more than five hundred numbers at every call, a third of the time to compile contact, and a tenth of its steps. A
tuple of a class that is registered here stays in the memory of the kernel that Python called, and others get its
address; an array is loaded where it is used. Threads can get it as well, unlike a tuple of tuples. A field of such a
class lies within the tuple's memory, and its address costs nothing: a tuple of many arrays can be parted into tuples
with names.

A tuple that a kernel itself makes of such a class is numba's tuple, as ever.
"""

from __future__ import annotations

import hashlib
from typing import Any, TypeVar

import numpy as np
from llvmlite import ir
from numba import extending, typeof, types
from numba.extending import infer_getattr, lower_getattr_generic, models, register_model, typeof_impl, unbox

from nuno_kernels.compilation.internals import AttributeTemplate

T = TypeVar("T", bound=type)
CLASSES: set[type] = set()
"""those that are passed by reference"""
NAMES: dict[str, int] = {}
"""how many of them have a name"""


class Reference(types.Type):  # type: ignore[misc]
    """The type of a tuple that is passed by reference."""

    def __init__(self, held: types.NamedTuple) -> None:
        self.held, self.instance_class, self.types = held, held.instance_class, held.types
        # Short: it is a part of the names of all functions compiled for it.
        suffix = hashlib.blake2b(str(held).encode(), digest_size=8).hexdigest()
        super().__init__(f"{held.instance_class.__name__}@{suffix}")

    @property
    def key(self) -> Any:
        """Return its identity: the class itself, for another may have its name and fields."""
        return self.held


@register_model(Reference)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, reference: Reference) -> None:
        super().__init__(manager, reference, manager[reference.held].get_value_type().as_pointer())


@unbox(Reference)  # type: ignore[untyped-decorator]
def _unbox(reference: Reference, value: Any, c: Any) -> Any:
    """Fill the tuple in memory item by item, each array by one call.

    numba checks each array once more, though it has chosen the kernel by its type, with a way out for each that fails,
    and makes one value of all: of the two hundred arrays of a skirt with cloth contact that took 3.4 s to compile in
    each kernel that Python calls, and this takes a tenth of it.
    """
    filled = _Filling(c)
    place = filled.tuple_at(reference, value)
    raised = c.builder.icmp_unsigned("!=", c.pyapi.err_occurred(), c.pyapi.get_null_object())
    with c.builder.if_then(c.builder.and_(filled.failed, c.builder.not_(raised)), likely=False):
        c.pyapi.err_set_string("PyExc_TypeError", f"a field of {reference.instance_class.__name__} is not what it was")
    return extending.NativeValue(place, is_error=filled.failed, cleanup=filled.give_back)


_COUNTED = types.MemInfoPointer(types.voidptr)
"""an array's first field, by which references to it are counted"""


class _Filling:
    """A tuple that is being filled in memory."""

    def __init__(self, c: Any) -> None:
        self.c, self.held = c, list[Any]()
        self.failed: Any = ir.Constant(ir.IntType(1), 0)

    def tuple_at(self, reference: Reference, value: Any) -> Any:
        """Return where the tuple of a class that is passed by reference lies."""
        with self.c.builder.goto_entry_block():
            place = self.c.builder.alloca(self.c.context.get_value_type(reference.held))
        self._fill_items(reference.types, value, place)
        return place

    def _fill_items(self, kinds: Any, value: Any, place: Any) -> None:
        for i, kind in enumerate(kinds):
            self._fill(kind, self.c.pyapi.tuple_getitem(value, i), _item(self.c.builder, place, i))

    def _fill(self, kind: Any, value: Any, place: Any) -> None:
        builder, pyapi = self.c.builder, self.c.pyapi
        if isinstance(kind, Reference):
            builder.store(self.tuple_at(kind, value), place)
        elif isinstance(kind, types.BaseTuple):
            self._fill_items(kind.types, value, place)
        elif isinstance(kind, types.Array):
            failed = pyapi.nrt_adapt_ndarray_from_python(value, builder.bitcast(place, pyapi.voidptr))
            self._note(builder.icmp_unsigned("!=", failed, ir.Constant(failed.type, 0)))
            self.held.append(_item(builder, place, 0))
        else:
            native = self.c.unbox(kind, value)
            if native.cleanup is not None:
                raise NotImplementedError(f"{kind} in a tuple that is handed on by reference")
            builder.store(native.value, place)
            self._note(native.is_error)

    def _note(self, failed: Any) -> None:
        self.failed = self.c.builder.or_(self.failed, failed)

    def give_back(self) -> None:
        """Release the arrays, which numba does itself for those that it passes as values."""
        for counted in self.held:
            self.c.context.nrt.decref(self.c.builder, _COUNTED, self.c.builder.load(counted))


def _item(builder: Any, place: Any, at: int) -> Any:
    """Return where an item of the tuple, or of the array, at `place` lies."""
    return builder.gep(place, [ir.Constant(ir.IntType(32), i) for i in (0, at)], inbounds=True)


@infer_getattr
class _Typed(AttributeTemplate):  # type: ignore[misc]
    key = Reference

    def generic_resolve(self, reference: Reference, name: str) -> Any:
        if name not in reference.held.fields:
            return None
        kind = reference.types[reference.held.fields.index(name)]
        return Reference(kind) if _is_part(kind) else kind


def _is_part(kind: types.Type) -> bool:
    """Whether a field's type is a tuple that lies within the one that has the field."""
    return isinstance(kind, types.NamedTuple) and kind.instance_class in CLASSES


@lower_getattr_generic(Reference)  # type: ignore[untyped-decorator]
def _load(context: Any, builder: Any, reference: Reference, value: Any, name: str) -> Any:
    at = reference.held.fields.index(name)
    place = _item(builder, value, at)
    if _is_part(reference.types[at]):
        return place
    item = builder.load(place)
    context.nrt.incref(builder, reference.types[at], item)
    return item


def by_reference(kind: T) -> T:
    """Make kernels pass tuples of a class by reference.

    The names of machine code have the names of its arguments' classes. Of classes of one name, as of two packages or
    of a notebook's cell that runs twice, the later ones get a number: they would run the first one's code.
    """
    CLASSES.add(kind)
    NAMES[kind.__name__] = earlier = NAMES.get(kind.__name__, -1) + 1
    if earlier:
        kind.__name__ += f"_{earlier}"

    @typeof_impl.register(kind)  # type: ignore[untyped-decorator]
    def _(value: Any, c: Any) -> Reference | None:
        if (key := _key(value)) not in TYPES:
            items = [typeof_impl(one, c) for one in value]
            if None in items:
                return None
            held = [one.held if isinstance(one, Reference) else one for one in items]
            TYPES[key] = Reference(types.NamedTuple(held, kind))
        return TYPES[key]

    return kind


TYPES: dict[Any, Reference] = {}
"""types of tuples by their keys: numba takes 0.7 ms for those of cloth contact, at each call from Python"""
OWNER = 4
"""the bit of an array's flags that makes no other type"""


def _key(value: Any) -> Any:
    """Return what a value's type follows from, sooner had than the type."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.num & ~OWNER
    if type(value) is tuple or hasattr(value, "_fields"):
        return type(value), *map(_key, value)
    return type(value) if isinstance(value, float | bool | None) else typeof(value)
