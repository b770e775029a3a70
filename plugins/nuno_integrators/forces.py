"""The forces on every vertex in one state, by kind: for analysis after a run, not for steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_integrators.packing import copy_terms, parts, silence
from nuno_kernels.forces.yarn_tension import link_tensions
from nuno_kernels.step.acceleration import Extra, Packed, call_each, evaluate
from nuno_kernels.terms import kernels_of, role_of
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float, State
from nuno_schemas.system import Forces, System, Touched


def undisturbed(packed: Packed) -> Packed:
    """Return a copy of the system without the adjustments that a solver's step makes to its terms: see Contact.rate."""
    packed = copy_terms(packed)
    call_each(packed, "approach", np.inf)
    return packed


def find_forces(
    system: System, state: State, packed: Packed, x: Float, v: Float, extra: Extra,
    poses: tuple[Poses, Poses] | None,
) -> Forces:  # fmt: skip
    """Return the forces in a state, which is also in x and v (3, n), with bodies as at the start of `poses`.

    Each kind is computed by the kernels of a step with the others silent, so nothing is compiled for it; with masses of
    1 kg their accelerations are newtons. The reaction of sliding surfaces is found as for balance
    (nuno_contact.sliding.grip).
    """
    mass, names = system.fabric.mass[:, None], parts(packed)
    bare = _bare(packed)

    def force(variant: Packed, python: Extra = None) -> Float:
        return _force(variant, x, v, 0.0, python)

    kinds = {"gravity": mass * np.asarray(system.gravity, np.float64)}
    if system.damping != 0.0:
        kinds["damping"] = -system.damping * mass * state.v
    for part in names:
        kinds[part] = force(silence(bare, *(name for name in names if name != part)))
    if extra is not None:
        kinds["python"] = force(silence(bare, *names), extra)
    total = np.sum(list(kinds.values()), axis=0)
    held = total if poses is None else _held(x, total, packed, poses[0])
    if held is not total:
        kinds["contact"] = kinds.get("contact", np.zeros_like(total)) + (held - total)
    moved = np.where(system.fabric.pinned[:, None], 0.0, held / mass)
    return Forces(kinds, moved, link_tensions(system.fabric, state.x))


def find_touched(
    system: System, packed: Packed, x: Float, v: Float, extra: Extra, poses: Poses, free: Float | None
) -> Touched:
    """Return the force of each body on the vertices in the state x, v (3, n), with bodies as at the end of the
    interval, where `poses` has them: its contact's force with all else silent. A sliding surface reacts to `free` (n,
    3) [N] on vertices that are not held, for methods whose steps use other forces than their laws'.
    """
    bare, mass = _bare(packed), system.fabric.mass[:, None]
    total = _force(bare, x, v, 1.0, extra)
    total += mass * np.asarray(system.gravity, np.float64) - system.damping * mass * v.T
    total = total if free is None else np.where(system.fabric.pinned[:, None], total, free)
    by: dict[str, Float] = {}
    for term, names in _with_bodies(system, packed):
        for number, name in enumerate(names):
            alone = role_of(type(term), "alone")(term, number)
            if kernels_of(term).unbalance is None:
                by[name] = _force(_only(bare, term, alone), x, v, 1.0, None)
            else:  # a sliding surface reacts to all forces, and to what those before have left of them
                left = _held(x, total, _only(bare, term, alone), poses)
                by[name], total = left - total, left
    return Touched(by, total)


def _with_bodies(system: System, packed: Packed) -> list[tuple[Any, tuple[str, ...]]]:
    """Return the terms that are contact with bodies, as they are packed, and the bodies' names; sliding ones last."""
    own = {id(term): term for term in (*packed.forces, *packed.bodies)}
    found: list[tuple[Any, tuple[str, ...]]] = []
    for term in system.terms:
        for kind in () if callable(term.data) or not term.bodies else map(type, term.data):
            key = next(key for key, one in own.items() if type(one) is kind)  # terms of a type keep their order
            found.append((own.pop(key), term.bodies))
    return sorted(found, key=lambda one: kernels_of(one[0]).unbalance is not None)


def _only(bare: Packed, term: Any, alone: Any) -> Packed:
    """Return the system, of the same types, in which only one term acts, replaced by `alone`."""
    forces, bodies = (tuple(alone if one is term else one for one in terms) for terms in (bare.forces, bare.bodies))
    on = [np.array([one is term for one in terms], np.bool_) for terms in (bare.forces, bare.bodies)]
    return bare._replace(forces=forces, forces_on=on[0], bodies=bodies, bodies_on=on[1])


def _bare(packed: Packed) -> Packed:
    """Return the system with masses of 1 kg, without gravity and damping: its accelerations are newtons."""
    return packed._replace(inverse_mass=np.ones(len(packed.inverse_mass)), gravity=np.zeros(3), damping=0.0)


def _force(packed: Packed, x: Float, v: Float, s: float, python: Extra) -> Float:
    """Return the forces (n, 3) [N] of a bare system at fraction s of the interval."""
    found = np.empty_like(x)
    evaluate(x, v, s, found, packed, python)
    return np.ascontiguousarray(found.T)


def _held(x: Float, total: Float, packed: Packed, poses: Poses) -> Float:
    """Return what surfaces and friction leave of forces (n, 3), as at rest; `total` itself without sliding."""
    acting = [term for term, on in zip(packed.bodies, packed.bodies_on, strict=True) if on]
    holding = [term for term in acting if kernels_of(term).unbalance is not None]
    if not holding:
        return total
    held = np.array(total.T, order="C")
    for term in holding:
        role_of(type(term), "interval")(term, poses, poses)
        role_of(type(term), "begin")(term, x, 0.0, packed.threads)
        role_of(type(term), "unbalance")(term, x, held)
    return np.ascontiguousarray(held.T)
