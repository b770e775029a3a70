"""Plugin kinds: one small protocol each, found by entry point, imported only when named.

A plugin is a module-level class without state of its own. `name` is its entry point's name;
`Config` is a pydantic model that forbids unknown fields. Memory goes in and comes out, and a
failure is a returned status, not hidden state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from nuno_schemas.bodies import Geometry, Poses, no_rows
from nuno_schemas.fabric import Fabric, Float, Memory, State
from nuno_schemas.field import DistanceField

GROUPS: Mapping[str, str] = {
    "nuno.models": "build a fabric: sheet, skirt, mesh, net",
    "nuno.forces": "forces beyond springs, hinges, gravity and damping: wind, drag",
    "nuno.integrators": "advance a fabric's state in time",
    "nuno.colliders": "shapes that cloth meets: capsule, sphere, plane, box, skeleton, mesh, sdf",
    "nuno.motions": "move a collider's frames: keyframes, bvh, hula",
    "nuno.contacts": "forces between cloth and bodies",
    "nuno.operations": "make something new of a fabric and where it is: repair, smooth, pressure, wrinkle",
    "nuno.renderers": "draw a picture of a frame",
    "nuno.dye_cloths": "build a cloth to dye: cells, woven, photograph",
    "nuno.dye_solvers": "spread dye in a cloth over time",
    "nuno.dye_pictures": "draw dyed cloth: yarns, photograph",
    "nuno.yarn_pictures": "draw knits on bodies: yarns, lines, density, map",
    "nuno.isotherms": "how much dye fibre fixes: partition, freundlich, langmuir",
}


class Config(BaseModel):
    """Base of every plugin's configuration: unknown fields are refused by name."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Files(Protocol):
    """Opens files that a scene names, inside the folders the user allows."""

    def resolve(self, name: str) -> Path:
        """The path of an existing file. Raises BadInput for one outside the roots or missing."""
        ...


@dataclass(frozen=True)
class Term:
    """One force, prepared for one fabric.

    `data` is a tuple of typed terms, each a NamedTuple of arrays whose type has compiled kernels
    (nuno_kernels.terms): they are fused into the compiled step. Or it is a function f(x, v, t, out) in plain
    Python, which adds newtons to `out` (n, 3) and is called at every evaluation, with x and v (n, 3) that are its own.
    """

    name: str
    data: tuple[Any, ...] | Callable[[Float, Float, float, Float], None]
    omega_squared: float = 0.0
    """Most this term can add to the squared angular frequency [1/s^2] where it is not active
    at the start (contact); terms active at the start leave 0 and are measured."""
    damping_rate: float = 0.0
    """Likewise for the damping rate c/m [1/s]."""
    facts: Mapping[str, float] = field(default_factory=dict)
    """Numbers for the report: of contact the depth m g / k at which it rests ("rest_depth", [m]), and by how much more
    than Coulomb's law says its friction lets go what starts to slide ("slip_speed", [m/s])."""

    @property
    def in_python(self) -> bool:
        """Whether it is called from Python at every evaluation."""
        return callable(self.data)


@dataclass(frozen=True)
class Carried:
    """Pinned vertices (b,) that move rigidly with frames of bodies: where each is in its frame, local (b, 3) [m], and
    the frame's number, frame (b,).
    """

    vertices: NDArray[Any]
    local: Float
    frame: NDArray[Any]


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


@dataclass(frozen=True)
class StepLimit:
    """How far a step may go.

    dt [s], inf where nothing limits it; omega [1/s] largest angular frequency;
    damping [1/s] largest rate of velocity damping; resolved [s] up to which a method that solves
    its steps only in part reaches the accuracy that it is configured for, inf for any other.
    """

    dt: float
    omega: float
    damping: float
    resolved: float = math.inf


@dataclass(frozen=True)
class StepReport:
    """What an integrator did in a frame."""

    status: Literal["ok", "diverged", "unconverged"]
    steps: int
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
    """Of a scene until balance: how far the vertex farthest from rest is from it; see Integrator.unbalance."""
    unsettled: int = 0
    """Of a scene until balance: vertices farther from rest than it allows."""


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


class Model(Protocol):
    """Builds a fabric at rest."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]

    def build(self, config: Any, files: Files, seed: int) -> Fabric: ...

    def count(self, config: Any, files: Files) -> int:
        """Vertices it will have, found without building it."""
        ...


class Drawn(Model, Protocol):
    """A model that can be drawn over a body: it is then built with the body's mesh, where that is at the start."""

    def over(self, config: Any) -> str | None:
        """Name of the body; None for one that is built by itself."""
        ...

    def build_over(self, config: Any, files: Files, seed: int, x: Float, faces: NDArray[np.int32]) -> Fabric:
        """Built over a closed mesh: vertices (v, 3) [m] in the world, triangles (f, 3)."""
        ...


class Force(Protocol):
    """A force on the cloth."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]

    def prepare(self, config: Any, fabric: Fabric, seed: int) -> Term: ...


class Contact(Protocol):
    """Forces between cloth and bodies."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]

    def prepare(self, config: Any, fabric: Fabric, geometry: Geometry, gravity: Float) -> Term:
        """The term of the bodies that have this contact, so configured: those of `geometry`, on the frames of all."""
        ...


class Integrator(Protocol):
    """Advances a system's state by whole steps over one frame."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]
    order: ClassVar[int]
    explicit: ClassVar[bool]
    adaptive: ClassVar[bool]
    """Whether it chooses its own steps: `dt` is then the largest it may take."""

    def prepare(self, config: Any, system: System, state: State) -> Memory:
        """Memory for this system; compiles nothing before the first `advance` or `limit`."""
        ...

    def limit(self, config: Any, system: System, state: State) -> StepLimit: ...

    def advance(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None, steps: int, dt: float
    ) -> StepReport:
        """Advance `state` in place by `steps` steps of `dt` [s].

        `poses` are the frames' poses at the start and at the end of the interval, or None
        where nothing moves and no body exists. No steps at all only measure the state.
        """
        ...

    def profile(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None
    ) -> Mapping[str, float]:
        """Wall time of one step by part [s], measured here and now on `state`: "springs", "hinges",
        "wind", "contact", "python" as far as the system has them, and "rest".

        Changes neither state nor memory; poses as in `advance`. Meant for the end of a run: a run's
        own steps are not slowed down by it.
        """
        ...

    def unbalance(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Float:
        """(n,) how far each vertex is from rest: the force that surfaces and friction leave on it, and what its
        velocity will turn into, as a share of the springs' mean tension. 0 for vertices that are held, inf for all
        others of cloth without springs. Changes neither state nor memory; poses as in `advance`.
        """
        ...

    def forces(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Forces:
        """What acts in a state, by kind of force, with bodies as at the start of the interval of `poses`, and as fast:
        what an explicit method's next step begins with. Changes neither state nor memory.
        """
        ...

    def about(self, system: System) -> str:
        """How its kernels run this system, in words for the report: threads, and why."""
        ...

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        """(2, 2) matrix of one step on x'' = -omega^2 x - damping x', state (x, v)."""
        ...


@dataclass(frozen=True)
class BodyShape:
    """A collider's primitives and frames, in the layout of Geometry (one body)."""

    frames: tuple[str, ...]
    kind: NDArray[np.int8]
    frame: NDArray[np.int32]
    a: Float
    b: Float
    radius: Float
    vertices: Float = field(default_factory=partial(no_rows, np.float64, 3))
    faces: NDArray[np.int32] = field(default_factory=partial(no_rows, np.int32, 3))
    owner: NDArray[np.int32] = field(default_factory=partial(no_rows, np.int32))
    fields: tuple[DistanceField, ...] = ()
    notes: tuple[str, ...] = ()
    """What the user should know of it, in words: where a mesh is open."""


class Motion(Protocol):
    """Moves frames over time."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]

    def prepare(self, config: Any, files: Files) -> Mover: ...


@dataclass(frozen=True)
class Mover:
    """A prepared motion.

    `joints` and `parents` describe a skeleton at rest: names, (j,) parent index or -1, and
    `offsets` (j, 3) [m] from the parent. A motion without skeleton has one joint.
    `pose(t)` gives rotation (j, 4) and translation (j, 3) of every joint in the world.
    """

    joints: tuple[str, ...]
    parents: NDArray[np.int32]
    offsets: Float
    pose: Callable[[float], tuple[Float, Float]]


class Collider(Protocol):
    """A shape on the frames of a motion."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]

    def build(self, config: Any, mover: Mover | None, files: Files) -> BodyShape:
        """Primitives; without a mover there is one frame, the world."""
        ...


@runtime_checkable
class Landmarked(Protocol):
    """A collider that knows places of its shape by name."""

    def heights(self, config: Any) -> Mapping[str, float]:
        """Heights of these places in the joint's frame [m]; none where the shape does not stand upright."""
        ...
