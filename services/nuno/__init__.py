"""Textile simulation as services. `nuno.run(scene)` simulates, `nuno.open(file)` reads a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nuno.api import Result, run
    from nuno.recording.reader import open_recording as open

__all__ = ["Result", "open", "run"]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    # Loaded when first used: a service's process needs neither.
    if name in ("run", "Result"):
        from nuno import api

        return getattr(api, name)
    if name == "open":
        from nuno.recording.reader import open_recording

        return open_recording
    raise AttributeError(name)
