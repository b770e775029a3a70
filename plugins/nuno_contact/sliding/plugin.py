"""Sliding contact with meshes (the stocking paper): vertices never enter, slide on the surface, and rub."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from nuno_contact.margins import Margin, check_margin, mesh_margins, triangle_spread
from nuno_contact.quantities import Size
from nuno_contact.sliding.skin import SkinSlides, make_skin_slides
from nuno_contact.sliding.slides import BLOCK, Slides
from nuno_geometry.check import check_closed, check_crossings
from nuno_geometry.tree import Tree, build_tree
from nuno_kernels.lanes import WIDTH
from nuno_schemas.bodies import OF_TRIANGLES, SKIN, Geometry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term

# Bodies that vertices slide on, in the layout of nuno_contact.sliding.slides.


class SlidingBody(NamedTuple):
    """A body that vertices slide on: its tree, the frame that carries it, Coulomb's coefficient, the gap of all
    vertices or of each (n,) [m].
    """

    tree: Tree
    frame: int
    friction: float
    gap: Float | float


def make_slides(bodies: Sequence[SlidingBody], frames: int, mass: Float) -> Slides:
    """Return the slides of bodies at rest, on some of so many `frames`; mass (n,) [kg], 0 for vertices left alone."""
    trees = [body.tree for body in bodies]
    n, b = len(mass), len(trees)
    blocks = -(-n // BLOCK)
    nodes, leaves, triangles, corners, sides = (
        np.cumsum([0, *(len(part(tree)) // unit for tree in trees)]) for part, unit in _PARTS
    )
    return Slides(
        root=nodes[:-1].astype(np.int64),
        frame=np.array([body.frame for body in bodies], np.int32),
        friction=np.array([body.friction for body in bodies], np.float64),
        gap=np.array([np.broadcast_to(body.gap, n) for body in bodies], np.float64).reshape(b, n),
        mass=np.array(mass, np.float64),
        rotation0=np.tile(np.eye(3).ravel(), (frames, 1)),
        origin0=np.zeros((frames, 3)),
        spin=np.zeros((frames, 3)),
        shift=np.zeros((frames, 3)),
        frames=np.zeros((frames, 18)),
        tree=Tree(
            boxes=np.concatenate([tree.boxes for tree in trees]),
            child=np.concatenate([moved_children(tree.child, nodes[k], leaves[k]) for k, tree in enumerate(trees)]),
            parent=np.concatenate([np.where(t.parent < 0, -1, t.parent + nodes[k]) for k, t in enumerate(trees)]),
            leaf_parent=np.concatenate([tree.leaf_parent + nodes[k] for k, tree in enumerate(trees)]),
            corners=np.concatenate([tree.corners for tree in trees]),
            face=np.concatenate([t.face + np.int32(triangles[k]) for k, t in enumerate(trees)]),
            place=np.concatenate([t.place + np.int32(WIDTH * leaves[k]) for k, t in enumerate(trees)]),
            faces=np.concatenate([t.faces + np.int32(corners[k]) for k, t in enumerate(trees)]),
            edges=np.concatenate([t.edges + np.int32(sides[k]) for k, t in enumerate(trees)]),
            vertex_normals=np.concatenate([tree.vertex_normals for tree in trees]),
            edge_normals=np.concatenate([tree.edge_normals for tree in trees]),
        ),
        before=np.full((b, 3, n), np.nan),
        clear=np.full((b, n), -np.inf),
        nearest=np.repeat((WIDTH * leaves[:-1]).astype(np.int64)[:, None], n, axis=1),
        planes=np.zeros((b, 7, n)),
        impulse=np.zeros((blocks, b, 3)),
        tally=np.zeros((blocks, 2), np.int64),
    )  # fmt: skip


def moved_children(child: NDArray[np.int64], nodes: int, leaves: int) -> NDArray[np.int64]:
    """Return a tree's children after so many nodes and leaves of other trees."""
    return np.where(child >= 0, child + nodes, child - leaves)


_PARTS: tuple[Any, ...] = (
    (lambda tree: tree.child, 1),
    (lambda tree: tree.corners, 9),
    (lambda tree: tree.faces, 1),
    (lambda tree: tree.vertex_normals, 1),
    (lambda tree: tree.edge_normals, 1),
)
"""the counts of several bodies' trees: nodes, leaves, triangles, vertices, edges"""


class SlidingConfig(Config):
    """The gap and the margin; friction belongs to each body of the scene."""

    gap: Size = Field(
        default=5e-5, description="distance from the surface at which cloth rests [m], such as half a yarn's width"
    )
    margin: Margin = Field(
        default="auto",
        description="distance beyond the gap at which vertices of triangles are kept [m]; auto: as much as their "
        "triangles, which cut through round bodies, and the body's curvature need",
    )


class Sliding:
    """Vertices keep off moving closed meshes by `gap`, those of triangles also by `margin`; see
    nuno_contact.sliding.slides.

    A body with a distance field is met by the triangles that the field was made of. Each body's Coulomb coefficient
    is in the Geometry; its stiffness and damping are not used. It adds no force, and so limits no step.
    """

    name: ClassVar[str] = "sliding"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = SlidingConfig
    of_triangles: ClassVar[bool] = True
    """Distance fields are neither sent, nor used to measure penetration."""

    def prepare(self, config: SlidingConfig, fabric: Fabric, geometry: Geometry, gravity: Float) -> Term:
        """Return the term. Raises BadInput for a body that is no closed mesh, and for friction that makes no sense."""
        gap, margin = config.gap, config.margin
        check_meshes(geometry)
        if margin != "auto":
            check_margin(margin, geometry)
        spread = triangle_spread(fabric.position, fabric.faces)
        for body, friction in zip(geometry.bodies, geometry.friction, strict=True):
            if not 0.0 <= friction < np.inf:
                raise BadInput("friction must not be negative", field=body, value=float(friction), limit=">= 0")
        mass, bodies, skins = np.where(fabric.pinned, 0.0, fabric.mass), list[SlidingBody](), list[SkinSlides]()
        for part, kind in enumerate(geometry.kind.tolist()):
            mesh, mu = geometry.mesh(part), float(geometry.friction[geometry.body[part]])
            # A skin also keeps off the middles of edges, so that triangles are half as long.
            square = 0.25 * spread if kind == SKIN else spread
            own = gap + (mesh_margins(square, *mesh) if margin == "auto" else np.where(spread > 0.0, margin, 0.0))
            if kind == SKIN:
                local = square if margin == "auto" else np.zeros_like(spread)
                skins.append(make_skin_slides(geometry, part, fabric, gap, own, local))
            else:
                bodies.append(SlidingBody(build_tree(*mesh), int(geometry.frame[part]), mu, own))
        rigid = (make_slides(bodies, 1 + max(body.frame for body in bodies), mass),) if bodies else ()
        return Term(name="slides", data=(*rigid, *skins))


def check_meshes(geometry: Geometry) -> None:
    """Raise BadInput for a body that is no mesh or has holes, and for a rigid one that passes through itself, which has
    no inside of its own. Skins do where limbs meet.
    """
    for primitive, kind in enumerate(geometry.kind.tolist()):
        body = geometry.bodies[geometry.body[primitive]]
        if kind not in OF_TRIANGLES:
            raise BadInput(
                "sliding contact is with meshes", field=body,
                remedy="give the body a mesh as collider, or contact: {plugin: penalty} of its own",
            )  # fmt: skip
        x, faces = geometry.mesh(primitive)
        closed = (check_closed, f"--set bodies.{body}.collider.mend=true fills holes")
        # A mesh that passes through itself has no hole to be filled.
        apart = (check_crossings, "cloth in its folds wants collider: {plugin: sdf, ...}, contact: {plugin: penalty}")
        for check, more in (closed,) if kind == SKIN else (closed, apart):
            try:
                check(x, faces)
            except BadInput as error:
                raise BadInput(
                    f"sliding contact is with closed meshes, and {error.problem}", field=body,
                    value=f"{error.field} {error.value}",
                    remedy=f'--set "cloth_contact={{plugin: offset, thickness: 2 mm, bodies: [{body}]}}" takes its '
                    f"triangles as they are; {more}",
                ) from None  # fmt: skip
