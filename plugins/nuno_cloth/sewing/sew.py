"""A sewn pattern in triangles: panels keep their flat rest shapes, and the vertices of a seam are merged.

A panel's triangles may connect the same two vertices as another's: at each corner where two seams meet, a triangle that
cuts off the corner has the same three vertices in all panels there. Such a side gets a point in its middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nuno_cloth.sewing.fill import Piece, cut_panel, draw_edges, split, too_coarse
from nuno_cloth.sewing.pattern import Pattern, Seam, find_sides
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int

TRIES = 4
MOST = 2_000_000
"""The most triangles of a garment."""


@dataclass(frozen=True)
class Stitched:
    """A seam: pairs (k, 2) of cut vertices that it merges, from the start of its first edge, and the lengths of its two
    edges [m].
    """

    seam: Seam
    pairs: Int
    lengths: tuple[float, float]


@dataclass(frozen=True)
class Sewn:
    """A garment of m cut vertices, panel by panel, and n sewn vertices.

    names   (p,)    the panels
    flat    (m, 2)  each panel with its outside up [m]: rest shapes, and a texture's coordinates
    placed  (m, 3)  where it starts, by the body [m]
    faces   (f, 3)  triangles of cut vertices, counter-clockwise in `flat` and as seen from outside
    panel   (f,)    panel of each triangle
    warp    (p, 2)  direction of the warp in `flat`
    inside  (p,)    whether a panel is worn with its wrong side out
    merged  (m,)    the sewn vertex of each cut one, 0 to n - 1
    edges           by panel and edge: its cut vertices, from start to end
    labels          by panel and edge: its label or None
    seams           in the pattern's order
    """

    names: tuple[str, ...]
    flat: Float
    placed: Float
    faces: Int
    panel: Int
    warp: Float
    inside: Bool
    merged: Int
    edges: tuple[tuple[Int, ...], ...]
    labels: tuple[tuple[str | None, ...], ...]
    seams: tuple[Stitched, ...]

    @property
    def number(self) -> int:
        """Number of sewn vertices."""
        return int(self.merged.max()) + 1

    @property
    def sewn_faces(self) -> Int:
        """Triangles (f, 3) of sewn vertices."""
        return np.asarray(self.merged[self.faces])

    @property
    def sides(self) -> Float:
        """Cut lengths (f, 3) of triangles' sides [m], in the order of find_edges."""
        return np.asarray(np.linalg.norm(self.flat[np.roll(self.faces, -1, axis=1)] - self.flat[self.faces], axis=2))

    def side_edges(self) -> Int:
        """Return the panel's edge along each side (f, 3) of triangles, in the order of find_edges, or -1."""
        runs = [(k, run) for panel in self.edges for k, run in enumerate(panel)]
        ends = np.concatenate([np.stack([run[:-1], run[1:]], axis=1) for _, run in runs])
        edge = np.repeat([k for k, _ in runs], [len(run) - 1 for _, run in runs])
        key = np.sort(ends, axis=1) @ [len(self.flat), 1]
        order = np.argsort(key)
        sides = np.stack([self.faces, np.roll(self.faces, -1, axis=1)], axis=2).astype(np.int64)
        sought = np.sort(sides, axis=2) @ [len(self.flat), 1]
        at = order[np.minimum(np.searchsorted(key, sought, sorter=order), len(key) - 1)]
        return np.where(key[at] == sought, edge[at], -1).astype(np.int32)


def sew(pattern: Pattern, spacing: float) -> Sewn:
    """Sew a pattern whose sides agree, in triangles with sides of about `spacing` [m]. Raises BadInput for triangles
    too large for a panel or its seams, and for too many triangles.
    """
    most = sum(abs(panel.area) for panel in pattern.panels.values()) / (np.sqrt(3.0) / 4.0 * spacing**2)
    if not most <= MOST:
        least = spacing * np.sqrt(most / MOST)
        raise BadInput(
            "triangles are too small for so much cloth", field="edge", value=f"{100 * spacing:.4g} cm",
            limit=f"{MOST:,} triangles", remedy=f"make them larger, {100 * least:.2g} cm at least",
        )  # fmt: skip
    drawn = draw_edges(pattern, spacing)
    pieces = [
        cut_panel(panel, [drawn[name, k] for k in range(len(panel.edges))], spacing)
        for name, panel in pattern.panels.items()
    ]
    place = {name: k for k, name in enumerate(pattern.panels)}
    for _ in range(TRIES):
        first = np.concatenate([[0], np.cumsum([len(piece.flat) for piece in pieces])])
        pairs = [_pairs(seam, pieces, place, first) for seam in pattern.seams]
        merged = _merge(int(first[-1]), pairs)
        sides_of_pieces = [_list_sides(piece, merged[at:]) for piece, at in zip(pieces, first[:-1], strict=True)]
        duplicates = _duplicate_sides(sides_of_pieces)
        if not any(map(len, duplicates)):
            break
        for piece, sides in zip(pieces, duplicates, strict=True):
            split(piece, sides)
    else:
        names = [piece.panel.name for piece, sides in zip(pieces, duplicates, strict=True) if len(sides)]
        raise too_coarse(", ".join(names), spacing)
    return _assemble(pattern, pieces, first, merged, pairs)


def _pairs(seam: Seam, pieces: list[Piece], place: dict[str, int], first: Int) -> Int:
    (one, k), (other, j) = seam.one, seam.other
    a, b = pieces[place[one]].edges[k] + first[place[one]], pieces[place[other]].edges[j] + first[place[other]]
    return np.stack([a, b if seam.right_wrong else b[::-1]], axis=1).astype(np.int32)


def _merge(m: int, pairs: list[Int]) -> Int:
    """Return the sewn vertex (m,) of each cut one, numbered in the order of their first cut ones."""
    a, b = np.concatenate([np.empty((0, 2), np.int32), *pairs]).T
    part = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(m, m)), directed=False)[1]
    _, first, inverse = np.unique(part, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first)).astype(np.int32)[inverse.reshape(-1)]


def _list_sides(piece: Piece, merged: Int) -> tuple[Int, Int, Bool]:
    """Return the unique sides (k, 2) of a piece's triangles by its vertices and by sewn ones, the lower first, and
    whether two triangles of the piece share them.
    """
    ends = np.sort(np.stack([piece.faces, np.roll(piece.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    sides, count = np.unique(ends, axis=0, return_counts=True)
    return sides, np.sort(merged[sides], axis=1), count > 1


def _duplicate_sides(sides_of_pieces: list[tuple[Int, Int, Bool]]) -> list[Int]:
    """Return for each piece the sides that connect a sewn vertex to itself, or the same two as another side does,
    except sides on seams, which coincide by intent.
    """
    sewn = np.concatenate([sides for _, sides, _ in sides_of_pieces])
    _, inverse = np.unique(sewn, axis=0, return_inverse=True)
    count = np.bincount(inverse.reshape(-1))[inverse.reshape(-1)]
    bad = np.concatenate([inner for _, _, inner in sides_of_pieces]) & ((count > 1) | (sewn[:, 0] == sewn[:, 1]))
    offsets = np.concatenate([[0], np.cumsum([len(sides) for sides, _, _ in sides_of_pieces])])
    return [sides[bad[offsets[k] : offsets[k + 1]]] for k, (sides, _, _) in enumerate(sides_of_pieces)]


def _assemble(pattern: Pattern, pieces: list[Piece], first: Int, merged: Int, pairs: list[Int]) -> Sewn:
    turned, _ = find_sides(pattern)
    inside = np.array([turned[piece.panel.name] for piece in pieces])
    flip = np.where(inside, -1.0, 1.0)
    mirrors = np.array([piece.mirror for piece in pieces]) * flip
    faces = [piece.faces[:, ::-1] if back else piece.faces for piece, back in zip(pieces, inside, strict=True)]
    starts = first[:-1].tolist()
    lengths = [(pattern.edge(seam.one).length, pattern.edge(seam.other).length) for seam in pattern.seams]
    stitched = [Stitched(*parts) for parts in zip(pattern.seams, pairs, lengths, strict=True)]
    return Sewn(
        names=tuple(pattern.panels),
        flat=np.concatenate([piece.flat * [side, 1.0] for piece, side in zip(pieces, flip, strict=True)]),
        placed=np.concatenate([piece.place() for piece in pieces]),
        faces=np.concatenate([part + at for part, at in zip(faces, starts, strict=True)]).astype(np.int32),
        panel=np.repeat(np.arange(len(pieces), dtype=np.int32), [len(piece.faces) for piece in pieces]),
        warp=np.array([piece.panel.grain * [mirror, 1.0] for piece, mirror in zip(pieces, mirrors, strict=True)]),
        inside=inside,
        merged=merged,
        edges=tuple(tuple(run + at for run in piece.edges) for piece, at in zip(pieces, starts, strict=True)),
        labels=tuple(tuple(edge.label for edge in piece.panel.edges) for piece in pieces),
        seams=tuple(stitched),
    )  # fmt: skip
