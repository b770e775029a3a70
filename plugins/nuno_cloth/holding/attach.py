"""The operation `attach`: a body carries vertices of the cloth from now on, like a closed gripper."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_cloth.holding.common import VERTICES, VertexNumber, check_vertices, unchanged
from nuno_cloth.quantities import Reach
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Binding, Fabric, Int, State
from nuno_schemas.operation import Beside, Outcome
from nuno_schemas.plugin import Config, Files
from nuno_schemas.vectors import turn


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


class Attach:
    """Binds vertices at their present places in a body's frame. A refused operation changes nothing."""

    name: ClassVar[str] = "attach"
    Config: ClassVar[type[BaseModel]] = AttachConfig

    def compile(self) -> None:
        """Do nothing: there is nothing to compile."""

    def resolve(self, config: AttachConfig, files: Files) -> AttachConfig:
        """Return the configuration unchanged: it names no files."""
        return config

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
            raise BadInput(problem, field="vertices", value=int(chosen[np.argmax(held)]), remedy=remedy)
        return chosen
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
