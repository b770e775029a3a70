"""The operations `attach` and `release`: a body carries vertices of the cloth, or held vertices move freely again."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_cloth.quantities import Reach
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Binding, Fabric, Int, State
from nuno_schemas.operation import Alteration, Beside, Changed, Holding, Outcome, Surface
from nuno_schemas.plugin import Config
from nuno_schemas.vectors import turn

# Functions that `attach` and `release` share.

VertexNumber = Annotated[int, Field(ge=0)]
VERTICES = "or just these, by their numbers in the object; those of its file, where a mesh was merged"


def check_vertices(numbers: tuple[int, ...], fabric: Fabric) -> Int:
    """Return the vertex (k,) of each number; two numbers of a merged file may be one vertex. Raises BadInput if there
    are no numbers, one does not exist or is named twice.
    """
    vertices = fabric.named()
    chosen = np.array(numbers, np.int64)
    if not len(chosen):
        raise BadInput("no vertex is named", field="vertices", value=[], limit="one or more")
    if chosen.max() >= len(vertices):
        limit = f"0 to {len(vertices) - 1}"
        remedy = "numbers are those of the object; or take what is within reach of a body: within: 1 cm"
        raise BadInput("there is no such vertex", field="vertices", value=int(chosen.max()), limit=limit, remedy=remedy)
    names, counts = np.unique(chosen, return_counts=True)
    if counts.max() > 1:
        raise BadInput("this vertex is named twice", field="vertices", value=int(names[counts.argmax()]))
    return vertices[chosen]


def unchanged(fabric: Fabric, state: State, vertices: int) -> Outcome:
    """Return a fabric of the same vertices, in place, with the numbers bound or released, and held by bodies."""
    facts = {"vertices": vertices, "held": sum(len(binding.vertices) for binding in fabric.bindings)}
    return Outcome(facts, changed=Changed(fabric, state, np.arange(fabric.number, dtype=np.int32)))


# The operation `release`: vertices that were held, by a body or in place, move freely from now on.


class ReleaseConfig(Config):
    """The vertices to release: those of a body, or by number, or both: those of the body with these numbers."""

    body: str | None = Field(default=None, description="name of the body that carries them")
    vertices: tuple[VertexNumber, ...] | None = Field(default=None, description=VERTICES)

    @model_validator(mode="after")
    def _require_choice(self) -> ReleaseConfig:
        if self.body is None and self.vertices is None:
            raise PydanticCustomError("release_what", "say what is let go of: body: NAME, or vertices: [...]")
        return self


class Release(Alteration):
    """Releases vertices, which keep the velocity of their body. A refused operation changes nothing."""

    name: ClassVar[str] = "release"
    Config: ClassVar[type[BaseModel]] = ReleaseConfig

    def apply(self, config: ReleaseConfig, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Return the fabric with these vertices free. Raises BadInput for a body that carries none, and for vertices
        that are not held.
        """
        held = fabric.pinned.copy()
        if config.body is not None:
            carriers = [binding.body for binding in fabric.bindings]
            if config.body not in carriers:
                remedy = nearest(config.body, carriers) if carriers else "attach it first"
                raise BadInput("nothing is attached to this body", field="body", value=config.body, remedy=remedy)
            held[:] = False
            for binding in fabric.bindings:
                held[binding.vertices] |= binding.body == config.body
        if config.vertices is not None:
            chosen = check_vertices(config.vertices, fabric)
            if (free := ~held[chosen]).any():
                holder = "held" if config.body is None else f"attached to {config.body}"
                raise BadInput(f"this vertex is not {holder}", field="vertices", value=config.vertices[np.argmax(free)])
            held[:] = False
            held[chosen] = True
        kept = [(binding, ~held[binding.vertices]) for binding in fabric.bindings]
        bindings = tuple(
            replace(one, vertices=one.vertices[stays], local=None if one.local is None else one.local[stays])
            for one, stays in kept
            if stays.any()
        )
        released = replace(fabric, pinned=fabric.pinned & ~held, bindings=bindings)
        return unchanged(released, state, int(held.sum()))


# The operation `attach`: a body carries vertices of the cloth from now on, like a closed gripper.


class AttachConfig(Config):
    """The body, and the vertices that it takes hold of."""

    body: str = Field(description="name of the body")
    frame: str | None = Field(
        default=None,
        description="the joint of it that carries them; each by the one that it is nearest to unless given",
    )
    within: Reach = Field(
        default=0.01, description="vertices are taken that are no farther than this from the body's surface [m]"
    )
    vertices: tuple[VertexNumber, ...] | None = Field(default=None, description=VERTICES)


class Attach(Holding):
    """Binds vertices at their present places in a body's frame. A refused operation changes nothing."""

    name: ClassVar[str] = "attach"
    Config: ClassVar[type[BaseModel]] = AttachConfig

    def body(self, config: AttachConfig) -> str:
        """Return the name of the body that takes hold."""
        return config.body

    def apply_beside(self, config: AttachConfig, fabric: Fabric, state: State, body: Beside) -> Outcome:
        """Return the fabric with these vertices bound. Raises BadInput for an unknown frame, for vertices that are held
        already, and if no vertex is within reach.
        """
        frames = list(body.frames)
        if config.frame is not None and config.frame not in frames:
            remedy = nearest(config.frame, frames)
            raise BadInput(f"{config.body} has no such frame", field="frame", value=config.frame, remedy=remedy)
        distance = body.distance.copy()
        if config.frame is not None:
            distance[[frame != config.frame for frame in frames]] = np.inf
        chosen = _choose_vertices(config, fabric, distance.min(axis=0))
        # All vertices are infinitely far from frames without a surface: then the named frame carries them, or the
        # first.
        first = frames.index(config.frame) if config.frame is not None else 0
        near = distance[:, chosen]
        owner = np.where(np.isfinite(near).any(axis=0), near.argmin(axis=0), first)
        pinned = fabric.pinned.copy()
        pinned[chosen] = True
        bound = replace(
            fabric, pinned=pinned, bindings=(*fabric.bindings, *_bindings(config, chosen, owner, state, body))
        )
        return unchanged(bound, state, len(chosen))


def _choose_vertices(config: AttachConfig, fabric: Fabric, distance: np.ndarray) -> Int:
    """Return the numbers of the vertices to bind, which nothing holds yet."""
    if config.vertices is not None:
        chosen = check_vertices(config.vertices, fabric)
        if (held := fabric.pinned[chosen]).any():
            problem, remedy = "this vertex is held already", "leave it out, or release it first"
            raise BadInput(problem, field="vertices", value=config.vertices[np.argmax(held)], remedy=remedy)
        return chosen if fabric.merged is None else np.unique(chosen)
    near = distance <= config.within
    if not near.any():
        raise BadInput(
            f"nothing of the cloth is within reach of {config.body}", field="within", value=f"{config.within:g} m",
            limit=f"the nearest vertex is {float(distance.min()):.3g} m from its surface",
            remedy="attach it later or nearer, reach farther, or give vertices by number",
        )  # fmt: skip
    if (near & ~fabric.pinned).any():
        return np.flatnonzero(near & ~fabric.pinned).astype(np.int32)
    raise BadInput(
        f"all that is within reach of {config.body} is held already", field="within", value=f"{config.within:g} m",
        limit=f"{int(near.sum())} vertices", remedy="release them first, or reach farther",
    )  # fmt: skip


def _bindings(config: AttachConfig, chosen: Int, owner: np.ndarray, state: State, body: Beside) -> list[Binding]:
    """Return a binding per frame, with the present place of each vertex in it."""
    bindings = []
    for number in np.unique(owner).tolist():
        carried = chosen[owner == number]
        inverse = rotation_matrices(body.rotation[number][None])[0].T
        local = turn(inverse, state.x[carried] - body.translation[number])
        bindings.append(Binding(carried, config.body, body.frames[number], local))
    return bindings
