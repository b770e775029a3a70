"""The report of a run: speed, accuracy, distance from the step limit, features left out."""

from __future__ import annotations

from typing import Any

from nuno.runtime.outcome import Outcome
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import scene_warnings
from nuno_schemas.messages import FRAMES

Report = dict[str, Any]
SIZES, DYE_SIZES = ("vertices", "springs", "triangles of a membrane", "hinges"), ("cells",)

LEADER_DEFAULTS: dict[str, Any] = {
    "digest": "", "began": 0.0, "paused_seconds": 0.0, "step_seconds": {}, "totals": {}, "dt": None,
    "steps_per_frame": None, "idle": 0, "rested": False, "threads": "", "energy": [], "stretch": 0.0,
    "start_stretch": 0.0, "rest": {}, "clock": None, "counts": {}, "arranged": [], "changes": [], "yarns": {},
    "courses": {}, "pressure": {},
}  # fmt: skip
"""Fields of the leading service's summary, and their values where it has none."""


def make_report(loaded: Loaded, outcome: Outcome) -> Report:
    """Return the counts of a run's services, in one JSON-able mapping."""
    summary, services = outcome.summary, outcome.services
    simulated = float(summary.get("simulated_seconds", 0.0))
    wall = float(summary.get("wall_seconds", outcome.seconds.get("run", 0.0)))
    parts = dict(summary.get("seconds", {}))
    solver = loaded.dye.solver if loaded.dye is not None and not loaded.scene.moves else loaded.integrator
    dyer = services.get("dye", {}).get("summary", {}) if loaded.scene.moves else summary
    if dyer and loaded.scene.moves:
        parts["dye"] = float(dyer.get("seconds", {}).get("steps", 0.0))
    return {
        "run": outcome.run,
        "scene": loaded.scene.name,
        "state": outcome.state,
        "error": outcome.error or summary.get("message", ""),
        "simulated_seconds": simulated,
        "wall_seconds": wall,
        "real_time_factor": simulated / wall if wall else 0.0,
        "prepare_seconds": outcome.seconds.get("prepare", 0.0),
        "parts_seconds": parts
        | {"bus": sum(float(s.get("bus_seconds", 0.0)) for s in services.values())}
        | {name: float(s["seconds"]) for name, s in services.items() if "seconds" in s},
        "solver": solver.name,
        "adaptive": loaded.scene.moves and solver.plugin.adaptive,
        "chosen": loaded.why,
        "warnings": [*scene_warnings(loaded), *summary.get("warnings", [])],
        "dt_limit": (summary.get("limit") or {}).get("dt"),
        "omega": (summary.get("limit") or {}).get("omega"),
        "size": {name: (dyer if name in DYE_SIZES else summary).get(name, 0) for name in _sizes(loaded)},
        "penetration": services.get("collision", {}).get("deepest"),
        "cloth_contact": services.get("collision", {}).get("cloth_contact"),
        "followed": services.get("collision", {}).get("followed", {}),
        "last_penetration": services.get("collision", {}).get("last_depth"),
        **{name: (summary.get("facts") or {}).get(name) for name in ("rest_depth", "slip_speed")},
        # A dye that had to finish before its first frame has no amounts.
        "dye": dyer["dye"] if "supplied" in (dyer.get("dye") or {}) else None,
        "dye_steps": _dye_steps(loaded, dyer) if dyer and loaded.scene.moves else None,
        **_traffic(outcome),
        "services": list(outcome.plan.services),
        "left_out": list(outcome.plan.left_out),
        **{name: summary.get(name, default) for name, default in LEADER_DEFAULTS.items()},
    }


def _traffic(outcome: Outcome) -> Report:
    """Return the numbers of frames and messages that were sent, recorded and lost."""
    services = outcome.services
    recorder, viewer = services.get("recorder", {}), services.get("viewer", {})
    return {
        "frames": {
            "sent": sum(_frames(services.get(name, {}).get("sent") or {}) for name in {outcome.plan.leader, "dye"}),
            "recorded": _frames(recorder["counts"]) if "counts" in recorder else None,
            "shown": viewer.get("shown", 0),
        },
        "missing": _count("missing", services),
        "lost": dict(recorder.get("missing") or {}),
        "refused": _count("refused", services),
        "recorded_bytes": recorder.get("bytes", 0),
    }


def _sizes(loaded: Loaded) -> tuple[str, ...]:
    return (SIZES if loaded.scene.moves else ()) + (DYE_SIZES if loaded.dye is not None else ())


def _dye_steps(loaded: Loaded, dyer: Report) -> Report:
    """Return the step data of a garment's dye, separate from its cloth's."""
    names = ("dt", "steps_per_frame", "totals", "threads", "digest", "frame")
    solver = loaded.dye.solver.name if loaded.dye is not None else ""
    limit = (dyer.get("limit") or {}).get("dt")
    return {"solver": solver, "adaptive": False, "dt_limit": limit, "dye": True} | {n: dyer.get(n) for n in names}


def _frames(counts: dict[str, int]) -> int:
    return sum(counts.get(topic, 0) for topic in FRAMES)


def _count(name: str, services: dict[str, dict[str, Any]]) -> int:
    """Return the number of messages counted under a name; one counted by several services counts once."""
    most: dict[str, int] = {}
    for service in services.values():
        for topic, number in (service.get(name) or {}).items():
            most[topic] = max(most.get(topic, 0), number)
    return sum(most.values())
