"""Kernels that are called by address keep their hands off the arrays that they are lent, and free what they make."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from nuno_kernels import FLAGS, block_kernel, kernel
from nuno_kernels.compile.calling_convention import Borrowing
from nuno_kernels.compile.reference import by_reference
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float


class Pair(NamedTuple):
    first: Float
    second: Float


@by_reference
class Lent(NamedTuple):
    """The same by reference, with what else a term may hold."""

    first: Float
    second: Float
    scale: float = 2.0
    on: bool = True
    none: None = None
    inner: tuple[Any, ...] = ()


@kernel
def longer(pair: Pair) -> Float:
    """An array out of two, chosen in a branch, where numba counts."""
    return pair.first if pair.first.shape[0] > pair.second.shape[0] else pair.second


@block_kernel
def borrow(pair: Pair, out: Float) -> None:
    for i in range(out.shape[0]):
        out[i] += longer(pair)[i]


@block_kernel
def make(pair: Pair, out: Float) -> None:
    made = np.full(out.shape[0], 1.0)
    for i in range(out.shape[0]):
        out[i] += made[i] * longer(pair)[i]


@block_kernel
def hand_back(pair: Pair, out: Float) -> Float:
    return longer(pair)


@block_kernel
def make_and_hand_back(pair: Pair) -> Float:
    made = np.empty(pair.first.shape[0])
    made[:] = 1.0
    return made


@block_kernel
def take(pair: Pair, out: Float) -> None:
    """Makes nothing, and has an array all the same."""
    made = make_and_hand_back(pair)
    for i in range(out.shape[0]):
        out[i] += made[i] * longer(pair)[i]


@kernel
def call_all(pair: Pair, out: Float) -> float:
    total = 0.0
    for _ in range(100):
        borrow(pair, out)
        make(pair, out)
        take(pair, out)
        total += hand_back(pair, out)[0]
    return total


@pytest.mark.parametrize("kind", [Pair, Lent])
def test_references_are_as_before_and_nothing_leaks(kind: Any) -> None:
    pair, out = kind(np.arange(8.0), np.arange(5.0)), np.zeros(4)
    assert call_all(pair, out) == 0.0
    np.testing.assert_array_equal(out, 300.0 * np.arange(4.0))
    counts = [sys.getrefcount(one) for one in (*pair[:2], out)]
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    for _ in range(10):
        call_all(pair, out)
    after = rtsys.get_allocation_stats()
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free
    assert after.alloc - before.alloc == after.free - before.free
    assert [sys.getrefcount(one) for one in (*pair[:2], out)] == counts
    np.testing.assert_array_equal(pair.first, np.arange(8.0))


@pytest.mark.parametrize(("function", "counts"), [(borrow, False), (make, True), (hand_back, True), (take, True)])
def test_only_what_makes_takes_or_hands_back_arrays_counts(function: Any, counts: bool) -> None:
    """By what is left of numba's counting when all is optimised."""
    fresh = numba.njit(pipeline_class=Borrowing, no_cpython_wrapper=True, **FLAGS)(function.py_func)
    fresh.compile((numba.typeof(Pair(np.zeros(8), np.zeros(5))), numba.typeof(np.zeros(4))))
    (code,) = fresh.inspect_llvm().values()
    assert ("call void @NRT_" in code) == counts


@block_kernel
def read_all(place: int, lent: Lent, out: Float) -> None:
    inner = lent.inner[0]
    if lent.on and lent.none is None:
        out[place] = lent.scale * lent.first[place] + inner.scale * inner.second[place]


read_blocks = over_blocks(read_all, "lent, out")


@kernel
def read_over(lent: Lent, out: Float, threads: int | None) -> None:
    read_blocks(lent, out, out.shape[0], threads)


@pytest.mark.parametrize("threads", [None, 2])
@pytest.mark.parametrize("on", [False, True])
def test_by_reference_all_is_there(on: bool, threads: int | None) -> None:
    """Numbers, what is None and what is within, also where threads read it."""
    first, second = np.random.default_rng(2).random((2, 50))
    out = np.zeros(50)
    read_over(Lent(first, second, 3.0, on, None, (Lent(second, first, 5.0),)), out, threads)
    np.testing.assert_array_equal(out, 3.0 * first + 5.0 * first if on else np.zeros(50))


def test_by_reference_is_one_argument() -> None:
    """In the place of the fourteen numbers that two arrays of one dimension are."""
    arguments = {}
    for kind in (Pair, Lent):
        fresh = numba.njit(pipeline_class=Borrowing, no_cpython_wrapper=True, **FLAGS)(borrow.py_func)
        fresh.compile((numba.typeof(kind(np.zeros(8), np.zeros(5))), numba.typeof(np.zeros(4))))
        ((made,),) = [list(fresh.overloads.values())]
        library = made.library.get_function(made.fndesc.llvm_func_name)
        arguments[kind] = len(list(library.arguments))
    assert arguments[Pair] - arguments[Lent] == 13


def taking_apart(arrays: int) -> int:
    """Lines of code of a kernel that Python calls with so many arrays by reference."""
    held = by_reference(NamedTuple("Held", [(f"array_{i}", Any) for i in range(arrays)]))  # type: ignore[misc]
    fresh = numba.njit(**FLAGS)(lambda held: 1.0)
    fresh.compile((numba.typeof(held(*[np.zeros(3)] * arrays)),))
    (code,) = fresh.inspect_llvm().values()
    return len(code.splitlines())


def test_python_hands_over_an_array_by_a_few_instructions() -> None:
    """Seven lines, where numba takes twenty and a branch: a system has two hundred arrays."""
    assert taking_apart(40) - taking_apart(20) <= 8 * 20
