"""A pattern's file: its fields as GarmentCode writes them, its panels and seams, and the faults that prevent sewing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Annotated, Any, Literal
from unicodedata import normalize

import numpy as np
from pydantic import BeforeValidator, Field

from nuno_cloth.sewing.curves import Arc, Bezier, Curve
from nuno_cloth.sewing.pattern import Edge, Panel, Pattern, Seam, Side, find_sides, name_of
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float
from nuno_schemas.pattern import Remark
from nuno_schemas.plugin import Config
from nuno_schemas.vectors import compose, norm, sides
from nuno_schemas.written import Path, Written, dotted

# A pattern's file, as GarmentCode writes it (Korosteleva & Sorkine-Hornung 2023, ACM Trans. Graph. 42, 199).
#
# Lengths are in the file's own unit; a metre has `units_in_meter` of them. Beyond GarmentCode's fields a panel may
# have a `grain`. `assemble` checks relations between fields, such as which edges meet.

LARGEST = 1e6
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Point = tuple[Number, Number]
Triple = tuple[Number, Number, Number]


class Quadratic(Config):
    type: Literal["quadratic"]
    params: tuple[Point] = Field(description="the control point", examples=[[[0.5, 0.1]]])


class Cubic(Config):
    type: Literal["cubic"]
    params: tuple[Point, Point] = Field(description="the two control points", examples=[[[0.3, 0.1], [0.7, 0.1]]])


class Circle(Config):
    type: Literal["circle"]
    params: tuple[Annotated[float, Field(gt=0, le=LARGEST)], bool, bool] = Field(
        description="radius, 1 for the longer arc of the circle, 1 if it bulges to the right of the way along the edge",
        examples=[[30, 0, 1]],
    )


def _as_curve(value: Any) -> Any:
    """Return one control point, as files of 2021 have it, as a curve (Korosteleva & Lee 2021, Generating Datasets of 3D
    Garments with Sewing Patterns).
    """
    return {"type": "quadratic", "params": [value]} if isinstance(value, list | tuple) else value


class EdgeFields(Config):
    endpoints: tuple[int, int] = Field(
        description="numbers of the vertices where it starts and ends", examples=[[0, 1]]
    )
    curvature: Annotated[
        Annotated[Quadratic | Cubic | Circle, Field(discriminator="type")] | None, BeforeValidator(_as_curve)
    ] = None
    label: str | None = None


class PanelFields(Config):
    vertices: tuple[Point, ...] = Field(
        min_length=2, max_length=400, description="in the file's unit", examples=[[[-36, 0], [36, 0], [24, 60]]]
    )
    edges: tuple[EdgeFields, ...] = Field(min_length=2, max_length=400, description="in order round the panel")
    translation: Triple = Field(default=(0.0, 0.0, 0.0), examples=[[0, 45, 20]])
    rotation: Triple = Field(
        default=(0.0, 0.0, 0.0), description="about x, then the new y, then the new z [deg]", examples=[[0, 90, 0]]
    )
    label: str | None = None
    grain: Number = Field(default=0.0, description="angle of the warp from the panel's y, counter-clockwise [deg]")


class SideFields(Config):
    panel: str
    edge: int


class PatternFields(Config):
    panels: dict[str, PanelFields] = Field(min_length=1)
    stitches: tuple[tuple[SideFields | Literal["right_wrong"], ...], ...] = Field(
        default=(), examples=[[[{"panel": "front", "edge": 1}, {"panel": "back", "edge": 2}]]]
    )
    panel_order: tuple[str, ...] = ()


class Properties(Config):
    units_in_meter: Annotated[
        float, Field(gt=0, le=LARGEST, allow_inf_nan=False, description="100 for centimetres", examples=[100])
    ]
    curvature_coords: Literal["relative", "absolute"] = "relative"
    normalize_panel_translation: Literal[False] = False
    normalized_edge_loops: Literal[True] = True
    original_units_in_meter: float | None = None


class PatternFile(Config):
    """A pattern's file. `parameters` and the like, which only the drawing program needs, are ignored."""

    pattern: PatternFields
    properties: Properties = Field(examples=[{"units_in_meter": 100}])
    parameters: dict[str, Any] = Field(default_factory=dict)
    parameter_order: tuple[Any, ...] = ()
    constraints: dict[str, Any] = Field(default_factory=dict)
    constraint_order: tuple[Any, ...] = ()


# Panels and seams of a pattern's file, and the faults, by line, that prevent sewing.

# Crossings of a panel's outline with itself.

FINE = 48
"""Chords that approximate a curve here."""
ROWS = 256
"""Chords that are compared with all others at a time."""


def find_crossing(curves: Sequence[Curve]) -> tuple[int, int, Float] | None:
    """Return the first two edges that cross or touch, and the point (2,) [m], of curves that go round end to end."""
    chords = [1 if isinstance(curve, Bezier) and len(curve.points) == 2 else FINE for curve in curves]
    corners = np.concatenate([curve.at(np.arange(n) / n) for curve, n in zip(curves, chords, strict=True)])
    owner = np.repeat(np.arange(len(curves)), chords)
    n = len(corners)
    ends = np.roll(corners, -1, axis=0)
    low, high = np.minimum(corners, ends), np.maximum(corners, ends)
    for at in range(0, n, ROWS):
        # Compare each with all from the one after the next; the first and the last are neighbours, too.
        i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(at, min(at + ROWS, n)), np.arange(n), indexing="ij"))
        candidates = (j > i + 1) & ~((i == 0) & (j == n - 1))
        candidates &= ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
        i, j = i[candidates], j[candidates]
        # Two chords meet if the ends of each are not on one side of the other, and, on one line, their boxes meet.
        crosses = [sides(corners[a], ends[a], corners[b]) * sides(corners[a], ends[a], ends[b]) <= 0
                  for a, b in ((i, j), (j, i))]  # fmt: skip
        met = np.flatnonzero(crosses[0] & crosses[1])
        if len(met):
            one, other = int(i[met[0]]), int(j[met[0]])
            return int(owner[one]), int(owner[other]), _meeting(corners[[one, other]], ends[[one, other]])
    return None


def _meeting(start: Float, end: Float) -> Float:
    """Return where (2,) two chords from start (2, 2) to end (2, 2) meet: on one line, the middle of their overlap."""
    (ux, uy), (vx, vy), (px, py) = *(end - start), start[1] - start[0]
    turn = ux * vy - uy * vx
    if turn != 0.0:
        return np.asarray(start[0] + min(max((px * vy - py * vx) / turn, 0.0), 1.0) * (end[0] - start[0]))
    return np.asarray(0.5 * (np.minimum(start, end).max(axis=0) + np.maximum(start, end).min(axis=0)))


SHORTEST = 1e-5
"""Shorter edges [m] are refused."""
FLATTEST = 1e-4
"""A panel whose area is a smaller share of the square of its perimeter is refused."""
STITCHES: Path = ("pattern", "stitches")
Note = Callable[..., None]


class BadPanel(Exception):
    """A panel cannot be sewn, for a reason that has been noted."""


def require_sound(written: Written[PatternFile]) -> Pattern:
    """Return the pattern of a file. Raises BadInput for its first fault."""
    pattern, remarks = assemble(written)
    for remark in remarks:
        raise BadInput(f"{remark.where}: {remark.text}", written.file, remark.line, remark.field, remedy=remark.remedy)
    return pattern


def assemble(written: Written[PatternFile]) -> tuple[Pattern, list[Remark]]:
    """Return the panels and seams without faults, and remarks on the faults."""
    remarks: list[Remark] = []

    def note(kind: str, where: str, text: str, path: Path, remedy: str | None = None) -> None:
        remarks.append(Remark(kind, True, where, text, written.line(path), dotted(path), remedy))

    properties, fields_of_panels = written.said.properties, written.said.pattern.panels
    panels = {}
    for name, fields in fields_of_panels.items():
        note_here = partial(_note_on_panel, note, name)
        try:
            panels[name] = _panel(name, fields, 1.0 / properties.units_in_meter, properties.curvature_coords, note_here)
        except BadPanel:
            continue
    seams = _seams(written, note)
    sewable = tuple(seam for seam in seams if seam.one[0] in panels and seam.other[0] in panels)
    pattern = Pattern(panels, sewable)
    _, seam = find_sides(pattern)
    if seam is not None:
        text = "the right side of one comes to the right side of the other, which other seams have turned inside out"
        if seam.right_wrong:
            text = "the right side of one comes to the wrong side of the other, which other seams have right side out"
        remedy = "without right_wrong?" if seam.right_wrong else "with right_wrong?"
        note("sides disagree", seam.names, text, (*STITCHES, seam.stitch), f"is this stitch meant {remedy}")
    return pattern, remarks


def _note_on_panel(note: Note, name: str, kind: str, text: str, path: Path = (), remedy: str | None = None) -> None:
    where = name_of((name, int(path[1]))) if path[:1] == ("edges",) and len(path) > 1 else name
    note(kind, where, text, ("pattern", "panels", name, *path), remedy)


def _panel(name: str, fields: PanelFields, unit: float, coords: str, note: Note) -> Panel:
    """Return a panel. Raises BadPanel if it cannot be sewn."""
    corners, number = np.array(fields.vertices) * unit, len(fields.vertices)
    for k, edge in enumerate(fields.edges):
        for vertex in edge.endpoints:
            if not 0 <= vertex < number:
                remedy = "vertices are counted from 0"
                text = f"ends at vertex {vertex}, and the panel has 0 to {number - 1}"
                note("no such vertex", text, ("edges", k, "endpoints"), remedy)
                raise BadPanel
    _require_closed(fields, note)
    edges = [
        _edge(fields.edges[k], corners, unit, coords, partial(_note_on_edge, note, k)) for k in range(len(fields.edges))
    ]
    x, y, z = np.radians(fields.rotation)
    grain = float(np.radians(fields.grain))
    panel = Panel(
        name, tuple(edges), rotation_of(x, y, z), np.array(fields.translation) * unit,
        np.array([-np.sin(grain), np.cos(grain)]), fields.label,
    )  # fmt: skip
    crossing = find_crossing([edge.curve for edge in edges])
    if crossing is not None:
        one, other, where = crossing
        text = "crosses itself" if one == other else f"crosses {name_of((name, other))}"
        x, y = where / unit
        note("crossing edges", f"{text} at ({x:.4g}, {y:.4g})", ("edges", one), "draw the outline without crossings")
        raise BadPanel
    around = sum(edge.length for edge in edges)
    if abs(panel.area) < FLATTEST * around**2:
        note("no area", f"encloses {1e4 * abs(panel.area):.3g} cm², {100 * around:.4g} cm round", ("edges",),
             "give it a third edge, or curve one of the two")  # fmt: skip
        raise BadPanel
    return panel


def _note_on_edge(note: Note, k: int, kind: str, text: str, path: Path = (), remedy: str | None = None) -> None:
    note(kind, text, ("edges", k, *path), remedy)


def _require_closed(fields: PanelFields, note: Note) -> None:
    """Raise BadPanel if edges do not go round the panel once."""
    ends = [edge.endpoints for edge in fields.edges]
    for k, (start, end) in enumerate(ends):
        after = (k + 1) % len(ends)
        if start == end:
            note("no length", f"starts and ends at vertex {start}", ("edges", k, "endpoints"))
            raise BadPanel
        if end != ends[after][0]:
            text = f"ends at vertex {end}, and edge {after} starts at vertex {ends[after][0]}"
            note("open outline", text, ("edges", k, "endpoints"), "list edges in order, each from where the last ended")
            raise BadPanel
    starts = [start for start, _ in ends]
    for k, start in enumerate(starts):
        if start in starts[:k]:
            text = f"comes to vertex {start} again, where edge {starts.index(start)} starts"
            note("crossing edges", text, ("edges", k, "endpoints"), "a panel has one outline; make two panels of it")
            raise BadPanel


def _edge(fields: EdgeFields, corners: Float, unit: float, coords: str, note: Note) -> Edge:
    """Return an edge. Raises BadPanel if it has no length, or its arc does not reach from end to end."""
    start, end = corners[fields.endpoints[0]], corners[fields.endpoints[1]]
    if norm(end - start) < SHORTEST:
        note("no length", f"is {100 * float(norm(end - start)):.3g} cm long", ("endpoints",), "leave one corner out")
        raise BadPanel
    try:
        return Edge(curve_of(fields, start, end, unit, coords), fields.label)
    except ValueError as error:
        least = float(str(error).rpartition(" ")[2]) / unit
        text = f"an arc of radius {fields.curvature.params[0]:.6g} does not reach from end to end: at least {least:.6g}"  # type: ignore[union-attr]
        note("no such arc", text, ("curvature", "params"))
        raise BadPanel from None


def curve_of(fields: EdgeFields, start: Float, end: Float, unit: float, coords: str) -> Curve:
    """Return an edge's curve. Raises ValueError for an arc that does not reach from end to end."""
    curvature = fields.curvature
    if curvature is None:
        return Bezier(np.stack([start, end]))
    if isinstance(curvature, Circle):
        radius, large, right = curvature.params
        return Arc.between(start, end, radius * unit, large, right)
    control = np.array(curvature.params)
    if coords == "relative":
        along = end - start
        control = start + control[:, :1] * along + control[:, 1:] * np.array([-along[1], along[0]])
    else:
        control = control * unit
    return Bezier(np.concatenate([start[None], control, end[None]]))


def rotation_of(x: float, y: float, z: float) -> Float:
    """Return the rotation (3, 3) about x, then the turned y, then the turned z [rad]: scipy's from_euler("XYZ")."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([x, y, z]), np.sin([x, y, z])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return compose(compose(about_x, about_y), about_z)


def _seams(written: Written[PatternFile], note: Note) -> list[Seam]:
    """Return the seams between existing edges that are each sewn once."""
    fields, sewn = written.said.pattern, dict[Side, int]()
    seams = []
    for k, stitch in enumerate(fields.stitches):
        path: Path = (*STITCHES, k)
        sides = [part for part in stitch[:2] if isinstance(part, SideFields)]
        if len(sides) < 2 or len(stitch) > 3 or (len(stitch) == 3 and isinstance(stitch[2], SideFields)):
            note("no seam", f"stitch {k}", "joins two edges: {panel, edge}, {panel, edge}", path,
                 "write two of them, and, where right comes to wrong, right_wrong as the third")  # fmt: skip
            continue
        ends = [(as_written(side.panel, fields.panels), side.edge) for side in sides]
        if sum(_side_exists(fields.panels, side, (*path, i), note) for i, side in enumerate(ends)) < 2:
            continue
        twice = next((i for i, side in enumerate(ends) if side in sewn or (i == 1 and side == ends[0])), None)
        if twice is None:
            seams.append(Seam(ends[0], ends[1], len(stitch) == 3, k))
            sewn |= dict.fromkeys(ends, k)
        else:
            before = sewn.get(ends[twice], k)
            text = "is sewn to itself" if before == k else f"is sewn twice, in stitches {before} and {k}"
            note("sewn twice", name_of(ends[twice]), text, (*path, twice), "part the edge in two, and sew each once")
    return seams


def as_written(name: str, names: Iterable[str]) -> str:
    """Return a panel's name as `names` have it, which may write an accented letter as one character or as two."""
    same = [one for one in names if normalize("NFC", one) == normalize("NFC", name)]
    return name if name in same or len(same) != 1 else same[0]


def _side_exists(panels: dict[str, PanelFields], side: Side, path: Path, note: Note) -> bool:
    name, edge = side
    if name not in panels:
        note("no such panel", name_of(side), f"no panel {name!r}", (*path, "panel"), nearest(name, panels))
    elif not 0 <= edge < len(panels[name].edges):
        text = f"no edge {edge}: the panel has 0 to {len(panels[name].edges) - 1}"
        note("no such edge", name_of(side), text, (*path, "edge"), "edges are counted from 0")
    else:
        return True
    return False
