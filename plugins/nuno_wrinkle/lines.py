"""Lines of all kinds as places in triangles: read, projected onto the cloth, and followed over it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_geometry.closest_point import corners_of, leaf_distances, nearest_in, take_nearest
from nuno_geometry.mesh_files.polygons import read_obj
from nuno_geometry.normals import face_normals
from nuno_geometry.poses import row_at
from nuno_geometry.tree import in_eights
from nuno_kernels import kernel
from nuno_kernels.lanes import WIDTH, minus
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Corners, Fabric, Float, Int
from nuno_schemas.parts import Metres, Part
from nuno_schemas.plugin import Files
from nuno_schemas.reading import read_as
from nuno_schemas.units import quantity
from nuno_wrinkle.surface import NO_BORDER, NO_CROWDED, NO_WAY, TOUCH, WAY, Passed, Way, link_faces, walk_line

# Lines drawn on cloth, ridges and valleys, and the smoothing of the cloth around them.

Number = Annotated[float, quantity("")]
Weight = Annotated[float, quantity("", ge=0, le=1)]

MOST_POINTS = 100_000
PLACES = ("points", "texture", "on_faces", "file")
"""Fields that give the position of a line."""
BARYCENTRIC = 1e-6
"""Largest difference of the sum of barycentric coordinates from 1."""


class OnFace(Part):
    """A point in a triangle of the cloth at the time when the line is drawn."""

    face: int = Field(ge=0, description="of the object's triangles, counted from 0")
    at: tuple[Weight, Weight, Weight] = Field(description="barycentric coordinates: shares of its corners")

    @model_validator(mode="after")
    def _whole(self) -> OnFace:
        if abs(sum(self.at) - 1.0) > BARYCENTRIC:
            problem = "barycentric coordinates add up to {total}, and must to 1; a corner is [1, 0, 0]"
            raise PydanticCustomError("not_whole", problem, {"total": f"{sum(self.at):g}", "inside": ("at",)})
        return self


class Line(Part):
    """A ridge or a valley: a polyline on the cloth, given in one of four ways."""

    points: tuple[tuple[Metres, Metres, Metres], ...] | None = Field(
        default=None, min_length=2, max_length=MOST_POINTS, description="places near the cloth as it lies then [m]"
    )
    texture: tuple[tuple[Number, Number], ...] | None = Field(
        default=None, min_length=2, max_length=MOST_POINTS, description="texture coordinates, u and v"
    )
    on_faces: tuple[OnFace, ...] | None = Field(
        default=None, min_length=2, max_length=MOST_POINTS, description="triangles and places in them"
    )
    file: str | None = Field(
        default=None, description="an OBJ file beside the scene: each of its elements l is a line, places in metres"
    )
    height: Metres = Field(description="k, how far the cloth is raised: above 0 a ridge, below a valley [m]")
    width: Annotated[float, quantity("m", gt=0)] | None = Field(
        default=None,
        description="w: the rest shape is raised by k cos^2(pi d / w) at a distance d < w / 2 from the line, and no "
        "triangle is split; a membrane and sewn cloth need it [m]",
    )
    closed: bool = Field(default=False, description="whether it goes on from its last point to its first")

    @model_validator(mode="after")
    def _one_place(self) -> Line:
        names = [name for name in PLACES if getattr(self, name) is not None]
        if len(names) != 1:
            problem = "a line is given by one of points, texture, on_faces and file, not by {given}"
            inside = (names[1],) if names else ()
            raise PydanticCustomError("one_place", problem, {"given": " and ".join(names) or "none", "inside": inside})
        if self.height == 0.0:
            problem = "a height of 0 raises nothing; give one above 0 for a ridge, below for a valley"
            raise PydanticCustomError("no_height", problem, {"inside": ("height",)})
        return self


class Smoothing(Part):
    """Taubin's lambda|mu: passes of x += lambda L(x), x += mu L(x), L by uniform weights."""

    passes: int = Field(default=8, ge=0, le=1000, description="how often; 0 leaves the cloth pointed")
    shrink: Number = Field(default=0.5, gt=0, lt=1, description="lambda")
    inflate: Number = Field(default=-0.53, description="mu, below 0 and larger than lambda")
    hierarchical: bool = Field(
        default=False, description="new vertices are smoothed among themselves only, so that a ridge stays one"
    )

    @model_validator(mode="after")
    def _does_not_shrink(self) -> Smoothing:
        if self.inflate >= 0.0 or -self.inflate <= self.shrink or self.inflate <= -2.0:
            problem = "mu is {mu}, and must lie between -2 and -lambda = {low}, or smoothing shrinks the cloth"
            raise PydanticCustomError(
                "shrinks", problem, {"mu": f"{self.inflate:g}", "low": f"{-self.shrink:g}", "inside": ("inflate",)}
            )
        return self


# The closest triangles of a mesh without a tree.


@kernel
def scan(points: Float, corners: Float, face: Int, triangle: Int, weights: Float, distance: Float) -> None:
    """Find the nearest triangle of each point by testing all, as for `scan_triangles`."""
    for i in range(points.shape[0]):
        p, best, which = row_at(points, i), math.inf, 0
        for leaf in range(corners.shape[0] // 9):
            best, which = take_nearest(leaf_distances(p, corners, leaf), leaf, face, best, which)
        a, b, c = corners_of(which, corners)
        s, t, _ = nearest_in(minus(p, a), b, c)
        weights[i, 0], weights[i, 1], weights[i, 2] = 1.0 - s - t, s, t
        triangle[i], distance[i] = face[which], math.sqrt(best)


def scan_triangles(points: Float, vertices: Float, faces: Int) -> tuple[Int, Float, Float]:
    """Return the triangle (n,) nearest to each of points (n, 3) [m], barycentric coordinates (n, 3) in it, and distance
    (n,) [m], for a few points of a moving mesh: building the tree of 20,000 triangles takes as long as testing all of
    them for a thousand points. Of equally near triangles the lowest number counts.
    """
    filled = np.minimum(np.arange(-(-len(faces) // WIDTH) * WIDTH), len(faces) - 1)
    a, b, c = (vertices.take(faces[filled, k], axis=0) for k in range(3))
    corners = in_eights(np.concatenate([a, b - a, c - a], axis=1), 0.0)
    triangle, weights, distance = np.empty(len(points), np.int32), np.empty((len(points), 3)), np.empty(len(points))
    scan(np.ascontiguousarray(points), corners, filled.astype(np.int32), triangle, weights, distance)
    return triangle, weights, distance


INSIDE = 1e-3
"""Least barycentric coordinate of a line's points: a point on an edge would belong to two triangles."""
APART = 0.1
"""Least barycentric coordinate of a new vertex: smaller ones would make slivers."""
TEXTURE_TOLERANCE = 1e-6
LARGEST_FILE = 64 * 2**20
PROBLEMS = {
    NO_BORDER: (
        "the line leaves the cloth through its border",
        "end it before the border, or draw more points along the cloth",
    ),
    NO_CROWDED: (
        "the line goes over an edge of more than two triangles, or of two that face opposite ways",
        "split the mesh there, or draw round it",
    ),
    NO_WAY: (
        "no way leads over the cloth",
        "draw more points: it follows the cut of the cloth with the plane through two of them and their normals",
    ),
}
"""Problem and remedy by the status with which `walk_line` stops early."""


@dataclass(frozen=True)
class Crossed:
    """The triangles that lines cross.

    face (m,) ascending; at (m, 3) barycentric coordinates of the new vertices; height (m,) [m]; chains: for each line
    the places of its triangles in `face`, in order.
    """

    face: Int
    at: Float
    height: Float
    chains: tuple[Int, ...]


def read_lines(lines: Iterable[Line], files: Files) -> tuple[Line, ...]:
    """Return the lines of a scene, those of files as points. Raises BadInput for a file without lines."""
    result: list[Line] = []
    for i, line in enumerate(lines):
        if line.file is None:
            result.append(line)
            continue
        path = files.resolve(line.file)
        mesh = read_as(path, "OBJ", read_obj, LARGEST_FILE)
        if (most := max(map(len, mesh.lines), default=0)) > MOST_POINTS:
            raise BadInput("a line has too many points", str(path), value=most, limit=f"{MOST_POINTS} points")
        rows = (tuple(map(tuple, mesh.points[stroke].tolist())) for stroke in mesh.lines)
        result += [Line(points=points, height=line.height, width=line.width, closed=line.closed) for points in rows]
        if not mesh.lines:
            raise BadInput(
                "the file holds no lines", str(path), field=f"lines[{i}].file", remedy="an element is written: l 1 2 3"
            )
    return tuple(result)


def follow_lines(fabric: Fabric, x: Float, across: Int, lines: tuple[Line, ...], tolerance: float) -> Crossed:
    """Return the triangles that lines cross, x (n, 3) [m] being the cloth's vertices. Raises BadInput. A triangle has
    one new vertex, however many lines cross it: at the mean of their parts in it, weighted by length, with the mean of
    their heights.
    """
    faces = fabric.faces
    total, up = np.zeros((len(faces) + 1, 5)), np.zeros((len(faces), 2), np.bool_)
    chains = []
    for i, line in enumerate(lines):
        path = _follow(fabric, x, across, line, i, tolerance, (total, up))[0]
        chains.append(np.ascontiguousarray(path[np.sort(np.unique(path, return_index=True)[1])]))
    clash = np.flatnonzero(up[:, 0] & up[:, 1])
    if clash.size:
        raise BadInput(
            "a ridge and a valley go through one triangle", field="lines", value=f"triangle {clash[0]}",
            limit=f"{clash.size} of them", remedy="keep them apart by two triangles, or refine the mesh",
        )  # fmt: skip
    face = np.flatnonzero(up[:, 0] | up[:, 1]).astype(np.int32)
    part = total[face]
    at = np.maximum(part[:, :3] / part[:, 3:4], APART)
    order = np.full(len(faces), -1, np.int32)
    order[face] = np.arange(len(face), dtype=np.int32)
    return Crossed(face, at / at.sum(axis=1)[:, None], part[:, 4] / part[:, 3], tuple(order[c] for c in chains))


def _flat(fabric: Fabric, across: Int, i: int) -> tuple[Float, Int, Int]:
    """Return the cloth on its texture, cut along seams: points (p, 3) whose third coordinate is 0, triangles (f, 3) and
    those across their edges, as by `surface.link_faces`.
    """
    laid = on_texture(fabric, i)
    points = np.ascontiguousarray(np.column_stack([laid.points, np.zeros(len(laid.points))]), np.float64)
    return points, laid.faces, across if fabric.corners is None else link_faces(laid.faces, len(points))


def on_texture(fabric: Fabric, i: int) -> Corners:
    """Return the texture coordinates of the cloth, for line `i`. Raises BadInput if it has none."""
    if (laid := fabric.laid_out) is None:
        remedy = "give the line as points [m], or the mesh texture coordinates"
        raise BadInput("the cloth has no texture coordinates", field=f"lines[{i}].texture", remedy=remedy)
    return laid


def _locate(faces: Int, x: Float, line: Line, i: int, tolerance: float) -> tuple[Int, Float]:
    """Return the triangle (p,) and barycentric coordinates (p, 3) of each point of a line. Raises BadInput."""
    if line.on_faces is not None:
        numbers = np.array([place.face for place in line.on_faces], np.int64)
        if numbers.max() >= len(faces):
            limit, value = f"0 to {len(faces) - 1}", int(numbers.max())
            raise BadInput("there is no such triangle", field=f"lines[{i}].on_faces", value=value, limit=limit)
        return numbers.astype(np.int32), _move_inwards(np.array([place.at for place in line.on_faces]))
    coordinates = line.points if line.points is not None else line.texture
    points = np.zeros((len(coordinates or ()), 3))
    points[:, : 3 if line.points is not None else 2] = coordinates
    if not np.ptp(points, axis=0).any():
        raise BadInput(
            "all points of the line are one", field=f"lines[{i}]", value=points[0].tolist(), remedy="draw it longer"
        )
    face, at, distance = scan_triangles(points, x, faces)
    worst, most = int(np.argmax(distance)), tolerance if line.points is not None else TEXTURE_TOLERANCE
    if not distance[worst] <= most:
        name, unit = ("points", " m") if line.points is not None else ("texture", "")
        raise BadInput(
            "the line lies off the cloth", field=f"lines[{i}].{name}[{worst}]", value=points[worst].tolist(),
            limit=f"{distance[worst]:.4g}{unit} away, and {most:.4g}{unit} are allowed",
            remedy="draw it nearer, or raise tolerance" if unit else "texture coordinates must lie on the cloth",
        )  # fmt: skip
    return face, _move_inwards(at)


def _move_inwards(at: Float) -> Float:
    moved = np.maximum(at, INSIDE)
    return np.asarray(moved / moved.sum(axis=1)[:, None])


def trace_line(fabric: Fabric, x: Float, across: Int, line: Line, i: int, tolerance: float) -> tuple[Int, Float]:
    """Return the triangles (q,) that a line passes, in order, and its points (q + 1, 3) [m]: its start, and where it
    leaves each of them. Arguments are those of `follow_lines`. Raises BadInput.
    """
    sums = np.zeros((len(fabric.faces) + 1, 5)), np.zeros((len(fabric.faces), 2), np.bool_)
    path, at = _follow(fabric, x, across, line, i, tolerance, sums)
    return path, np.einsum("qc,qck->qk", at, x[fabric.faces[np.append(path[:1], path)]])


def _follow(
    fabric: Fabric, cloth: Float, around: Int, line: Line, i: int, tolerance: float, sums: tuple[Float, Bool]
) -> tuple[Int, Float]:
    """Return the triangles (q,) of one line in order, and the barycentric coordinates (q + 1, 3) of its start in the
    first and of where it leaves each; `sums` are total and up of `Passed`. Raises BadInput if it cannot be followed.
    """
    x, faces, across = (cloth, fabric.faces, around) if line.texture is None else _flat(fabric, around, i)
    face, at = _locate(faces, x, line, i, tolerance)
    if line.closed:
        face, at = np.append(face, face[:1]), np.concatenate([at, at[:1]])
    normal = face_normals(x, faces[face])
    normal[~normal.any(axis=1), 2] = 1.0
    points = np.einsum("pc,pck->pk", at, x[faces[face]])
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    sums[0][-1, 0] = TOUCH * max(float(step.max()), 1e-300)
    most = 2 * len(faces) + len(face)
    path, leave = np.empty(most, np.int32), np.empty((most, 3))
    polyline = Way(face, at, points, normal, float(line.height))
    status, point, passed = walk_line(x, faces, across, polyline, Passed(*sums, path, leave))
    if status != WAY:
        (problem, remedy), after = (
            PROBLEMS[status],
            (point + 1) % len(line.points or line.texture or line.on_faces or ()),
        )
        raise BadInput(problem, field=f"lines[{i}]", value=f"between points {point} and {after}", remedy=remedy)
    return path[:passed], np.concatenate([at[:1], leave[:passed]])
