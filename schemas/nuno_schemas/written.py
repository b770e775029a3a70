"""A YAML or JSON file written by a user: its fields, and the line of each field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from pydantic import BaseModel

from nuno_schemas.errors import BadInput

Path = tuple[str | int, ...]
"""Path of a field from the top of the file: ("objects", 0, "name")."""
Fields = TypeVar("Fields", bound=BaseModel)


def dotted(path: Path) -> str:
    """Return a path as text: ("objects", 0, "name") -> "objects[0].name"."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


@dataclass(frozen=True)
class Written(Generic[Fields]):
    """Fields as validated by their model, the name of the file in errors, and the line of every path in it."""

    said: Fields
    file: str
    lines: Mapping[Path, int]

    def line(self, path: Path) -> int | None:
        """Return the line of a field, or of the innermost field around it that has one."""
        return next((self.lines[path[:k]] for k in range(len(path), -1, -1) if path[:k] in self.lines), None)

    def wrong(
        self, problem: str, path: Path, value: object = None, limit: str | None = None, remedy: str | None = None
    ) -> BadInput:
        """Return an error for a field that its model accepts, but that makes no sense."""
        return BadInput(problem, self.file, self.line(path), dotted(path), value, limit, remedy)
