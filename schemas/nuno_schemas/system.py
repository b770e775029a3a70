"""The forces on a fabric, and a solver's reports of its steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.bodies import Skin
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.layout import Bounds


@dataclass(frozen=True)
class Term:
    """One force, prepared for one fabric.

    `data` is a tuple of typed terms, each a NamedTuple of arrays whose type has compiled kernels
    (nuno_kernels.terms): they are fused into the compiled step. Or it is a function f(x, v, t, out) in plain
    Python, called at every evaluation with copies of x and v (n, 3), which adds its forces [N] to `out` (n, 3).
    """

    name: str
    data: tuple[Any, ...] | Callable[[Float, Float, float, Float], None]
    omega_squared: Annotated[float, Bounds(0.0)] = 0.0
    """Most this term can add to the squared angular frequency [1/s^2] if it is not active
    at the start (contact); terms active at the start leave 0 and are measured."""
    damping_rate: Annotated[float, Bounds(0.0)] = 0.0
    """Most this term can add to the damping rate c/m [1/s] if it is not active at the start."""
    facts: Mapping[str, float] = field(default_factory=dict)
    """Numbers for the report: of contact its depth at rest, m g / k ("rest_depth", [m]), the largest distance at which
    it keeps vertices off ("margin", [m]), and by how much the speed of a vertex that starts to slide exceeds that by
    Coulomb's law ("slip_speed", [m/s])."""
    bodies: tuple[str, ...] = ()
    """Names of the bodies of a contact, by their numbers in the term."""


@dataclass(frozen=True)
class Carried:
    """Pinned vertices (b,) that move rigidly with frames of bodies: their positions in the frames, local (b, 3) [m],
    and the frames' numbers, frame (b,). Or vertices that move with a skin of b vertices: local is then their positions
    in the bind pose, and frame (b,) the first frame of the skin.
    """

    vertices: NDArray[Any]
    local: Float
    frame: NDArray[Any]
    skin: Skin | None = None


@dataclass(frozen=True)
class System:
    """A fabric and everything that acts on it."""

    fabric: Fabric
    gravity: Float
    """(3,) [m/s^2]"""
    damping: float = 0.0
    """Viscous damping per unit mass [1/s]: a -= damping v."""
    terms: tuple[Term, ...] = ()
    threads: int = 1
    """Most threads a kernel may use; the result is the same to the last bit."""
    carried: tuple[Carried, ...] = ()
    leave: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64), compare=False)
    """(1,) Not 0: the solver must abandon its steps at once. Another thread may write it at any time."""


@dataclass(frozen=True)
class StepLimit:
    """Limits of a stable step.

    dt [s] largest step, inf without a limit; omega [1/s] largest angular frequency;
    damping [1/s] largest rate of velocity damping; resolved [s] largest step at which a method that solves
    its steps only in part reaches its configured accuracy, or at which dear forces are evaluated least often, inf for
    other methods.
    """

    dt: Annotated[float, Bounds(above=0.0, finite=False)]
    omega: Annotated[float, Bounds(0.0, finite=False)]
    damping: Annotated[float, Bounds(0.0, finite=False)]
    resolved: Annotated[float, Bounds(0.0, finite=False)] = math.inf


@dataclass(frozen=True)
class StepReport:
    """An integrator's report of a frame."""

    status: Literal["ok", "diverged", "unconverged", "left"]
    """left: System.leave was written; the state is unchanged, and memory must not be used again"""
    steps: Annotated[int, Bounds(0)]
    message: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Wall time per part [s], e.g. {"forces": .., "contact": ..}, if measured separately."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """Counts of the state at the end: skipped zero-length springs, contacts."""
    energy: Mapping[str, float] = field(default_factory=dict)
    """Energy at the end by kind [J]: kinetic, gravitational, springs, hinges."""
    stretch: float = 0.0
    """Largest |d| / rest - 1 over the springs at the end."""
    totals: Mapping[str, int] = field(default_factory=dict)
    """Counts that add up over a run: rejected steps, evaluations, iterations of a solver."""
    unbalance: float = math.inf
    """Largest `Integrator.unbalance` of a vertex, in a scene until balance."""
    unsettled: int = 0
    """Number of vertices farther from rest than a scene until balance allows."""


@dataclass(frozen=True)
class Touched:
    """Forces of bodies on a fabric in one state, and its total forces, both in newtons."""

    by: Mapping[str, Float]
    """(n, 3) contact force of each body, by its name; as in `Forces`"""
    total: Float
    """(n, 3) sum of all forces; for carried vertices, the force with which they pull at their carrier"""


@dataclass(frozen=True)
class Forces:
    """Forces on a fabric in one state, by the laws of its scene, however the solver treats them in a step. Impulses by
    which contact of triangles holds what its law does not count by their mean over the last frame.
    """

    parts: Mapping[str, Float]
    """(n, 3) [N] by kind, only those present: gravity, damping (of the scene), springs (with their own damping),
    hinges, yarns (tension passed along them), wind, particle_wind, python, contact. All also act on held or carried
    vertices, which do not follow them. Sliding contact is not a law of force: its value is the reaction of surfaces
    and friction to the other forces, as on a vertex at rest."""
    acceleration: Float
    """(n, 3) [m/s^2] sum of all forces over the mass; 0 for held or carried vertices"""
    tension: Float
    """(s,) [N] along each spring, including tension passed along its yarn, without damping; > 0 pulls"""
