"""Weaves as drawdowns, which give the upper yarn at each crossing.

A drawdown is (picks, ends) bool: rows are weft picks, columns warp ends, True where the warp is above. It is one
repeat; row 0 is at the top of a picture, column 0 at its left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool
from nuno_schemas.plugin import Config

MOST_YARNS = 16_384
"""The most yarns of a repeat, in either direction."""
MOST_CROSSINGS = 2**24

Floats = Annotated[int, Field(ge=1, le=256)]
SatinEnds = Annotated[int, Field(ge=5, le=1024)]


def draw_plain() -> Bool:
    """Return a plain weave (2, 2): every yarn goes over one and under one."""
    return np.array([[True, False], [False, True]])


def draw_twill(over: int, under: int, direction: Literal["right", "left"] = "right") -> Bool:
    """Return a twill (n, n), n = over + under: each end is above `over` picks and below `under`, one pick later than
    its neighbour.

    The diagonal climbs to the right (Z) or to the left (S) of a picture.
    """
    n = over + under
    pick, end = np.indices((n, n))
    return np.asarray((pick + end if direction == "right" else pick - end) % n < over)


def find_satin_steps(n: int) -> tuple[int, ...]:
    """Return steps of regular satins on n ends: coprime to n, and neither 1 nor n - 1, which make a twill."""
    return tuple(step for step in range(2, n - 1) if math.gcd(step, n) == 1)


def draw_satin(n: int, step: int, face: Literal["warp", "weft"] = "warp") -> Bool:
    """Return a satin (n, n): each pick binds one end, `step` ends after that of the previous pick. Elsewhere the warp
    is above (satin), or the weft (sateen). Raises BadInput for a step that leaves ends unbound, or aligns the bindings.
    """
    steps = find_satin_steps(n)
    if step not in steps:
        raise BadInput(
            f"no satin on {n} ends has this step", field="step", value=step,
            limit=f"one of {', '.join(map(str, steps))}" if steps else f"none exists for {n} ends",
            remedy="a step coprime to the ends, and not 1 or one less than the ends" if steps else "5, 7 or 8 ends",
        )  # fmt: skip
    bound = np.zeros((n, n), np.bool_)
    pick = np.arange(n)
    bound[pick, step * pick % n] = True
    return ~bound if face == "warp" else bound


def read_matrix(rows: Sequence[Sequence[object]]) -> Bool:
    """Return a drawdown (picks, ends) from rows such as "1010" or [1, 0, 1, 0].

    Raises BadInput for rows of different lengths, entries other than 0 and 1, sizes beyond the limits, and a matrix in
    which no yarn crosses another, so that its layers would be loose.
    """
    _check_size(len(rows), len(rows[0]) if len(rows) else 0)
    for pick, row in enumerate(rows):
        if len(row) != len(rows[0]):
            raise BadInput(
                "rows differ in length", field=f"rows[{pick}]", value=f"{len(row)} entries",
                limit=f"{len(rows[0])} entries, as rows[0] has",
            )  # fmt: skip
        for end, entry in enumerate(row):
            if entry not in ("0", "1", 0, 1):
                raise BadInput(
                    "not an entry of a drawdown", field=f"rows[{pick}][{end}]", value=entry,
                    limit="1 where the warp is above, 0 where the weft is",
                )  # fmt: skip
    drawdown = np.array([[entry in ("1", 1) for entry in row] for row in rows], np.bool_)
    check_interlacing(drawdown)
    return drawdown


def check_interlacing(drawdown: Bool, file: str | None = None) -> None:
    """Raise BadInput if one layer is above the other everywhere."""
    if drawdown.all() or not drawdown.any():
        raise BadInput(
            "the warp is above the weft everywhere" if drawdown.all() else "the weft is above the warp everywhere",
            file=file, field="rows" if file is None else "drawdown", limit="yarns that interlace",
            value=f"{drawdown.shape[0]} picks x {drawdown.shape[1]} ends",
        )  # fmt: skip


def _check_size(picks: int, ends: int) -> None:
    if not (1 <= picks <= MOST_YARNS and 1 <= ends <= MOST_YARNS and picks * ends <= MOST_CROSSINGS):
        raise BadInput(
            "not the size of a drawdown", field="rows", value=f"{picks} picks x {ends} ends",
            limit=f"1 to {MOST_YARNS} each, {MOST_CROSSINGS} crossings",
        )  # fmt: skip


class PlainConfig(Config):
    """Each yarn over one, under one."""

    plugin: Literal["plain"] = "plain"


class TwillConfig(Config):
    """A twill over/under, for example 2/1 for denim."""

    plugin: Literal["twill"] = "twill"
    over: Floats = Field(default=2, description="picks that an end is above, in a repeat")
    under: Floats = Field(default=2, description="picks that it is below")
    direction: Literal["right", "left"] = Field(default="right", description="to which the diagonal climbs")


class SatinConfig(Config):
    """A satin ends/step, for example 5/2 or 8/3."""

    plugin: Literal["satin"] = "satin"
    ends: SatinEnds = Field(default=5, description="of a repeat, which has as many picks")
    step: int = Field(default=2, description="ends from one pick's binding to the next one's")
    face: Literal["warp", "weft"] = Field(default="warp", description="what floats above: satin or sateen")


class MatrixConfig(Config):
    """A drawdown of your own."""

    plugin: Literal["matrix"] = "matrix"
    rows: tuple[str | tuple[int, ...], ...] = Field(
        description='one per pick, from the top, such as "1010" or [1, 0, 1, 0]: 1 where the warp is above'
    )
