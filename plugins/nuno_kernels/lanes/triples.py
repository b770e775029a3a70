"""Vectors in space, eight side by side: x, y and z of each are lanes. Lanes may also be single numbers."""

from __future__ import annotations

from nuno_kernels import kernel
from nuno_kernels.lanes.simd import Lanes, Triple, gather, load, read
from nuno_schemas.fabric import Float, Int


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
