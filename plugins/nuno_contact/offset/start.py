"""Checks of cloth contact's start: cloth that meets cloth or bodies, and cloth that is too thick for its mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nuno_contact.offset.candidate_pairs import begun_apart, make_list
from nuno_contact.offset.contact_state import ContactState, Solids, tree_of
from nuno_contact.offset.places import LISTED
from nuno_contact.untangle.search import find_crossings
from nuno_geometry.check import place_of
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_kernels import block_kernel
from nuno_schemas.bodies import MESH, SKIN, Geometry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.vectors import norm

NEAREST = 1e-8
"""Cloth that starts nearer to cloth or a body than this [m] touches it: within rounding no plane can be shown to keep
it apart, and layers in one plane seem apart in the search for edges that go through triangles."""


def check_thickness(fabric: Fabric, thickness: float) -> None:
    """Raise BadInput for cloth that is thicker than its edges are long: as they are cut, if that is known."""
    x, faces, cut = fabric.position, fabric.faces, fabric.membrane
    lengths = norm(x[faces] - x[np.roll(faces, -1, axis=1)])
    if cut is not None and len(cut.faces) == len(faces):
        lengths = cut.sides()
    shortest = float(lengths.min())
    if thickness > shortest:
        raise BadInput(
            "cloth is thicker than its shortest edge is long", field="thickness", value=f"{thickness:g} m",
            limit=f"{shortest:.3g} m", remedy="make it thinner, or the mesh coarser",
        )  # fmt: skip


def check_start(m: ContactState, fabric: Fabric, pieces: Sequence[str], objects: int) -> None:
    """Raise BadInput for cloth that passes through cloth or a body as it starts; bodies are the pieces after so many
    objects; pieces that do not meet may.
    """
    x = np.ascontiguousarray(m.start.T)
    edge, face = find_crossings(tree_of(m), x, m.piece, m.meets, objects < len(pieces))
    if not len(edge):
        return
    both = m.piece[m.edges[edge, 0]], m.piece[m.faces[face, 0]]
    of_cloth = np.flatnonzero((both[0] < objects) & (both[1] < objects))
    first = int(of_cloth[0]) if len(of_cloth) else 0
    i, j = m.edges[edge[first]]
    place = place_of(x[[i, j]].mean(axis=0))
    if len(of_cloth):
        one, other = (pieces[int(piece[first])] for piece in both)
        raise BadInput(
            f"{one} passes through {'itself' if one == other else other} where it starts "
            f"({len(of_cloth):,} edges through triangles)",
            value=f"edge {fabric.told(i)}-{fabric.told(j)} through triangle {face[first]}, {place}",
            limit="a start in which nothing meets",
            remedy="add operations: [{plugin: untangle}], move the objects apart, or leave cloth_contact out",
        )  # fmt: skip
    cloth, body = (pieces[i] for i in sorted((int(both[0][first]), int(both[1][first]))))
    remedy = f"add operations: [{{plugin: untangle}}], place or size {cloth}, or move the body, otherwise, or "
    # An edge that goes in and out again has both ends outside: it is a chord across a round body.
    of_edge = np.unique(edge[both[0] < objects], return_counts=True)[1]
    if len(of_edge) and not (of_edge % 2).any():
        remedy = "give the cloth shorter edges, which go round what these go through; or "
    raise BadInput(
        f"{cloth} passes through {body} where it starts ({len(edge):,} edges through triangles)",
        field="bodies", value=place, limit="a start in which nothing meets", remedy=remedy + _without(body),
    )  # fmt: skip


def _without(body: str) -> str:
    """Suggest contact for a body that no start avoids, such as a scan that passes through itself: neither by its
    triangles, nor by vertices that slide on them.
    """
    field = "collider: {plugin: sdf, ...} and contact: {plugin: penalty}"
    return f"leave {body} out here and give it, if it is no skin, {field}"


def check_outside(fabric: Fabric, geometry: Geometry, solids: Solids) -> None:
    """Raise BadInput for cloth that starts inside of a closed mesh."""
    count = 0
    for primitive, kind in enumerate(geometry.kind.tolist()):
        starts, faces = geometry.mesh(primitive)
        x = solids.x[count : count + len(starts)]
        count += len(starts)
        if kind not in (MESH, SKIN):
            continue
        distance = np.asarray(closest_points(build_tree(x, faces), fabric.position).distance)
        if len(inside := np.flatnonzero(distance < 0.0)):
            name, deepest = geometry.bodies[int(geometry.body[primitive])], int(distance.argmin())
            raise BadInput(
                f"cloth starts inside of {name} ({len(inside):,} of {fabric.number:,} vertices)", field="bodies",
                value=f"vertex {fabric.told(deepest)}, {-1e3 * distance[deepest]:.3g} mm deep, "
                + place_of(fabric.position[deepest]),
                remedy=f"place or size the cloth, or move the body, otherwise, or {_without(name)}",
            )  # fmt: skip


@block_kernel
def gaps_at_start(m: ContactState, gap: Float) -> None:
    """Write how far apart each of the listed pairs starts, gap (p,) [m]."""
    for p in range(gap.shape[0]):
        gap[p] = begun_apart(m, p)


def check_gaps(m: ContactState, pieces: Sequence[str]) -> None:
    """Raise BadInput for cloth that touches itself, other cloth or a body as it starts."""
    m.reference[:3] = m.start
    make_list(m, None)
    gap = np.empty(int(m.number[LISTED]))
    gaps_at_start(m, gap)
    if len(close := np.flatnonzero(gap < NEAREST)):
        i, j = m.pair[close[gap[close].argmin()], [0, 3]]
        one, other = (pieces[k] for k in sorted((int(m.piece[i]), int(m.piece[j]))))
        raise BadInput(
            f"{one} touches {'itself' if one == other else other} where it starts "
            f"({len(close):,} pairs of vertices, edges and triangles)",
            value=place_of(m.start[:, i]), limit=f"{NEAREST:g} m apart at least",
            remedy="lay it out without layers in one plane" if one == other else "move them apart",
        )  # fmt: skip
    m.reference[:] = np.nan
    m.number[:] = 0
