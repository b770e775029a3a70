"""Lines as the page sends them, and as scenes, runs and files have them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nuno.cloth.build import Piece
from nuno.live_view.snapshot import Sight
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

MOST_LINES, MOST_POINTS = 500, 20_000
DIGITS = 5
"""Of a barycentric coordinate: a hundred-thousandth of a triangle."""
MICRON = 6
"""Digits of a length in metres, after the point."""
Face = Annotated[int, Field(ge=0, lt=2**31)]


class Stroke(BaseModel):
    """A line of the page: rows of a triangle's number and its place there, two barycentric coordinates.

    The triangle counts among all of the cloth; the coordinates are those of its second and third corner.
    """

    model_config = ConfigDict(extra="forbid", strict=True)
    points: list[tuple[Face, float, float]] = Field(min_length=2, max_length=MOST_POINTS)
    height: float = Field(allow_inf_nan=False)
    closed: bool = False
    """Whether it goes on from its last point to its first."""


def read_strokes(given: object, sight: Sight) -> list[Stroke]:
    """The page's lines. Raises BadInput, whose field begins with lines[i], for one that cannot be."""
    if not isinstance(given, list) or not 1 <= len(given) <= MOST_LINES:
        raise BadInput("draw a line first", field="lines", limit=f"1 to {MOST_LINES}")
    strokes = []
    for i, one in enumerate(given):
        try:
            # Points are rows of JSON, which knows no tuples.
            rows = [tuple(row) for row in one["points"]]
            stroke = Stroke.model_validate(one | {"points": rows})
        except (ValidationError, TypeError, KeyError):
            raise BadInput("this is no line", field=f"lines[{i}]", remedy="draw it again") from None
        _check(stroke, i, sight)
        strokes.append(stroke)
    return strokes


def _check(stroke: Stroke, i: int, sight: Sight) -> None:
    if round(stroke.height, MICRON) == 0.0:
        remedy = "choose a height above 0: a ridge rises by it, a valley sinks"
        raise BadInput("a line of no height raises nothing", field=f"lines[{i}].height", remedy=remedy)
    face, at = places(stroke)
    if face.min() < 0 or face.max() >= len(sight.faces) or not (at > -1e-3).all():
        raise BadInput("the line lies off the cloth", field=f"lines[{i}]", remedy="draw it again, on the cloth")
    if len({piece_of(sight, int(sight.faces[f, 0])).name for f in np.unique(face)}) > 1:
        remedy = "draw one line on each"
        raise BadInput("the line goes over two pieces of cloth", field=f"lines[{i}]", remedy=remedy)


def places(stroke: Stroke) -> tuple[Int, Float]:
    """Triangles (p,) and barycentric coordinates (p, 3) of a line's points."""
    face = np.array([row[0] for row in stroke.points], np.int64)
    second = np.array([row[1:] for row in stroke.points], np.float64)
    return face.astype(np.int32), np.column_stack([1.0 - second.sum(axis=1), second])


def positions(stroke: Stroke, sight: Sight) -> Float:
    """(p, 3) where a line's points are [m]."""
    face, at = places(stroke)
    return np.asarray(np.einsum("pc,pck->pk", at, sight.x[sight.faces[face]]))


def piece_of(sight: Sight, vertex: int) -> Piece:
    """The piece that a vertex belongs to."""
    return next(piece for piece in sight.pieces if piece.start <= vertex < piece.stop)


def faces_of(piece: Piece, sight: Sight) -> Int:
    """Numbers of a piece's triangles among all, in their order."""
    first = sight.faces[:, 0]
    return np.flatnonzero((first >= piece.start) & (first < piece.stop)).astype(np.int32)


def line_at(strokes: Sequence[Stroke], piece: Piece, triangle: int, sight: Sight) -> int:
    """The last of the lines, on one piece, that come near the middle of its triangle of this number."""
    corners = sight.x[sight.faces[faces_of(piece, sight)[triangle]]]
    middle, size = corners.mean(axis=0), float(np.linalg.norm(np.ptp(corners, axis=0)))
    far = np.concatenate([distance_to(middle[None], positions(stroke, sight)) for stroke in strokes])
    return int(np.flatnonzero(far <= max(size, float(far.min())))[-1])


def distance_to(places: Float, line: Float) -> Float:
    """(n,) distance of places (n, 3) to a polyline (k, 3) [m]."""
    start, side = line[:-1], np.diff(line, axis=0)
    way = places[:, None] - start
    share = np.clip((way * side).sum(axis=2) / np.maximum((side * side).sum(axis=1), 1e-30), 0.0, 1.0)
    return np.asarray(np.linalg.norm(way - share[..., None] * side, axis=2).min(axis=1))


def pieces_of(strokes: Sequence[Stroke], sight: Sight) -> dict[str, list[int]]:
    """Which of the lines are on each object."""
    found: dict[str, list[int]] = {}
    for i, stroke in enumerate(strokes):
        piece = piece_of(sight, int(sight.faces[stroke.points[0][0], 0]))
        found.setdefault(piece.name, []).append(i)
    return found


def by_object(strokes: Sequence[Stroke], sight: Sight, exact: bool = True) -> dict[str, list[dict[str, Any]]]:
    """Lines as a scene has them, by the object that they are on, whose triangles count from 0.

    Where not `exact`, by their places in the world, which stay good where triangles change.
    """
    pieces = {piece.name: piece for piece in sight.pieces}
    return {
        name: [_as_line(strokes[i], pieces[name], sight) if exact else _as_points(strokes[i], sight) for i in which]
        for name, which in pieces_of(strokes, sight).items()
    }


def _as_points(stroke: Stroke, sight: Sight) -> dict[str, Any]:
    return {"points": np.round(positions(stroke, sight), MICRON).tolist(), **_said(stroke)}


def _as_line(stroke: Stroke, piece: Piece, sight: Sight) -> dict[str, Any]:
    face, at = places(stroke)
    rows = zip(np.searchsorted(faces_of(piece, sight), face), at, strict=True)
    return {"on_faces": [_on_face(f, row) for f, row in rows], **_said(stroke)}


def _said(stroke: Stroke) -> dict[str, Any]:
    return {"height": round(stroke.height, MICRON)} | ({"closed": True} if stroke.closed else {})


def _on_face(face: int, at: Float) -> dict[str, Any]:
    """A point of a line, coordinates rounded so that they still add up to 1."""
    b, c = (min(max(round(float(value), DIGITS), 0.0), 1.0) for value in at[1:])
    c = min(c, round(1.0 - b, DIGITS))
    return {"face": int(face), "at": [round(1.0 - b - c, DIGITS), b, c]}


def to_obj(strokes: Sequence[Stroke], sight: Sight) -> str:
    """An OBJ file of the lines as polylines, where they are on the cloth now [m]; heights stand in their names."""
    rows, start = ["# ridges and valleys, in metres"], 1
    for i, stroke in enumerate(strokes):
        points = positions(stroke, sight)
        kind = "ridge" if stroke.height > 0 else "valley"
        rows.append(f"o {kind}_{i + 1}_{abs(stroke.height) * 1e3:g}mm")
        rows += [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in points]
        ends = [start] if stroke.closed else []
        rows.append("l " + " ".join(map(str, [*range(start, start + len(points)), *ends])))
        start += len(points)
    return "\n".join(rows) + "\n"
