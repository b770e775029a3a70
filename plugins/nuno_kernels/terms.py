"""Forces on cloth as typed terms: a NamedTuple of arrays, and the compiled functions that go with its type.

A system holds tuples of terms. numba compiles a step for just the types in them: `each` makes a function over such a
tuple that calls, term by term, the kernel that the term's type has for a role, and nothing for types without it. A
type's kernels are given once, where they are defined, by `register`; nothing lists the types.

A term in the tuple can be switched off without another type, so that nothing is compiled anew: a mask goes with the
tuple, and each call asks it once. Not chosen: `literal_unroll`, which compiles a loop's body once for every type with
all that surrounds it; recursion over the tuple, whose every level is optimised once more with all that it calls.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from inspect import signature
from operator import attrgetter
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numba
from numba import prange, types
from numba.extending import overload

from nuno_kernels import FLAGS
from nuno_kernels.compilation.internals import by_address
from nuno_kernels.compilation.reference import by_reference
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.layout import Bounds


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
class VertexRoles:
    """What a force on each vertex alone is made of: see nuno_kernels.forces.vertex."""

    force: Any = None
    """force(term, x, v, t) -> three newtons, with those of x, v and t that it names"""
    energy: Any = None
    """energy(term, x) -> joules"""


@dataclass(frozen=True)
class StepRoles:
    """Compiled functions that every method's steps call.

    x, v (3, n) are positions and velocities, s the fraction of the frame, `threads` None or how many.
    """

    block: Any = None
    """block(term, block, origin, x, v, force, t) adds newtons to the block's force (3, w), column 0 vertex `origin`, at
    the time t [s]; one that does not depend on it has no such parameter"""
    after: Any = None
    """after(term, x, v, s, a, threads) adds newtons to a (3, n) once all blocks are done"""
    place: Any = None
    """place(term, x, v, s) puts vertices where they are carried to, before forces are found"""
    look: Any = None
    """look(term, x, v) notes what its blocks need to know of all vertices"""
    settle: Any = None
    """settle(term, x, v, s, threads) remembers what a whole step has led to"""
    hold: Any = None
    """hold(term, x, v, s, threads) moves vertices after a step"""
    slow: Any = None
    """slow(term, x, v, threads) holds velocities off what `hold` found"""
    credit: Any = None
    """credit(term, change) counts among its impulses what `hold` has changed velocities by besides, (3, n)"""


@dataclass(frozen=True)
class FrameRoles:
    """Functions that prepare a term for the steps that follow. Python calls them."""

    interval: Any = None
    """interval(term, start, end) writes the bodies' poses over a frame into the term"""
    begin: Any = None
    """begin(term, x, span, threads) is called before an interval's first step; it lasts `span` [s]"""
    approach: Any = None
    """approach(term, rate) sets most of a depth that may be gone through in a second [1/s]"""
    hold_over: Any = None
    """hold_over(term, inverse_mass) -> term, the same whose force is held over several steps"""
    stick: Any = None
    """stick(term, x) lets nothing slip on a short way from x (3, n)"""


@dataclass(frozen=True)
class MatrixRoles:
    """The term's matrix in implicit steps (nuno_integrators.implicit.matrix). Compiled, but for `rows`, `elements` and
    `assemble`, which Python calls.
    """

    rows: Any = None
    """rows(term) -> tuple, room for the matrix: see nuno_kernels.forces.linear"""
    elements: Any = None
    """elements(rows) -> columns, vertices: (p,) columns of the elements' rows, each once, and (corners, p)"""
    fill: Any = None
    """fill(term, rows, block, x, before, rate, floor, follow) writes the rows of the term's matrix"""
    diagonal: Any = None
    """diagonal(term, rows, block, origin, out) adds the matrix' diagonal blocks to (6, w)"""
    multiply: Any = None
    """multiply(term, rows, block, origin, u, out) adds the matrix' product with u (3, n) to out (3, w)"""
    assemble: Any = None
    """assemble(rows, places, diagonal, values) adds the matrix to a factor; see nuno_kernels.forces.linear. One without
    stays out of factors: what it couples changes"""


@dataclass(frozen=True)
class NewtonRoles:
    """What Newton's method asks of a term (nuno_integrators.implicit.newton). Python calls them."""

    bound: Any = None
    """bound(term, x, d, s, threads) -> bool: shortens, in place, a way d (3, n) from x towards fraction s; whether it
    did"""
    waits: Any = None
    """waits(term) -> bool: whether what `bound` moves along has not come to its end"""
    cut: Any = None
    """cut(term, held) counts vertices (n,) that a step leaves where `bound` holds them"""
    foresee: Any = None
    """foresee(term, x, d, out) -> bool: adds to out (3, n) what forces that begin on a way d (3, n) from x bring to a
    linear step's right side; whether they are others than before"""
    grip: Any = None
    """grip(term) -> Grip: what implicit steps hold on its bodies, see nuno_contact.sliding.grip"""
    stiffest: Any = None
    """stiffest(term) -> float, the largest stiffness [N/m]"""
    tension: Any = None
    """tension(term, x) -> float, the largest single force [N]"""
    turning: Any = None
    """turning(term, before, x, d) -> float, see nuno_kernels.forces.springs.turning"""


@dataclass(frozen=True)
class XpbdRoles:
    """What xpbd solves for in the place of a force. Compiled, but for `constraints`, which Python calls."""

    constraints: Any = None
    """constraints(term, vertices) -> tuple of constraints, see nuno_kernels.forces.constraints"""
    carry: Any = None
    """carry(term, moved, s) puts displacements of carried vertices into `Displaced`"""
    project: Any = None
    """project(term, moved, s, held, threads) solves for what cloth meets, bodies or cloth; see
    nuno_contact.penalty.projection, nuno_contact.offset.projection"""
    sweep: Any = None
    """sweep(batches, batch, moved) of batches of constraints: solves one batch, in place in the displacements"""
    forget: Any = None
    """forget(batches) of batches of constraints: begins a step without forces"""


@dataclass(frozen=True)
class ReportRoles:
    """What reports and views ask of a term between frames. Python calls them."""

    energy: Any = None
    """energy(term, x) -> float or Measured, energy [J]"""
    counts: Any = None
    """counts(term) -> mapping, counts for a step's report"""
    pinched: Any = None
    """pinched(term) -> pieces, places: which piece each vertex is of that cannot go on, and where (k, 3) [m]"""
    alone: Any = None
    """alone(term, body) -> term, the same in which only one of its bodies acts, by number"""
    pushed: Any = None
    """pushed(term) -> (n, 3), mean force of its impulses in the last interval, beside those of its law [N]"""
    unbalance: Any = None
    """unbalance(term, x, force) holds forces (3, n) off bodies, in place"""


@dataclass(frozen=True)
class Kernels:
    """The functions of one type of term, by who calls them; a type sets only those that it has.

    A role is named by its part, as "step.block". One may be given as text "module:function", which is loaded when a
    solver first needs it.
    """

    name: str
    """name in reports; several types of one force share a name"""
    lags: bool = True
    """whether a method that has no constraint for it may take it as at the step's start"""
    memory: tuple[str, ...] = ()
    """fields that are part of the state, such as "last", or "plan.spread" of a nested tuple: checkpoints have them by
    their last name"""
    bounds: Callable[[Any], Mapping[str, Bounds]] | None = None
    """`Bounds` of fields that are part of the state; see Memory.bounds"""
    lists: bool = False
    """whether it makes lists now and then, as far as vertices move: only real steps show its cost"""
    reads_velocity: Callable[[Any], bool] = lambda term: False
    vertices: Callable[[Any], int] = lambda term: 0
    """number of vertices that a term examines, if bodies' vertices are among them"""
    vertex: VertexRoles = VertexRoles()
    step: StepRoles = StepRoles()
    frame: FrameRoles = FrameRoles()
    matrix: MatrixRoles = MatrixRoles()
    newton: NewtonRoles = NewtonRoles()
    xpbd: XpbdRoles = XpbdRoles()
    report: ReportRoles = ReportRoles()

    @property
    def reads_time(self) -> bool:
        """Whether its force depends on the time."""
        force = self.vertex.force or self.step.block
        return force is not None and "t" in parameters_of(force)

    def find(self, role: str) -> Any:
        """Return the function of a role such as "step.block", None for none."""
        function = attrgetter(role)(self)
        return resolve_name(function) if isinstance(function, str) else function

    def all(self) -> list[Any]:
        """Return the functions of all roles."""
        parts = {one.name: getattr(self, one.name) for one in fields(self)}
        roles = [f"{name}.{one.name}" for name, part in parts.items() if is_dataclass(part) for one in fields(part)]
        found = [self.bounds, self.reads_velocity, self.vertices, *map(self.find, roles)]
        return [function for function in found if function is not None]


def register(kind: type, **roles: Any) -> None:
    """Register the kernels of a type of term, a NamedTuple of arrays and numbers, which is passed by reference.

    `roles` are the fields of Kernels.
    """
    by_reference(kind)
    kind.kernels = Kernels(**roles)  # type: ignore[attr-defined]
    kind.registered_by = sys._getframe(1).f_globals["__name__"]  # type: ignore[attr-defined]


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
    """Return the function of a role of Kernels for terms of a type, None for none."""
    kernels: Kernels = kind.kernels  # type: ignore[attr-defined]
    return kernels.find(role)


COMPILED = '    raise TypeError("only compiled code can call this: wrap it in a kernel")'
"""Body of functions that numba replaces in compiled code. Interpreted, as with a force written in Python, it raises."""


def parameters_of(function: Any) -> list[str]:
    """Return the names of the parameters of a function, compiled or not."""
    return list(signature(getattr(function, "py_func", function)).parameters)


def define(name: str, parameters: str, body: str, **scope: Any) -> Any:
    """Make a function from source: numba has no other way to call by a tuple's types."""
    exec(f"def {name}({parameters}):\n{body or '    pass'}\n", scope)
    return scope[name]


def each(role: str, parameters: str, linear: bool = False) -> Any:
    """Return a function f(terms, on, <parameters>) for kernels, which calls all terms' kernels of a role such as
    "step.block", in order, each with as many of the parameters as it has.

    `linear` ones take (terms, on, rows, <parameters>), and each kernel its term's rows after the term.
    """
    head = f"terms, on, rows, {parameters}" if linear else f"terms, on, {parameters}"

    def build(terms: Any) -> Any:
        kernels, body = dict[str, Any](), ""
        for k, kind in enumerate(terms.types):
            kernel = role_of(kind.instance_class, role)
            if kernel is not None:
                given = [f"terms[{k}]", *([f"rows[{k}]"] if linear else []), *parameters.split(", ")]
                body += f"    if on[{k}]:\n        kernel{k}({', '.join(given[: len(parameters_of(kernel))])})\n"
                kernels[f"kernel{k}"] = by_address(kernel)
        return define("each", head, body, **kernels)

    return overloaded(head, build)


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
    loop = numba.njit(parallel=True, **FLAGS)(define("loop", f"{parameters}, blocks", body, one=one, prange=prange))
    alone = define("alone", head, f"    for block in range(blocks):\n        {call}", one=one)
    body = f"    loop({parameters}, blocks)"
    if worth:
        body = f"    if work < {worth}:\n        alone({head})\n    else:\n    {body}"
    several = define("several", head, body, loop=loop, alone=numba.njit(**FLAGS)(alone))
    called = define("called", head, COMPILED)
    body = "    return alone if isinstance(threads, types.NoneType) else several"
    typed = define("typed", head, body, alone=alone, several=several, types=types)
    overload(called, jit_options=FLAGS, inline="always")(typed)
    return called


def overloaded(parameters: str, build: Callable[[Any], Any]) -> Any:
    """Return a function that compiled code calls as the one that `build` makes for the type of its first parameter."""
    called = define("called", parameters, COMPILED)
    typed = define("typed", parameters, f"    return build({parameters.partition(',')[0]})", build=build)
    overload(called, jit_options=FLAGS, inline="always")(typed)
    return called
