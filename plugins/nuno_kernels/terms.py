"""Forces on cloth as typed terms: a NamedTuple of arrays, and the compiled functions that go with its type.

A system holds tuples of terms. numba compiles a step for just the types in them: `each` makes a function over such a
tuple that calls, term by term, the kernel that the term's type has for a role, and nothing for types without it. A
type's kernels are given once, where they are defined, by `register`; nothing lists the types.

A term in the tuple can be switched off without another type, so that nothing is compiled anew: a mask goes with the
tuple, and each call asks it once. Not chosen: `literal_unroll`, which compiles a loop's body once for every type with
all that surrounds it; recursion over the tuple, whose every level is optimised once more with all that it calls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numba
from numba import prange, types
from numba.extending import overload

from nuno_kernels import FLAGS
from nuno_kernels.compile.calling_convention import by_address
from nuno_kernels.compile.reference import by_reference
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float


class Measured(NamedTuple):
    """A term's energy [J]; of springs also the largest |d| / L - 1, the smallest |d| > 0 [m] and the number without
    length.
    """

    energy: float
    stretch: float = 0.0
    shortest: float = float("inf")
    zero_length: int = 0


class Displaced(NamedTuple):
    """An xpbd step in progress: x (3, n) [m] at its start, u (3, n) displacements [m], y and w (3, n) scratch, mobility
    (1, n) [s^2/kg] (see nuno_kernels.forces.constraints), and 1 / the step [1/s].
    """

    x: Float
    u: Float
    y: Float
    w: Float
    mobility: Float
    inverse_step: float


@dataclass(frozen=True)
class Kernels:
    """The compiled functions of one type of term; what a type has no use for is None.

    Compiled: x, v (3, n) positions and velocities, s the fraction of the frame, `threads` None or how many.

    block(term, block, origin, x, v, force)        adds newtons to the block's force (3, w), column 0 vertex `origin`
    after(term, x, v, s, a, threads)               adds newtons to a (3, n) once all blocks are done
    place(term, x, v, s)                           puts vertices where they are carried to, before forces are found
    look(term, x, v)                               notes what its blocks need to know of all vertices
    settle(term, x, v, s, threads)                 remembers what a whole step has led to
    hold(term, x, v, s, threads)                   moves vertices after a step
    slow(term, x, v, threads)                      holds velocities off what `hold` found
    fill(term, rows, block, x, before, rate, floor, follow)   writes the rows of the term's matrix; see
                                                   nuno_integrators.implicit.matrix
    diagonal(term, rows, block, origin, out)       adds the matrix' diagonal blocks to (6, w)
    multiply(term, rows, block, origin, u, out)    adds the matrix' product with u (3, n) to out (3, w)
    assemble(rows, places, diagonal, values)       adds the matrix to a factor; see nuno_kernels.forces.linear. One
                                                   without stays out of factors: what it couples changes

    carry(term, moved, s)                          of xpbd: puts displacements of carried vertices into `Displaced`
    project(term, moved, s, held, threads)         of xpbd: solves for what cloth meets, bodies or cloth; see
                                                   nuno_contact.penalty.projection, nuno_contact.offset.projection
    sweep(batches, batch, moved)                   of batches of constraints: solves those of one batch, in place in the
                                                   displacements; see nuno_kernels.forces.constraints
    forget(batches)                                of batches of constraints: begins a step without forces

    Called from Python:

    energy(term, x) -> float or Measured           energy [J]
    tension(term, x) -> float                      the largest single force [N]
    stiffest(term) -> float                        the largest stiffness [N/m]
    turning(term, before, x, d) -> float           see nuno_kernels.forces.springs.turning
    rows(term) -> tuple                            room for the matrix: see nuno_kernels.forces.linear
    elements(rows) -> columns, vertices            (p,) columns of the elements' rows, each once, and (corners, p)
    constraints(term, vertices) -> tuple           what xpbd solves for in the place of the force; see
                                                   nuno_kernels.forces.constraints
    stick(term, x)                                 lets nothing slip on a short way from x (3, n)
    hold_over(term, inverse_mass) -> term          the same whose force is held over several steps
    interval(term, start, end)                     writes the bodies' poses over a frame into the term
    begin(term, x, span, threads)                  before an interval's first step; it lasts `span` [s]
    approach(term, rate)                           most of a depth that may be gone through in a second [1/s]
    bound(term, x, d, s, threads) -> bool          shortens a way d (3, n) that Newton's method is to go from x towards
                                                   fraction s, in place; whether it did
    waits(term) -> bool                            whether what `bound` moves along has not come to its end
    cut(term, held)                                counts vertices (n,) that a step leaves where `bound` holds them
    foresee(term, x, d, out) -> bool               adds to out (3, n) what forces that begin on a way d (3, n) from x
                                                   bring to a linear step's right side; whether they are others than
                                                   before
    unbalance(term, x, force)                      holds forces (3, n) off bodies, in place
    grip(term) -> Grip                             what implicit steps hold on its bodies: see nuno_contact.sliding.grip
    alone(term, body) -> term                      the same in which only one of its bodies acts, by number
    counts(term) -> mapping                        counts for a step's report
    pinched(term) -> pieces, places                which piece each vertex is of that cannot go on, and where (k, 3) [m]
    bounds(term) -> mapping                        `Bounds` of fields that are part of the state; see Memory.bounds
    """

    name: str
    """name in reports; several types of one force share a name"""
    lags: bool = True
    """whether a method that has no constraint for it may take it as at the step's start"""
    memory: tuple[str, ...] = ()
    """fields that are part of the state"""
    lists: bool = False
    """whether it makes lists now and then, as far as vertices move: only real steps show its cost"""
    reads_velocity: Callable[[Any], bool] = lambda term: False
    vertices: Callable[[Any], int] = lambda term: 0
    """number of vertices that a term examines, if bodies' vertices are among them"""
    block: Any = None
    after: Any = None
    place: Any = None
    look: Any = None
    settle: Any = None
    hold: Any = None
    slow: Any = None
    carry: Any = None
    project: Any = None
    sweep: Any = None
    forget: Any = None
    fill: Any = None
    diagonal: Any = None
    multiply: Any = None
    assemble: Any = None
    energy: Any = None
    tension: Any = None
    stiffest: Any = None
    turning: Any = None
    rows: Any = None
    elements: Any = None
    constraints: Any = None
    begin: Any = None
    interval: Any = None
    approach: Any = None
    bound: Any = None
    waits: Any = None
    cut: Any = None
    foresee: Any = None
    unbalance: Any = None
    grip: Any = None
    alone: Any = None
    counts: Any = None
    pinched: Any = None
    bounds: Any = None
    stick: Any = None
    hold_over: Any = None

    def find(self, role: str) -> Any:
        """Return the function of a role, None for none."""
        kernel = getattr(self, role)
        return resolve_name(kernel) if isinstance(kernel, str) else kernel

    def all(self) -> list[Any]:
        """Return the functions of all roles."""
        roles = [one.name for one in fields(self) if one.name not in ("name", "lags", "memory", "lists")]
        return [kernel for role in roles if (kernel := self.find(role)) is not None]


def register(kind: type, **roles: Any) -> None:
    """Register the kernels of a type of term, a NamedTuple of arrays and numbers, which is passed by reference.

    Fields of Kernels by name. A role may be given as "module:function", which is loaded when a solver first needs it.
    """
    by_reference(kind)
    kind.kernels = Kernels(**roles)  # type: ignore[attr-defined]


def kernels_of(term: Any) -> Kernels:
    """Return the kernels of a term. Raises BadInput for one of a type that has none."""
    kernels = getattr(type(term), "kernels", None)
    if not isinstance(kernels, Kernels):
        raise BadInput(
            f"no kernels for a force of type {type(term).__name__!r}",
            field="forces",
            limit="a type that nuno_kernels.terms.register knows, or a function f(x, v, t, out)",
        )
    return kernels


def role_of(kind: type, role: str) -> Any:
    """Return the function of a role for terms of a type, None for none."""
    kernels: Kernels = kind.kernels  # type: ignore[attr-defined]
    return kernels.find(role)


COMPILED = '    raise TypeError("only compiled code can call this: wrap it in a kernel")'
"""Body of functions that numba replaces in compiled code. Interpreted, as with a force written in Python, it raises."""


def _define(name: str, parameters: str, body: str, **scope: Any) -> Any:
    """Make a function from source: numba has no other way to call by a tuple's types."""
    exec(f"def {name}({parameters}):\n{body or '    pass'}\n", scope)
    return scope[name]


def each(role: str, parameters: str, linear: bool = False) -> Any:
    """Return a function f(terms, on, <parameters>) for kernels, which calls all terms' kernels of this role, in order.

    `linear` ones take (terms, on, rows, <parameters>), and each kernel its term's rows after the term.
    """
    head = f"terms, on, rows, {parameters}" if linear else f"terms, on, {parameters}"
    term = "terms[{0}], rows[{0}]" if linear else "terms[{0}]"
    call = "    if on[{0}]:\n        kernel{0}(" + term + ", " + parameters + ")\n"

    def build(kinds: Any) -> Any:
        kernels = {f"kernel{k}": by_address(role_of(kind.instance_class, role)) for k, kind in enumerate(kinds)}
        lines = [call.format(k) for k in range(len(kinds)) if kernels[f"kernel{k}"] is not None]
        return _define("each", head, "".join(lines), **kernels)

    return _overloaded(head, build)


def over_blocks(one: Any, parameters: str, worth: int = 0, order: str = "block") -> Any:
    """Return a function f(<parameters>, blocks, threads) for kernels, which calls one(block, <parameters>) for every
    block, in order if `threads` is None, else on several threads.

    The choice is made when a kernel is compiled, and only that branch is compiled. With `worth` f takes the amount of
    work before `threads`; less than that is done in order by one thread, since waking others takes some microseconds.
    Each of several threads takes consecutive blocks; with `order`, an expression in `block`, those that it gives for
    them.
    """
    head, call = f"{parameters}, blocks{', work' if worth else ''}, threads", f"one(block, {parameters})"
    body = f"    for block in prange(blocks):\n        one({order}, {parameters})"
    loop = numba.njit(parallel=True, **FLAGS)(_define("loop", f"{parameters}, blocks", body, one=one, prange=prange))
    alone = _define("alone", head, f"    for block in range(blocks):\n        {call}", one=one)
    body = f"    loop({parameters}, blocks)"
    if worth:
        body = f"    if work < {worth}:\n        alone({head})\n    else:\n    {body}"
    several = _define("several", head, body, loop=loop, alone=numba.njit(**FLAGS)(alone))
    called = _define("called", head, COMPILED)
    body = "    return alone if isinstance(threads, types.NoneType) else several"
    typed = _define("typed", head, body, alone=alone, several=several, types=types)
    overload(called, jit_options=FLAGS, inline="always")(typed)
    return called


def _overloaded(parameters: str, build: Callable[[Any], Any]) -> Any:
    """Return a function that compiled code calls as the one that `build` makes for the types in its first parameter."""
    called = _define("called", parameters, COMPILED)
    typed = _define("typed", parameters, "    return build(terms.types)", build=build)
    overload(called, jit_options=FLAGS, inline="always")(typed)
    return called
