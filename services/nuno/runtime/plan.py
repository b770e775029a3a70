"""The services of a scene's run, and the features left out with their reasons, decided before anything starts."""

from __future__ import annotations

from dataclasses import dataclass

from nuno.runtime.service import Options
from nuno.scene.scene_file import Loaded


@dataclass(frozen=True)
class Plan:
    """Services of a run, and features left out."""

    services: tuple[str, ...]
    must_see: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def leader(self) -> str:
        """The stepping service that sets the pace, answers control requests and ends the run."""
        return self.services[0]


def make_plan(loaded: Loaded, options: Options) -> Plan:
    """Choose the services for a scene and the user's options."""
    scene = loaded.scene
    absent = [name for name, part in (("dye", scene.dye), ("wrinkles", scene.operations)) if not part]
    # Each with whether it is needed, and the text if it is not.
    services = [
        ("simulation", scene.moves, "simulation and collision services: nothing in the scene moves"),
        ("dye", scene.dye is not None, ""),
        (
            "collision",
            bool(scene.bodies or scene.meets),
            "collision service and contact force: the scene has no bodies",
        ),
        ("render", scene.view.pictures is not None, "render service: view.pictures is not given"),
        ("recorder", options.record is not None, "recorder: not asked for"),
        ("viewer", bool(options.view or options.save), "viewer: no screen, or not asked for"),
    ]
    parts = [
        ("cloth", bool(scene.objects), "cloth, and all that acts on it: the scene has no objects"),
        ("forces", bool(scene.forces), "wind and other forces: the scene names none"),
        ("damping", bool(scene.damping), "viscous damping: 0"),
        ("bodies", bool(scene.bodies) or not scene.meets, "contact with bodies: the scene has none"),
        ("cloth", scene.meets, "contact of cloth with cloth, which passes through: cloth_contact is not given"),
        ("gravity", any(scene.gravity), "gravity: 0"),
        ("others", not absent, f"{' and '.join(absent)}: the scene has none"),
    ]
    if not scene.moves:  # nothing acts on cloth that is only dyed
        services, parts = [service for service in services if service[0] != "collision"], []
    chosen = tuple(name for name, needed, _ in services if needed)
    # A window may skip frames; a file may not. No service waits for the leader.
    lockstep = {"dye", "collision", "recorder", *(["viewer"] if options.save else [])}
    must_see = tuple(name for name in chosen[1:] if name in lockstep)
    return Plan(chosen, must_see, tuple(text for _, needed, text in (*services, *parts) if not needed and text))
