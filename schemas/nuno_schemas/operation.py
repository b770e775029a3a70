"""Operations: plugins that make something new of a fabric and where it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.curves import YarnCurves
from nuno_schemas.fabric import Fabric, Float, Int, State
from nuno_schemas.plugin import Files, Plugin


@dataclass(frozen=True)
class Surface:
    """Closed meshes in the world at one time: vertices (n, 3) [m], faces (f, 3) counter-clockwise from outside."""

    vertices: Float
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class Beside:
    """A body beside cloth, at one time.

    frames       names of its f frames
    rotation     (f, 4) unit quaternions w, x, y, z, and translation (f, 3) [m] of them
    distance     (f, n) of each vertex from the surface of what a frame carries, negative inside; inf where it carries
                 nothing [m]
    """

    frames: Annotated[tuple[str, ...], "f"]
    rotation: Annotated[Float, "f", 4]
    translation: Annotated[Float, "f", 3]
    distance: Annotated[Float, "f", "n"]


@dataclass(frozen=True)
class Changed:
    """A fabric that takes the place of the one it was made of, and its state, while a run goes on.

    source (n,) int32: the vertex that each was, -1 for a new one; old vertices keep their order
    """

    fabric: Fabric
    state: State
    source: NDArray[np.int32]


@dataclass(frozen=True)
class Arranged:
    """Where a fabric is to start: position (n, 3) [m], and numbers for a report."""

    position: Annotated[Float, "n", 3]
    facts: Mapping[str, float]


@dataclass(frozen=True)
class Outcome:
    """What an operation made.

    `facts` are numbers for a report; `curves` yarns as curves, where it makes any, and `arrays` what more
    there is to say of each of their points, or of the fabric's where it makes no curves; `changed` the fabric
    itself, by an operation that may be applied in a running simulation.
    """

    facts: Mapping[str, float]
    curves: YarnCurves | None = None
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    changed: Changed | None = None


class Operation(Plugin, Protocol):
    """Makes something new of a fabric and where it is."""

    def apply(self, config: Any, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """`skin` are the bodies that are meshes, None where there is none. Changes none of its arguments."""
        ...


class Arrangement(Operation, Protocol):
    """An operation that moves all cloth of a scene before anything acts on it."""

    def arrange(
        self, config: Any, fabric: Fabric, objects: Mapping[str, Int], meet: NDArray[np.bool_],
        thickness: float | None, bodies: Surface | None = None,
    ) -> Arranged:  # fmt: skip
        """Where cloth starts instead of fabric.position; what is pinned stays where it is, to the bit. `objects` are
        the vertices (k,) of each by name, meet (o, o) says which of them, in that order, meet each other and
        themselves, `thickness` [m] is that of cloth in contact, None without, and `bodies` are those that it meets as
        it meets cloth, where they start. Changes none of its arguments.
        """
        ...


class Alteration(Operation, Protocol):
    """An operation that changes the fabric, and may be applied while a simulation goes on.

    It may have a method `require(config, fabric)`, which raises BadInput for a fabric that it can never change,
    wherever that moves: a run is then refused before it starts.
    """

    def compile(self) -> None:
        """Compile what `apply` needs, so that a run does not wait for it."""
        ...

    def resolve(self, config: Any, files: Files) -> Any:
        """The configuration with what its files hold in the place of their names. Raises BadInput."""
        ...


class Holding(Alteration, Protocol):
    """An alteration that is made beside a body: it is applied by `apply_beside`."""

    def body(self, config: Any) -> str:
        """Name of the body."""
        ...

    def apply_beside(self, config: Any, fabric: Fabric, state: State, body: Beside) -> Outcome:
        """As `apply`."""
        ...


def arranges(operation: object) -> bool:
    """Whether an operation is an `Arrangement`."""
    return hasattr(operation, "arrange")
