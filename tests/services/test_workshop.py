"""What a page waits for is made in a process that is ended where that is no longer wanted, or takes too much."""

from __future__ import annotations

import operator
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nuno.scene import yaml_lines
from nuno.studio.processes import Workshop
from nuno_schemas.errors import BadInput

REMEDY = "make less of it"
SOON = 8.0
"""Within what a process begins, on a machine that is busy [s]."""


@pytest.fixture(scope="module")
def shop() -> Iterator[Workshop]:
    one = Workshop("it", 60.0, REMEDY)
    yield one
    one.close()


def begin(shop: Workshop, page: str, *task: object) -> tuple[threading.Thread, list[str]]:
    """Ask for something beside: what was refused of it."""
    refused: list[str] = []

    def ask() -> None:
        try:
            shop.make(page, *task)  # type: ignore[arg-type]
        except BadInput as error:
            refused.append(error.problem)

    thread = threading.Thread(target=ask)
    thread.start()
    return thread, refused


def test_what_is_asked_for_anew_ends_what_the_page_asked_for_before_and_the_process_goes_on(shop: Workshop) -> None:
    number = shop.make("a", os.getpid)
    assert number != os.getpid()
    waiting = []
    for _ in range(7):
        waiting.append(begin(shop, "a", time.sleep, 50.0))
        time.sleep(0.05)
    start = time.monotonic()
    assert shop.make("a", os.getpid) == number and time.monotonic() - start < SOON
    for thread, refused in waiting:
        thread.join(SOON)
        assert refused == ["another one has been asked for meanwhile"]


def test_another_page_waits_for_its_turn_and_nothing_of_the_first_is_lost(shop: Workshop) -> None:
    first, refused = begin(shop, "a", time.sleep, 0.4)
    time.sleep(0.1)
    assert shop.make("b", operator.add, 1, 2) == 3
    first.join(SOON)
    assert not refused
    left, refused = begin(shop, "a", time.sleep, 50.0)
    time.sleep(0.1)
    shop.forget("a")
    left.join(SOON)
    assert refused


def test_what_cannot_be_interrupted_is_killed_and_the_next_is_made(shop: Workshop) -> None:
    number = shop.make("a", os.getpid)
    thread, refused = begin(shop, "a", sum, range(10**10))  # one call of C
    time.sleep(0.2)
    assert shop.make("a", os.getpid) != number
    thread.join(SOON)
    assert refused


def test_time_and_memory_have_limits_that_are_told() -> None:
    short = Workshop("it", 0.3, REMEDY)
    with pytest.raises(BadInput, match="it takes too long") as refused:
        short.make("a", time.sleep, 50.0)
    assert (refused.value.limit, refused.value.remedy) == ("0.3 s", REMEDY)
    short.close()
    small = Workshop("it", 60.0, REMEDY, 2**28)
    with pytest.raises(BadInput, match="it takes too much memory") as refused:
        small.make("a", operator.mul, b"x" * 2**10, 2**21)
    assert refused.value.limit == "0.25 GiB"
    assert small.make("a", operator.add, 1, 2) == 3
    small.close()


def test_errors_arrive_as_they_were_raised_and_a_process_that_dies_is_told(shop: Workshop) -> None:
    with pytest.raises(BadInput) as there:
        shop.make("a", yaml_lines.parse, "a: [", "x.yaml")
    with pytest.raises(BadInput) as here:
        yaml_lines.parse("a: [", "x.yaml")
    assert str(there.value) == str(here.value)
    with pytest.raises(ZeroDivisionError):
        shop.make("a", operator.truediv, 1, 0)
    with pytest.raises(BadInput, match="has ended on its way"):
        shop.make("a", os._exit, 3)
    assert shop.make("a", operator.add, 1, 2) == 3


def test_it_works_in_the_present_folder_and_imports_nothing_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("queue", "pickle", "psutil", "nuno"):
        Path(f"{name}.py").write_text("raise SystemExit('the wrong module')\n")
    one = Workshop("it", 60.0, REMEDY)
    assert one.make("a", os.getcwd) == str(tmp_path)
    one.close()
