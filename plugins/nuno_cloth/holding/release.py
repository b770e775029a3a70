"""The operation `release`: vertices that were held, by a body or in place, move freely from now on."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_cloth.holding.common import VERTICES, VertexNumber, check_vertices, unchanged
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.operation import Outcome, Surface
from nuno_schemas.plugin import Config, Files


class ReleaseConfig(Config):
    """The vertices to release: those of a body, or by number, or both: those of the body with these numbers."""

    body: str | None = Field(default=None, description="name of the body that carries them")
    vertices: tuple[VertexNumber, ...] | None = Field(default=None, description=VERTICES)

    @model_validator(mode="after")
    def _require_choice(self) -> ReleaseConfig:
        if self.body is None and self.vertices is None:
            raise PydanticCustomError("release_what", "say what is let go of: body: NAME, or vertices: [...]")
        return self


class Release:
    """Releases vertices, which keep the velocity of their body. A refused operation changes nothing."""

    name: ClassVar[str] = "release"
    Config: ClassVar[type[BaseModel]] = ReleaseConfig

    def compile(self) -> None:
        """Do nothing: there is nothing to compile."""

    def resolve(self, config: ReleaseConfig, files: Files) -> ReleaseConfig:
        """Return the configuration unchanged: it names no files."""
        return config

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
                raise BadInput(f"this vertex is not {holder}", field="vertices", value=int(chosen[np.argmax(free)]))
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
