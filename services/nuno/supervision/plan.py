"""What a scene will run, and what is left out and why: decided before anything starts."""

from __future__ import annotations

from dataclasses import dataclass

from nuno.scene.scene_file import Loaded
from nuno.service import Options


@dataclass(frozen=True)
class Plan:
    """Services that a run needs, and what it does without."""

    services: tuple[str, ...]
    must_see: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def leader(self) -> str:
        """The service that steps: it sets the pace, answers control and says when the run ends."""
        return self.services[0]


def make_plan(loaded: Loaded, options: Options) -> Plan:
    """Choose the services for a scene and the user's options."""
    if not loaded.scene.moves:
        return _plan_dye(options)
    services, left_out = ["simulation"], []
    scene = loaded.scene
    if not scene.objects:
        left_out.append("cloth, and all that acts on it: the scene has no objects")
    if scene.dye is not None:
        services.append("dye")
    if scene.bodies:
        services.append("collision")
    else:
        left_out.append("collision service and contact force: the scene has no bodies")
    if scene.view.pictures is not None:
        services.append("render")
    else:
        left_out.append("render service: view.pictures is not given")
    _plan_outputs(options, services, left_out)
    if not scene.forces:
        left_out.append("wind and other forces: the scene names none")
    if not scene.damping:
        left_out.append("viscous damping: 0")
    if not any(scene.gravity):
        left_out.append("gravity: 0")
    absent = [name for name, part in (("dye", scene.dye), ("wrinkles", scene.operations)) if not part]
    if absent:
        left_out.append(f"{' and '.join(absent)}: the scene has none")
    return Plan(tuple(services), _must_see(services, options), tuple(left_out))


def _plan_dye(options: Options) -> Plan:
    """The services of a cloth that is dyed by itself."""
    services, left_out = ["dye"], ["simulation and collision services: nothing in the scene moves"]
    _plan_outputs(options, services, left_out)
    return Plan(tuple(services), _must_see(services[1:], options), tuple(left_out))


def _plan_outputs(options: Options, services: list[str], left_out: list[str]) -> None:
    """Add recorder and viewer, or why they are left out."""
    if options.record is not None:
        services.append("recorder")
    else:
        left_out.append("recorder: not asked for")
    if options.view is not None or options.save is not None:
        services.append("viewer")
    else:
        left_out.append("viewer: no screen, or not asked for")


def _must_see(services: list[str], options: Options) -> tuple[str, ...]:
    """A window may skip frames; a file that is being written may not."""
    return tuple(n for n in ("dye", "collision", "recorder") if n in services) + (("viewer",) if options.save else ())
