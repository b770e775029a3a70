"""What acts on a fabric, and what a solver says of its steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.layout import Bounds
from nuno_schemas.skin import Skin


@dataclass(frozen=True)
class Term:
    """One force, prepared for one fabric.

    `data` is a tuple of typed terms, each a NamedTuple of arrays whose type has compiled kernels
    (nuno_kernels.terms): they are fused into the compiled step. Or it is a function f(x, v, t, out) in plain
    Python, which adds newtons to `out` (n, 3) and is called at every evaluation, with x and v (n, 3) that are its own.
    """

    name: str
    data: tuple[Any, ...] | Callable[[Float, Float, float, Float], None]
    omega_squared: Annotated[float, Bounds(0.0)] = 0.0
    """Most this term can add to the squared angular frequency [1/s^2] where it is not active
    at the start (contact); terms active at the start leave 0 and are measured."""
    damping_rate: Annotated[float, Bounds(0.0)] = 0.0
    """Most this term can add to the damping rate c/m [1/s] where it is not active at the start."""
    facts: Mapping[str, float] = field(default_factory=dict)
    """Numbers for the report: of contact the depth m g / k at which it rests ("rest_depth", [m]), and by how much more
    than Coulomb's law says its friction lets go what starts to slide ("slip_speed", [m/s])."""
    bodies: tuple[str, ...] = ()
    """Names of those that it is contact with, by the numbers that they have in it."""

    @property
    def in_python(self) -> bool:
        """Whether it is called from Python at every evaluation."""
        return callable(self.data)


@dataclass(frozen=True)
class Carried:
    """Pinned vertices (b,) that move rigidly with frames of bodies: where each is in its frame, local (b, 3) [m], and
    the frame's number, frame (b,). Or with a skin, which has b vertices: local is where each is as that is bound, and
    frame (b,) the first of its frames.
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
    """(1,) Not 0: steps are to be left at once, wherever they are. Another thread may write it at any time."""


@dataclass(frozen=True)
class StepLimit:
    """How far a step may go.

    dt [s], inf where nothing limits it; omega [1/s] largest angular frequency;
    damping [1/s] largest rate of velocity damping; resolved [s] up to which a method that solves
    its steps only in part reaches the accuracy that it is configured for, inf for any other.
    """

    dt: Annotated[float, Bounds(above=0.0, finite=False)]
    omega: Annotated[float, Bounds(0.0, finite=False)]
    damping: Annotated[float, Bounds(0.0, finite=False)]
    resolved: Annotated[float, Bounds(0.0, finite=False)] = math.inf


@dataclass(frozen=True)
class StepReport:
    """What an integrator did in a frame."""

    status: Literal["ok", "diverged", "unconverged", "left"]
    """left: System.leave was written, and the state is as it was before; memory is not to be used again"""
    steps: Annotated[int, Bounds(0)]
    message: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Wall time per part [s], e.g. {"forces": .., "contact": ..}, where it can be told apart."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """The state at the end: skipped zero-length springs, contacts."""
    energy: Mapping[str, float] = field(default_factory=dict)
    """Energy at the end by kind [J]: kinetic, gravitational, springs, hinges."""
    stretch: float = 0.0
    """Largest |d| / rest - 1 over the springs at the end."""
    totals: Mapping[str, int] = field(default_factory=dict)
    """What adds up over a run: rejected steps, evaluations, iterations of a solver."""
    unbalance: float = math.inf
    """How far the vertex farthest from rest is from it, of a scene until balance; see Integrator.unbalance."""
    unsettled: int = 0
    """Vertices farther from rest than a scene until balance allows."""


@dataclass(frozen=True)
class Touched:
    """What bodies do to a fabric in one state, and all that acts on it, both in newtons."""

    by: Mapping[str, Float]
    """(n, 3) of each body's contact, by its name; as in `Forces`"""
    total: Float
    """(n, 3) of everything; on vertices that are carried along it is what they pull at what carries them"""


@dataclass(frozen=True)
class Forces:
    """What acts on a fabric in one state, by the laws of its scene, whatever the solver makes of them in a step."""

    parts: Mapping[str, Float]
    """(n, 3) [N] by kind, as far as there is any: gravity, damping (of the scene), springs (with their own damping),
    hinges, yarns (tension that passes along them), wind, particle_wind, python, contact. All act on vertices that are
    held or carried, too, which do not follow them. Sliding contact is no law of force: what it says is what surfaces
    and friction hold against the other forces, as on a vertex at rest."""
    acceleration: Float
    """(n, 3) [m/s^2] the sum of all over the mass; 0 for vertices that are held or carried"""
    tension: Float
    """(s,) [N] along each spring, with what it takes over along its yarn, without damping; > 0 pulls"""
