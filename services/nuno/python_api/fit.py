"""Fit of the garments of a recording on the body that wears them: girths and ease, strain, seams, pressure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from nuno.collision.bodies import build_bodies, outlines, surface, vertex_normals
from nuno.exports.cloth import ShownPiece, read_pieces
from nuno.recording.reader import Recording
from nuno.resimulation.frame_state import FrameState, states
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.simulation.yarns import named_heights
from nuno_schemas.bodies import OF_TRIANGLES
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Bool, Corners, Float, Int, Membrane, Panels
from nuno_schemas.vectors import unit_rows

Mesh = tuple[Float, Int]
"""Vertices (m, 3) [m] and faces (g, 3)."""
MEASURED = "use a pattern, shirt, mesh or skirt with cut: circle, half or quarter, of a preset fabric, not of springs"
CONTACTS = ("contact", "cloth_contact")


def read_fits(
    recording: Recording, frame: int | None = None, body: str | None = None, heights: dict[str, float] | None = None
) -> list[Fit]:
    """Measure the fit of each garment of a frame (default: the last) on a body (default: the only one).

    heights [m] are above the body's lowest point, by name, and override the body's own. Raises BadInput for a recording
    without such a body, or without a garment of measured fabric.
    """
    return [fit for fit, _ in map_fits(recording, frame, body, heights)]


def map_fits(
    recording: Recording, frame: int | None = None, body: str | None = None, heights: dict[str, float] | None = None
) -> list[tuple[Fit, FitMap]]:
    """Measure the fit of each garment as `read_fits` does, and how it varies over the garment. Raises BadInput."""
    numbers = sorted(number for number, _ in recording.marks().values())
    if not numbers:
        raise BadInput("the recording holds no frames", str(recording.path))
    if frame is not None and frame not in numbers:
        raise recording.no_frame(frame, numbers)
    with restored_scene(recording) as loaded:
        wearer(loaded, body, 0.0, str(recording.path))  # refused before the frame is simulated again
    (moment,) = states(recording, [numbers[-1] if frame is None else frame], forces=True)
    with restored_scene(recording) as loaded:
        mesh, landmarks, search = wearer(loaded, body, moment.t, str(recording.path))
    floor = float(mesh[0][:, 1].min())
    at = (landmarks or find_heights(*mesh)) | {name: floor + height for name, height in (heights or {}).items()}
    at = dict(sorted(at.items(), key=lambda one: -one[1]))
    closest = search(moment.x)
    normals = unit_rows(np.einsum("nc,ncd->nd", closest.weights, vertex_normals(*mesh)[mesh[1][closest.face]]))
    fits = [fit for piece in read_pieces(recording) if (fit := _fit(piece, moment, mesh, at, normals))]
    if not fits:
        problem = "no garment of a measured fabric, whose triangles were cut"
        raise BadInput(problem, str(recording.path), remedy=MEASURED)
    return [(replace(fit, girths=[replace(one, height=one.height - floor) for one in fit.girths],
                     openings=[replace(one, low=one.low - floor, high=one.high - floor) for one in fit.openings]), over)
            for fit, over in fits]  # fmt: skip


@dataclass(frozen=True)
class FitMap:
    """Pressure on the body [Pa], 0 where none is touched, and the larger strain of warp and weft, both (n,), of the
    vertices from `start` on; strain is the mean over each vertex's triangles by area, NaN without a triangle.
    """

    start: int
    pressure: Float
    strain: Float


def map_fit(start: int, x: Float, membrane: Membrane, outwards: Float) -> FitMap:
    """Return the map of a garment at x (n, 3) [m] with the forces `outwards` (n,) [N] on its vertices."""
    corners, thirds = membrane.faces.reshape(-1), np.repeat(membrane.area / 3.0, 3)
    area = np.bincount(corners, thirds, len(x))
    strain = np.maximum(*_yarn_strains(x, membrane).values())
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.bincount(corners, thirds * np.repeat(strain, 3), len(x)) / area
        pressure = np.where(area > 0.0, np.maximum(outwards, 0.0) / area, 0.0)
    return FitMap(start, pressure, mean)


def _fit(
    piece: ShownPiece, moment: FrameState, mesh: Mesh, at: dict[str, float], normals: Float
) -> tuple[Fit, FitMap] | None:
    """Measure the fit of a piece; None for a piece without a membrane."""
    fabric, forces, start, stop = moment.fabric, moment.forces, piece.start, piece.stop
    if fabric is None or forces is None or fabric.membrane is None:
        return None
    whole = fabric.membrane
    part = (whole.faces[:, 0] >= start) & (whole.faces[:, 0] < stop)
    if not part.any():
        return None
    faces = (whole.faces[part] - start).astype(np.int32)
    membrane = Membrane(faces, whole.along[part], whole.across[part], whole.area[part], whole.moduli[:, part],
                        whole.damping[:, part])  # fmt: skip
    x = moment.x[start:stop]
    corners = piece.corners
    if corners is not None and not np.array_equal(faces, corners.vertex[corners.faces]):
        corners = None
    fit = measure(piece.name, x, membrane, mesh, at, None if corners is None else corners.panels)
    force = sum((forces.parts[kind][start:stop] for kind in CONTACTS if kind in forces.parts), 0.0 * x)
    seams = [] if corners is None else measure_seams(x, membrane, corners)
    pressed = measure_pressure(membrane, force, normals[start:stop])
    left = fabric.mass[start:stop, None] * forces.acceleration[start:stop]  # 0 for held vertices
    size, over = (float(np.linalg.norm(one, axis=1).sum()) for one in (force, left))
    over = over / size if size > 0.0 else 0.0
    outwards = (force * normals[start:stop]).sum(axis=1)
    return replace(fit, pressed=replace(pressed, unbalanced=over), seams=seams), map_fit(start, x, membrane, outwards)


def wearer(
    loaded: Loaded, name: str | None, t: float, path: str
) -> tuple[Mesh, dict[str, float], Callable[[Float], Any]]:
    """Return a body's mesh at t [s], its own named heights [m], and a function that finds its closest points.

    name is None for the only body; path is the recording's. Raises BadInput if there is no such body of triangles.
    """
    names = [one.name for one in loaded.scene.bodies]
    if not names:
        raise BadInput("the recording has no body to fit", path)
    if name is None and len(names) > 1:
        raise BadInput("which body wears it is not said", path, field="--body", limit=", ".join(names))
    if name is not None and name not in names:
        raise BadInput("no such body", path, field="--body", value=name, remedy=nearest(name, names))
    number = 0 if name is None else names.index(name)
    bodies = build_bodies(loaded)
    geometry = bodies.geometry
    parts = [int(i) for i in np.flatnonzero(geometry.body == number)]
    collider = loaded.colliders[number].plugin
    if not parts or any(geometry.kind[i] not in OF_TRIANGLES for i in parts) or not hasattr(collider, "search"):
        problem, remedy = "fit is measured on a body of triangles", "give it a mesh as its collider"
        raise BadInput(problem, path, field="--body", value=names[number], remedy=remedy)
    shown = surface(geometry.of_primitives(parts))
    heights = named_heights(loaded) if len(names) == 1 else {}
    mesh = np.ascontiguousarray(shown.at(bodies.poses(t))), shown.faces
    return mesh, heights, collider.search(*mesh)


# Fit of a garment of triangles: its girths and the body's, strain of its yarns, and pressure.

THIN = 0.01
"""A part of the body with less than this share of the area of the largest part is a fold of its mesh [-]."""


NESTED = 0.5
"""A part of the body has passed through two openings if more than this share of the smaller part is in the larger."""


@dataclass(frozen=True)
class Opening:
    """Heights of an opening's lowest and highest point [m], its length as cut [m], and the girth of each part of the
    body through it [m], the longest first.

    edges   edges of panels around it, if the garment was sewn
    passed  numbers, from 0, of openings within its part of the body: the body passes through them and through this one
            as well, as an arm does through a neckline that has slipped off its shoulder
    """

    low: float
    high: float
    cut: float
    through: tuple[float, ...]
    edges: tuple[str, ...] = ()
    passed: tuple[int, ...] = ()


def find_openings(
    x: Float, membrane: Membrane, corners: Float, body: tuple[Float, Int], panels: Panels | None = None
) -> list[Opening]:
    """Return a garment's openings, from the top: x (n, 3) [m] are its vertices, corners (t, 3, 2) those of each
    triangle as cut, body is the body's mesh, and panels are those of the membrane's triangles.
    """
    sides = np.stack([membrane.faces, np.roll(membrane.faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    number = {side: i for i, side in enumerate(map(tuple, sides))}
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).reshape(-1)
    openings, beyond = list[Opening](), list[Bool]()
    for loop in sorted(outlines(membrane.faces), key=lambda one: -x[one, 1].max()):
        border = [number[side] for side in zip(loop, [*loop[1:], loop[0]], strict=True)]
        height, (tapes, out) = x[loop, 1], _through(x[loop], *body)
        edges = () if panels is None else _edges(panels, np.array(border))
        openings.append(Opening(float(height.min()), float(height.max()), float(lengths[border].sum()), tapes, edges))
        beyond.append(out)
    passed = [tuple(j for j, other in enumerate(beyond) if j != i and _within(other, one))
              for i, one in enumerate(beyond)]  # fmt: skip
    return [replace(one, passed=those) for one, those in zip(openings, passed, strict=True)]


def _edges(panels: Panels, sides: Int) -> tuple[str, ...]:
    """Return the panel edges of sides of triangles, each once."""
    of, edge = panels.of[sides // 3].tolist(), panels.edge[sides // 3, sides % 3].tolist()
    return tuple(dict.fromkeys(f"{panels.names[k]}[{j}]" for k, j in zip(of, edge, strict=True) if k >= 0 and j >= 0))


def _within(one: Bool, other: Bool) -> bool:
    """Return whether a part of the body is mostly within a larger part."""
    return bool(0 < one.sum() < other.sum() and (one & other).sum() > NESTED * one.sum())


def _through(loop: Float, x: Float, faces: Int) -> tuple[tuple[float, ...], Bool]:
    """Return the girths [m] of the parts of a body x (m, 3), faces (g, 3), through a loop (k, 3), in its mean plane;
    and which (m,) of the body's vertices are beyond the plane and connected with these parts.

    The loop has the cloth on its left, seen from outside, as the sides of triangles do.
    """
    centre = loop.mean(axis=0)
    # The area vector of a bag's mouth points into the bag.
    inwards = np.cross(loop - centre, np.roll(loop, -1, axis=0) - centre).sum(axis=0)
    if not (size := float(np.linalg.norm(inwards))) > 0.0:
        return (), np.zeros(len(x), np.bool_)
    # The second axis is normal to the plane, which is then level.
    up = -inwards / size
    side = unit_rows(np.cross(up, np.eye(3)[int(np.abs(up).argmin())]))
    turn = np.stack([np.cross(up, side), up, side], axis=1)
    outline, placed = (loop - centre) @ turn, (x - centre) @ turn
    parts = [(part, *part.hull()) for part in cut(placed, faces, 0.0).curves()]
    at = outline[:, [2, 0]]
    parts = [part for part in parts if abs(turns(at - part[3], np.roll(at, -1, axis=0) - part[3])) > 0.5]
    most = max((area for _, _, area, _ in parts), default=0.0)
    parts = [part for part in parts if part[2] > THIN * most]
    tapes = tuple(sorted((girth for _, girth, _, _ in parts), reverse=True))
    crossed = np.concatenate([np.empty(0, np.int32), *(part.face for part, *_ in parts)])
    return tapes, _beyond(faces, placed[:, 1] >= 0.0, crossed)


def _beyond(faces: Int, above: Bool, crossed: Int) -> Bool:
    """Return which of a body's vertices (m,) are connected with those above a plane in the triangles that it cuts,
    after the cut: none, if the body is still connected around it.
    """
    whole = np.ones(len(faces), np.bool_)
    whole[crossed] = False
    sides = faces[crossed][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    kept = sides[above[sides[:, 0]] == above[sides[:, 1]]]  # they do not cross the plane
    ends = np.concatenate([faces[whole][:, [0, 1]], faces[whole][:, [1, 2]], kept])
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(above), len(above)))
    part = connected_components(graph, directed=False)[1]
    at = faces[crossed].reshape(-1)
    return np.isin(part, np.setdiff1d(part[at[above[at]]], part[at[~above[at]]]))


ROUND = 0.5
"""Least share of a turn around a body with which a curve of cloth counts as worn at that height."""
HIGH = 0.95
"""Share of the area for the high value of strain and pressure: the 95th percentile."""


@dataclass(frozen=True)
class Girth:
    """A named height [m], and the girths there [m]: of the body's trunk, of the cloth as cut, and as worn; and the
    share of a turn that the cloth covers, 1 if it is closed.

    With several layers of cloth, such as tiers, it is the one with the shortest girth; None for missing values.
    """

    name: str
    height: float
    body: float | None
    cut: float | None
    worn: float | None
    share: float | None

    @property
    def ease(self) -> float | None:
        """Girth of the cloth as cut minus that of the body [m]; None for open cloth, or no cloth or body."""
        if self.body is None or self.cut is None or self.share is None or self.share < 1.0 - 1e-6:
            return None
        return self.cut - self.body


@dataclass(frozen=True)
class Spread:
    """Distribution of a quantity over the garment's area: median, 95th percentile, and maximum."""

    median: float
    high: float
    most: float


@dataclass(frozen=True)
class Pressed:
    """Pressure of a garment on bodies: contact area [m^2], mean and 95th percentile there [Pa], and total force [N];
    and what all forces on its vertices leave over, as a share of those of contact: 0 at rest, and without contact.
    """

    area: float
    mean: float
    high: float
    force: float
    unbalanced: float = 0.0


@dataclass(frozen=True)
class Fit:
    """Fit of one garment on its body, as `measure` returns it."""

    name: str
    girths: list[Girth]
    openings: list[Opening]
    """Openings from the top."""
    strains: dict[str, Spread] = field(default_factory=dict)
    pressed: Pressed | None = None
    seams: list[Seam] = field(default_factory=list)

    @property
    def off(self) -> bool:
        """Whether no part of the garment touches the body."""
        return self.pressed is not None and self.pressed.area == 0.0

    @property
    def on(self) -> bool:
        """Whether the garment is worn: it touches the body, and no part of the body passes through two openings, as an
        arm does through a neckline that has slipped.
        """
        return not self.off and not any(one.passed for one in self.openings)


def measure(
    name: str,
    x: Float,
    membrane: Membrane,
    body: tuple[Float, Int],
    heights: dict[str, float],
    panels: Panels | None = None,
) -> Fit:
    """Measure girths, openings and strains of a garment.

    x (n, 3) [m] are its vertices, y up; membrane its triangles; body the body's mesh, vertices (m, 3) and faces (g, 3);
    heights [m] by name; panels those of the membrane's triangles.
    """
    corners = _corners(membrane.along, membrane.across)
    girths = [_girth(place, height, x, membrane, corners, body) for place, height in heights.items()]
    return Fit(name, girths, find_openings(x, membrane, corners, body, panels), _strains(x, membrane))


def measure_pressure(membrane: Membrane, force: Float, normal: Float) -> Pressed:
    """Return the pressure on a body from contact forces (n, 3) [N] on a garment's vertices: their component along its
    normal (n, 3) at the closest point, over the area of each vertex. Forces between layers of cloth are opposite, and
    cancel.
    """
    area = np.bincount(membrane.faces.reshape(-1), np.repeat(membrane.area / 3.0, 3), len(force))
    outwards = (force * normal).sum(axis=1)
    touching = (outwards > 0.0) & (area > 0.0)
    if not touching.any():
        return Pressed(0.0, 0.0, 0.0, float(outwards.sum()))
    pressed = float(area[touching].sum())
    high = _spread(outwards[touching] / area[touching], area[touching]).high
    return Pressed(pressed, float(outwards[touching].sum()) / pressed, high, float(outwards.sum()))


def _corners(along: Float, across: Float) -> Float:
    """Return the corners of each triangle as cut, shape (t, 3, 2), along warp and weft from the first [m]."""
    # The two sides from the first corner, as columns, times (along, across) are the cloth's unit vectors.
    sides = np.linalg.inv(np.stack([along, across], axis=2))
    return np.concatenate([np.zeros((len(sides), 1, 2)), sides.transpose(0, 2, 1)], axis=1)


def _flat_length(one: Slice, corners: Float) -> float:
    """Return the length of a curve on the cloth as cut [m]."""
    ends = np.einsum("mec,mcd->med", one.shares, corners[one.face])
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())


def _girth(name: str, height: float, x: Float, membrane: Membrane, corners: Float, body: tuple[Float, Int]) -> Girth:
    level = cut(*body, height)
    wearer = trunk(level)
    if wearer is None:
        return Girth(name, height, None, None, None, None)
    tape, area, middle = wearer.hull()
    curves = [
        (share, _flat_length(one, corners), one)
        for one in cut(x, membrane.faces, height).curves()
        if (share := abs(one.turns(middle))) > ROUND
    ]
    if not curves:
        return Girth(name, height, tape, None, None, None)
    share, flat, cloth = min(curves, key=lambda one: one[1])
    # A skirt is round both legs, and so is the tape; trousers are round each.
    inside = [
        one for one in level.curves()
        if (hull := one.hull())[1] > LIMB * area and abs(cloth.turns(hull[2])) > ROUND
    ]  # fmt: skip
    if len(inside) > 1:
        tape = level._of(np.isin(level.piece, [one.piece[0] for one in inside])).hull()[0]
    return Girth(name, height, tape, flat, cloth.length(), min(share, 1.0))


def _strains(x: Float, membrane: Membrane) -> dict[str, Spread]:
    return {name: _spread(strain, membrane.area) for name, strain in _yarn_strains(x, membrane).items()}


def _yarn_strains(x: Float, membrane: Membrane) -> dict[str, Float]:
    """Return the strains along warp and weft of each triangle, (t,)."""
    a, b, c = np.take(x, membrane.faces.T, axis=0)
    strains = {}
    for name, yarns in (("warp", membrane.along), ("weft", membrane.across)):
        stretched = yarns[:, :1] * (b - a) + yarns[:, 1:] * (c - a)
        strains[name] = np.linalg.norm(stretched, axis=1) - 1.0
    return strains


def _spread(values: Float, area: Float) -> Spread:
    order = np.argsort(values, kind="stable")
    below = np.cumsum(area[order]) / area.sum()
    median, high = (float(values[order[np.searchsorted(below, share)]]) for share in (0.5, HIGH))
    return Spread(median, high, float(values.max()))


# Slices of a mesh by level planes, for girths.


@dataclass(frozen=True)
class Slice:
    """The cut of a mesh by a level plane: m segments, one for each cut triangle, counter-clockwise around the inside
    seen from above.

    face    (m,) triangle of each segment
    shares  (m, 2, 3) weights of the triangle's corners in each end
    ends    (m, 2, 2) z and x of both ends [m]
    piece   (m,) connected curve of each segment
    """

    face: Int
    shares: Float
    ends: Float
    piece: Int

    def curves(self) -> list[Slice]:
        """Return each connected curve as a slice."""
        return [self._of(self.piece == i) for i in range(int(self.piece.max(initial=-1)) + 1)]

    def _of(self, which: Bool) -> Slice:
        return Slice(self.face[which], self.shares[which], self.ends[which], self.piece[which])

    def length(self) -> float:
        """Return the length of all segments [m]."""
        return float(np.linalg.norm(self.ends[:, 1] - self.ends[:, 0], axis=1).sum())

    def turns(self, centre: Float) -> float:
        """Return the winding number of the curve around a point (z, x), counter-clockwise seen from above."""
        return turns(*(self.ends - centre).transpose(1, 0, 2))

    def hull(self) -> tuple[float, float, Float]:
        """Return the girth of the convex hull, as by a tape over hollows [m], its area [m^2] and centre (z, x)."""
        try:
            hull = ConvexHull(self.ends.reshape(-1, 2))
        except (QhullError, ValueError):
            return 0.0, 0.0, self.ends.reshape(-1, 2).mean(axis=0)
        # For plane figures, Qhull's `area` is the perimeter, and `volume` the area.
        return float(hull.area), float(hull.volume), hull.points[hull.vertices].mean(axis=0)


def turns(start: Float, end: Float) -> float:
    """Return the winding number of segments from `start` (m, 2) to `end` (m, 2) around the origin."""
    angle = np.arctan2(start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0], (start * end).sum(axis=1))
    return float(angle.sum() / (2.0 * np.pi))


def cut(x: Float, faces: Int, height: float) -> Slice:
    """Cut a mesh x (n, 3) [m], faces (f, 3), with y up, at a height [m]; a vertex at that height counts as above."""
    above = x[:, 1] >= height
    over = above[faces]
    crossed = np.flatnonzero((over.sum(axis=1) % 3) != 0)
    over = over[crossed]
    # The single corner on one side of the plane, and the triangle's sides from it.
    lone = np.argmax(over == (over.sum(axis=1) == 1)[:, None], axis=1)
    rows = np.arange(len(crossed))
    shares, keys = np.zeros((len(crossed), 2, 3)), np.zeros((len(crossed), 2), np.int64)
    for end in range(2):
        other = (lone + 1 + end) % 3
        p, q = faces[crossed, lone], faces[crossed, other]
        part = (height - x[p, 1]) / (x[q, 1] - x[p, 1])
        shares[rows, end, lone], shares[rows, end, other] = 1.0 - part, part
        keys[:, end] = np.minimum(p, q).astype(np.int64) * len(x) + np.maximum(p, q)
    # A triangle with its lone corner above has its outside on the right of the segment to the second side.
    flipped = ~over[rows, lone]
    shares[flipped], keys[flipped] = shares[flipped][:, ::-1], keys[flipped][:, ::-1]
    ends = np.einsum("mec,mcd->med", shares, x[faces[crossed]])[:, :, [2, 0]]
    _, number = np.unique(keys, return_inverse=True)
    number = number.reshape(-1, 2)
    total = int(number.max(initial=-1)) + 1
    graph = coo_matrix((np.ones(len(number)), (number[:, 0], number[:, 1])), shape=(total, total))
    piece = connected_components(graph, directed=False)[1] if total else np.zeros(0, np.int32)
    of = piece[number[:, 0]] if len(number) else np.zeros(0, np.int32)
    return Slice(crossed.astype(np.int32), shares, ends, of.astype(np.int32))


# Tension across seams.
#
# A membrane's energy per area is W = (C_w e_w^2 + C_f e_f^2 + 2 C_wf e_w e_f + G g^2) / 2 of the strains of F_w and F_f
# (nuno_schemas.fabric.Membrane). A line of the cloth as cut, with the unit normal (n_w, n_f), carries per length
#
#     T = n_w dW/dF_w + n_f dW/dF_f,   dW/dF_w = (C_w e_w + C_wf e_f) F_w / |F_w| + G g F_f,
#
# and dW/dF_f with the two exchanged. Each of the two edges of a seam has a triangle next to it; in cloth at rest both
# pull equally, except for forces of bending, weight and contact.


@dataclass(frozen=True)
class Seam:
    """A seam: its letters in the drawing of the flat pattern, the panels that it joins, and its length as cut [m].

    mean and most are those of the tension across it [N/m]; below zero its edges are pushed together.
    """

    letters: str
    panels: list[str]
    length: float
    mean: float
    most: float


def measure_seams(x: Float, membrane: Membrane, corners: Corners) -> list[Seam]:
    """Measure the tension of each seam with a length, of a garment at x (n, 3) [m] whose membrane has the triangles of
    `corners`.
    """
    panels = corners.panels
    if panels is None:
        return []
    ends = np.stack([corners.faces, np.roll(corners.faces, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    points = len(corners.points)
    keys = np.sort(ends, axis=1) @ [points, 1]
    order = np.argsort(keys)
    seams = []
    for number in np.unique(panels.seam).tolist():
        pairs = panels.pairs[panels.seam == number].astype(np.int64)
        runs = np.stack([pairs[:-1], pairs[1:]], axis=2).transpose(1, 0, 2).reshape(-1, 2)
        wanted = np.sort(runs, axis=1) @ [points, 1]
        at = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)]
        # An end of a closed short side may be in no triangle.
        at = at[keys[at] == wanted]
        if not len(at):
            continue
        length, pull = pull_across(x, membrane, at // 3, at % 3)
        names = [panels.names[k] for k in dict.fromkeys(panels.of[at // 3].tolist())]
        mean = float((length * pull).sum() / length.sum())
        seams.append(Seam(panels.letters(number), names, 0.5 * float(length.sum()), mean, float(pull.max())))
    return seams


def pull_across(x: Float, membrane: Membrane, face: Int, side: Int) -> tuple[Float, Float]:
    """Return the lengths as cut [m] of sides of triangles, each from a corner `side` (k,) of a `face` (k,) to the next,
    and the outward tension across them within the cloth [N/m], at x (n, 3) [m].
    """
    flat = _corners(membrane.along[face], membrane.across[face])
    placed = x[membrane.faces[face]]
    k = np.arange(len(face))
    start, end, third = ((k, (side + step) % 3) for step in range(3))
    edge, inwards = flat[end] - flat[start], flat[third] - flat[start]
    length = np.linalg.norm(edge, axis=1)
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length[:, None]
    normal *= -np.sign((normal * inwards).sum(axis=1, keepdims=True))
    yarns = np.einsum("ytc,tcd->ytd", membrane.shares()[:, face], placed)
    stress = _stress(yarns, membrane.moduli[:, face])
    traction = np.einsum("ty,ytd->td", normal, stress)
    way, out = unit_rows(placed[end] - placed[start]), placed[start] - placed[third]
    out = unit_rows(out - (out * way).sum(axis=1, keepdims=True) * way)
    return length, (traction * out).sum(axis=1)


def _stress(yarns: Float, moduli: Float) -> Float:
    """Return dW/dF_w and dW/dF_f, shape (2, k, 3) [N/m], for F_w and F_f (2, k, 3)."""
    (warp, weft), (c_w, c_f, c_wf, g) = yarns, moduli[..., None]
    long, wide = (np.linalg.norm(one, axis=1, keepdims=True) for one in yarns)
    shear = g * (warp * weft).sum(axis=1, keepdims=True)
    along = (c_w * (long - 1.0) + c_wf * (wide - 1.0)) * warp / long + shear * weft
    across = (c_f * (wide - 1.0) + c_wf * (long - 1.0)) * weft / wide + shear * warp
    return np.stack([along, across])


# Heights of a body's bust, waist and hips, from its mesh.

LEVELS, LOWEST, HIGHEST = 120, 0.3, 0.9
"""Number of slices, and the shares of the body's height between which they are."""
LIMB = 0.2
"""A curve with less than this share of the largest area is a hand, not a second leg."""
JOINED = 0.1
"""Arms join the trunk where the girth grows by more than this share from one slice to the next."""


def trunk(piece: Slice) -> Slice | None:
    """Return the closed curve of a slice with the largest area, or None."""
    closed = [one for one in piece.curves() if abs(abs(one.turns(one.hull()[2])) - 1.0) < 1e-6]
    return max(closed, key=lambda one: one.hull()[1], default=None)


def find_heights(x: Float, faces: Int) -> dict[str, float]:
    """Return the heights of bust, waist and hip [m] of a body that stands with y up and faces +z; empty for a body
    without legs, or with arms that are not separate from its trunk below the shoulders.

    The trunk is between the height at which two legs join, and that at which the arms join. Its hips are at the largest
    girth below its middle, its waist at the smallest girth above the hips, its bust where it extends farthest forwards
    in the upper half above the waist.
    """
    middle = 0.5 * float(x[:, 0].min() + x[:, 0].max())
    floor, tall = float(x[:, 1].min()), float(np.ptp(x[:, 1]))
    heights = floor + tall * np.linspace(LOWEST, HIGHEST, LEVELS)
    slices = [cut(x, faces, float(h)) for h in heights]
    girth, forwards, legs = np.zeros(LEVELS), np.zeros(LEVELS), np.zeros(LEVELS, np.bool_)
    for i, one in enumerate(slices):
        hulls = [piece.hull() for piece in one.curves()]
        areas = np.sort([area for _, area, _ in hulls])[::-1]
        legs[i] = len(areas) > 1 and areas[1] > LIMB * areas[0] and _beside(hulls, middle)
        if (body := trunk(one)) is not None:
            girth[i], forwards[i] = body.hull()[0], float(body.ends[..., 0].max())
    half = int((0.5 - LOWEST) / (HIGHEST - LOWEST) * LEVELS)
    if not legs[:half].any():
        return {}
    crotch = int(np.flatnonzero(legs[:half])[-1]) + 1
    grown = girth[1:] > (1.0 + JOINED) * girth[:-1]
    joined = np.flatnonzero(grown[half:])
    if not len(joined):
        return {}
    armpit = half + int(joined[0]) + 1
    hip = crotch + int(girth[crotch : (crotch + armpit) // 2].argmax())
    waist = hip + int(girth[hip:armpit].argmin())
    chest = (waist + armpit) // 2
    bust = chest + int(forwards[chest:armpit].argmax())
    return {name: float(heights[i]) for name, i in (("bust", bust), ("waist", waist), ("hip", hip))}


def _beside(hulls: list[tuple[float, float, Float]], middle: float) -> bool:
    """Return whether the two largest are on opposite sides of the body's middle, an x [m]."""
    first, second = sorted(hulls, key=lambda one: -one[1])[:2]
    return bool((first[2][1] - middle) * (second[2][1] - middle) < 0.0)


# The fit of a garment as tables of text, remarks and a sentence.

SEAMS = 8
"""Most seams in the text, those with the largest pull."""
UNBALANCED = 0.1
"""Sum of all forces, as a share of those of contact, above which a remark says that they do not balance."""


def tables(fit: Fit) -> list[list[list[str]]]:
    """Return tables of girths and ease, openings, strains and seams, in centimetres; without those that are empty."""
    girths = [["at", "height cm", "body cm", "cut cm", "worn cm", "ease cm"], *map(_row, fit.girths)]
    openings = [["opening", "from cm", "to cm", "cut cm", "round cm"]]
    openings += [[f"{i}", *(f"{1e2 * value:.1f}" for value in (one.low, one.high, one.cut)),
                  " + ".join(f"{1e2 * girth:.1f}" for girth in one.through) or "-"]
                 for i, one in enumerate(fit.openings, 1)]  # fmt: skip
    strains = [["strain", "median %", "95 % below", "most %"]]
    strains += [[name, *(f"{100 * value:+.1f}" for value in (one.median, one.high, one.most))]
                for name, one in fit.strains.items()]  # fmt: skip
    found = [girths, openings, strains, *([_seam_rows(fit.seams)] if fit.seams else [])]
    return [rows for rows in found if len(rows) > 1 or rows is strains]


def pressing(fit: Fit) -> list[tuple[str, str]]:
    """Return a row of the pressure on the body, if it was measured."""
    if (p := fit.pressed) is None:
        return []
    text = f"{p.mean:.0f} Pa on {1e4 * p.area:.0f} cm² of cloth, 95 % of it below {p.high:.0f} Pa"
    return [("presses", f"{text}; {p.force:.2f} N in all")]


def verdict(fit: Fit) -> str:
    """Return in a sentence whether a garment is worn as it was meant, and its ease."""
    ease = ", ".join(f"{one.name} {1e2 * one.ease:+.1f} cm" for one in fit.girths if one.ease is not None)
    doubts = "; ".join(f"{name} {text}" for name, text in remarks(fit))
    return "; ".join(filter(None, [doubts or "worn, and nowhere smaller than the body", ease and f"ease: {ease}"]))


def remarks(fit: Fit) -> list[tuple[str, str]]:
    """Return remarks on a fit, heading and text: forces that do not balance, a garment that is off or has slipped,
    openings for nothing, girths below the body's; none if it is worn as it was meant.
    """
    found = list[tuple[str, str]]()
    if fit.pressed is not None and fit.pressed.unbalanced > UNBALANCED:
        why = "it is not at rest, or its contact bears more than this solver reports"
        found.append(("unbalanced", f"by {fit.pressed.unbalanced:.0%} of these forces: {why}"))
    if fit.off:
        found.append(("worn", "not at all: it touches the body nowhere, and is not on yet, or has slid off"))
    for i, one in enumerate(fit.openings, 1):
        if one.passed:
            inner, edges = " and ".join(f"{k + 1}" for k in one.passed), ", ".join(one.edges) or "of no panel"
            several = "s" if len(one.passed) > 1 else ""
            text = f"what goes out through opening{several} {inner} goes out through opening {i} ({edges}), too"
            found.append(("slipped", f"{text}: narrow it, or hold it by an elastic"))
    numbered = enumerate(fit.openings, 1)
    empty = [f"{i} ({', '.join(one.edges) or 'of no panel'})" for i, one in numbered if not one.through]
    if empty and not fit.off:
        found.append(("empty", f"nothing of the body goes through opening {', '.join(empty)}: is it worn there?"))
    if tight := [one for one in fit.girths if one.ease is not None and one.ease < 0.0]:
        girths = ", ".join(f"by {-1e2 * (one.ease or 0.0):.1f} cm at the {one.name}" for one in tight)
        found.append(("smaller", f"than the body {girths}"))
    return found


def _seam_rows(seams: list[Seam]) -> list[list[str]]:
    """Return rows of the seams with the largest pull."""
    most = sorted(seams, key=lambda one: -one.mean)[:SEAMS]
    which = "seam" if len(most) == len(seams) else f"{len(most)} of {len(seams)} seams"
    rows = [[which, "panels", "cut cm", "pulled N/m", "most N/m"]]
    return rows + [
        [one.letters, ", ".join(one.panels), f"{1e2 * one.length:.1f}", f"{one.mean:.1f}", f"{one.most:.1f}"]
        for one in most
    ]


def _row(one: Girth) -> list[str]:
    open_ = one.share is not None and one.ease is None and one.body is not None
    without = f"open, {100 * (one.share or 0):.0f} % round" if open_ else "-"
    ease = without if one.ease is None else f"{1e2 * one.ease:+.1f}"
    cells = ["-" if value is None else f"{1e2 * value:.1f}" for value in (one.body, one.cut, one.worn)]
    return [one.name, f"{1e2 * one.height:.1f}", *cells, ease]
