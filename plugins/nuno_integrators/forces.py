"""What acts on every vertex in one state, by kind of force: to be read after a run, not for steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_kernels.acceleration import Packed, evaluate
from nuno_kernels.packing import PARTS, own_copy, silence
from nuno_kernels.yarn_tension import link_tensions
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float, State
from nuno_schemas.plugin import Forces, System


def own_contact(packed: Packed) -> Packed:
    """The same system, whose contact is its own and free of what a solver's step makes of it: see Contact.rate."""
    if packed.contact is not None:
        from nuno_kernels.contact import AT_ONCE

        packed = packed._replace(contact=own_copy(packed.contact)._replace(rate=np.full(1, AT_ONCE)))
    return packed if packed.slides is None else packed._replace(slides=own_copy(packed.slides))


def find_forces(
    system: System, state: State, packed: Packed, x: Float, v: Float, extra: Any, poses: tuple[Poses, Poses] | None
) -> Forces:
    """The forces in a state, which is also in x and v (3, n), with bodies as at the start of `poses`.

    Each kind is what the kernels of a step give where the others do nothing, so nothing is compiled for it; with
    masses of 1 kg their accelerations are newtons. What surfaces that are slid on hold against is found as for
    balance (nuno_kernels.balance).
    """
    mass, zero = system.fabric.mass[:, None], np.zeros(3)
    bare = packed._replace(inverse_mass=np.ones(x.shape[1]), gravity=zero, damping=0.0)
    particle_wind = bare.particle_wind
    if particle_wind is not None:
        bare = bare._replace(particle_wind=particle_wind._replace(force=zero))

    def force(variant: Packed, python: Any = None) -> Float:
        found = np.empty_like(x)
        evaluate(x, v, 0.0, found, variant, python)
        return np.ascontiguousarray(found.T)

    parts = {"gravity": mass * np.asarray(system.gravity, np.float64)}
    if system.damping != 0.0:
        parts["damping"] = -system.damping * mass * state.v
    for part, fields in PARTS.items():
        if any(getattr(packed, name) is not None for name in fields):
            parts[part] = force(_alone(bare, part))
    if particle_wind is not None:
        parts["particle_wind"] = np.tile(particle_wind.force, (x.shape[1], 1))
    if extra is not None:
        parts["python"] = force(_alone(bare), extra)
    total = np.sum(list(parts.values()), axis=0)
    if packed.slides is not None:
        held = total if poses is None else _held(x, total, packed.slides, poses[0])
        parts["contact"] = held - total
        total = held
    moved = np.where(system.fabric.pinned[:, None], 0.0, total / mass)
    return Forces(parts, moved, link_tensions(system.fabric, state.x))


def _alone(packed: Packed, kept: str = "") -> Packed:
    """With one of the parts alone, or none."""
    for part in PARTS:
        if part != kept:
            packed = silence(packed, part)
    return packed


def _held(x: Float, total: Float, slides: Any, poses: Poses) -> Float:
    """(n, 3) what surfaces and friction leave of the forces on vertices, as at rest."""
    from nuno_kernels.balance import hold_forces
    from nuno_kernels.slides import find_room, set_slide_poses

    set_slide_poses(slides, poses, poses)
    find_room(x, slides)
    held = np.ascontiguousarray(total.T)
    hold_forces(x, held, slides)
    return np.ascontiguousarray(held.T)
