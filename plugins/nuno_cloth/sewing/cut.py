"""A panel in triangles."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from nuno_cloth.sewing.fill import fill
from nuno_cloth.sewing.pattern import Panel
from nuno_cloth.sewing.segments import EdgePolygon
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int


@dataclass
class Piece:
    """A panel in triangles, its right side up.

    flat (n, 2) [m], the outline's points first; faces (f, 3) counter-clockwise; edges: the points along each edge, from
    start to end; mirror: factor of x to the panel as it is drawn
    """

    panel: Panel
    flat: Float
    faces: Int
    edges: list[Int]
    mirror: float

    def place(self) -> Float:
        """Return the starting places (n, 3) of its points [m]."""
        return self.panel.place(self.flat * [self.mirror, 1.0])


def cut_panel(panel: Panel, polygons: list[EdgePolygon], spacing: float) -> Piece:
    """Return the triangles of a panel with these polygons of its edges. Raises BadInput if they are too coarse."""
    mirror = 1.0 if panel.area > 0.0 else -1.0
    outline = np.concatenate([edge.points[:-1] for edge in polygons]) * [mirror, 1.0]
    try:
        flat, faces = fill(outline, spacing)
    except ValueError:
        raise too_coarse(panel.name, spacing) from None
    first = np.concatenate([[0], np.cumsum([len(edge.points) - 1 for edge in polygons])])
    runs = [np.arange(a, b + 1) % first[-1] for a, b in pairwise(first)]
    return Piece(panel, flat, faces, [run.astype(np.int32) for run in runs], mirror)


def too_coarse(where: str, spacing: float) -> BadInput:
    return BadInput(
        f"triangles are too large for {where}", field="edge", value=f"{100 * spacing:.4g} cm",
        remedy="make them smaller: half as large, for a start",
    )  # fmt: skip


def split(piece: Piece, sides: Int) -> None:
    """Insert a point in the middle of sides (k, 2) that two of the piece's triangles share."""
    for a, b in sides.tolist():
        adjacent = np.flatnonzero(((piece.faces == a) | (piece.faces == b)).sum(axis=1) == 2)
        new = len(piece.flat)
        piece.flat = np.concatenate([piece.flat, piece.flat[[a, b]].mean(axis=0)[None]])
        faces = [np.where(piece.faces[adjacent] == end, new, piece.faces[adjacent]) for end in (a, b)]
        kept = np.delete(piece.faces, adjacent, axis=0)
        piece.faces = np.ascontiguousarray(np.concatenate([kept, *faces]).astype(np.int32))
