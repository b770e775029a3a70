"""Errors that a user can act on: they state the problem, the place, the limit and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, replace


@dataclass
class BadInput(Exception):
    """Input refused before anything starts (exit code 2).

    `problem` is one sentence; the other fields are printed unless they are None.
    """

    problem: str
    file: str | None = None
    line: int | None = None
    field: str | None = None
    value: object = None
    limit: str | None = None
    remedy: str | None = None

    def __post_init__(self) -> None:
        super().__init__(self.problem)

    def at(self, field: str) -> BadInput:
        """Return this error of a file as an error of a field of the scene."""
        return replace(self, file=None, line=None, field=field)

    def told(self) -> dict[str, str | float]:
        """Return the fields that are set, as JSON values: `BadInput(**fields)` prints the same words."""
        fields = {name: value for name, value in vars(self).items() if value is not None}
        return {name: value if isinstance(value, str | int | float) else str(value) for name, value in fields.items()}

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.line) if part is not None)
        head = ": ".join(part for part in (place, self.field) if part)
        lines = [f"{head}: {self.problem}" if head else self.problem]
        if self.value is not None:
            shown = repr(self.value)
            lines.append(f"  value:  {shown if len(shown) <= 120 else shown[:117] + '...'}")
        if self.limit is not None:
            lines.append(f"  limit:  {self.limit}")
        if self.remedy is not None:
            lines.append(f"  remedy: {self.remedy}")
        return "\n".join(lines)


class RunFailed(Exception):
    """A run that failed after its start (exit code 1); its recording is kept.

    `peer` names the service that caused the failure, if it is another one.
    """

    def __init__(self, problem: str, peer: str = "") -> None:
        super().__init__(problem)
        self.peer = peer


MANY = 24
"""Largest number of names that an error lists in full."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a remedy with the nearest known name, then all known names, or the nearest few of more than MANY."""
    names = sorted(set(known))
    close = [one for one in names if one.lower() == name.lower()]  # another case alone
    close = close or difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    if len(names) > MANY and close:
        return f"{hint}near it: {', '.join(close)}, of {len(names)}"
    return f"{hint}known: {', '.join(names) if names else 'none'}"
