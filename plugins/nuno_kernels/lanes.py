"""Eight float64 lanes as one value, so that kernels vectorise by construction: arithmetic, choices, and vectors in
space.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, ClassVar

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from nuno_kernels import kernel
from nuno_schemas.fabric import Float, Int

# Eight float64 lanes as one value, so that kernels vectorise by construction.
#
# LLVM's loop vectoriser gives up on these kernels wherever it cannot prove that arrays do not
# overlap, and leaves remainder loops as long as a row of a small sheet. Here `load`, arithmetic
# and `store` become one instruction each on AVX-512 and a few on anything narrower. Every lane
# is rounded as the scalar operation would be, so results do not depend on the machine's width.
#
# Indices are not checked and never wrap around.

WIDTH = 8
"""lanes of a vector"""

LANES = ir.VectorType(ir.DoubleType(), WIDTH)
_I32 = ir.IntType(32)

Lanes = Any
"""eight float64 lanes as one value in compiled code; Python itself has none"""
Triple = tuple[Lanes, Lanes, Lanes]
"""x, y, z of eight vectors"""


class _VectorType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Vector8")


vector = _VectorType()


@register_model(_VectorType)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, frontend: Any) -> None:
        super().__init__(manager, frontend, LANES)


def spread(builder: Any, value: Any, of: Any = LANES) -> Any:
    first = builder.insert_element(ir.Constant(of, ir.Undefined), value, ir.Constant(_I32, 0))
    mask = ir.Constant(ir.VectorType(_I32, WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, ir.Constant(of, ir.Undefined), mask)


def _define(op: Callable[..., Any], method: str) -> None:
    """Give vectors the operator `op`, between vectors or a vector and a number."""

    class Template(ConcreteTemplate):  # type: ignore[misc]
        cases: ClassVar[list[Any]] = [
            signature(vector, vector, vector),
            signature(vector, vector, types.float64),
            signature(vector, types.float64, vector),
        ]

    infer_global(op)(Template)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pair = [a if t is vector or t == vector else spread(builder, a) for t, a in zip(sig.args, args, strict=True)]
        return getattr(builder, method)(*pair)

    for case in Template.cases:
        lower_builtin(op, *case.args)(lower)


for _op, _method in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _define(_op, _method)


def instruction(function: Callable[..., Any]) -> Any:
    """Make a function that compiled code calls without the leading typing context."""
    return intrinsic(function)


def _address(context: Any, builder: Any, kind: Any, array: Any, row: Any, column: Any) -> Any:
    """Return a pointer to array[row, column] of a C-contiguous 2-D array."""
    view = context.make_array(kind)(context, builder, array)
    columns = builder.extract_value(view.shape, 1)
    return builder.gep(view.data, [builder.add(builder.mul(row, columns), column)])


def _mask(builder: Any, count: Any) -> Any:
    """Return a mask of lanes 0 .. count - 1."""
    index = ir.VectorType(ir.IntType(64), WIDTH)
    return builder.icmp_signed("<", ir.Constant(index, list(range(WIDTH))), spread(builder, count, index))


def _plane(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 2 and array.layout == "C" and array.dtype == types.float64


@instruction
def load(typing: Any, array: Any, row: Any, column: Any) -> Any:
    """Return eight values from array[row, column] on."""
    if not _plane(array):
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _address(context, builder, sig.args[0], *args)
        return builder.load(builder.bitcast(pointer, LANES.as_pointer()), align=8)

    return vector(array, types.int64, types.int64), build


@instruction
def store(typing: Any, array: Any, row: Any, column: Any, value: Any) -> Any:
    """Write eight values to array[row, column] and on."""
    if not _plane(array):
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _address(context, builder, sig.args[0], *args[:3])
        builder.store(args[3], builder.bitcast(pointer, LANES.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64, vector), build


@instruction
def load_first(typing: Any, array: Any, row: Any, column: Any, count: Any) -> Any:
    """Return the first `count` of eight values, zeros in the other lanes; reads nothing else."""
    if not _plane(array):
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = builder.bitcast(_address(context, builder, sig.args[0], *args[:3]), LANES.as_pointer())
        mask = _mask(builder, args[3])
        kind = ir.FunctionType(LANES, [pointer.type, _I32, mask.type, LANES])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.load.v8f64.p0")
        return builder.call(function, [pointer, ir.Constant(_I32, 8), mask, ir.Constant(LANES, [0.0] * WIDTH)])

    return vector(array, types.int64, types.int64, types.int64), build


@instruction
def store_first(typing: Any, array: Any, row: Any, column: Any, count: Any, value: Any) -> Any:
    """Write the first `count` of eight values and nothing else."""
    if not _plane(array):
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = builder.bitcast(_address(context, builder, sig.args[0], *args[:3]), LANES.as_pointer())
        mask = _mask(builder, args[3])
        kind = ir.FunctionType(ir.VoidType(), [LANES, pointer.type, _I32, mask.type])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.store.v8f64.p0")
        builder.call(function, [args[4], pointer, ir.Constant(_I32, 8), mask])
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64, types.int64, vector), build


@instruction
def gather(typing: Any, array: Any, row: Any, index: Any, which: Any, start: Any) -> Any:
    """Return array[row, index[which, start + lane]] for eight lanes; index is (w, m) int32."""
    if not _plane(array):
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        base = _address(context, builder, sig.args[0], args[0], args[1], ir.Constant(ir.IntType(64), 0))
        places = _address(context, builder, sig.args[2], args[2], args[3], args[4])
        value = ir.Constant(LANES, ir.Undefined)
        for lane in range(WIDTH):
            place = builder.load(builder.gep(places, [ir.Constant(ir.IntType(64), lane)]))
            item = builder.load(builder.gep(base, [builder.sext(place, ir.IntType(64))]))
            value = builder.insert_element(value, item, ir.Constant(_I32, lane))
        return value

    return vector(array, types.int64, index, types.int64, types.int64), build


@instruction
def add_at(typing: Any, array: Any, row: Any, index: Any, which: Any, start: Any, value: Any) -> Any:
    """Add array[row, index[which, start + lane]] += value[lane], lane after lane."""
    if not _plane(array):
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        base = _address(context, builder, sig.args[0], args[0], args[1], ir.Constant(ir.IntType(64), 0))
        places = _address(context, builder, sig.args[2], args[2], args[3], args[4])
        for lane in range(WIDTH):
            place = builder.load(builder.gep(places, [ir.Constant(ir.IntType(64), lane)]))
            pointer = builder.gep(base, [builder.sext(place, ir.IntType(64))])
            item = builder.extract_element(args[5], ir.Constant(_I32, lane))
            builder.store(builder.fadd(builder.load(pointer), item), pointer)
        return context.get_dummy_value()

    return types.void(array, types.int64, index, types.int64, types.int64, vector), build


@instruction
def splat(typing: Any, value: Any) -> Any:
    """Return the same number in all lanes."""
    return vector(types.float64), lambda context, builder, sig, args: spread(builder, args[0])


@instruction
def root(typing: Any, value: Any) -> Any:
    """Return the square root of every lane."""
    if value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(LANES, [LANES]), "llvm.sqrt.v8f64")
        return builder.call(function, args)

    return vector(vector), build


@instruction
def magnitude(typing: Any, value: Any) -> Any:
    """Return the absolute value of every lane."""
    if value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(LANES, [LANES]), "llvm.fabs.v8f64")
        return builder.call(function, args)

    return vector(vector), build


@instruction
def fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c of every lane, rounded once: the same on every machine."""
    if not a == b == c == vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.FunctionType(LANES, [LANES, LANES, LANES])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.fma.v8f64"), args)

    return vector(vector, vector, vector), build


@kernel
def read(a: Float, row: int, column: int, count: int) -> Lanes:
    """Return up to eight values; zeros beyond `count`."""
    if count == WIDTH:
        return load(a, row, column)
    return load_first(a, row, column, count)


@kernel
def write(a: Float, row: int, column: int, count: int, value: Lanes) -> None:
    """Write up to eight values."""
    if count == WIDTH:
        store(a, row, column, value)
    else:
        store_first(a, row, column, count, value)


# Choices between vectors of eight lanes: comparisons, selection, extremes.


@instruction
def alternate(typing: Any, even: Any, odd: Any, first: Any) -> Any:
    """Return `even` in the lanes whose number `first` + lane is even, `odd` in the others."""
    if even != vector or odd != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        index = ir.VectorType(ir.IntType(64), WIDTH)
        number = builder.add(spread(builder, args[2], index), ir.Constant(index, list(range(WIDTH))))
        parity = builder.and_(number, ir.Constant(index, [1] * WIDTH))
        return builder.select(builder.icmp_signed("==", parity, ir.Constant(index, [0] * WIDTH)), args[0], args[1])

    return vector(vector, vector, types.int64), build


@instruction
def lower(typing: Any, a: Any, b: Any) -> Any:
    """Return the lesser of `a` and `b` in every lane; `b` if either is NaN."""
    return _extreme("<", a, b)


@instruction
def higher(typing: Any, a: Any, b: Any) -> Any:
    """Return the greater of `a` and `b` in every lane; `b` if either is NaN."""
    return _extreme(">", a, b)


def _extreme(order: str, a: Any, b: Any) -> Any:
    if a != vector or b != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(order, *args), *args)

    return vector(vector, vector), build


@instruction
def lane(typing: Any, value: Any, which: Any) -> Any:
    """Return one of the eight numbers."""
    if value != vector:
        return None
    return types.float64(vector, types.int64), lambda context, builder, sig, args: builder.extract_element(*args)


@instruction
def any_below(typing: Any, value: Any, limit: Any) -> Any:
    """Whether any lane is less than the number `limit`; NaN is not."""
    if value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        below = builder.fcmp_ordered("<", args[0], spread(builder, args[1]))
        bits = builder.bitcast(below, ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(WIDTH), 0))

    return types.boolean(vector, types.float64), build


@instruction
def where_not_zero(typing: Any, test: Any, value: Any) -> Any:
    """Return `value` where `test` is not 0, NaN included, and 0 elsewhere."""
    if test != vector or value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(LANES, [0.0] * WIDTH)
        return builder.select(builder.fcmp_unordered("!=", args[0], zero), args[1], zero)

    return vector(vector, vector), build


@instruction
def where_greater(typing: Any, test: Any, limit: Any, value: Any) -> Any:
    """Return 0 where `test` <= `limit`, `value` elsewhere (also where either is NaN)."""
    if test != vector or limit != vector or value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(LANES, [0.0] * WIDTH)
        return builder.select(builder.fcmp_unordered(">", args[0], args[1]), args[2], zero)

    return vector(vector, vector, vector), build


@instruction
def where_not_negative(typing: Any, test: Any, value: Any, other: Any) -> Any:
    """Return `value` where `test` >= 0, `other` elsewhere (also where `test` is NaN)."""
    if not test == value == other == vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(LANES, [0.0] * WIDTH)
        return builder.select(builder.fcmp_ordered(">=", args[0], zero), args[1], args[2])

    return vector(vector, vector, vector), build


EVERY = (1 << WIDTH) - 1
"""bits of all lanes"""


@instruction
def lanes_up_to(typing: Any, value: Any, limit: Any) -> Any:
    """Return the bits of lanes that are no more than the number `limit`: bit j for lane j; NaN is not."""
    if value != vector:
        return None

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        below = builder.fcmp_ordered("<=", args[0], spread(builder, args[1]))
        return builder.zext(builder.bitcast(below, ir.IntType(WIDTH)), ir.IntType(64))

    return types.int64(vector, types.float64), build


@instruction
def first_lane(typing: Any, bits: Any) -> Any:
    """Return the number of the lowest bit that is set, of bits that are not 0."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), build


# Vectors in space, eight side by side: x, y and z of each are lanes. Lanes may also be single numbers.


@kernel
def plus(a: Triple, b: Triple) -> Triple:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def minus(a: Triple, b: Triple) -> Triple:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def times(w: Lanes, a: Triple) -> Triple:
    """Return w a."""
    return w * a[0], w * a[1], w * a[2]


@kernel
def dot(a: Triple, b: Triple) -> Lanes:
    """Return a.b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Triple, b: Triple) -> Triple:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def load_triple(a: Float, row: int, p: int) -> Triple:
    """Return three rows of `a`, from `row` on, at eight columns from p on."""
    return load(a, row, p), load(a, row + 1, p), load(a, row + 2, p)


@kernel
def read_triple(a: Float, row: int, p: int, m: int) -> Triple:
    """Return the same at up to eight columns, m of them."""
    return read(a, row, p, m), read(a, row + 1, p, m), read(a, row + 2, p, m)


@kernel
def gather_triple(a: Float, indices: Int, which: int, p: int) -> Triple:
    """Return the first three rows of `a` at the columns of eight indices in row `which`, from place p on."""
    return gather(a, 0, indices, which, p), gather(a, 1, indices, which, p), gather(a, 2, indices, which, p)
