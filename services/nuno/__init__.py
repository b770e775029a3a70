"""Textile simulation as services. `nuno.run(scene)` simulates, `nuno.open(file)` reads a recording, and
`nuno.states(recording)` gives its frames as they were, in float64, with what acted on them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nuno.api import Result, run
    from nuno.moments import Moment, states
    from nuno.recording.reader import open_recording as open

__all__ = ["Moment", "Result", "open", "run", "states"]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    # Loaded when first used: a service's process needs neither.
    if name in ("run", "Result"):
        from nuno import api

        return getattr(api, name)
    if name in ("states", "Moment"):
        from nuno import moments

        return getattr(moments, name)
    if name == "open":
        from nuno.recording.reader import open_recording

        return open_recording
    raise AttributeError(name)
