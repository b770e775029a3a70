"""Quantities are converted once to SI or refused in words, and are told as people read them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nuno.formatting import data_size, duration, factor, many, time_of
from nuno_schemas import units
from nuno_schemas.units import to_si


@pytest.fixture
def fresh() -> Iterator[None]:
    """Units that are read anew."""
    units._registry.cache_clear()
    yield
    units._registry.cache_clear()


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        (2, "s", 2.0),
        ("2", "s", 2.0),
        ("1 ms", "s", 1e-3),
        ("-3.5e2 cm", "m", -3.5),
        ("27 N/m", "N/m", 27.0),
        ("0.5/s", "1/s", 0.5),
        ("0.5 1/s", "1/s", 0.5),
        ("9.81 m/s**2", "m/s^2", 9.81),
        ("9.81 m*s^-2", "m/s^2", 9.81),
        ("200 g/m^2", "kg/m^2", 0.2),
        ("90 degree", "rad", math.pi / 2),
        ("30 %", "", 0.3),
        ("1/240 s", "s", 1 / 240),
        ("1/240", "s", 1 / 240),
        ("30000/1001 Hz", "Hz", 30000 / 1001),
        ("121 g/m²", "kg/m^2", 0.121),
        ("180 gsm", "kg/m^2", 0.18),
        ("8 osy", "kg/m^2", 8 * 0.028349523125 / 0.9144**2),
        ("12 momme", "kg/m^2", 12 * 4.340e-3),
        ("12.1 mg/cm2", "kg/m^2", 0.121),
        ("2 mm2/h", "m^2/s", 2e-6 / 3600),
        ("2 gf/(cm·degree)", "N/m", 2 * 98.0665e-2 * 180 / math.pi),
        ("2 gf/cm/degree", "N/m", 2 * 98.0665e-2 * 180 / math.pi),
        ("1 grain", "kg", 64.79891e-6),
        ("100 gon", "rad", math.pi / 2),
        ("3 µN·m", "N*m", 3e-6),
        ("3 m s⁻¹", "m/s", 3.0),
        ("50 %", "", 0.5),
        ("1/2 inch", "m", 0.0127),
        ("5\u00a0cm", "m", 0.05),
    ],
)
def test_quantities_are_converted(text: object, unit: str, value: float) -> None:
    assert to_si(text, unit) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "unit", "words"),
    [
        ("1 lightyer", "m", "unknown unit 'lightyer'; write for example '1 m'"),
        ("1 kg", "m", "kilogram cannot be converted to m; write for example '1 m'"),
        ("1 kg", "", "kilogram cannot be converted to a plain number"),
        ("soon", "s", "not a quantity; write for example '1 s', or a plain number in s"),
        ("", "s", "not a quantity"),
        ("ms", "s", "not a quantity"),
        ("1/0 s", "s", "not a quantity"),
        ("1/2/3 s", "s", "not a quantity"),
        ("2,1 s", "s", "a decimal comma; write 2.1 s"),
        ("0,1 m", "m", "write 0.1 m"),
        (" -,1m", "m", "write -0.1m"),
        ("1,2", "s", "write 1.2"),
        ("2,1e1 s", "s", "write 2.1e1 s"),
        ("1,111 m", "m", "write 1.111 m, or 1111 m if thousands are meant"),
        ("1.111,1 m", "m", "not a quantity"),
        ("1,1,1 m", "m", "not a quantity"),
        ("2 1 s", "s", "not a quantity"),
        ("2. 1 s", "s", "not a quantity"),
        ("2·1 s", "s", "not a quantity"),
        ("2'1 s", "s", "not a quantity"),
        ("1_1 s", "s", "not a quantity"),
        ("1½ s", "s", "not a quantity"),
        ("150 gr/m^2", "kg/m^2", "gr is of two meanings; write g for gram, or grain"),
        ("30 grad", "rad", "write deg for degree, or gon"),
        ("30 Grad", "rad", "write deg"),
        ("5² m", "m", "not a quantity"),
        ("5 ² m", "m", "not a quantity"),
        ("5± m", "m", "not a quantity"),
        ("5 m'", "m", "not a quantity"),
        ("5 m? ", "m", "not a quantity"),
        ("5;m", "m", "not a quantity"),
        ("5\u200b m", "m", "not a quantity"),
        ("1,200.5 m", "m", "not a quantity"),
        ("1.200,5 m", "m", "not a quantity"),
        ("1'200 m", "m", "not a quantity"),
        ("1 200 m", "m", "not a quantity"),
        ("1/2,1 s", "s", "not a quantity"),
        ("5 k,m", "m", "not a quantity"),
        ("1 m + 2 m", "m", "not a quantity"),
        ("1 m22", "m^2", "not a quantity"),
        ("2 gf/cm·degree", "N/m", "gf/(cm*degree)"),
        ("2 gf/cm deg", "N/m", "gf/(cm*deg)"),
        ("x" * 101, "s", "at most 100 characters"),
        (True, "s", "must be a quantity"),
        (None, "s", "must be a quantity"),
        ([1], "s", "must be a quantity"),
        (math.nan, "s", "must be finite"),
        pytest.param(10**400, "s", "must be finite", id="400 digits"),
        ("1e400 s", "s", "must be finite"),
        ("inf", "s", "must be finite"),
        ("-inf", "s", "must be finite"),
    ],
)
def test_what_is_no_quantity_is_refused_in_words(text: object, unit: str, words: str) -> None:
    with pytest.raises(ValueError) as caught:
        to_si(text, unit)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "9**9**9**9 m",
        "1 m**9**9**9",
        "1 m^(9^9^9)",
        "1 m*9**99999999",
        "2**99999999",
        "1 (m**99)**99**99",
        "1 m**999999",
    ],
)
def test_expressions_are_not_evaluated(text: str) -> None:
    # Each would keep pint busy for longer than anybody waits.
    with pytest.raises(ValueError, match="not a quantity"):
        to_si(text, "m")


@settings(deadline=None, derandomize=True)
@given(
    st.one_of(st.text(max_size=30), st.text("0123456789.eE+-*/^() msNkg", max_size=30)), st.sampled_from(["s", "m/s^2"])
)
def test_any_text_is_a_finite_number_or_a_value_error(text: str, unit: str) -> None:
    try:
        value = to_si(text, unit)
    except ValueError:
        return
    assert math.isfinite(value)


@pytest.mark.usefixtures("fresh")
def test_units_are_read_where_they_cannot_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("no folder can be made below it")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "cache"))
    assert to_si("1 ms", "s") == pytest.approx(1e-3)


@pytest.mark.usefixtures("fresh")
def test_units_that_were_kept_in_part_are_read_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert to_si("1 ms", "s") == pytest.approx(1e-3)
    kept = list(tmp_path.rglob("*.pickle"))
    assert kept
    for file in kept:
        file.write_bytes(file.read_bytes()[:-100])
    units._registry.cache_clear()
    assert to_si("2 ms", "s") == pytest.approx(2e-3)


def test_a_fault_of_the_machine_is_no_bad_quantity(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise PermissionError("no units")

    monkeypatch.setattr(units, "_registry", fail)
    with pytest.raises(PermissionError):
        to_si("1 ms", "s")


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
    assert [data_size(n) for n in (0, 6.1e5, 9.996e5, 2.19e7, 9.99e8, 9.996e8, 2.19e9)] == [
        "0 kB", "610 kB", "1 MB", "21.9 MB", "999 MB", "1 GB", "2.19 GB",
    ]  # fmt: skip
