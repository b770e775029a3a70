"""What acts on every vertex in one state, by kind of force: to be read after a run, not for steps."""

from __future__ import annotations

import numpy as np

from nuno_kernels.forces.yarn_tension import link_tensions
from nuno_kernels.step.acceleration import Extra, Packed, evaluate
from nuno_kernels.step.packing import call_each, own_terms, parts, silence
from nuno_kernels.terms import kernels_of, role_of
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float, State
from nuno_schemas.system import Forces, System


def undisturbed(packed: Packed) -> Packed:
    """The same system, whose terms are its own and free of what a solver's step makes of them: see Contact.rate."""
    packed = own_terms(packed)
    call_each(packed, "approach", np.inf)
    return packed


def find_forces(
    system: System, state: State, packed: Packed, x: Float, v: Float, extra: Extra,
    poses: tuple[Poses, Poses] | None,
) -> Forces:  # fmt: skip
    """The forces in a state, which is also in x and v (3, n), with bodies as at the start of `poses`.

    Each kind is what the kernels of a step give where the others do nothing, so nothing is compiled for it; with
    masses of 1 kg their accelerations are newtons. What surfaces that are slid on hold against is found as for
    balance (nuno_contact.sliding.balance).
    """
    mass, names = system.fabric.mass[:, None], parts(packed)
    bare = packed._replace(inverse_mass=np.ones(x.shape[1]), gravity=np.zeros(3), damping=0.0)

    def force(variant: Packed, python: Extra = None) -> Float:
        found = np.empty_like(x)
        evaluate(x, v, 0.0, found, variant, python)
        return np.ascontiguousarray(found.T)

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


def _held(x: Float, total: Float, packed: Packed, poses: Poses) -> Float:
    """(n, 3) what surfaces and friction leave of the forces on vertices, as at rest; `total` itself where none do."""
    holding = [term for term in packed.bodies if kernels_of(term).unbalance is not None]
    if not holding:
        return total
    held = np.array(total.T, order="C")
    for term in holding:
        role_of(type(term), "interval")(term, poses, poses)
        role_of(type(term), "begin")(term, x, 0.0, packed.threads)
        role_of(type(term), "unbalance")(term, x, held)
    return np.ascontiguousarray(held.T)
