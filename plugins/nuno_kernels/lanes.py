"""Eight float64 lanes as one value, so that kernels vectorise by construction: arithmetic, choices, and vectors in
space.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from functools import wraps
from itertools import product
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

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
ZERO = ir.Constant(LANES, [0.0] * WIDTH)

Lanes = Any
"""eight float64 lanes as one value in compiled code; Python itself has none"""
Triple = tuple[Lanes, Lanes, Lanes]
"""x, y, z of eight vectors"""
Seven = tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]
"""the first seven numbers of eight rows"""


class _VectorType(types.Type):  # type: ignore[misc]
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

    @type_callable(op)  # type: ignore[untyped-decorator]
    def typed(context: Any) -> Any:
        def accept(a: Any, b: Any) -> Any:
            kinds = [vector if one == vector else types.float64 for one in (a, b)]
            numbers = all(one == vector or isinstance(one, types.Integer | types.Float) for one in (a, b))
            return vector(*kinds) if numbers and vector in kinds else None

        return accept

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pair = [a if kind == vector else spread(builder, a) for kind, a in zip(sig.args, args, strict=True)]
        return getattr(builder, method)(*pair)

    for kinds in product((vector, types.float64), repeat=2):
        if vector in kinds:
            lower_builtin(op, *kinds)(lower)


for _op, _method in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _define(_op, _method)


PLANE, INDICES = types.Array(types.float64, 2, "C"), types.Array(types.int32, 2, "C")


def instruction(result: Any, *kinds: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make emit(builder, *values) a function that compiled code calls with values of these types, and that returns a
    `result`. Of arrays, which are C-contiguous, it is given views.
    """

    def accepts(kind: Any, given: Any) -> bool:
        if not isinstance(kind, types.Array):
            return bool(kind != vector or given == vector)
        wanted = kind.ndim, kind.layout, kind.dtype
        return isinstance(given, types.Array) and (given.ndim, given.layout, given.dtype) == wanted

    def make(emit: Callable[..., Any]) -> Any:
        @wraps(emit)
        def typed(typing: Any, *given: Any) -> Any:
            if not all(map(accepts, kinds, given)):
                return None
            pairs = zip(kinds, given, strict=True)
            return result(*(one if isinstance(kind, types.Array) else kind for kind, one in pairs)), build

        def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            views = [
                context.make_array(kind)(context, builder, value) if isinstance(kind, types.Array) else value
                for kind, value in zip(sig.args, args, strict=True)
            ]
            found = emit(builder, *views)
            return context.get_dummy_value() if result == types.void else found

        return intrinsic(typed)

    return make


def address(builder: Any, view: Any, row: Any, column: Any) -> Any:
    """Return a pointer to [row, column] of a view of an array."""
    columns = builder.extract_value(view.shape, 1)
    return builder.gep(view.data, [builder.add(builder.mul(row, columns), column)])


def _lanes_at(builder: Any, view: Any, row: Any, column: Any) -> Any:
    """Return a pointer to eight values from [row, column] of a view on."""
    return builder.bitcast(address(builder, view, row, column), LANES.as_pointer())


def _mask(builder: Any, count: Any) -> Any:
    """Return a mask of lanes 0 .. count - 1."""
    index = ir.VectorType(ir.IntType(64), WIDTH)
    return builder.icmp_signed("<", ir.Constant(index, list(range(WIDTH))), spread(builder, count, index))


def call(builder: Any, name: str, result: Any, *values: Any) -> Any:
    """Call one of LLVM's functions."""
    kind, known = ir.FunctionType(result, [value.type for value in values]), builder.module.globals
    return builder.call(known[name] if name in known else ir.Function(builder.module, kind, name), values)


@instruction(vector, PLANE, types.int64, types.int64)
def load(builder: Any, array: Any, row: Any, column: Any) -> Any:
    """Return eight values from array[row, column] on."""
    return builder.load(_lanes_at(builder, array, row, column), align=8)


@instruction(types.void, PLANE, types.int64, types.int64, vector)
def store(builder: Any, array: Any, row: Any, column: Any, value: Any) -> None:
    """Write eight values to array[row, column] and on."""
    builder.store(value, _lanes_at(builder, array, row, column), align=8)


@instruction(vector, PLANE, types.int64, types.int64, types.int64)
def load_first(builder: Any, array: Any, row: Any, column: Any, count: Any) -> Any:
    """Return the first `count` of eight values, zeros in the other lanes; reads nothing else."""
    pointer, mask = _lanes_at(builder, array, row, column), _mask(builder, count)
    return call(builder, "llvm.masked.load.v8f64.p0", LANES, pointer, ir.Constant(_I32, 8), mask, ZERO)


@instruction(types.void, PLANE, types.int64, types.int64, types.int64, vector)
def store_first(builder: Any, array: Any, row: Any, column: Any, count: Any, value: Any) -> None:
    """Write the first `count` of eight values and nothing else."""
    pointer, mask = _lanes_at(builder, array, row, column), _mask(builder, count)
    call(builder, "llvm.masked.store.v8f64.p0", ir.VoidType(), value, pointer, ir.Constant(_I32, 8), mask)


def _places(builder: Any, array: Any, row: Any, index: Any, which: Any, start: Any) -> Iterator[Any]:
    """Yield pointers to array[row, index[which, start + lane]] for eight lanes."""
    base = address(builder, array, row, ir.Constant(ir.IntType(64), 0))
    places = address(builder, index, which, start)
    for lane in range(WIDTH):
        place = builder.load(builder.gep(places, [ir.Constant(ir.IntType(64), lane)]))
        yield builder.gep(base, [builder.sext(place, ir.IntType(64))])


@instruction(vector, PLANE, types.int64, INDICES, types.int64, types.int64)
def gather(builder: Any, array: Any, row: Any, index: Any, which: Any, start: Any) -> Any:
    """Return array[row, index[which, start + lane]] for eight lanes; index is (w, m) int32."""
    value = ir.Constant(LANES, ir.Undefined)
    for lane, pointer in enumerate(_places(builder, array, row, index, which, start)):
        value = builder.insert_element(value, builder.load(pointer), ir.Constant(_I32, lane))
    return value


@instruction(types.void, PLANE, types.int64, INDICES, types.int64, types.int64, vector)
def add_at(builder: Any, array: Any, row: Any, index: Any, which: Any, start: Any, value: Any) -> None:
    """Add array[row, index[which, start + lane]] += value[lane], lane after lane."""
    for lane, pointer in enumerate(_places(builder, array, row, index, which, start)):
        item = builder.extract_element(value, ir.Constant(_I32, lane))
        builder.store(builder.fadd(builder.load(pointer), item), pointer)


def transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Return the columns of a square of numbers, both as vectors: in each turn squares twice as wide change places."""
    size, width = len(rows), 1
    while width < size:
        kept = [lane if not lane & width else size + lane - width for lane in range(size)]
        given = [lane + width if not lane & width else size + lane for lane in range(size)]
        for one in (row for row in range(size) if not row & width):
            pair = rows[one], rows[one + width]
            for row, lanes in ((one, kept), (one + width, given)):
                rows[row] = builder.shuffle_vector(*pair, ir.Constant(ir.VectorType(_I32, size), lanes))
        width *= 2
    return rows


@instruction(types.UniTuple(vector, 7), PLANE, INDICES, types.int64)
def gather_rows(builder: Any, array: Any, index: Any, column: Any) -> Any:
    """Return the first seven columns of an array (n, 8) in eight rows, index[lane, column]."""
    rows = []
    for lane in range(WIDTH):
        row = builder.load(address(builder, index, ir.Constant(ir.IntType(64), lane), column))
        first = ir.Constant(ir.IntType(64), 0)
        rows.append(builder.load(_lanes_at(builder, array, builder.sext(row, ir.IntType(64)), first), align=8))
    found = ir.Constant(ir.ArrayType(LANES, 7), ir.Undefined)
    for number, columns in enumerate(transposed(builder, rows)[:7]):
        found = builder.insert_value(found, columns, number)
    return found


@instruction(vector, types.float64)
def splat(builder: Any, value: Any) -> Any:
    """Return the same number in all lanes."""
    return spread(builder, value)


@instruction(vector, vector)
def root(builder: Any, value: Any) -> Any:
    """Return the square root of every lane."""
    return call(builder, "llvm.sqrt.v8f64", LANES, value)


@instruction(vector, vector)
def magnitude(builder: Any, value: Any) -> Any:
    """Return the absolute value of every lane."""
    return call(builder, "llvm.fabs.v8f64", LANES, value)


@instruction(vector, vector, vector, vector)
def fused(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c of every lane, rounded once: the same on every machine."""
    return call(builder, "llvm.fma.v8f64", LANES, a, b, c)


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


@instruction(vector, vector, vector, types.int64)
def alternate(builder: Any, even: Any, odd: Any, first: Any) -> Any:
    """Return `even` in the lanes whose number `first` + lane is even, `odd` in the others."""
    index = ir.VectorType(ir.IntType(64), WIDTH)
    number = builder.add(spread(builder, first, index), ir.Constant(index, list(range(WIDTH))))
    parity = builder.and_(number, ir.Constant(index, [1] * WIDTH))
    return builder.select(builder.icmp_signed("==", parity, ir.Constant(index, [0] * WIDTH)), even, odd)


@instruction(vector, vector, vector)
def lower(builder: Any, a: Any, b: Any) -> Any:
    """Return the lesser of `a` and `b` in every lane; `b` if either is NaN."""
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


@instruction(vector, vector, vector)
def higher(builder: Any, a: Any, b: Any) -> Any:
    """Return the greater of `a` and `b` in every lane; `b` if either is NaN."""
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


@instruction(types.float64, vector, types.int64)
def lane(builder: Any, value: Any, which: Any) -> Any:
    """Return one of the eight numbers."""
    return builder.extract_element(value, which)


@instruction(vector, vector, types.int64, types.float64)
def with_lane(builder: Any, value: Any, which: Any, number: Any) -> Any:
    """Return the vector with another number in one lane."""
    return builder.insert_element(value, number, which)


@instruction(types.boolean, vector, types.float64)
def any_below(builder: Any, value: Any, limit: Any) -> Any:
    """Whether any lane is less than the number `limit`; NaN is not."""
    below = builder.fcmp_ordered("<", value, spread(builder, limit))
    bits = builder.bitcast(below, ir.IntType(WIDTH))
    return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(WIDTH), 0))


@instruction(vector, vector, vector)
def where_not_zero(builder: Any, test: Any, value: Any) -> Any:
    """Return `value` where `test` is not 0, NaN included, and 0 elsewhere."""
    return builder.select(builder.fcmp_unordered("!=", test, ZERO), value, ZERO)


@instruction(vector, vector, vector, vector)
def where_greater(builder: Any, test: Any, limit: Any, value: Any) -> Any:
    """Return 0 where `test` <= `limit`, `value` elsewhere (also where either is NaN)."""
    return builder.select(builder.fcmp_unordered(">", test, limit), value, ZERO)


@instruction(vector, vector, vector, vector)
def where_not_negative(builder: Any, test: Any, value: Any, other: Any) -> Any:
    """Return `value` where `test` >= 0, `other` elsewhere (also where `test` is NaN)."""
    return builder.select(builder.fcmp_ordered(">=", test, ZERO), value, other)


EVERY = (1 << WIDTH) - 1
"""bits of all lanes"""


@instruction(types.int64, vector, types.float64)
def lanes_up_to(builder: Any, value: Any, limit: Any) -> Any:
    """Return the bits of lanes that are no more than the number `limit`: bit j for lane j; NaN is not."""
    below = builder.fcmp_ordered("<=", value, spread(builder, limit))
    return builder.zext(builder.bitcast(below, ir.IntType(WIDTH)), ir.IntType(64))


@instruction(types.int64, vector, types.float64)
def lanes_above(builder: Any, value: Any, limit: Any) -> Any:
    """Return the bits of lanes that are greater than the number `limit`; NaN is not."""
    above = builder.fcmp_ordered(">", value, spread(builder, limit))
    return builder.zext(builder.bitcast(above, ir.IntType(WIDTH)), ir.IntType(64))


@instruction(types.int64, types.int64)
def first_lane(builder: Any, bits: Any) -> Any:
    """Return the number of the lowest bit that is set, of bits that are not 0."""
    return builder.cttz(bits, ir.Constant(ir.IntType(1), 1))


# Vectors in space, eight side by side: x, y and z of each are lanes. Lanes may also be single numbers.

Three = Triple | Float
"""A vector, also as an array (3,)."""


@kernel
def plus(a: Three, b: Three) -> Triple:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def minus(a: Three, b: Three) -> Triple:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def times(w: Lanes, a: Three) -> Triple:
    """Return w a."""
    return w * a[0], w * a[1], w * a[2]


@kernel
def over(a: Three, w: Lanes) -> Triple:
    """Return a / w."""
    return a[0] / w, a[1] / w, a[2] / w


@kernel
def dot(a: Three, b: Three) -> Lanes:
    """Return a.b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Three, b: Three) -> Triple:
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


@kernel
def edge(a: Float, i: int, j: int) -> tuple[float, float, float]:
    """Return column j minus column i of `a` (3, n), single numbers."""
    return a[0, j] - a[0, i], a[1, j] - a[1, i], a[2, j] - a[2, i]
