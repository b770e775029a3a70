"""The operation `attach`: from now on a body carries vertices of the cloth, as a gripper does that has closed."""

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
    """What a body takes hold of."""

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
    """Vertices keep the place in the body's frame that they have now; nothing is changed where it is refused."""

    name: ClassVar[str] = "attach"
    Config: ClassVar[type[BaseModel]] = AttachConfig

    def compile(self) -> None:
        """There is nothing to compile."""

    def resolve(self, config: AttachConfig, files: Files) -> AttachConfig:
        """It names no files."""
        return config

    def body(self, config: AttachConfig) -> str:
        """See nuno_schemas.operation.Holding."""
        return config.body

    def apply_beside(self, config: AttachConfig, fabric: Fabric, state: State, body: Beside) -> Outcome:
        """The fabric with these vertices bound. Raises BadInput for a frame that there is not, for vertices that are
        held already, and where nothing is within reach.
        """
        frames = list(body.frames)
        if config.frame is not None and config.frame not in frames:
            remedy = nearest(config.frame, frames)
            raise BadInput(f"{config.body} has no such frame", field="frame", value=config.frame, remedy=remedy)
        distance = body.distance.copy()
        if config.frame is not None:
            distance[[frame != config.frame for frame in frames]] = np.inf
        chosen = _chosen(config, fabric, distance.min(axis=0))
        # Of a frame that carries no surface all is infinitely far: it is then the one that is named, or the first.
        first = frames.index(config.frame) if config.frame is not None else 0
        near = distance[:, chosen]
        owner = np.where(np.isfinite(near).any(axis=0), near.argmin(axis=0), first)
        pinned = fabric.pinned.copy()
        pinned[chosen] = True
        made = replace(
            fabric, pinned=pinned, bindings=(*fabric.bindings, *_bindings(config, chosen, owner, state, body))
        )
        return unchanged(made, state, len(chosen))


def _chosen(config: AttachConfig, fabric: Fabric, distance: np.ndarray) -> Int:
    """Numbers of the vertices that are taken, which nothing holds yet."""
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
    """By frame, with where each vertex is in it now."""
    made = []
    for number in np.unique(owner).tolist():
        own = chosen[owner == number]
        inverse = rotation_matrices(body.rotation[number][None])[0].T
        local = turn(inverse, state.x[own] - body.translation[number])
        made.append(Binding(own, config.body, body.frames[number], local))
    return made
