"""Sliding contact with meshes (the stocking paper): vertices never enter, slide on the surface, and rub."""

from __future__ import annotations

from typing import ClassVar, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.quantities import Size
from nuno_kernels.slides import make_slides
from nuno_kernels.surface_tree import build_tree
from nuno_schemas.bodies import MESH, Geometry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.plugin import Config, Term


class SlidingConfig(Config):
    """How near vertices come; friction belongs to each body of the scene."""

    gap: Size = Field(
        default=5e-5, description="distance from the surface at which vertices rest [m], such as half a yarn's width"
    )


class Sliding:
    """Vertices keep off moving closed meshes by `gap`; see nuno_kernels.slides.

    Each body's Coulomb coefficient is in the Geometry; its stiffness and damping are not used. It adds no
    force, and so limits no step.
    """

    name: ClassVar[str] = "sliding"
    Config: ClassVar[type[BaseModel]] = SlidingConfig

    def prepare(self, config: BaseModel, fabric: Fabric, geometry: Geometry, gravity: Float) -> Term:
        """The term. Raises BadInput for a body that is no mesh, and for friction that makes no sense."""
        gap = cast(SlidingConfig, config).gap
        for primitive in np.flatnonzero(geometry.kind != MESH).tolist():
            raise BadInput(
                "sliding contact is with meshes", field=geometry.bodies[geometry.body[primitive]],
                remedy="give the body a mesh as collider, or leave contact to penalty",
            )  # fmt: skip
        for body, friction in zip(geometry.bodies, geometry.friction, strict=True):
            if not 0.0 <= friction < np.inf:
                raise BadInput("friction must not be negative", field=body, value=float(friction), limit=">= 0")
        trees = [build_tree(*geometry.mesh(i)) for i in range(len(geometry.kind))]
        slides = make_slides(
            trees, geometry.frame, geometry.friction[geometry.body], len(geometry.frames), gap,
            np.where(fabric.pinned, 0.0, fabric.mass),
        )  # fmt: skip
        return Term(kind="slides", data=slides, facts={"gap": gap})
