"""Textile simulation as services.

`nuno.run(scene)` simulates, `nuno.plan(scene)` describes a run and its cost, `nuno.Scene` is a scene as an object;
`nuno.open(file)` reads a recording, `nuno.resume`, `nuno.verify` and `nuno.export` use it, and `nuno.states` returns
its frames in float64, with the forces in them; `nuno.sweep` runs a scene for many values; `nuno.watch` receives the
messages of an active run, and `nuno.drive` moves a body in it; `nuno.register` makes a plugin known without a package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nuno.plugin_contract.registry import register
    from nuno.python_api.active_run import Heard, drive, watch
    from nuno.python_api.plan import Plan, plan
    from nuno.python_api.recordings import export, states, verify
    from nuno.python_api.recordings import open_file as open
    from nuno.python_api.run import Result, resume, run
    from nuno.python_api.scene import Scene
    from nuno.recording.reader import Recording
    from nuno.resimulation.frame_state import FrameState
    from nuno_bench.sweep.grid import sweep

__all__ = [
    "FrameState",
    "Heard",
    "Plan",
    "Recording",
    "Result",
    "Scene",
    "drive",
    "export",
    "open",
    "plan",
    "register",
    "resume",
    "run",
    "states",
    "sweep",
    "verify",
    "watch",
]  # fmt: skip
PLACES = {
    "nuno.plugin_contract.registry": ("register",),
    "nuno.python_api.active_run": ("Heard", "drive", "watch"),
    "nuno.python_api.plan": ("Plan", "plan"),
    "nuno.python_api.recordings": ("export", "open", "states", "verify"),
    "nuno.python_api.run": ("Result", "resume", "run"),
    "nuno.python_api.scene": ("Scene",),
    "nuno.resimulation.frame_state": ("FrameState",),
    "nuno.recording.reader": ("Recording",),
    "nuno_bench.sweep.grid": ("sweep",),
}
"""The module of each name."""


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    # Loaded when first used: a service's process needs none of them.
    for place, names in PLACES.items():
        if name in names:
            return getattr(import_module(place), "open_file" if name == "open" else name)
    raise AttributeError(name)
