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

from nuno_schemas.bodies import CAPSULE, SKIN, ClosedForm, DistanceField, Geometry, Poses, Skin, no_rows
from nuno_schemas.fabric import Fabric, Float, Int, Memory, State
from nuno_schemas.layout import Bounds
from nuno_schemas.live import Live
from nuno_schemas.parts import Part
from nuno_schemas.system import Forces, StepLimit, StepReport, System, Term, Touched
from nuno_schemas.written import Fields, Written

GROUPS: Mapping[str, str] = {
    "nuno.models": "build a fabric: sheet, skirt, shirt, mesh, pattern, swatch, net, knit",
    "nuno.forces": "forces beyond springs, hinges, gravity and damping: wind, particle_wind",
    "nuno.integrators": "advance a fabric's state in time",
    "nuno.colliders": "shapes that cloth meets: capsule, sphere, plane, box, skeleton, mesh, sdf, skin, surface",
    "nuno.motions": "move a collider's frames: keyframes, bvh, hula, topic, animation",
    "nuno.contacts": "forces between cloth and bodies",
    "nuno.cloth_contacts": "forces between cloth and cloth, and what keeps it from passing through",
    "nuno.operations": "change a fabric and its state: attach, release, repair, smooth, pressure, untangle, wrinkle",
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
    """What every plugin has: the name of its entry point, and the model of its configuration in a scene."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]


class Files(Protocol):
    """Opens files that a scene names, inside the folders the user allows."""

    def resolve(self, name: str) -> Path:
        """Return the path of an existing file. Raises BadInput for a file that is missing or outside the roots."""
        ...

    def read(self, name: str, kind: type[Fields]) -> Written[Fields]:
        """Read an existing YAML or JSON file into the model `kind`, with the line of each field. Raises BadInput with
        the line of a field that the model refuses.
        """
        ...


class Model(Plugin, Protocol):
    """Builds a fabric at rest."""

    def build(self, config: Any, files: Files, seed: int) -> Fabric: ...

    def count(self, config: Any, files: Files) -> int:
        """Return the number of vertices of the fabric, without building it."""
        ...


class Drawn(Model, Protocol):
    """A model that can be drawn over a body: it is then built from the body's mesh in its pose at the start."""

    def over(self, config: Any) -> str | None:
        """Return the name of the body, or None for a fabric that is built without one."""
        ...

    def build_over(
        self, config: Any, files: Files, seed: int, x: Float, faces: NDArray[np.int32], worn: Sequence[Fabric] = ()
    ) -> Fabric:
        """Build the fabric over a closed mesh: vertices (v, 3) [m] in the world, triangles (f, 3).

        worn  cloth of triangles that is already on the same body, innermost first, in its start position
        """
        ...


@dataclass(frozen=True)
class Rested:
    """An object at rest: its configuration, and its vertices (n, 3) at the start and at rest [m]."""

    config: Any
    start: Float
    x: Float


class Refined(Drawn, Protocol):
    """A drawn model that can settle on a coarser mesh first, as `coarse` of its Config says, and go on from there."""

    def coarser(self, config: Any) -> Any:
        """Return the configuration of the coarser mesh, or None if the model is built at once."""
        ...

    def build_over(
        self, config: Any, files: Files, seed: int, x: Float, faces: NDArray[np.int32], worn: Sequence[Fabric] = (),
        rested: Rested | None = None,
    ) -> Fabric:  # fmt: skip
        """Build the fabric in the place of its coarser mesh, `rested`."""
        ...


class Force(Plugin, Protocol):
    """A force on the cloth.

    A force whose configuration and files refer to no vertex by number declares `any_numbering = True`, and so may a
    contact: large cloth with vertices in random order is then renumbered for speed before the force is prepared, and
    `Fabric.told` returns the user's number of a vertex. Without the declaration, vertices keep the user's order.
    """

    def prepare(self, config: Any, fabric: Fabric, seed: int) -> Term: ...


class Contact(Plugin, Protocol):
    """Forces between cloth and bodies."""

    def prepare(self, config: Any, fabric: Fabric, geometry: Geometry, gravity: Float) -> Term:
        """Return the term of the bodies with this contact and configuration: `geometry` holds these bodies, and the
        frames of all bodies.
        """
        ...


class ClothContact(Plugin, Protocol):
    """Contact between cloth and cloth. Its Config has a `thickness` [m], the distance that cloth keeps from cloth: the
    collision service measures distances up to it.
    """

    def prepare(
        self, config: Any, fabric: Fabric, objects: Mapping[str, Int], meet: NDArray[np.bool_], gravity: Float,
        bodies: Geometry | None = None, poses: Poses | None = None,
    ) -> Term:  # fmt: skip
        """Return the term of all cloth, which has faces. `objects` holds the vertices (k,) of each object by name; meet
        (o, o) is true for objects, in that order, that collide with each other or themselves. `bodies` are those that
        the scene treats as cloth, with the frames of all bodies, and `poses` their start; None if it names none and
        there is no skin, whose own contact moves vertices out of it before this one acts.
        """
        ...


class Integrator(Plugin, Protocol):
    """Advances a system's state by whole steps over one frame.

    States, and all values per vertex that it returns, are in the order of the system's fabric, which may be renumbered
    (as Force explains): its messages name a vertex by `Fabric.told`.
    """

    order: ClassVar[int]
    explicit: ClassVar[bool]
    adaptive: ClassVar[bool]
    """Whether it chooses its own steps: `dt` is then the largest step allowed."""

    def prepare(self, config: Any, system: System, state: State, without: Sequence[str] = ()) -> Memory:
        """Return memory for this system without the effect of the terms named in `without`. Nothing compiles before the
        first `advance` or `limit`.
        """
        ...

    def limit(self, config: Any, system: System, state: State) -> StepLimit: ...

    def advance(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None, steps: int, dt: float
    ) -> StepReport:
        """Advance `state` in place by `steps` steps of `dt` [s].

        `poses` are the frames' poses at the start and at the end of the interval, or None
        if there is no body. With `steps` = 0 the state is only measured.
        """
        ...


class Inspected(Integrator, Protocol):
    """An integrator that also tells what acts in a state. Without these methods runs have no forces, no share of each
    force in their time, and cannot go on until balance.

    No method changes state or memory; poses are as in `advance`.
    """

    def profile(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None
    ) -> Mapping[str, float]:
        """Measure the wall time by part [s] of one step on `state`, or of one evaluation of the forces for methods that
        count evaluations: "springs", "hinges", "wind", "contact", "python", as far as the system has them.

        The terms of `Memory.lists` are left out. Called at the end of a run, so that it does not slow down the run's
        own steps.
        """
        ...

    def unbalance(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Float:
        """Return how far each vertex is from rest, shape (n,): the force that surfaces and friction do not balance, and
        that which its velocity will become, over the springs' mean tension. 0 for held vertices, inf for all others of
        cloth without springs.
        """
        ...

    def forces(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Forces:
        """Return the forces in a state by kind, with the bodies' poses and velocities at the end of the interval of
        `poses`, as held vertices of the state have them.
        """
        ...

    def touched(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses]) -> Touched:
        """Return the forces of each body on the cloth in a state, with the bodies' poses and velocities at the end of
        the interval of `poses`.
        """
        ...


@dataclass(frozen=True)
class DrawnSkin:
    """A skin that is drawn in the place of a body that cloth meets, on the same frames: its d vertices [m] in its bind
    pose and e triangles, each vertex in one at least.
    """

    vertices: Annotated[Float, "d", 3]
    faces: Annotated[Int, "e", 3, Bounds(0, below="d")]
    skin: Skin


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
    fields: tuple[DistanceField | ClosedForm, ...] = ()
    notes: tuple[str, ...] = ()
    """Remarks for the user, such as where a mesh is open."""
    skins: tuple[Skin, ...] = ()
    pose: Callable[[float], tuple[Float, Float]] | None = None
    """As `Mover.pose`, if the frames differ from the motion's joints; None if they are the same."""
    drawn: DrawnSkin | None = None
    """What is shown and recorded in its place; None: itself."""

    @property
    def shown(self) -> BodyShape:
        """The body as it is shown and recorded."""
        return self if self.drawn is None else BodyShape.of_skin(self.frames, self.drawn)

    @classmethod
    def of_skin(cls, frames: tuple[str, ...], drawn: DrawnSkin) -> BodyShape:
        """Return a body of one skin on all its frames."""
        x, kind, owner = drawn.vertices, np.array([SKIN], np.int8), np.zeros(len(drawn.faces), np.int32)
        low, high, none = x.min(axis=0)[None], x.max(axis=0)[None], np.zeros(1)
        return cls(frames, kind, np.zeros(1, np.int32), low, high, none, x, drawn.faces, owner, skins=(drawn.skin,))


class Motion(Plugin, Protocol):
    """Moves frames over time. A motion with a live mover also has a method paced(config) -> bool: whether its frames
    wait for the clock.
    """

    def prepare(self, config: Any, files: Files) -> Mover: ...


@dataclass(frozen=True)
class Mover:
    """A prepared motion.

    `joints` and `parents` describe a skeleton at rest: names, (j,) parent index or -1, and
    `offsets` (j, 3) [m] from the parent. A motion without skeleton has one joint.
    `pose(t)` returns rotation (j, 4) and translation (j, 3) of every joint in the world.
    """

    joints: Annotated[tuple[str, ...], "j"]
    parents: Annotated[Int, "j", Bounds(-1, below="j")]
    offsets: Annotated[Float, "j", 3]
    pose: Callable[[float], tuple[Float, Float]]
    live: Live | None = None
    """Joints that are steered from outside during the run; `pose` is then `live.pose`."""
    notes: tuple[str, ...] = ()
    """Remarks for the user."""
    surface: Annotated[Int, "t", 3, Bounds(0, below="j")] | None = None
    """Triangles (t, 3) of a body whose vertices the joints are, which do not turn; `offsets` are where they start."""
    lasts: Annotated[float, Bounds(0.0)] | None = None
    """How long it moves [s], after which it stands still, if it was made for one shot."""


class Collider(Plugin, Protocol):
    """A shape on the frames of a motion."""

    def build(self, config: Any, mover: Mover | None, files: Files) -> BodyShape:
        """Return the primitives and frames; without a mover the only frame is the world."""
        ...


@runtime_checkable
class Landmarked(Protocol):
    """A collider with named landmarks on its shape."""

    def heights(self, config: Any) -> Mapping[str, float]:
        """Return the heights of the landmarks in the joint's frame [m]; empty if the shape does not stand upright."""
        ...
