"""Checks of a pattern before it is sewn: sizes, openings, and seams that look wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from nuno_cloth.sewing.pattern import Panel, Pattern, Side, find_openings, find_pieces, find_sides, name_of
from nuno_cloth.sewing.pattern_file import STITCHES, PanelFields, PatternFile, assemble
from nuno_schemas.fabric import Float
from nuno_schemas.pattern import Checked, Opening, PanelSize, Remark
from nuno_schemas.plugin import Files
from nuno_schemas.vectors import dot, norm
from nuno_schemas.written import Path, dotted

TURNED = -0.5
"""A seam looks turned if the cosine of the angle between its edges is below this: beyond 120 degrees."""
TELLS = 0.03
"""Least length of edges that show which way a seam runs [m]."""
LEVEL = 0.1
"""Least sine of a panel's angle to the level at which it has a right and an upper side."""
SHORT = 2e-3
"""Edges shorter than this are probably unintended [m]."""
NEAR = 0.1
"""Translations of all panels below this share of the largest are probably in another unit."""
SIZES = 0.02, 5.0
"""Smallest and largest size of a garment [m]."""
Note = Callable[..., None]


def check_pattern(files: Files, name: str, gather: float) -> Checked:
    """Return a pattern's sizes, openings and remarks, also on seams whose longer edge is more than `gather` times the
    shorter. Raises BadInput for a file whose fields are not those of a pattern.
    """
    written = files.read(name, PatternFile)
    pattern, remarks = assemble(written)

    def note(kind: str, where: str, text: str, path: Path, remedy: str | None = None) -> None:
        remarks.append(Remark(kind, False, where, text, written.line(path), dotted(path), remedy))

    broken = bool(remarks)
    _note_lengths(pattern, gather, note)
    _note_turned(pattern, note)
    _note_crossed(pattern, note)
    _note_edges(pattern, note)
    corners = [panel.place(edge.ends())[:, 1] for panel in pattern.panels.values() for edge in panel.edges]
    # Openings of a pattern that lacks a panel or a seam are unknown.
    openings = [] if broken else find_openings(pattern)
    if not broken:
        _note_pieces(pattern, openings, note)
        _note_places(written.said.pattern.panels, note)
    length = sum(min(pattern.edge(seam.one).length, pattern.edge(seam.other).length) for seam in pattern.seams)
    ordered = sorted(remarks, key=lambda remark: not remark.wrong)
    return Checked(
        tuple(_size(panel, pattern) for panel in pattern.panels.values()), len(pattern.seams), length,
        tuple(Opening(tuple(map(name_of, one)), sum(pattern.edge(side).length for side in one)) for one in openings),
        tuple(ordered), float(np.max(corners, initial=0.0)), _edges(pattern),
    )  # fmt: skip


def _edges(pattern: Pattern) -> dict[str, tuple[float, str | None]]:
    sides = [(name, k) for name, panel in pattern.panels.items() for k in range(len(panel.edges))]
    partner = {side: name_of(other) for side, (other, _) in pattern.partner.items()}
    return {name_of(side): (pattern.edge(side).length, partner.get(side)) for side in sides}


def _size(panel: Panel, pattern: Pattern) -> PanelSize:
    points = np.concatenate([edge.curve.at(np.linspace(0.0, 1.0, 33)) for edge in panel.edges])
    width, height = np.ptp(points, axis=0)
    sewn = sum((panel.name, k) in pattern.partner for k in range(len(panel.edges)))
    return PanelSize(panel.name, len(panel.edges), sewn, abs(panel.area), float(width), float(height))


def _note_lengths(pattern: Pattern, gather: float, note: Note) -> None:
    for seam in pattern.seams:
        one, other = pattern.edge(seam.one).length, pattern.edge(seam.other).length
        ratio = max(one, other) / min(one, other)
        if ratio > gather:
            (short, short_name), (long, long_name) = sorted([(one, name_of(seam.one)), (other, name_of(seam.other))])
            text = f"{100 * long:.2f} cm are gathered onto {100 * short:.2f} cm, {ratio:.2f} to 1"
            note("unequal seam", f"{long_name}, {short_name}", text, (*STITCHES, seam.stitch))


def _note_turned(pattern: Pattern, note: Note) -> None:
    """Note seams that look turned. Panels may stand far from each other, before and behind the body, so that the
    directions of their edges are compared, not the places: in space, as at a shoulder, or as seen from outside of each
    panel, as cloth goes round the body. A seam whose edges run apart in both looks turned. Short edges, as at a
    shoulder's tip, are not checked.
    """
    inside, _ = find_sides(pattern)
    for seam in pattern.seams:
        if min(pattern.edge(side).length for side in seam.sides) < TELLS:
            continue
        sign = 1.0 if seam.right_wrong else -1.0
        directions = [_directions(pattern.panels[name], edge, inside[name]) for name, edge in seam.sides]
        cosine = max(sign * _cosine(one, other) for one, other in zip(*directions, strict=True))
        if cosine < TURNED:
            angle = np.degrees(np.arccos(max(cosine, -1.0)))
            text = f"as the panels are placed, the edges run {angle:.0f}° apart"
            remedy = "is it sewn the wrong way round, or is a panel upside down?"
            note("turned seam", seam.names, text, (*STITCHES, seam.stitch), remedy)


def _note_crossed(pattern: Pattern, note: Note) -> None:
    """Note seams that run through the body, from one side of both panels, left or front, to the other side of both: as
    placed, each edge is beyond the middles of both panels by a quarter of the narrower panel's width.
    """
    for seam in pattern.seams:
        panels = [pattern.panels[name] for name, _ in seam.sides]
        corners = [np.concatenate([panel.place(edge.ends()) for edge in panel.edges]) for panel in panels]
        ends = [panel.place(pattern.edge(side).ends()).mean(axis=0)
                for panel, side in zip(panels, seam.sides, strict=True)]  # fmt: skip
        middles, width = [one.mean(axis=0) for one in corners], np.min([np.ptp(one, axis=0) for one in corners], axis=0)
        beyond = np.max(ends, axis=0) - np.max(middles, axis=0), np.min(middles, axis=0) - np.min(ends, axis=0)
        if (
            seam.one[0] != seam.other[0]
            and (over := (np.min(beyond, axis=0) > 0.25 * width) & (width > TELLS))[[0, 2]].any()
        ):
            text = f"as the panels are placed, it joins {'left to right' if over[0] else 'front to back'}"
            remedy = "is a panel mirrored or turned, or its other side meant?"
            note("crossed seam", seam.names, text, (*STITCHES, seam.stitch), remedy)


def _directions(panel: Panel, edge: int, inside: bool) -> tuple[Float, Float]:
    """Return the vector from an edge's start to its end: (3,) in space, and (2,) to the right and up as seen from
    outside, 0 if the panel lies level.
    """
    start, end = panel.place(panel.edges[edge].ends())
    outside = panel.rotation[:, 2] * (1.0 if (panel.area > 0.0) != inside else -1.0)
    right = np.cross([0.0, 1.0, 0.0], outside)
    flat_direction = np.array([dot(end - start, right), dot(end - start, np.cross(outside, right))])
    return end - start, flat_direction * (norm(right) > LEVEL)


def _cosine(one: Float, other: Float) -> float:
    """Return the cosine of the angle between two vectors, 1 if one is 0."""
    lengths = float(norm(one) * norm(other))
    return float(dot(one, other)) / lengths if lengths > 0.0 else 1.0


def _note_edges(pattern: Pattern, note: Note) -> None:
    points = []
    for name, panel in pattern.panels.items():
        for k, edge in enumerate(panel.edges):
            points.append(panel.place(edge.ends()))
            if edge.length < SHORT:
                text = f"{1e3 * edge.length:.2g} mm long: do two cuts miss each other? It is closed where it can be"
                note("short edge", name_of((name, k)), text, ("pattern", "panels", name, "edges", k))
    if points:
        size = float(np.ptp(np.concatenate(points), axis=0).max())
        if not SIZES[0] <= size <= SIZES[1]:
            text = (
                f"the whole is {100 * size:.4g} cm large, where a garment has {100 * SIZES[0]:g} to {100 * SIZES[1]:g}"
            )
            note(
                "size", "pattern", text, ("properties", "units_in_meter"), "is the unit right? 100 for cm, 1000 for mm"
            )


def _note_places(panels: Mapping[str, PanelFields], note: Note) -> None:
    if names := [name for name, one in panels.items() if "translation" not in one.model_fields_set]:
        remedy = "give it a translation: in front of or behind the part of the body that it is worn on"
        note("no place", ", ".join(names), "begins at the drawing's origin", ("pattern", "panels", names[0]), remedy)
    size = max((float(np.ptp(one.vertices, axis=0).max()) for one in panels.values()), default=0.0)
    moved = max((float(np.abs(one.translation).max()) for one in panels.values()), default=0.0)
    if not names and len(panels) > 1 and moved < NEAR * size:
        text = f"the panels, up to {size:.4g} large, lie on each other, at most {moved:.3g} from the drawing's origin"
        remedy = "are the translations in the unit of the vertices?"
        note("places", "pattern", text, ("pattern", "panels", next(iter(panels)), "translation"), remedy)


def _note_pieces(pattern: Pattern, openings: list[list[Side]], note: Note) -> None:
    piece = find_pieces(pattern)
    open_ = {piece[side[0]] for edges in openings for side in edges}
    pieces = {first: [name for name in piece if piece[name] == first] for first in dict.fromkeys(piece.values())}
    for first, names in pieces.items():
        path: Path = ("pattern", "panels", first)
        if len(names) == 1 and len(pieces) > 1:
            note("loose panel", first, "is sewn to no other panel", path)
        if first not in open_:
            note("closed bag", ", ".join(names), "is sewn shut all round: nothing can be put into it", path)
    if sum(len(names) > 1 for names in pieces.values()) > 1:
        listed = "; ".join(", ".join(names) for names in pieces.values())
        note(
            "several pieces",
            "pattern",
            f"{len(pieces)} pieces hang together by no seam: {listed}",
            ("pattern", "panels"),
        )
