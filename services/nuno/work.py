"""What a service that steps is given to step, and what comes back of a frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Protocol

from nuno.scene.scene_file import Loaded


class Work(Protocol):
    """What is stepped, independent of how it is sent."""

    loaded: Loaded
    frame: int

    @property
    def t(self) -> float: ...

    @property
    def finished(self) -> bool: ...

    def digest(self) -> str:
        """Hash of the float64 state: equal digests mean equal bits."""
        ...

    def set(self, item: str) -> None:
        """Change a field of the running scene. Raises BadInput."""
        ...

    def add(self, item: str) -> str:
        """Add an item, `list: {...}`, to the running scene; its field. Raises BadInput."""
        ...


class Report(Protocol):
    """What a solver says of a frame."""

    @property
    def status(self) -> Literal["ok", "diverged", "unconverged"]: ...

    @property
    def message(self) -> str: ...

    @property
    def totals(self) -> Mapping[str, int]: ...
