"""Operations: plugins that make something new from a fabric and its state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Fabric, Float, Int, State
from nuno_schemas.plugin import Files, Plugin

# Yarns as curves: made from a knit's links, drawn in pictures.


def first_of_pieces(ptr: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the points (s,) at which pieces of polylines begin; polyline y is points ptr[y]:ptr[y + 1]."""
    return np.delete(np.arange(ptr[-1]), ptr[1:][np.diff(ptr) > 0] - 1)


@dataclass(frozen=True)
class YarnCurves:
    """Yarns as polylines of round cross section, on skin or free.

    points (n, 3)     float64  points along each yarn, yarn by yarn [m]; a ring ends where it began
    ptr    (y + 1,)   int64    yarn y is points[ptr[y]:ptr[y + 1]]
    radius (y,)       float64  [m], 0 for a line
    kind   (y,)       int32    index into `names`
    names                      e.g. ("nylon", "support")
    normal (n, 3)     float64  unit normal of the skin below each point, outwards; 0 without skin
    """

    points: Float
    ptr: NDArray[np.int64]
    radius: Float
    kind: NDArray[np.int32]
    names: tuple[str, ...]
    normal: Float

    @property
    def number(self) -> int:
        """Number of yarns."""
        return int(self.radius.shape[0])

    def segments(self) -> NDArray[np.int64]:
        """Return the first point of every segment, shape (s,)."""
        return first_of_pieces(self.ptr)

    def yarn(self) -> NDArray[np.int64]:
        """Return the yarn of each point, shape (n,)."""
        return np.repeat(np.arange(self.number), np.diff(self.ptr))


@dataclass(frozen=True)
class Surface:
    """Closed meshes in the world at one time: vertices (n, 3) [m], faces (f, 3) counter-clockwise from outside."""

    vertices: Float
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class Beside:
    """A body near cloth, at one time.

    frames       names of its f frames
    rotation     (f, 4) unit quaternions w, x, y, z, and translation (f, 3) [m] of the frames
    distance     (f, n) signed distance of each vertex from the primitives on each frame, negative inside; inf for a
                 frame without primitives [m]
    """

    frames: Annotated[tuple[str, ...], "f"]
    rotation: Annotated[Float, "f", 4]
    translation: Annotated[Float, "f", 3]
    distance: Annotated[Float, "f", "n"]


@dataclass(frozen=True)
class Changed:
    """A fabric that replaces the one it was made from during a run, and its state.

    source (n,) int32: index of each vertex in the old fabric, -1 for a new one; old vertices keep their order
    """

    fabric: Fabric
    state: State
    source: NDArray[np.int32]


@dataclass(frozen=True)
class Arranged:
    """The start of a fabric: position (n, 3) [m], and numbers for a report."""

    position: Annotated[Float, "n", 3]
    facts: Mapping[str, float]


@dataclass(frozen=True)
class Outcome:
    """Result of an operation.

    `facts` are numbers for a report; `curves` are yarns as curves, if it makes any; `arrays` are further values
    per point of the curves, or per vertex of the fabric without curves; `changed` is the new fabric, of an
    operation that may be applied in a running simulation.
    """

    facts: Mapping[str, float]
    curves: YarnCurves | None = None
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    changed: Changed | None = None


class Operation(Plugin, Protocol):
    """Makes something new from a fabric and its state."""

    def apply(self, config: Any, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Apply the operation; `skin` is the surface of all mesh bodies, or None. Changes none of its arguments."""
        ...


class Arrangement(Operation, Protocol):
    """An operation that moves all cloth of a scene before anything acts on it."""

    def arrange(
        self, config: Any, fabric: Fabric, objects: Mapping[str, Int], meet: NDArray[np.bool_],
        thickness: float | None, bodies: Surface | None = None,
    ) -> Arranged:  # fmt: skip
        """Return the start of the cloth instead of fabric.position; pinned vertices keep theirs to the bit. `objects`
        holds the vertices (k,) of each object by name; meet (o, o) is true for objects, in that order, that collide
        with each other or themselves; `thickness` [m] is that of cloth contact, None without; `bodies` are the bodies
        that the scene treats as cloth, in their start poses. Changes none of its arguments.
        """
        ...


class Alteration(Operation, Protocol):
    """An operation that changes the fabric, and may be applied during a simulation.

    It may have a method `require(config, fabric, earlier)`, which raises BadInput for a fabric that it cannot change in
    any state, after the operations of the same name on the object with the configurations `earlier`: a run is then
    refused before it starts.
    """

    def compile(self) -> None:  # none by default
        """Compile what `apply` needs, so that a run does not wait for it."""

    def resolve(self, config: Any, files: Files) -> Any:
        """Return the configuration with the names of files replaced by their content. Raises BadInput."""
        return config


class Holding(Alteration, Protocol):
    """An alteration that depends on a body: it is applied by `apply_beside`."""

    def body(self, config: Any) -> str:
        """Return the name of the body."""
        ...

    def apply_beside(self, config: Any, fabric: Fabric, state: State, body: Beside) -> Outcome:
        """Apply the operation near the body, as `apply` does without one."""
        ...


def arranges(operation: object) -> bool:
    """Return whether an operation is an `Arrangement`."""
    return hasattr(operation, "arrange")
