"""Bodies that vertices slide on, in the layout of nuno_contact.sliding.slides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.sliding.slides import BLOCK, Slides
from nuno_kernels.lanes.simd import WIDTH
from nuno_kernels.meshes.tree import Tree
from nuno_schemas.fabric import Float


class Slid(NamedTuple):
    """A body that vertices slide on: its tree, the frame that carries it, Coulomb's coefficient, the gap [m]."""

    tree: Tree
    frame: int
    friction: float
    gap: float


def make_slides(bodies: Sequence[Slid], frames: int, mass: Float) -> Slides:
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
        gap=np.array([body.gap for body in bodies], np.float64),
        mass=np.array(mass, np.float64),
        rotation0=np.tile(np.eye(3).ravel(), (frames, 1)),
        origin0=np.zeros((frames, 3)),
        spin=np.zeros((frames, 3)),
        shift=np.zeros((frames, 3)),
        frames=np.zeros((frames, 18)),
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
