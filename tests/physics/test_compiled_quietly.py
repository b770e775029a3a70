"""While kernels are compiled nothing looks for garbage, and what looked for it before does so again."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import numba
import pytest
from numba.core import event
from numba.core.errors import NumbaError

import nuno_kernels  # noqa: F401


@pytest.fixture
def looking() -> Iterator[list[bool]]:
    """Whether garbage was looked for, at the start of each compilation and after each."""
    seen: list[bool] = []

    class Watch(event.Listener):  # type: ignore[misc]
        def on_start(self, event: object) -> None:
            seen.append(gc.isenabled())

        def on_end(self, event: object) -> None:
            seen.append(gc.isenabled())

    watch = Watch()
    event.register("numba:compile", watch)
    gc.enable()
    yield seen
    event.unregister("numba:compile", watch)
    gc.enable()


def test_a_compilation_and_those_within_it_are_quiet(looking: list[bool]) -> None:
    inner = numba.njit(lambda x: 2.0 * x)
    assert numba.njit(lambda x: inner(x) + 1.0)(2.0) == 5.0
    assert looking == [False, False, False, True] and gc.isenabled()


def test_one_that_fails_leaves_garbage_to_be_looked_for(looking: list[bool]) -> None:
    with pytest.raises(NumbaError):
        numba.njit(lambda x: x.nothing)(2.0)
    assert gc.isenabled() and not any(looking[:-1])


def test_who_looks_for_none_goes_on_so(looking: list[bool]) -> None:
    gc.disable()
    assert numba.njit(lambda x: 3.0 * x)(2.0) == 6.0
    assert not gc.isenabled() and not any(looking)
