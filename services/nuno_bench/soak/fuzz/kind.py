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


class Broken(Exception):
    """An input was accepted, and what the reader promises of it does not hold."""


@dataclass(frozen=True)
class Kind:
    """One kind of input.

    seeds    valid inputs, made with the project's own writers where it has any, given a folder to work in
    reader   makes the function that reads one input, given a folder to work in
    mutate   a changed input, still of the kind's structure for the most part
    modules  whose lines are counted: where the kind is read
    follows  libraries that read it, which guide the search, too, but are not counted
    refusals what a reader may raise
    """

    name: str
    seeds: Callable[[Path], list[bytes]]
    reader: Callable[[Path], Read]
    mutate: Callable[[bytes, Random], bytes]
    modules: tuple[str, ...]
    follows: tuple[str, ...] = ()
    refusals: tuple[type[Exception], ...] = (BadInput,)
    words: tuple[str, ...] = ()
    longest: int = 20_000
    """Bytes of an input."""


class OneFile:
    """Stands for a scene's files: whatever is named is the one that is being tried."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def resolve(self, name: str) -> Path:
        return self.path


def require(holds: bool, law: str) -> None:
    """Raises Broken."""
    if not holds:
        raise Broken(law)


def require_finite(**arrays: Any) -> None:
    """Raises Broken for the first array that holds NaN or an infinity."""
    for name, values in arrays.items():
        require(bool(np.isfinite(values).all()), f"{name} is not finite")
