"""Weaves: the definition of each, by counting floats and bindings."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nuno_dye.drafts.weaves import draw_plain, draw_satin, draw_twill, find_satin_steps, read_matrix
from nuno_schemas.errors import BadInput


def longest_float(drawdown: np.ndarray) -> int:
    """Longest run of True along the picks of a repeat that goes on for ever."""
    longest = 0
    for end in np.tile(drawdown, (2, 1)).T:
        runs = "".join("x" if up else " " for up in end).split()
        longest = max([longest, *map(len, runs)])
    return longest


def test_plain_alternates_along_every_yarn() -> None:
    twice = np.tile(draw_plain(), (2, 2))
    assert (twice[1:] != twice[:-1]).all() and (twice[:, 1:] != twice[:, :-1]).all()


@pytest.mark.parametrize(("over", "under"), [(1, 2), (2, 1), (2, 2), (3, 1), (4, 3), (1, 1)])
def test_twill_floats_over_and_under_and_moves_by_one_pick(over: int, under: int) -> None:
    n = over + under
    for direction, to_the_right in (("right", -1), ("left", 1)):
        weave = draw_twill(over, under, direction)  # type: ignore[arg-type]
        assert weave.shape == (n, n)
        assert (weave.sum(axis=0) == over).all() and (weave.sum(axis=1) == over).all()
        assert longest_float(weave) == over and longest_float(~weave) == under
        # A step to the right is a step up for a right-hand twill: row 0 is on top.
        for end in range(n):
            assert np.array_equal(weave[:, (end + 1) % n], np.roll(weave[:, end], to_the_right))


@pytest.mark.parametrize("n", range(5, 24))
def test_satin_binds_every_end_once_and_no_two_side_by_side(n: int) -> None:
    assert find_satin_steps(n) == tuple(s for s in range(2, n - 1) if math.gcd(s, n) == 1)
    for step in find_satin_steps(n):
        sateen = draw_satin(n, step, "weft")
        assert (sateen.sum(axis=0) == 1).all() and (sateen.sum(axis=1) == 1).all()
        # No binding touches another, not even at a corner, also from repeat to repeat.
        around = sum(np.roll(sateen, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0))
        assert not (sateen & (np.asarray(around) > 0)).any()
        assert np.array_equal(draw_satin(n, step, "warp"), ~sateen)


@pytest.mark.parametrize(
    ("n", "step"), [(5, 1), (5, 4), (5, 0), (5, 5), (8, 2), (8, 4), (9, 6), (6, 5), (5, -2), (5, 7)]
)
def test_what_is_no_satin_is_refused_with_the_steps_that_are(n: int, step: int) -> None:
    with pytest.raises(BadInput) as refused:
        draw_satin(n, step)
    steps = find_satin_steps(n)
    assert refused.value.field == "step" and refused.value.value == step
    assert all(str(known) in str(refused.value.limit) for known in steps or ("none",))


def test_a_matrix_is_read_as_written() -> None:
    weave = read_matrix(["110", "011"])
    assert weave.dtype == np.bool_ and weave.tolist() == [[True, True, False], [False, True, True]]
    assert np.array_equal(weave, read_matrix([[1, 1, 0], [0, 1, 1]]))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([], "0 picks"),
        ([""], "0 ends"),
        (["10", "1"], r"rows\[1\].*\n.*1 entries\D*2 entries"),
        (["10", "1x"], r"rows\[1\]\[1\]"),
        ([[0, 2]], r"rows\[0\]\[1\]"),
        (["11", "11"], "warp is above the weft everywhere"),
        (["00"], "weft is above the warp everywhere"),
        (["01" * 10_000], "20000 ends"),
        ([range(5000)] * 5000, "5000 picks"),
    ],
)
def test_what_is_no_drawdown_is_refused(rows: list[str], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        read_matrix(rows)
