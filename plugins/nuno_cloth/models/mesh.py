"""Any triangle mesh as a garment."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_cloth.fabrics.material import FABRIC, FabricChoice, HandSet, resolve
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.membrane import TENSION, OfTriangles, Tension, build_elements
from nuno_cloth.models.placement import (
    STILL,
    TEXTURE,
    VELOCITY,
    Attach,
    Direction,
    Point,
    Rotation,
    Velocity,
    find_texture,
)
from nuno_cloth.models.triangles import ACROSS, Edges, find_edges, second_axis
from nuno_cloth.quantities import Scale
from nuno_geometry.mesh_files.mesh import join_vertices, load_mesh, material_images
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Binding, Bool, Corners, Fabric, Float, Int
from nuno_schemas.plugin import Config, Files
from nuno_schemas.reading import read_as
from nuno_schemas.vectors import face_areas, turn

KINDS = ("obj", "ply", "stl")
SEEN_ACROSS = 0.1
"""Share of the cloth that its warp may be normal to without a word."""
LARGEST_GROUPS = 256 * 2**20
TAKEN = 0.5
"""Weight from which on a vertex belongs to a group."""
FARTHEST = 1e100
"""Squares and cubes of coordinates beyond this [m] overflow."""


class Box(Config):
    """Vertices inside it are pinned."""

    low: Point = Field(description="corner with the smallest x, y and z, in the world [m]")
    high: Point = Field(description="corner with the largest x, y and z, in the world [m]")


Pin = int | Box | Annotated[str, Field(min_length=1)]


class MeshConfig(Config):
    """A file's triangles: scaled, turned about the file's origin, then moved by `centre`."""

    file: str = Field(description="a mesh beside the scene: OBJ, PLY or STL")
    scale: Scale = Field(default=1.0, description="length of one of the file's units [m]")
    rotate: Rotation | None = Field(default=None, description="a turn about the file's origin")
    centre: Point = Field(default=(0.0, 0.0, 0.0), description="where the file's origin comes to lie [m]")
    velocity: Velocity = Field(default=STILL, description=VELOCITY)
    warp: Direction = Field(
        default=(0.0, 1.0, 0.0),
        description="direction of the warp yarns in the file's axes, laid onto each triangle; triangles that it is "
        "normal to have another axis laid onto them, z if it is upright",
    )
    merge: bool = Field(
        default=False,
        description="join vertices at the same place on the rims of the file's pieces: files that are cut along the "
        "seams of a texture need it; STL, which has no shared vertices, is always merged",
    )
    pin: tuple[Pin, ...] = Field(
        default=(),
        description="vertex numbers of the file, counted from 0, also where it is merged, boxes of the world "
        "{low, high} [m], or names of `groups`; the vertices of an STL are counted as their places first appear",
        examples=[[0, 7]],
    )
    groups: str | None = Field(
        default=None,
        description="a JSON file beside the scene with groups of the file's vertices: {name: [number, ...]}, or "
        "{name: {number: weight}}, which takes weights of 0.5 and more",
    )
    attach: Attach | None = Field(
        default=None,
        description="the body and frame that its pinned vertices follow; at rest in the world unless given",
    )
    fabric: FabricChoice = Field(default="denim", description=FABRIC)
    tension: Tension = Field(default="auto", description=TENSION)
    texture: str | None = Field(default=None, description=TEXTURE)

    @model_validator(mode="after")
    def _names_are_of_groups(self) -> MeshConfig:
        for i, pin in enumerate(self.pin if self.groups is None else ()):
            if isinstance(pin, str):
                problem = "a mesh has no pins with names; give vertex numbers, such as pin: [0, 7], or boxes, such as "
                problem += "pin: [{low: [-1, 0.9, -1], high: [1, 2, 1]}], or the names' vertices in groups: FILE.json"
                raise PydanticCustomError("no_groups", problem, {"inside": ("pin", i)})
        return self


class Mesh(OfTriangles):
    """A mesh with a measured fabric's membrane and bending, or with springs on the edges and hinges, or, for a fabric
    set by hand with `bending`, the wrinkle paper's springs between the two vertices opposite each inner edge.
    """

    name: ClassVar[str] = "mesh"
    Config: ClassVar[type[BaseModel]] = MeshConfig

    def count(self, config: MeshConfig, files: Files) -> int:
        return len(read_mesh(files.resolve(config.file), config.merge).points)

    def left_out(self, config: MeshConfig, files: Files) -> tuple[str, ...]:
        """Describe the images of an OBJ file's materials, which a mesh without a `texture` does not show."""
        path = files.resolve(config.file)
        images = [] if config.texture is not None or path.suffix.lower() != ".obj" else material_images(path)
        return tuple(
            f"the materials of {path.name} name the image {image}, and are not read: give the model "
            f'texture: "{image}", or the object a colour'
            for image in images
        )

    def doubts(self, config: MeshConfig, files: Files) -> tuple[str, ...]:
        """Describe a warp of measured cloth that is normal to more than SEEN_ACROSS of it."""
        if not isinstance(resolve(config.fabric), Material):
            return ()
        points, faces, *_ = read_mesh(files.resolve(config.file), config.merge)
        warp, normal = np.asarray(config.warp), np.cross(*np.diff(points[faces], axis=1).transpose(1, 0, 2))
        size = np.linalg.norm(normal, axis=1)
        across = np.linalg.norm(np.cross(warp, normal), axis=1) <= ACROSS * np.linalg.norm(warp) * size
        share = float(size[across].sum() / max(size.sum(), 1e-300))
        if share <= SEEN_ACROSS:
            return ()
        matrix = np.eye(3) if config.rotate is None else config.rotate.matrix()
        axis = "xyz"[int(second_axis(turn(matrix, warp)).argmax())]
        return (
            f"warp: it is normal to {share:.0%} of the cloth, where the yarns lie along {axis} instead: give another",
        )

    def build(self, config: MeshConfig, files: Files, seed: int) -> Fabric:
        """Build the garment. Raises BadInput for a mesh that is empty, degenerate, not manifold, not oriented."""
        path = files.resolve(config.file)
        points, faces, uv, numbers, merged = read_mesh(path, config.merge)
        edges = find_edges(faces)
        check_mesh(path, points, faces, edges, numbers)
        matrix = np.eye(3) if config.rotate is None else config.rotate.matrix()
        x = np.ascontiguousarray(turn(matrix, points) * config.scale + np.asarray(config.centre))
        far = ~(np.abs(x) <= FARTHEST).all(axis=1)
        if far.any():
            where, at = int(numbers[np.argmax(far)]), x[far][0].tolist()
            limit, remedy = f"{FARTHEST:g} m", "give a smaller `scale`, or mend the file"
            raise BadInput("too far away", str(path), field=f"vertex {where}", value=at, limit=limit, remedy=remedy)
        material = resolve(config.fabric)
        warp = turn(matrix, np.asarray(config.warp))
        groups = {} if config.groups is None else read_groups(files.resolve(config.groups))
        held = pin_mesh(config.pin, x, numbers if merged is None else merged, groups)
        elements = build_elements(material, x, faces, edges, warp, tension=config.tension, held=held)
        more = lay_out(path, len(x), faces, uv, config.texture is not None)
        more |= {"texture": find_texture(config.texture, files), "merged": merged}
        if config.attach is not None:
            if not held.any():
                problem, remedy = "nothing is pinned that could follow a body", "pin: [NAME], of a group"
                raise BadInput(problem, field="attach", remedy=remedy)
            places = np.flatnonzero(held).astype(np.int32)
            more["bindings"] = (Binding(places, config.attach.body, config.attach.frame),)
        # Without inner edges no spring shows the bending stiffness.
        origin = {"k_bend": material.bending[0]} if isinstance(material, HandSet) and not len(edges.inner) else {}
        return elements.fabric(self.name, x, held, config.velocity, origin=origin, **more)


class ClothMesh(NamedTuple):
    """A file's triangles, merged or not.

    points   (n, 3)     vertices in the file's axes and unit
    faces    (f, 3)     triangles
    uv       (f, 3, 2)  texture coordinates of their corners, or None
    numbers  (n,)       the file's number of each vertex, its first; of an STL, which numbers none, its own
    merged   (g,)       the vertex of each of the file's numbers, if they were merged, or None
    """

    points: Float
    faces: Int
    uv: NDArray[np.float32] | None
    numbers: Int
    merged: Int | None


def read_mesh(path: Path, merge: bool) -> ClothMesh:
    """Read a file. Raises BadInput."""
    mesh = load_mesh(path, KINDS)
    points, faces = np.ascontiguousarray(mesh.points), np.ascontiguousarray(mesh.faces, np.int32)
    stl = path.suffix.lower() == ".stl"
    if not merge and not stl:
        return ClothMesh(points, faces, mesh.uv, np.arange(len(points), dtype=np.int32), None)
    kept, joined = (indices.astype(np.int32) for indices in join_vertices(points, faces))
    numbers, merged = (np.arange(len(kept), dtype=np.int32), None) if stl else (kept, joined)
    return ClothMesh(points[kept], joined[faces], mesh.uv, numbers, merged)


def lay_out(path: Path, number: int, faces: Int, uv: NDArray[np.float32] | None, printed: bool) -> dict[str, Any]:
    """Return texture coordinates as fields of a fabric of `number` vertices: `uv` of vertices where all triangles
    agree, else `corners`; empty if a triangle has none. Raises BadInput if `printed`, because a print needs them.
    """
    missing = np.ones(len(faces), bool) if uv is None else ~np.isfinite(uv).all(axis=(1, 2))
    if uv is None or missing.any():
        if printed:
            problem = f"{int(missing.sum())} of {len(faces)} triangles have no texture coordinates, which a print needs"
            remedy = "unwrap the mesh in the program that it comes from, or leave `texture` out"
            raise BadInput(problem, str(path), field="texture", value=f"face {np.argmax(missing)}", remedy=remedy)
        return {}
    corners = Corners.of(faces, uv)
    return {"uv": corners.points} if len(corners.points) == number else {"corners": corners}


def check_mesh(path: Path, x: Float, faces: Int, edges: Edges, numbers: Int) -> None:
    """Raise BadInput that names the first bad vertex, face or edge, by the file's `numbers` (n,) of vertices; nothing
    is mended silently.
    """

    def refuse(
        bad: NDArray[np.integer], field: str, shown: Int | None, problem: str, remedy: str | None = None
    ) -> None:
        """Raise BadInput for the first of the `bad` numbers, if any, with its row of `shown`, vertices of triangles or
        edges, or with the place of the vertex.
        """
        if bad.size:
            first = int(bad[0])
            name, value = (numbers[first], x[first]) if shown is None else (first, numbers[shown[first]])
            raise BadInput(problem, str(path), field=field.format(name), value=value.tolist(), remedy=remedy)

    refuse(np.flatnonzero(~np.isfinite(x).all(axis=1)), "vertex {}", None, "not a finite position")
    _, first, count = np.unique(x, axis=0, return_index=True, return_counts=True)
    shared = np.sort(first[count > 1])
    if shared.size:
        merges = len(join_vertices(x, faces)[0]) == len(first)
        remedy = "merge: true" if merges else "move what touches apart: cloth in contact has a distance"
        refuse(shared, "vertex {}", None, f"{shared.size} places hold several vertices", remedy)
    unused = np.setdiff1d(np.arange(len(x)), faces)
    problem = f"{unused.size} vertices belong to no triangle and would weigh nothing"
    refuse(unused, "vertex {}", None, problem, "remove them")
    longest = np.square(x[faces] - x[np.roll(faces, 1, axis=1)]).sum(-1).max(1)
    flat = np.flatnonzero(face_areas(x[faces]) <= 1e-9 * longest)
    refuse(flat, "face {}", faces, f"{flat.size} triangles without area", "remove them in a mesh editor")
    crowded = np.flatnonzero(edges.count > 2)
    refuse(crowded, "edge", edges.pairs, "an edge with more than two triangles", "split the mesh there")
    twisted = np.setdiff1d(np.flatnonzero(edges.count == 2), edges.inner)
    refuse(twisted, "edge", edges.pairs, "neighbouring triangles face opposite ways", "make the normals consistent")


def read_groups(path: Path) -> dict[str, list[int]]:
    """Return the numbers of vertices of each group of a JSON file. Raises BadInput."""

    def read(data: bytes) -> dict[str, list[int]]:
        found = {}
        for name, group in json.loads(data).items():
            numbers = [n for n, w in group.items() if float(w) >= TAKEN] if isinstance(group, dict) else list(group)
            found[name] = [int(number) for number in numbers]
        return found

    return read_as(path, "groups of vertices", read, LARGEST_GROUPS)


def pin_mesh(pins: tuple[Pin, ...], x: Float, vertices: Int, groups: Mapping[str, Sequence[int]]) -> Bool:
    """Return which vertices (n,) are pinned; x (n, 3) in the world [m], `vertices` (g,) by number. Raises BadInput."""
    pinned = np.zeros(len(x), np.bool_)
    for index, pin in enumerate(pins):
        field = f"pin[{index}]"
        if isinstance(pin, Box):
            inside = ((x >= np.asarray(pin.low)) & (x <= np.asarray(pin.high))).all(axis=1)
            if not inside.any():
                remedy = "corners are in the world, low before high"
                raise BadInput("the box holds no vertex", field=field, remedy=remedy)
            pinned |= inside
            continue
        if isinstance(pin, str) and not groups.get(pin):
            problem = "the group holds no vertex" if pin in groups else "no such group of vertices"
            remedy = "leave it out, or pin a box" if pin in groups else nearest(pin, list(groups))
            raise BadInput(problem, field=field, value=pin, remedy=remedy)
        for number in groups[pin] if isinstance(pin, str) else [pin]:
            if not 0 <= number < len(vertices):
                limit = f"0 to {len(vertices) - 1}"
                remedy = "take the file's numbers, counted from 0, or a box: {low: [x, y, z], high: [x, y, z]}"
                raise BadInput("the file has no such vertex", None, None, field, number, limit, remedy)
            pinned[vertices[number]] = True
    return pinned
