"""Forces on cloth as typed terms: a NamedTuple of arrays, and the compiled functions that go with its type.

A system holds tuples of terms, with a table of the addresses of their kernels: `each` makes a function that walks it
and calls, term by term, the kernel that the term's type has for a role, and nothing for types without it. A type's
kernels are given once, where they are defined, by `register`; nothing lists the types. They are compiled for the type
alone, and steps for no type at all (nuno_kernels.compilation.table).

A mask goes with the terms, by which one can be switched off.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from inspect import signature
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numba
from numba import prange, typeof, types
from numba.extending import intrinsic, overload, typeof_impl

from nuno_kernels import FLAGS
from nuno_kernels.compilation.internals import address_of, by_address
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.compilation.table import NOTHING, TABLE, UNKNOWN, call_by_table, table_of
from nuno_kernels.compilation.workers import compile_all
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


FORCE = {
    "block": "(term, block, origin, x, v, force, t) adds newtons to the block's force (3, w), column 0 for `origin`, "
    "by the time t [s], which one that does not depend on it leaves out",
    "at_vertex": "(term, x, v, t) -> three newtons on one vertex, with those of x, v and t that it names",
    "energy_at_vertex": "(term, x) -> joules of one vertex",
    "settle": "(term, x, v, s, threads) remembers what a whole step has led to",
    "energy": "(term, x) -> joules, or Measured",
    "begin": "(term, x, span, threads) is called before an interval's first step; it lasts `span` [s]",
    "hold_over": "(term, inverse_mass) -> term, the same whose force is held over several steps",
    "stick": "(term, x) lets nothing slip on a short way from x",
    "counts": "(term) -> mapping, counts for a step's report",
}
"""Roles of forces. x, v (3, n) are positions and velocities, s the fraction of the frame, `threads` None or how many.
Those up to settle are compiled, and Python calls the others."""

IMPLICIT = {
    "rows": "(term) -> tuple, room for the matrix: see nuno_kernels.forces.linear",
    "elements": "(rows) -> columns, vertices: (p,) columns of the elements' rows, each once, and (corners, p)",
    "fill": "(term, rows, block, x, before, rate, floor, follow) writes the rows of the term's matrix",
    "diagonal": "(term, rows, block, origin, out) adds the matrix' diagonal blocks to (6, w)",
    "multiply": "(term, rows, block, origin, u, out) adds the matrix' product with u (3, n) to out (3, w)",
    "assemble": "(rows, places, diagonal, values) adds the matrix to a factor, see nuno_kernels.forces.linear; without "
    "it a matrix stays out of factors: what it couples changes",
    "stiffest": "(term) -> float, the largest stiffness [N/m]",
    "tension": "(term, x) -> float, the largest single force [N]",
    "turning": "(term, before, x, d) -> float, see nuno_kernels.forces.springs.turning",
    "constraints": "(term, vertices) -> tuple of constraints, see nuno_kernels.forces.constraints",
    "sweep": "(batches, batch, moved) of batches of constraints: solves one batch, in place in the displacements",
    "forget": "(batches) of batches of constraints: begins a step without forces",
}
"""Roles that implicit solvers ask for besides: a force's matrix, or, in xpbd, constraints in its place. fill, diagonal,
multiply, sweep and forget are compiled."""

CONTACT = {
    "place": "(term, x, v, s) puts vertices where they are carried to, before forces are found",
    "look": "(term, x, v) notes what its blocks need to know of all vertices",
    "after": "(term, x, v, s, a, threads) adds newtons to a (3, n) once all blocks are done",
    "hold": "(term, x, v, s, threads) moves vertices after a step",
    "slow": "(term, x, v, threads) holds velocities off what `hold` found",
    "credit": "(term, change) counts among its impulses what `hold` has changed velocities by besides, (3, n)",
    "carry": "(term, moved, s) puts displacements of carried vertices into `Displaced`",
    "project": "(term, moved, s, held, threads) solves for what cloth meets, bodies or cloth; see projection.py",
    "interval": "(term, start, end) writes the bodies' poses over a frame into the term",
    "approach": "(term, rate) sets most of a depth that may be gone through in a second [1/s]",
    "bound": "(term, x, d, s, threads) -> bool: shortens, in place, a way d (3, n) from x towards s; whether it did",
    "waits": "(term) -> bool: whether what `bound` moves along has not come to its end",
    "cut": "(term, held) counts vertices (n,) that a step leaves where `bound` holds them",
    "foresee": "(term, x, d, out) -> bool: adds to out (3, n) what forces that begin on a way d (3, n) from x bring to "
    "a linear step's right side; whether they are others than before",
    "grip": "(term) -> Grip: what implicit steps hold on its bodies, see nuno_contact.sliding.grip",
    "pinched": "(term) -> pieces, places: which piece each vertex is of that cannot go on, and where (k, 3) [m]",
    "alone": "(term, body) -> term, the same in which only one of its bodies acts, by number",
    "pushed": "(term) -> (n, 3), mean force of its impulses in the last interval, beside those of its law [N]",
    "unbalance": "(term, x, force) holds forces (3, n) off bodies, in place",
}
"""Roles of contact with bodies and cloth besides, and of what carries vertices. Those up to project are compiled."""


@dataclass(frozen=True)
class Kernels:
    """The functions of one type of term by their roles, those of FORCE, IMPLICIT and CONTACT that it has. One may be
    text "module:function", of a module next to the type's, which is loaded when a solver first needs it.
    """

    name: str
    """name in reports; several types of one force share a name"""
    roles: Mapping[str, Any]
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

    def __contains__(self, role: str) -> bool:
        """Whether the type has a role."""
        return role in self.roles

    @property
    def reads_time(self) -> bool:
        """Whether its force depends on the time."""
        force = self.roles.get("at_vertex", self.roles.get("block"))
        return force is not None and "t" in parameters_of(force)

    def find(self, role: str) -> Any:
        """Return the function of a role, None for none."""
        function = self.roles.get(role)
        return resolve_name(function) if isinstance(function, str) else function

    def all(self) -> list[Any]:
        """Return the functions of all roles."""
        found = [self.bounds, self.reads_velocity, self.vertices, *map(self.find, self.roles)]
        return [function for function in found if function is not None]


def register(kind: type, name: str, **given: Any) -> None:
    """Register the kernels of a type of term, a NamedTuple of arrays and numbers, which is passed by reference: its
    roles, and other fields of Kernels.
    """
    about = {one.name: given.pop(one.name) for one in fields(Kernels) if one.name in given}
    if unknown := given.keys() - FORCE.keys() - IMPLICIT.keys() - CONTACT.keys():
        raise TypeError(f"a force has no role {', '.join(unknown)}: nuno_kernels.terms lists those that there are")
    by_reference(kind)
    beside = kind.__module__.rpartition(".")[0]
    given |= {role: f"{beside}.{place}" for role, place in given.items() if isinstance(place, str)}
    kind.kernels = Kernels(name, given, **about)  # type: ignore[attr-defined]
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


class Terms(tuple[Any, ...]):
    """Terms as compiled steps call them."""

    roles: Sequence[str]
    """those in which steps call them"""
    given: Collection[str]
    """those of VARIANTS that are not None"""
    rows: Sequence[Any]
    """of each term the rows of its matrix, which `linear` roles take after the term, or None"""

    def __new__(
        cls, terms: Iterable[Any] = (), roles: Sequence[str] = (), given: Collection[str] = (),
        rows: Sequence[Any] | None = None,
    ) -> Terms:  # fmt: skip
        self = super().__new__(cls, terms)
        self.roles, self.given, self.rows = roles, given, rows or (None,) * len(self)
        return self

    def again(self, terms: Iterable[Any]) -> Terms:
        """Return other terms in the same roles."""
        return Terms(terms, self.roles, self.given, self.rows)

    @cached_property
    def address(self) -> int:
        """The address of the table. It compiles what is called, and raises what that raises."""
        pairs = zip(self, self.rows, strict=True)
        typed = [[(typeof(one), one) for one in pair if one is not None] for pair in pairs]
        variants = {role: sum(VARIANTS[one] for one in self.given if one in CALLS[role]) for role in self.roles}
        calls = dict[tuple[int, int], tuple[Any, tuple[Any, ...]]]()
        addresses = [[UNKNOWN] * len(PLACES) for _ in self]
        for k, term in enumerate(self):
            for (role, variant), place in PLACES.items():
                if role not in kernels_of(term):
                    addresses[k][place] = NOTHING
                elif variants.get(role) == variant:
                    kernel, taken = (
                        kernels_of(term).find(role),
                        (*(kind for kind, _ in typed[k]), *_types_of(role, variant)),
                    )
                    calls[k, place] = by_address(kernel), taken[: len(parameters_of(kernel))]
        compile_all(list(calls.values()))
        for (k, place), call in calls.items():
            addresses[k][place] = address_of(*call)
        self._memory = table_of(typed, addresses)
        return int(self._memory[0].ctypes.data)


@typeof_impl.register(Terms)  # type: ignore[untyped-decorator]
def _table(value: Terms, context: Any) -> Any:
    return TABLE


def call_each(packed: Any, role: str, *args: Any) -> list[Any]:
    """Return the results of a role of all acting terms of a packed system that have it, in order."""
    terms = zip((*packed.forces, *packed.bodies), (*packed.forces_on, *packed.bodies_on), strict=True)
    acting = {id(term): term for term, on in terms if on}
    calls = [(kernels_of(term).find(role), term) for term in acting.values()]
    return [call(term, *args) for call, term in calls if call is not None]


ROWS = types.Array(types.float64, 2, "C")
TYPES: Mapping[str, Any] = {
    **dict.fromkeys(("block", "origin", "batch", "threads"), types.int64),
    **dict.fromkeys(("t", "s", "rate", "floor", "follow"), types.float64),
    **dict.fromkeys(("x", "v", "force", "a", "change", "before", "u", "out", "held"), ROWS),
    "moved": types.NamedTuple([ROWS] * 5 + [types.float64], Displaced),
}
"""types of the parameters of compiled roles"""
VARIANTS = {"threads": 1, "held": 2}
"""parameters that may be None instead: kernels are compiled for that"""
ROLES = (
    "block", "place", "look", "after", "settle", "hold", "slow", "credit", "carry", "project", "fill", "diagonal",
    "multiply", "sweep", "forget",
)  # fmt: skip
"""compiled roles that steps call"""
PLACES = {(role, variant): 4 * k + variant for k, role in enumerate(ROLES) for variant in range(4)}
"""places of their addresses in a table"""
CALLS: dict[str, list[str]] = {}
"""parameters that steps call them with"""

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
    """Return a function f(terms, on, <parameters>) for kernels, which calls all acting terms' kernels of a compiled
    role, in order, each with as many of the parameters as it has; `linear` ones after the rows of its matrix, too.
    """
    CALLS[role] = parameters.split(", ") if parameters else []
    given = f", {parameters}" if parameters else ""
    typed = call_by_table(lambda kinds: _call_of(role, kinds), len(PLACES), linear)
    call = intrinsic(define("call", f"typing, terms, k{given}", f"    return typed({parameters})", typed=typed))
    body = f"    for k in range(len(terms)):\n        if on[k]:\n            call(terms, k{given})"
    walk = define("walk", f"terms, on{given}", body, call=call)
    return numba.njit(forceinline=True, **FLAGS)(walk)


def _call_of(role: str, given: Sequence[Any]) -> tuple[int, list[Any]]:
    """Return the place in a table of the kernel that a role calls with these types, and the types that it takes."""
    named = zip(CALLS[role], given, strict=True)
    variant = sum(VARIANTS[name] for name, kind in named if name in VARIANTS and not isinstance(kind, types.NoneType))
    return PLACES[role, variant], _types_of(role, variant)


def _types_of(role: str, variant: int) -> list[Any]:
    """Return the types of a role's parameters."""
    return [types.none if name in VARIANTS and not variant & VARIANTS[name] else TYPES[name] for name in CALLS[role]]


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
    overload(called, jit_options=FLAGS | {"forceinline": True}, strict=False)(typed)
    return called


def overloaded(parameters: str, build: Callable[[Any], Any]) -> Any:
    """Return a function that compiled code calls as the one that `build` makes for the type of its first parameter."""
    called = define("called", parameters, COMPILED)
    typed = define("typed", parameters, f"    return build({parameters.partition(',')[0]})", build=build)
    overload(called, jit_options=FLAGS | {"forceinline": True}, strict=False)(typed)
    return called
