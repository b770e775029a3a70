"""Times and factors as people read them."""

from __future__ import annotations

import pytest

from nuno.formatting import duration, factor, many, megabytes, time_of


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.0, "0 s"), (0.25, "0.25 s"), (600.0, "600 s"), (5400.0, "1.5 h"), (720_000.0, "8.33 d")]
)
def test_long_times_are_told_in_longer_units(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_a_unit_is_the_longest_that_fits() -> None:
    assert [time_of(t)[1] for t in (0.5, 59.0, 60.0, 3599.0, 3600.0, 86400.0)] == ["s", "s", "min", "min", "h", "d"]


def test_a_factor_has_no_digits_that_nobody_reads() -> None:
    assert [factor(x) for x in (0.031, 12.345, 8178.66)] == ["0.03x", "12.35x", "8,179x"]


def test_things_and_bytes_are_counted_as_people_do() -> None:
    assert [many(n, "edge") for n in (0, 1, 2190)] == ["0 edges", "1 edge", "2,190 edges"]
    assert [megabytes(n) for n in (6.1e5, 2.19e7, 9.99e8, 9.996e8, 2.19e9)] == [
        "0.61 MB", "21.9 MB", "999 MB", "1 GB", "2.19 GB",
    ]  # fmt: skip
