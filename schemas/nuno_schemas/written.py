"""A file of fields that someone has written, YAML or JSON: what it says, and the line of each field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from pydantic import BaseModel

from nuno_schemas.errors import BadInput

Path = tuple[str | int, ...]
"""Where a field stands, from the file's top on: ("objects", 0, "name")."""
Fields = TypeVar("Fields", bound=BaseModel)


def dotted(path: Path) -> str:
    """("objects", 0, "name") -> "objects[0].name"."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


@dataclass(frozen=True)
class Written(Generic[Fields]):
    """Fields as their model took them, what errors call the file, and the line of every path in it."""

    said: Fields
    file: str
    lines: Mapping[Path, int]

    def line(self, path: Path) -> int | None:
        """Of a field, or of the nearest that it is in."""
        return next((self.lines[path[:k]] for k in range(len(path), -1, -1) if path[:k] in self.lines), None)

    def wrong(
        self, problem: str, path: Path, value: object = None, limit: str | None = None, remedy: str | None = None
    ) -> BadInput:
        """The error of a field that means nothing, though its model takes it."""
        return BadInput(problem, self.file, self.line(path), dotted(path), value, limit, remedy)
