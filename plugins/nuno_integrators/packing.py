"""Packing a System into the layout of the kernels."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_kernels import threads_available
from nuno_kernels.forces.bending import pack_bending
from nuno_kernels.forces.bending_friction import pack_friction
from nuno_kernels.forces.hinges import pack_hinges
from nuno_kernels.forces.membrane import pack_membrane
from nuno_kernels.forces.python import make_forces
from nuno_kernels.forces.springs import pack_springs
from nuno_kernels.step.acceleration import OF_BODIES, Packed
from nuno_kernels.terms import Kernels, Terms, kernels_of
from nuno_schemas.fabric import Bool, Fabric, Float
from nuno_schemas.system import System

PARALLEL_FROM, OF_CLOTH = 4096, 1024
"""Fewest vertices that run on several threads, two blocks, and fewest of them that are the cloth's: contact with a fine
body does far more than steps alone. Whether several run in a frame is found by trying."""


def to_rows(array: Float) -> Float:
    """Return (n, 3) as C-contiguous (3, n) that shares no memory with it.

    Not np.ascontiguousarray: one vertex transposed is contiguous as it is, and would be handed back as a view.
    """
    return np.array(array.T, np.float64, order="C")


def thread_count(system: System) -> int:
    """Return the number of threads that this system's kernels run on."""
    number, terms = system.fabric.number, [term.data for term in system.terms if not callable(term.data)]
    looked = max([number, *(kernels_of(part).vertices(part) for data in terms for part in data)])
    if looked < PARALLEL_FROM or number < min(OF_CLOTH, PARALLEL_FROM):
        return 1
    return max(1, min(system.threads, threads_available()[0]))


def pack(system: System, copy: bool = True) -> Packed:
    """Return the kernel layout of a system. Raises BadInput for a force of a type without kernels. Without `copy` its
    terms' arrays are the system's: for callers that take no steps.
    """
    fabric, time = system.fabric, np.zeros(2)
    packed_terms = [part for term in system.terms if not callable(term.data) for part in term.data]
    packed_terms = [copy_term(part) for part in packed_terms] if copy else packed_terms
    packed_terms = [part._replace(leave=system.leave) if "leave" in part._fields else part for part in packed_terms]
    n = fabric.number
    forces: tuple[Any, ...] = (
        *pack_springs(fabric.springs, n),
        *pack_hinges(fabric.hinges, n),
        *pack_membrane(fabric.membrane, n),
    )
    friction = pack_friction(fabric.friction, n)
    forces += (*pack_bending(fabric.bending, n), *friction, *_pack_yarns(fabric))
    forces += tuple(part for part in packed_terms if "block" in kernels_of(part))
    python = [term.data for term in system.terms if callable(term.data)]
    packed_terms += [make_forces(python, n, time, system.leave)] if python else []
    bodies = (*_pack_carried(system), *friction, *(part for part in packed_terms if _has_steps(kernels_of(part))))
    threads = thread_count(system)
    adds = any("after" in kernels_of(part) for part in bodies)
    moved = any(_disturbs(kernels_of(part)) for part in bodies)
    packed = Packed(
        inverse_mass=np.divide(1.0, fabric.mass, out=np.zeros(fabric.number), where=~fabric.pinned),
        gravity=np.array(system.gravity, np.float64),
        damping=float(system.damping),
        forces=Terms(forces, ("block",)),
        forces_on=np.ones(len(forces), np.bool_),
        bodies=Terms(bodies, OF_BODIES, ("threads",) if threads > 1 else ()),
        bodies_on=np.ones(len(bodies), np.bool_),
        threads=threads if threads > 1 else None,
        late=True if adds else None,
        moved=moved,
        time=time,
        leave=system.leave,
    )
    return packed._replace(velocity_matters=reads_velocity(packed))


def copy_terms(packed: Packed) -> Packed:
    """Return the system, of the same types, whose bodies have copies of arrays. A term that is among the forces, too,
    stays one term: what it finds in one role it reads in the other. A term that only adds to forces writes nothing.
    """
    copies = {id(term): copy_term(term) for term in packed.bodies}
    forces = packed.forces.again(copies.get(id(term), term) for term in packed.forces)
    return packed._replace(forces=forces, bodies=packed.bodies.again(copies[id(term)] for term in packed.bodies))


def hold_over(packed: Packed) -> Packed:
    """Return the system, whose softest forces are held over several steps."""
    terms = {id(term): term for term in (*packed.forces, *packed.bodies)}
    for key, term in terms.items():
        hold = kernels_of(term).find("hold_over")
        terms[key] = term if hold is None else hold(term, packed.inverse_mass)
    forces, bodies = (part.again(terms[id(term)] for term in part) for part in (packed.forces, packed.bodies))
    return packed._replace(forces=forces, bodies=bodies)


def making_lists(packed: Packed) -> tuple[str, ...]:
    """Return the names of the terms whose cost only real steps show."""
    terms = (*packed.forces, *packed.bodies)
    return tuple(dict.fromkeys(kernels_of(term).name for term in terms if kernels_of(term).lists))


def parts(packed: Packed) -> tuple[str, ...]:
    """Return the names of the parts of a step's forces."""
    felt = [term for term in packed.bodies if "after" in kernels_of(term)]
    return tuple(dict.fromkeys(kernels_of(term).name for term in (*packed.forces, *felt)))


def silence(packed: Packed, *names: str) -> Packed:
    """Return the system, of the same types, in which the terms of these names do nothing.

    Being of the same types, it runs the kernels that are compiled already.
    """

    def acting(terms: tuple[Any, ...], on: Bool) -> Bool:
        return on & np.array([kernels_of(term).name not in names for term in terms], np.bool_)

    return packed._replace(
        forces_on=acting(packed.forces, packed.forces_on), bodies_on=acting(packed.bodies, packed.bodies_on)
    )


def silence_bodies(packed: Packed) -> Packed:
    """Return the system, of the same types, in which no body carries, meets or holds vertices. Cloth contact, which
    adds to forces, acts without bodies too: its own stay in place.
    """
    alone = ["interval" not in kernels_of(term) or "block" in kernels_of(term) for term in packed.bodies]
    return packed._replace(bodies_on=packed.bodies_on & np.array(alone, np.bool_))


def reads_velocity(packed: Packed) -> bool:
    """Whether any of the compiled forces depends on the velocity, or bodies move vertices after a step: an
    acceleration found before is then not that of the next step's start.
    """
    terms = (*packed.forces, *packed.bodies)
    return packed.damping != 0.0 or packed.moved or any(kernels_of(term).reads_velocity(term) for term in terms)


def reads_time(system: System) -> bool:
    """Whether any force depends on the time, as one in Python may."""
    return any(callable(term.data) or any(kernels_of(part).reads_time for part in term.data) for term in system.terms)


def _has_steps(kernels: Kernels) -> bool:
    """Whether terms have a part in steps besides a force by blocks."""
    return "block" not in kernels or "hold" in kernels


def _disturbs(kernels: Kernels) -> bool:
    """Whether such terms change forces after a step: a force that only remembers how far it has slipped does not."""
    return "hold" in kernels or ("settle" in kernels and "block" not in kernels)


def _pack_carried(system: System) -> tuple[Any, ...]:
    """Return the bindings of vertices that frames carry."""
    if not system.carried:
        return ()
    from nuno_integrators.bindings import make_bindings

    return (make_bindings(system.carried),)


def _pack_yarns(fabric: Fabric) -> tuple[Any, ...]:
    """Return pairs of links between which tension passes, () without any: their kernel is then not loaded."""
    if fabric.yarns is None or fabric.springs is None:
        return ()
    from nuno_kernels.forces.yarns import pack_yarns

    pairs = pack_yarns(fabric.yarns, fabric.springs, fabric.number)
    return () if pairs is None else (pairs,)


def copy_term(data: Any) -> Any:
    """Copy a term's tuple with its arrays, also of nested tuples: anchors and scratch belong to one solver's memory.
    Read-only arrays are shared.
    """

    def copied(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.copy() if value.flags.writeable else value
        return copy_term(value) if hasattr(value, "_fields") else value

    return type(data)(*map(copied, data))
