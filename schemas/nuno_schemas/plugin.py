"""Plugin kinds: one small protocol each, found by entry point, imported only when named.

A plugin is a module-level class without state of its own. `name` is its entry point's name;
`Config` is a pydantic model that forbids unknown fields. Memory goes in and comes out, and a
failure is a returned status, not hidden state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nuno_schemas.bodies import CAPSULE, SKIN, Geometry, Poses, no_rows
from nuno_schemas.fabric import Fabric, Float, Int, Memory, State
from nuno_schemas.field import DistanceField
from nuno_schemas.layout import Bounds
from nuno_schemas.live import Live
from nuno_schemas.parts import Part
from nuno_schemas.skin import Skin
from nuno_schemas.system import Forces, StepLimit, StepReport, System, Term, Touched
from nuno_schemas.written import Fields, Written

GROUPS: Mapping[str, str] = {
    "nuno.models": "build a fabric: sheet, skirt, mesh, net",
    "nuno.forces": "forces beyond springs, hinges, gravity and damping: wind, drag",
    "nuno.integrators": "advance a fabric's state in time",
    "nuno.colliders": "shapes that cloth meets: capsule, sphere, plane, box, skeleton, mesh, sdf, skin",
    "nuno.motions": "move a collider's frames: keyframes, bvh, hula",
    "nuno.contacts": "forces between cloth and bodies",
    "nuno.cloth_contacts": "forces between cloth and cloth, and what keeps it from passing through",
    "nuno.operations": "make something new of a fabric and where it is: repair, smooth, pressure, untangle, wrinkle",
    "nuno.renderers": "draw a picture of a frame",
    "nuno.dye_cloths": "build a cloth to dye: cells, woven, photograph",
    "nuno.dye_solvers": "spread dye in a cloth over time",
    "nuno.dye_pictures": "draw dyed cloth: yarns, photograph",
    "nuno.yarn_pictures": "draw knits on bodies: yarns, lines, density, map",
    "nuno.isotherms": "how much dye fibre fixes: partition, freundlich, langmuir",
}


class Config(Part):
    """Base of every plugin's configuration."""


class Plugin(Protocol):
    """What every plugin has: its entry point's name, and what a scene may say of it."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]


class Files(Protocol):
    """Opens files that a scene names, inside the folders the user allows."""

    def resolve(self, name: str) -> Path:
        """The path of an existing file. Raises BadInput for one outside the roots or missing."""
        ...

    def read(self, name: str, kind: type[Fields]) -> Written[Fields]:
        """The fields of an existing YAML or JSON file, with their lines. Raises BadInput by line for what the model
        `kind` does not take.
        """
        ...


class Model(Plugin, Protocol):
    """Builds a fabric at rest."""

    def build(self, config: Any, files: Files, seed: int) -> Fabric: ...

    def count(self, config: Any, files: Files) -> int:
        """Vertices it will have, found without building it."""
        ...


class Drawn(Model, Protocol):
    """A model that can be drawn over a body: it is then built with the body's mesh, where that is at the start."""

    def over(self, config: Any) -> str | None:
        """Name of the body; None for one that is built by itself."""
        ...

    def build_over(
        self, config: Any, files: Files, seed: int, x: Float, faces: NDArray[np.int32], worn: Sequence[Fabric] = ()
    ) -> Fabric:
        """Built over a closed mesh: vertices (v, 3) [m] in the world, triangles (f, 3).

        worn  cloth of triangles that was drawn over the same body before, the innermost first, where it starts
        """
        ...


@dataclass(frozen=True)
class Rested:
    """What an object has come to rest as: how it was configured, and where its vertices (n, 3) began and lie [m]."""

    config: Any
    start: Float
    x: Float


class Refined(Drawn, Protocol):
    """A drawn model that can come to rest on fewer vertices first, as `coarse` of its Config says, and goes on from
    there.
    """

    def coarser(self, config: Any) -> Any:
        """How it is configured to have fewer vertices; None for one that is built at once."""
        ...

    def build_over(
        self, config: Any, files: Files, seed: int, x: Float, faces: NDArray[np.int32], worn: Sequence[Fabric] = (),
        rested: Rested | None = None,
    ) -> Fabric:  # fmt: skip
        """The same, where what has `rested` lies."""
        ...


class Force(Plugin, Protocol):
    """A force on the cloth.

    One that knows no vertex by a number of its own, from its configuration or a file, says `any_numbering = True`, and
    so may contacts: large cloth whose vertices stand in no order is then handed to it, and stepped, in a better one,
    in which `Fabric.told` gives the user's number of a vertex. One that does not say so has the user's order.
    """

    def prepare(self, config: Any, fabric: Fabric, seed: int) -> Term: ...


class Contact(Plugin, Protocol):
    """Forces between cloth and bodies."""

    def prepare(self, config: Any, fabric: Fabric, geometry: Geometry, gravity: Float) -> Term:
        """The term of the bodies that have this contact, so configured: those of `geometry`, on the frames of all."""
        ...


class ClothContact(Plugin, Protocol):
    """What cloth does to cloth. Its Config has a `thickness` [m], from which on cloth keeps off cloth: up to there the
    collision service measures how near it comes.
    """

    def prepare(
        self, config: Any, fabric: Fabric, objects: Mapping[str, Int], meet: NDArray[np.bool_], gravity: Float,
        bodies: Geometry | None = None, poses: Poses | None = None,
    ) -> Term:  # fmt: skip
        """The term of all cloth, which has faces; `objects` are the vertices (k,) of each by name, and meet (o, o) says
        which of them, in that order, meet each other and themselves. The bodies, on the frames of all, are those that
        the scene wants to be met as cloth is, and poses where they are at the start; not given where it names none.
        """
        ...


class Integrator(Plugin, Protocol):
    """Advances a system's state by whole steps over one frame.

    States, and all values of vertices that it gives, are in the order of the system's fabric, which may be renumbered
    (see Force): its messages call a vertex by `Fabric.told`.
    """

    order: ClassVar[int]
    explicit: ClassVar[bool]
    adaptive: ClassVar[bool]
    """Whether it chooses its own steps: `dt` is then the largest it may take."""

    def prepare(self, config: Any, system: System, state: State, without: Sequence[str] = ()) -> Memory:
        """Memory for this system, in which the terms of the names in `without` do nothing; compiles nothing before the
        first `advance` or `limit`.
        """
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
        """Wall time by part [s] of one step, or of one evaluation of the forces where a method counts those, measured
        here and now on `state`: "springs", "hinges", "wind", "contact", "python" as far as the system has them.

        Without those of `making_lists`. Changes neither state nor memory; poses as in `advance`. Meant for the end of a
        run: a run's own steps are not slowed down by it.
        """
        ...

    def making_lists(self, memory: Memory) -> tuple[str, ...]:
        """Names of the terms that make lists now and then, so that only real steps tell what they cost."""
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

    def touched(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses]) -> Touched:
        """What each body does to the cloth in a state, with bodies as at the end of the interval of `poses`, and as
        fast. Changes neither state nor memory.
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

    frames: Annotated[tuple[str, ...], "j"]
    kind: Annotated[NDArray[np.int8], "p", Bounds(CAPSULE, SKIN)]
    frame: Annotated[Int, "p", Bounds(0, below="j")]
    a: Annotated[Float, "p", 3]
    b: Annotated[Float, "p", 3]
    radius: Annotated[Float, "p", Bounds(0.0)]
    vertices: Annotated[Float, "v", 3] = field(default_factory=partial(no_rows, np.float64, 3))
    faces: Annotated[Int, "t", 3, Bounds(0, below="v")] = field(default_factory=partial(no_rows, np.int32, 3))
    owner: Annotated[Int, "t", Bounds(0, below="p")] = field(default_factory=partial(no_rows, np.int32))
    fields: tuple[DistanceField, ...] = ()
    notes: tuple[str, ...] = ()
    """What the user should know of it, in words: where a mesh is open."""
    skins: tuple[Skin, ...] = ()
    pose: Callable[[float], tuple[Float, Float]] | None = None
    """As that of Mover, where the frames are not where the motion has them; None: they are."""


class Motion(Plugin, Protocol):
    """Moves frames over time. One whose mover is live also says whether its frames wait for the clock, by a method
    paced(config) -> bool.
    """

    def prepare(self, config: Any, files: Files) -> Mover: ...


@dataclass(frozen=True)
class Mover:
    """A prepared motion.

    `joints` and `parents` describe a skeleton at rest: names, (j,) parent index or -1, and
    `offsets` (j, 3) [m] from the parent. A motion without skeleton has one joint.
    `pose(t)` gives rotation (j, 4) and translation (j, 3) of every joint in the world.
    """

    joints: Annotated[tuple[str, ...], "j"]
    parents: Annotated[Int, "j", Bounds(-1, below="j")]
    offsets: Annotated[Float, "j", 3]
    pose: Callable[[float], tuple[Float, Float]]
    live: Live | None = None
    """Of joints that are told where to be while the run goes on; `pose` is then its own."""
    notes: tuple[str, ...] = ()
    """What the user should know of it, in words."""


class Collider(Plugin, Protocol):
    """A shape on the frames of a motion."""

    def build(self, config: Any, mover: Mover | None, files: Files) -> BodyShape:
        """Primitives; without a mover there is one frame, the world."""
        ...


@runtime_checkable
class Landmarked(Protocol):
    """A collider that knows places of its shape by name."""

    def heights(self, config: Any) -> Mapping[str, float]:
        """Heights of these places in the joint's frame [m]; none where the shape does not stand upright."""
        ...
