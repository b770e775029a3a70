"""Findings about a run: forces by kind, distance from rest, the cost of each part, and where values were lost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from nuno_integrators.packing import copy_terms, making_lists, parts, silence
from nuno_kernels.forces.yarn_tension import lengths, link_tensions, own_tensions
from nuno_kernels.step.acceleration import Packed, evaluate
from nuno_kernels.terms import call_each, kernels_of
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Bool, Fabric, Float, Membrane, State
from nuno_schemas.system import Forces, System, Touched
from nuno_schemas.vectors import norm

# The forces on every vertex in one state, by kind: for analysis after a run, not for steps.


def undisturbed(packed: Packed) -> Packed:
    """Return a copy of the system without the adjustments that a solver's step makes to its terms: see Contact.rate."""
    packed = copy_terms(packed)
    call_each(packed, "approach", np.inf)
    return packed


def find_forces(
    system: System, state: State, packed: Packed, x: Float, v: Float,
    poses: tuple[Poses, Poses] | None, felt: Float, unkicked: Collection[str] = (),
) -> Forces:  # fmt: skip
    """Return the forces in a state, which is also in x and v (3, n), with bodies as at the end of `poses`. All parts
    but the `unkicked` ones feel the velocity `felt` (3, n), by which the step's last kick went.

    Each kind is computed by the kernels of a step with the others silent, so nothing is compiled for it; with masses of
    1 kg their accelerations are newtons. Impulses of contact count by their mean over the interval. The reaction of
    sliding surfaces is found as for balance (nuno_contact.sliding.grip).
    """
    mass, names = system.fabric.mass[:, None], parts(packed)
    bare = _bare(packed)

    def force(variant: Packed, velocity: Float) -> Float:
        return _force(variant, x, velocity, 1.0)

    kinds: dict[str, Float] = {"gravity": mass * np.asarray(system.gravity, np.float64)}
    if system.damping != 0.0:
        kinds["damping"] = -system.damping * mass * state.v
    for part in names:
        velocity = v if part in unkicked else felt
        alone = silence(bare, *(name for name in names if name != part))
        kinds[part] = sum(call_each(alone, "pushed"), start=force(alone, velocity))
    total = np.sum(list(kinds.values()), axis=0)
    held = total if poses is None else _held(x, total, packed, poses[1])
    if held is not total:
        kinds["contact"] = kinds.get("contact", np.zeros_like(total)) + (held - total)
    moved = np.where(system.fabric.pinned[:, None], 0.0, held / mass)
    return Forces(kinds, moved, link_tensions(system.fabric, state.x))


def find_touched(system: System, packed: Packed, x: Float, v: Float, poses: Poses, free: Float | None) -> Touched:
    """Return the force of each body on the vertices in the state x, v (3, n), with bodies as at the end of the
    interval, where `poses` has them: its contact's force with all else silent. A sliding surface reacts to `free` (n,
    3) [N] on vertices that are not held, for methods whose steps use other forces than their laws'.
    """
    bare, mass = _bare(packed), system.fabric.mass[:, None]
    total = _force(bare, x, v, 1.0)
    total += mass * np.asarray(system.gravity, np.float64) - system.damping * mass * v.T
    total = sum(call_each(bare, "pushed"), start=total)
    total = total if free is None else np.where(system.fabric.pinned[:, None], total, free)
    by: dict[str, Float] = {}
    for term, names in _with_bodies(system, packed):
        for number, name in enumerate(names):
            alone = kernels_of(term).find("alone")(term, number)
            if "unbalance" not in kernels_of(term):
                only = _only(bare, term, alone)
                by[name] = sum(call_each(only, "pushed"), start=_force(only, x, v, 1.0))
            else:  # a sliding surface reacts to all forces, and to what those before have left of them
                left = _held(x, total, _only(bare, term, alone), poses)
                by[name], total = by.get(name, 0.0) + left - total, left  # skins are terms of their own
    return Touched(by, total)


def _with_bodies(system: System, packed: Packed) -> list[tuple[Any, tuple[str, ...]]]:
    """Return the terms that are contact with bodies, as they are packed, and the bodies' names; sliding ones last."""
    own = {id(term): term for term in (*packed.forces, *packed.bodies)}
    found: list[tuple[Any, tuple[str, ...]]] = []
    for term in system.terms:
        for kind in () if callable(term.data) or not term.bodies else map(type, term.data):
            key = next(key for key, one in own.items() if type(one) is kind)  # terms of a type keep their order
            found.append((own.pop(key), term.bodies))
    return sorted(found, key=lambda one: "unbalance" in kernels_of(one[0]))


def _only(bare: Packed, term: Any, alone: Any) -> Packed:
    """Return the system, of the same types, in which only one term acts, replaced by `alone`."""
    both = bare.forces, bare.bodies
    forces, bodies = (terms.again(alone if one is term else one for one in terms) for terms in both)
    on = [np.array([one is term for one in terms], np.bool_) for terms in both]
    return bare._replace(forces=forces, forces_on=on[0], bodies=bodies, bodies_on=on[1])


def _bare(packed: Packed) -> Packed:
    """Return the system with masses of 1 kg, without gravity and damping: its accelerations are newtons."""
    return packed._replace(inverse_mass=np.ones(len(packed.inverse_mass)), gravity=np.zeros(3), damping=0.0)


def _force(packed: Packed, x: Float, v: Float, s: float) -> Float:
    """Return the forces (n, 3) [N] of a bare system at fraction s of the interval."""
    found = np.empty_like(x)
    evaluate(x, v, s, found, packed)
    return np.ascontiguousarray(found.T)


def _held(x: Float, total: Float, packed: Packed, poses: Poses) -> Float:
    """Return what surfaces and friction leave of forces (n, 3), as at rest; `total` itself without sliding."""
    acting = [term for term, on in zip(packed.bodies, packed.bodies_on, strict=True) if on]
    holding = [term for term in acting if "unbalance" in kernels_of(term)]
    if not holding:
        return total
    held = np.array(total.T, order="C")
    for term in holding:
        kernels_of(term).find("interval")(term, poses, poses)
        kernels_of(term).find("begin")(term, x, 0.0, packed.threads)
        kernels_of(term).find("unbalance")(term, x, held)
    return np.ascontiguousarray(held.T)


# Reports of a state that is not finite: in which step it became so, and at which vertices first.

Go = Callable[[int, int], None]
"""Advances the rows x, v (3, n) in place, which have taken so many steps, by so many more."""


def find_nonfinite(x: Float, v: Float) -> Bool:
    """Return whether the position or velocity of each vertex, x and v (3, n), is not finite, shape (n,)."""
    return np.asarray(np.logical_not(np.isfinite(x).all(axis=0) & np.isfinite(v).all(axis=0)))


def describe_nonfinite(fabric: Fabric, before: State, nonfinite: Bool, first: Bool, step: str) -> str:
    """Describe the non-finite vertices (n,); `first` became so first, in a step, in words, or "" if that is not known.

    The one named is the free one that was fastest in the state before: non-finite vertices take their neighbours along,
    pinned ones too, on which an infinite force times no mobility is NaN.
    """
    first = first if step else nonfinite
    summary = f"{int(nonfinite.sum())} of {fabric.number} vertices have no finite position or velocity; "
    speed = np.where(first, np.where(fabric.pinned, 0.0, np.abs(before.v).max(axis=1)), -1.0)
    vertex = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
    named = f"vertex {fabric.told(vertex)}, at {math.hypot(*before.v[vertex]):.3g} m/s before"
    if step and first.sum() == 1:
        return f"{summary}the first was {named}, {step}"
    if step:
        return f"{summary}the first were {int(first.sum())}, {step}, the fastest free one of them {named}"
    return f"{summary}the fastest free one of them was {named}"


def find_first(before: State, x: Float, v: Float, go: Go, steps: int) -> tuple[Bool, int]:
    """Return which vertices (n,) become non-finite first on the way from a state over so many steps, and the number of
    that step, from 1 on, or 0 if none does so again. Leaves x and v (3, n) unchanged.

    Steps are repeated by bisection: a non-finite vertex stays so.
    """
    end, taken, left = (x.copy(), v.copy()), 0, steps
    start = before.x.T.copy(), before.v.T.copy()
    while left:
        half = max(1, left // 2)
        x[...], v[...] = start
        go(taken, half)
        first = find_nonfinite(x, v)
        if first.any():
            if half == 1:
                break
            left = half
        else:
            taken, left, start = taken + half, left - half, (x.copy(), v.copy())
    x[...], v[...] = end
    return first, taken + 1 if first.any() else 0


# The cost of each part of a step, found by leaving it out.

REPEATS = 5
"""repeats of each variant; the fastest counts, since other programs can only slow it down"""

LONG = 8e-3
"""time [s] that steps are run for together, so that entering the kernel and a method's extra work at an interval's end
do not show"""

BRIEF = 1e-200
"""duration of a step [s] that moves nothing by more than rounding hides, and yet is not 0, at which loops of one pass
leave forces in place of positions"""

MOST = 64
"""most steps run together"""


def profile_steps(loop: Any, packed: Packed, x: Float, v: Float, stages: Float) -> Mapping[str, float]:
    """Return the seconds per step by part: the names of its terms, and "python" for forces written in Python. The rest
    of a step is attachments, gravity, the update.

    Steps of hardly any duration leave x and v (3, n) where they are, and the loop is the one that the run compiled,
    over tuples of the same types, so nothing is compiled for it. A part's cost is what a step saves without it. Anchors
    are those of a copy. Terms that make lists do so as far as vertices move: such steps do not measure those, which are
    left out.
    """
    lists = making_lists(packed)
    packed_copy = silence(copy_terms(packed), *lists)
    place, speed = x.copy(), v.copy()

    def run(variant: Packed, steps: int) -> float:
        call_each(variant, "begin", place, steps * BRIEF, variant.threads)
        began = time.perf_counter()
        loop(place, speed, stages, steps, BRIEF, variant)
        return (time.perf_counter() - began) / steps

    steps = max(1, min(MOST, int(LONG / max(run(packed_copy, 1), 1e-9))))
    timed = [part for part in parts(packed) if part not in lists]
    variants = [packed_copy, *(silence(packed_copy, part) for part in timed)]
    # Round by round, so that a disturbance affects all variants alike.
    rounds = [[run(variant, steps) for variant in variants] for _ in range(REPEATS)]
    whole, *without = np.min(rounds, axis=0).tolist()
    return {part: max(0.0, whole - rest) for part, rest in zip(timed, without, strict=True)}


# How far every vertex of a cloth is from rest, as a share of the forces of its springs or triangles.

TINY = 1e-300
"""stands for the length of a yarn of length 0 [1], which then exerts no force"""
NO_STRAIN = 1e-11
"""Springs strained by less than this share of the cloth's largest coordinate count with that strain: their own length
is known no better, so that cloth without load, whose forces are rounding, is at rest."""


def typical_tension(fabric: Fabric, x: Float) -> float:
    """Return the mean size of the forces [N] at x (n, 3) [m] of springs and of triangles at their corners; 0 without
    either.

    Summed exactly: NumPy's order differs between machines, and this decides which frame is the last.
    """
    pulls, stiffness = list[float](), list[float]()
    if fabric.springs is not None:
        _, length = lengths(fabric.springs, x)
        pulls += np.abs(own_tensions(fabric.springs, length)).tolist()
        stiffness += fabric.springs.per_spring(fabric.springs.k).tolist()
    if fabric.membrane is not None:
        pulls += pulls_of_membrane(fabric.membrane, x).reshape(-1).tolist()
        stiffness += fabric.membrane.stiffness().reshape(-1).tolist()
    if not pulls:
        return 0.0
    try:
        pull = math.fsum(pulls)
    except OverflowError:  # cloth that flies apart
        pull = math.inf
    return max(pull, NO_STRAIN * float(np.abs(x).max()) * math.fsum(stiffness)) / len(pulls)


def pulls_of_membrane(membrane: Membrane, x: Float) -> Float:
    """Return the size of the force [N] that each triangle has on each corner at x (n, 3) [m], shape (t, 3)."""
    shares, corners = membrane.shares(), x[membrane.faces]
    warp, weft = (sum(share[:, k, None] * corners[:, k] for k in range(3)) for share in shares)
    long, wide = norm(warp), norm(weft)
    c_w, c_f, both, g = membrane.area * membrane.moduli
    along, across = c_w * (long - 1.0) + both * (wide - 1.0), c_f * (wide - 1.0) + both * (long - 1.0)
    shear = g * (warp[:, 0] * weft[:, 0] + warp[:, 1] * weft[:, 1] + warp[:, 2] * weft[:, 2])
    on_warp = (along / np.maximum(long, TINY))[:, None] * warp + shear[:, None] * weft
    on_weft = (across / np.maximum(wide, TINY))[:, None] * weft + shear[:, None] * warp
    forces = [shares[0, :, k, None] * on_warp + shares[1, :, k, None] * on_weft for k in range(3)]
    return np.stack([norm(force) for force in forces], axis=1)


def unbalance(fabric: Fabric, x: Float, v: Float, left: Float) -> Float:
    """Return the distance from rest (n,): the force `left` (n, 3) [N] on each vertex and what its velocity v (n, 3)
    [m/s] will turn into, over the typical tension; 0 for held vertices, inf for all others in cloth without tension.

    Force alone is no measure of rest: a mass that swings feels none in the middle of its way. With K the stiffness of
    all springs and triangles of a vertex, F^2 + m K v^2 is the same all along its swing, the square of the force at
    its ends.
    """
    far = np.zeros(fabric.number)
    scale = typical_tension(fabric, x)
    if scale == 0.0:
        return np.where(fabric.pinned, 0.0, np.inf)
    stiffness = fabric.stiffness()
    for axis in range(3):
        far += left[:, axis] ** 2 + fabric.mass * stiffness * v[:, axis] ** 2
    return np.where(fabric.pinned, 0.0, np.sqrt(far) / scale)
