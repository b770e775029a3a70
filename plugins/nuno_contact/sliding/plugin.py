"""Sliding contact with meshes (the stocking paper): vertices never enter, slide on the surface, and rub."""

from __future__ import annotations

from typing import ClassVar, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.quantities import Size
from nuno_contact.sliding.bodies import Slid, make_slides
from nuno_kernels.meshes.check import check_closed, check_crossings
from nuno_kernels.meshes.tree import build_tree
from nuno_schemas.bodies import OF_TRIANGLES, SKIN, Geometry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term


class SlidingConfig(Config):
    """The gap; friction belongs to each body of the scene."""

    gap: Size = Field(
        default=5e-5, description="distance from the surface at which vertices rest [m], such as half a yarn's width"
    )


class Sliding:
    """Vertices keep off moving closed meshes by `gap`; see nuno_contact.sliding.slides.

    A body with a distance field is met by the triangles that the field was made of. Each body's Coulomb coefficient
    is in the Geometry; its stiffness and damping are not used. It adds no force, and so limits no step.
    """

    name: ClassVar[str] = "sliding"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = SlidingConfig
    of_triangles: ClassVar[bool] = True
    """Distance fields are neither sent, nor used to measure penetration."""

    def prepare(self, config: BaseModel, fabric: Fabric, geometry: Geometry, gravity: Float) -> Term:
        """Return the term. Raises BadInput for a body that is no closed mesh, and for friction that makes no sense."""
        gap = float(cast(SlidingConfig, config).gap)
        check_meshes(geometry)
        for body, friction in zip(geometry.bodies, geometry.friction, strict=True):
            if not 0.0 <= friction < np.inf:
                raise BadInput("friction must not be negative", field=body, value=float(friction), limit=">= 0")
        parts = zip(geometry.frame.tolist(), geometry.friction[geometry.body].tolist(), strict=True)
        bodies = [Slid(build_tree(*geometry.mesh(i)), *part, gap) for i, part in enumerate(parts)]
        slides = make_slides(bodies, len(geometry.frames), np.where(fabric.pinned, 0.0, fabric.mass))
        return Term(name="slides", data=(slides,))


def check_meshes(geometry: Geometry) -> None:
    """Raise BadInput for a body that is no mesh, has holes, or passes through itself: it has no inside of its own."""
    for primitive, kind in enumerate(geometry.kind.tolist()):
        body = geometry.bodies[geometry.body[primitive]]
        if kind == SKIN:
            raise BadInput(
                "sliding contact is with bodies that do not bend, and a skin does", field=body,
                remedy=f"cloth_contact: {{plugin: offset, bodies: [{body}]}} meets its triangles",
            )  # fmt: skip
        if kind not in OF_TRIANGLES:
            raise BadInput(
                "sliding contact is with meshes", field=body,
                remedy="give the body a mesh as collider, or contact: {plugin: penalty} of its own",
            )  # fmt: skip
        x, faces = geometry.mesh(primitive)
        # A mesh that passes through itself has no hole to be filled.
        for check, more in (
            (check_closed, f"--set bodies.{body}.collider.mend=true fills holes"),
            (check_crossings, "cloth in its folds wants collider: {plugin: sdf, ...}, contact: {plugin: penalty}"),
        ):
            try:
                check(x, faces)
            except BadInput as error:
                raise BadInput(
                    f"sliding contact is with closed meshes, and {error.problem}", field=body,
                    value=f"{error.field} {error.value}",
                    remedy=f'--set "cloth_contact={{plugin: offset, thickness: 2 mm, bodies: [{body}]}}" takes its '
                    f"triangles as they are; {more}",
                ) from None  # fmt: skip
