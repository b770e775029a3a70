"""Lines drawn on cloth: their forms for scenes, runs and files, and the cloth that can have them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nuno.plugin_contract import registry
from nuno.scene import yaml_lines
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno.simulation.cloth import Piece
from nuno.studio.live_view import Sight, see_objects
from nuno.studio.scenes import append_items
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int

LIST, OPERATION = "operations", "wrinkle"
Lines = Mapping[str, list[dict[str, Any]]]
"""Lines in the form of a scene, by object."""


class Settings(BaseModel):
    """Settings of the page for all lines."""

    model_config = ConfigDict(extra="forbid", strict=True)
    passes: int = Field(default=8, ge=0, le=1000)
    hierarchical: bool = False
    keep: bool = False


def as_operations(lines: Lines, settings: object) -> list[dict[str, Any]]:
    """Return an operation for each object. Raises BadInput."""
    try:
        chosen = Settings.model_validate(settings or {})
    except ValidationError:
        raise BadInput("these are no settings of lines", field="settings", remedy="load the page again") from None
    smoothing: dict[str, Any] = {"passes": chosen.passes} | ({"hierarchical": True} if chosen.hierarchical else {})
    keep: dict[str, Any] = {"keep": True} if chosen.keep else {}
    return [
        {"plugin": OPERATION, "object": name, **({} if "width" in rows[0] else {"smoothing": smoothing}), **keep,
         "lines": rows} for name, rows in lines.items()
    ]  # fmt: skip


class Trial:
    """The cloth of a scene's objects at the start, for checks of lines before they are kept."""

    def __init__(self, loaded: Loaded, fabrics: Sequence[Fabric]) -> None:
        names = [spec.name for spec in loaded.scene.objects]
        self._fabrics = dict(zip(names, fabrics, strict=True))
        self._plugin = registry.load("nuno.operations", OPERATION)

    def apply(self, operation: dict[str, Any]) -> None:
        """Apply an operation of a scene and discard the result. Raises BadInput."""
        fabric = self._fabrics[operation["object"]]
        others = ("plugin", "object")
        config = self._plugin.Config.model_validate({k: v for k, v in operation.items() if k not in others})
        self._plugin.apply(config, fabric, cloth.start_state(fabric), None)


def with_lines(
    text: str, file: str, base: Sight, lines: Mapping[bool, Lines], settings: object, load: Callable[[str], Loaded]
) -> tuple[str, dict[str, int]]:
    """Return a scene's text with lines added to it, and everything else unchanged, and the number of the first of them
    on each object. Raises BadInput.

    Lines that are the first operation are given by triangles of `base` (`lines[True]`); after other operations, by
    positions on the cloth at the start (`lines[False]`).
    """
    first = not yaml_lines.parse(text, file)[0].get(LIST)
    operations = as_operations(lines[first], settings)
    after = append_items(text, LIST, operations, file)
    loaded = load(after)
    sight, _, fabrics = see_objects(loaded)
    if not np.array_equal(sight.faces, base.faces):
        problem, remedy = "the lines were drawn on other triangles than the text's scene has", "draw them again"
        raise BadInput(problem, file, remedy=remedy)
    if first:
        trial = Trial(loaded, fabrics)
        for operation in operations:
            trial.apply(operation)
    count, pairs = dict.fromkeys(lines[first], 1), zip(loaded.scene.operations, loaded.operations, strict=True)
    for applied, chosen in list(pairs)[: -len(operations)]:
        name = applied.object or loaded.scene.objects[0].name
        if chosen.name == OPERATION and applied.at == 0.0 and name in count:
            count[name] += len(getattr(chosen.config, "lines", ()))
    return after, count


# Conversion of lines from the page to the forms of scenes, runs and files.

MOST_LINES, MOST_POINTS = 500, 20_000
DIGITS = 5
"""Digits of a barycentric coordinate: a hundred-thousandth of a triangle."""
MICRON = 6
"""Digits of a length in metres, after the point."""
Face = Annotated[int, Field(ge=0, lt=2**31)]


class Stroke(BaseModel):
    """A line of the page: rows of a triangle's number and two barycentric coordinates.

    Triangles are numbered over the whole cloth; the coordinates are those of the second and third corner.
    """

    model_config = ConfigDict(extra="forbid", strict=True)
    points: list[tuple[Face, float, float]] = Field(min_length=2, max_length=MOST_POINTS)
    height: float = Field(allow_inf_nan=False)
    width: float | None = Field(default=None, ge=1e-6, allow_inf_nan=False)
    """[m]; None for a line that splits triangles."""
    closed: bool = False
    """Whether the last point is joined to the first."""


def read_strokes(data: object, sight: Sight) -> list[Stroke]:
    """Validate the page's lines. Raises BadInput, with a field that begins with lines[i], for an invalid line."""
    if not isinstance(data, list) or not 1 <= len(data) <= MOST_LINES:
        raise BadInput("draw a line first", field="lines", limit=f"1 to {MOST_LINES}")
    strokes = []
    for i, one in enumerate(data):
        try:
            # Points are rows of JSON, which has no tuples.
            rows = [tuple(row) for row in one["points"]]
            stroke = Stroke.model_validate(one | {"points": rows})
        except (ValidationError, TypeError, KeyError):
            raise BadInput("this is no line", field=f"lines[{i}]", remedy="draw it again") from None
        _check(stroke, i, sight)
        strokes.append(stroke)
        if (stroke.width is None) != (strokes[0].width is None):
            remedy = "give all a width, or none"
            raise BadInput("lines with a width and without are drawn apart", field=f"lines[{i}].width", remedy=remedy)
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
    """Return triangles (p,) and barycentric coordinates (p, 3) of a line's points."""
    face = np.array([row[0] for row in stroke.points], np.int64)
    second = np.array([row[1:] for row in stroke.points], np.float64)
    return face.astype(np.int32), np.column_stack([1.0 - second.sum(axis=1), second])


def positions(stroke: Stroke, sight: Sight) -> Float:
    """Return the positions (p, 3) of a line's points [m]."""
    face, at = places(stroke)
    return np.asarray(np.einsum("pc,pck->pk", at, sight.x[sight.faces[face]]))


def piece_of(sight: Sight, vertex: int) -> Piece:
    """Return the piece of a vertex."""
    return next(piece for piece in sight.pieces if piece.start <= vertex < piece.stop)


def faces_of(piece: Piece, sight: Sight) -> Int:
    """Return the numbers of a piece's triangles in the whole cloth, ascending."""
    first = sight.faces[:, 0]
    return np.flatnonzero((first >= piece.start) & (first < piece.stop)).astype(np.int32)


def numbered(which: Mapping[str, list[int]], first: Mapping[str, int]) -> list[tuple[str, int]]:
    """Return object and number of each line, whose numbers on each object are consecutive from `first`."""
    places = {i: (name, first[name] + k) for name, rows in which.items() for k, i in enumerate(rows)}
    return [places[i] for i in sorted(places)]


def line_at(strokes: Sequence[Stroke], piece: Piece, triangle: int, sight: Sight) -> int:
    """Return the number of the last line, of those on a piece, that comes near the centre of one of its triangles."""
    corners = sight.x[sight.faces[faces_of(piece, sight)[triangle]]]
    middle, size = corners.mean(axis=0), float(np.linalg.norm(np.ptp(corners, axis=0)))
    distances = np.concatenate([distance_to(middle[None], positions(stroke, sight)) for stroke in strokes])
    return int(np.flatnonzero(distances <= max(size, float(distances.min())))[-1])


def distance_to(points: Float, line: Float) -> Float:
    """Return the distance (n,) of points (n, 3) from a polyline (k, 3) [m]."""
    start, side = line[:-1], np.diff(line, axis=0)
    way = points[:, None] - start
    share = np.clip((way * side).sum(axis=2) / np.maximum((side * side).sum(axis=1), 1e-30), 0.0, 1.0)
    return np.asarray(np.linalg.norm(way - share[..., None] * side, axis=2).min(axis=1))


def pieces_of(strokes: Sequence[Stroke], sight: Sight) -> dict[str, list[int]]:
    """Return the numbers of the lines on each object."""
    numbers: dict[str, list[int]] = {}
    for i, stroke in enumerate(strokes):
        piece = piece_of(sight, int(sight.faces[stroke.points[0][0], 0]))
        numbers.setdefault(piece.name, []).append(i)
    return numbers


def by_object(strokes: Sequence[Stroke], sight: Sight, exact: bool = True) -> dict[str, list[dict[str, Any]]]:
    """Return lines in the form of a scene, by object, with triangles of each object numbered from 0.

    If not `exact`, lines are given by positions in the world, which stay valid when triangles change.
    """
    pieces = {piece.name: piece for piece in sight.pieces}
    return {
        name: [_as_line(strokes[i], pieces[name], sight) if exact else _as_points(strokes[i], sight) for i in which]
        for name, which in pieces_of(strokes, sight).items()
    }


def _as_points(stroke: Stroke, sight: Sight) -> dict[str, Any]:
    return {"points": np.round(positions(stroke, sight), MICRON).tolist(), **_properties(stroke)}


def _as_line(stroke: Stroke, piece: Piece, sight: Sight) -> dict[str, Any]:
    face, at = places(stroke)
    rows = zip(np.searchsorted(faces_of(piece, sight), face), at, strict=True)
    return {"on_faces": [_on_face(f, row) for f, row in rows], **_properties(stroke)}


def _properties(stroke: Stroke) -> dict[str, Any]:
    width = {} if stroke.width is None else {"width": round(stroke.width, MICRON)}
    return {"height": round(stroke.height, MICRON)} | width | ({"closed": True} if stroke.closed else {})


def _on_face(face: int, at: Float) -> dict[str, Any]:
    """Return a point of a line, with rounded coordinates that still add up to 1."""
    b, c = (min(max(round(float(value), DIGITS), 0.0), 1.0) for value in at[1:])
    c = min(c, round(1.0 - b, DIGITS))
    return {"face": int(face), "at": [round(1.0 - b - c, DIGITS), b, c]}


def to_obj(strokes: Sequence[Stroke], sight: Sight) -> str:
    """Return the text of an OBJ file of the lines as polylines on the present cloth [m], named by height."""
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


# Requirements of cloth for drawing lines.


def require_lines(loaded: Loaded, fabrics: Sequence[Fabric]) -> dict[str, Any]:
    """Return whether lines on some of the cloth need a width, and the mean edge of its triangles at the start [m].
    Raises BadInput for cloth that cannot have lines.
    """
    plugin, line = registry.load("nuno.operations", OPERATION), {"points": [[0, 0, 0], [1, 0, 0]], "height": 0.1}
    configs = [plugin.Config.model_validate({"lines": [line | more]}) for more in ({}, {"width": 1.0})]

    def refusal(config: Any, fabric: Fabric) -> BadInput | None:
        try:
            plugin.require(config, fabric, ())
        except BadInput as error:
            return replace(error, field=None)
        return None

    found = [[refusal(config, fabric) for config in configs] for fabric in fabrics]
    if (first := next((wide for _, wide in found if wide is not None), None)) and all(wide for _, wide in found):
        raise loaded.at("objects[0].model", first)
    sides = [fabric.position[fabric.faces] - fabric.position[np.roll(fabric.faces, 1, axis=1)] for fabric in fabrics]
    edge = float(np.linalg.norm(np.concatenate(sides), axis=2).mean())
    return {"needs_width": any(plain and not wide for plain, wide in found), "edge": edge}
