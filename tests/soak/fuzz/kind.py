"""A kind of input: what valid ones look like, how they are changed, and what must hold of whoever reads them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from nuno_schemas.errors import BadInput

Read = Callable[[bytes], None]
"""Reads one input. Returns where it was accepted, raises what refuses it, or Broken."""
TAU3 = {"I": 0.1, "II": 0.1, "III": 0.1}


class Broken(Exception):
    """An input was accepted, and what the reader promises of it does not hold."""


@dataclass(frozen=True)
class Kind:
    """One kind of input.

    seeds    valid inputs, made with the project's own writers where it has any, given a folder to work in
    reader   makes the function that reads one input, given a folder to work in
    mutate   a changed input, still of the kind's structure for the most part
    follows  modules and libraries that read it, whose branches guide the search
    refusals what a reader may raise
    longest  bytes of an input
    """

    name: str
    seeds: Callable[[Path], list[bytes]]
    reader: Callable[[Path], Read]
    mutate: Callable[[bytes, Random], bytes]
    follows: tuple[str, ...]
    refusals: tuple[type[Exception], ...] = (BadInput,)
    longest: int = 20_000


def require(holds: bool, law: str) -> None:
    """Raises Broken."""
    if not holds:
        raise Broken(law)


def require_finite(**arrays: Any) -> None:
    """Raises Broken for the first array that holds NaN or an infinity."""
    for name, values in arrays.items():
        require(bool(np.isfinite(values).all()), f"{name} is not finite")
