"""All bodies of a scene as one geometry, their poses, and their surfaces for drawing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from weakref import WeakValueDictionary

import numpy as np

from nuno.collision.crossings import compiled
from nuno.scene.scene_file import Loaded
from nuno_schemas.bodies import BOX, CAPSULE, OF_TRIANGLES, PLANE, Geometry, Poses, Skin, rotation_matrices
from nuno_schemas.fabric import Float, Int
from nuno_schemas.live import Live
from nuno_schemas.plugin import BodyShape, Mover

KEPT = 16
"""Times whose poses are kept: more frames than the simulation runs ahead."""


@dataclass(frozen=True)
class Bodies:
    """All bodies of a scene: their geometry and their motions."""

    geometry: Geometry
    drawn: Geometry
    """What is shown and recorded: of a body that is drawn otherwise than cloth meets it, that."""
    movers: tuple[Mover | None, ...]
    notes: tuple[str, ...] = ()
    """Notes about the bodies for the user."""
    loaded: Loaded | None = None
    """Their scene."""
    _posed: dict[float, Poses] = field(default_factory=dict, repr=False, compare=False)
    """Poses of the last few times, if no other program moves a body."""

    def live(self) -> Iterator[tuple[str, tuple[str, ...], Live]]:
        """Yield name, joints and present pose of each live body."""
        for name, mover in zip(self.geometry.bodies, self.movers, strict=True):
            if mover is not None and mover.live is not None:
                yield name, mover.joints, mover.live

    def poses(self, t: float) -> Poses:
        """Return the poses of all frames at time t [s]; services of one process compute each once."""
        poses = self._posed.get(t)
        if poses is None:
            poses = self._pose(t)
            if not any(self.live()):
                self._posed[t] = poses
                for earlier in tuple(self._posed)[:-KEPT]:
                    self._posed.pop(earlier, None)
        return poses

    def _pose(self, t: float) -> Poses:
        ordered = sorted(self.movers, key=_is_surface)
        parts = [m.pose(t) if m else (np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3))) for m in ordered]
        return Poses(t, np.concatenate([q for q, _ in parts]), np.concatenate([p for _, p in parts]))


def build_bodies(loaded: Loaded) -> Bodies:
    """Build a scene's bodies and join them. Raises BadInput."""
    shapes: list[BodyShape] = []
    movers: list[Mover | None] = []
    for i, (collider, motion) in enumerate(zip(loaded.colliders, loaded.motions, strict=True)):
        with loaded.errors_at(f"bodies[{i}].motion"):
            mover = motion.plugin.prepare(motion.config, loaded.files) if motion else None
        with loaded.errors_at(f"bodies[{i}].collider"):
            shape = collider.plugin.build(collider.config, mover, loaded.files)
        shapes.append(shape)
        movers.append(replace(mover, pose=shape.pose) if mover and shape.pose else mover)
    each = zip(loaded.scene.bodies, movers, shapes, strict=True)
    notes = [f"{body.name}: {n}" for body, mover, shape in each for n in (mover.notes if mover else ()) + shape.notes]
    for body, mover in zip(loaded.scene.bodies, movers, strict=True):
        run = loaded.scene.duration
        if mover is not None and mover.lasts is not None and mover.lasts < run - 0.5 / loaded.scene.frame_rate:
            notes.append(f"{body.name}: its motion lasts {mover.lasts:.4g} s of {run:.4g} s: then it stands still")
    drawn = _geometry(loaded, [shape.shown for shape in shapes], movers)
    return Bodies(_geometry(loaded, shapes, movers), drawn, tuple(movers), tuple(notes), loaded)


_BUILT: WeakValueDictionary[int, Bodies] = WeakValueDictionary()
"""Bodies in use, by the identity of their scene, which they keep."""
_BUILDING = threading.Lock()


def shared_bodies(loaded: Loaded) -> Bodies:
    """Return a scene's bodies, built once for all services of a process. Raises BadInput."""
    with _BUILDING:
        bodies = _BUILT.get(id(loaded))
        if bodies is None:
            bodies = _BUILT[id(loaded)] = build_bodies(loaded)
        return bodies


def _is_surface(mover: Mover | None) -> bool:
    """Whether a body has a frame for each of its vertices. They come after all others, so that contact of rigid bodies
    does not pose them.
    """
    return mover is not None and mover.surface is not None


def _geometry(loaded: Loaded, shapes: list[BodyShape], movers: list[Mover | None]) -> Geometry:
    bodies = loaded.scene.bodies
    order = sorted(range(len(shapes)), key=lambda i: _is_surface(movers[i]))
    names = [f"{bodies[i].name}/{frame}" for i in order for frame in shapes[i].frames]
    starts = np.zeros(len(shapes), np.int64)
    starts[order] = np.cumsum([0, *(len(shapes[i].frames) for i in order)])[:-1]
    of_triangles = [getattr(contact.plugin, "of_triangles", False) for contact in loaded.contacts]
    fields = [None if of else field for s, of in zip(shapes, of_triangles, strict=True) for field in s.fields]
    return Geometry(
        tuple(body.name for body in bodies),
        tuple(names),
        np.concatenate([s.kind for s in shapes]).astype(np.int8),
        np.concatenate([s.frame + at for s, at in zip(shapes, starts, strict=False)]).astype(np.int32),
        np.repeat(np.arange(len(shapes), dtype=np.int32), [len(s.kind) for s in shapes]),
        np.concatenate([s.a for s in shapes]),
        np.concatenate([s.b for s in shapes]),
        np.concatenate([s.radius for s in shapes]),
        np.array([np.nan if b.stiffness == "auto" else b.stiffness for b in bodies]),
        np.array([b.damping for b in bodies]),
        np.array([b.friction for b in bodies]),
        *_join_meshes(shapes),
        tuple(fields),
        tuple(skin for s in shapes for skin in s.skins),
    )


def _join_meshes(shapes: list[BodyShape]) -> tuple[Float, Int, Int]:
    """Return vertices, faces and owners of all bodies' meshes, in Geometry's layout."""
    vertices = np.cumsum([0, *(len(s.vertices) for s in shapes)])
    primitives = np.cumsum([0, *(len(s.kind) for s in shapes)])
    return (
        np.concatenate([s.vertices for s in shapes]),
        np.concatenate([s.faces + at for s, at in zip(shapes, vertices, strict=False)]).astype(np.int32),
        np.concatenate([s.owner + at for s, at in zip(shapes, primitives, strict=False)]).astype(np.int32),
    )


# Surfaces of a scene's bodies from their geometry and poses, and normals of any mesh, for drawing.

AROUND, RINGS = 24, 6
"""Vertices around a capsule, and rings on each of its caps."""


def _frame_along(direction: Float) -> Float:
    """Return a rotation (3, 3) whose second column is `direction` (any length, y where it is 0)."""
    length = float(np.linalg.norm(direction))
    y = direction / length if length > 0.0 else np.array([0.0, 1.0, 0.0])
    helper = np.eye(3)[int(np.argmin(np.abs(y)))]
    x = np.cross(helper, y)
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _grid_faces(rows: int, columns: int) -> Int:
    """Return the triangles of a closed tube of `rows` rings, counter-clockwise from outside."""
    row, column = np.divmod(np.arange((rows - 1) * columns), columns)
    a, b = row * columns + column, row * columns + (column + 1) % columns
    c, d = a + columns, b + columns
    return np.stack([a, c, b, b, c, d], axis=1).reshape(-1, 3).astype(np.int32)


def capsule_mesh(a: Float, b: Float, radius: float) -> tuple[Float, Int]:
    """Return a closed capsule (a sphere where a = b): rings from pole to pole, all vertices on its surface."""
    latitude = np.concatenate([np.linspace(-0.5, 0.0, RINGS + 1), np.linspace(0.0, 0.5, RINGS + 1)])[1:-1] * np.pi
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    ring = radius * np.cos(latitude)[:, None, None] * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)
    ring[:, :, 1] = radius * np.sin(latitude)[:, None]
    centre = np.where((np.arange(latitude.size) <= RINGS - 1)[:, None], a, b)
    turn = _frame_along(b - a)
    body = (ring @ turn.T + centre[:, None]).reshape(-1, 3)
    poles = np.stack([a - radius * turn[:, 1], b + radius * turn[:, 1]])
    tube, n = _grid_faces(latitude.size, AROUND), body.shape[0]
    here = np.arange(AROUND)
    after, top = (here + 1) % AROUND, n - AROUND
    south = np.stack([np.full(AROUND, n), here, after], axis=1)
    north = np.stack([np.full(AROUND, n + 1), top + after, top + here], axis=1)
    return np.concatenate([body, poles]), np.concatenate([tube, south, north]).astype(np.int32)


def box_mesh(centre: Float, half: Float) -> tuple[Float, Int]:
    """Return the eight corners and twelve triangles of a box."""
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    faces = [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]  # fmt: skip
    return centre + corner * half, np.array(faces, np.int32)


def plane_mesh(point: Float, normal: Float, size: float) -> tuple[Float, Int]:
    """Return a square of edge `size` [m] around a point of the plane, facing along its normal."""
    turn = _frame_along(normal)
    corner = 0.5 * size * np.array([[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    return point + corner @ turn.T, np.array([[0, 2, 1], [0, 3, 2]], np.int32)


@dataclass(frozen=True)
class Surfaces:
    """Triangles of all bodies in their frames: vertices (n, 3) [m], faces (f, 3) counter-clockwise seen from outside,
    and the frame (n,) of each vertex; and for skins, whose vertices follow several frames, the number of the first
    vertex and the skin.
    """

    vertices: Float
    faces: Int
    frame: Int
    skins: tuple[tuple[int, Skin], ...] = ()

    def at(self, poses: Poses) -> Float:
        """Return the vertices (n, 3) in the world [m]. Raises IndexError for poses of fewer frames."""
        turned = np.einsum("nij,nj->ni", rotation_matrices(poses.rotation)[self.frame], self.vertices)
        placed = np.asarray(turned + poses.translation[self.frame])
        for first, skin in self.skins:
            part = slice(first, first + len(skin.joint))
            placed[part] = poses.bend(skin, int(self.frame[first]), self.vertices[part], compiled().bend_skin)
        return placed


NO_SURFACES = Surfaces(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0, np.int32))


def surface(geometry: Geometry, plane_size: float = 4.0) -> Surfaces:
    """Return the surfaces of all primitives, in order; infinite planes become squares of `plane_size` [m]."""
    parts = [_primitive(geometry, i, plane_size) for i in range(len(geometry.kind))]
    if not parts:
        return NO_SURFACES
    sizes = [len(x) for x, _ in parts]
    faces = [own + at for (_, own), at in zip(parts, np.cumsum([0, *sizes]), strict=False)]
    frame = np.repeat(geometry.frame, sizes).astype(np.int32)
    skins = tuple(
        (int(at), skin) for i, at in enumerate(np.cumsum([0, *sizes[:-1]])) if (skin := geometry.skin(i)) is not None
    )
    return Surfaces(np.concatenate([x for x, _ in parts]), np.concatenate(faces).astype(np.int32), frame, skins)


def find_sizes(geometry: Geometry, poses: Poses) -> dict[str, Float]:
    """Return the extents (3,) [m] of bodies along x, y and z by name; planes have none."""
    bodies = [geometry.of_bodies([i]) for i in range(len(geometry.bodies))]
    return {one.bodies[0]: np.ptp(surface(one).at(poses), axis=0) for one in bodies if PLANE not in one.kind}


def _primitive(geometry: Geometry, i: int, plane_size: float) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and faces (f, 3) of one primitive in its frame."""
    kind, a, b, radius = geometry.kind[i], geometry.a[i], geometry.b[i], float(geometry.radius[i])
    if kind in OF_TRIANGLES:
        return geometry.mesh(i)
    if kind == BOX:
        return box_mesh(a, b)
    if kind == PLANE:
        return plane_mesh(a, b, plane_size)
    if kind == CAPSULE:
        return capsule_mesh(a, b, radius)
    raise ValueError(f"unknown primitive kind {int(kind)}")


def vertex_normals(x: Float, faces: Int) -> Float:
    """Return unit normals (n, 3) of vertices x (n, 3): means over their triangles by area, 0 without any."""
    a, b, c = np.take(x, faces.T, axis=0)
    u, v, corners = (b - a).T, (c - a).T, faces.reshape(-1)
    twice = (u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3))  # the cross product, by axes
    normal = np.stack([np.bincount(corners, np.repeat(area, 3), len(x)) for area in twice], axis=1)
    size = np.sqrt(normal[:, 0] ** 2 + normal[:, 1] ** 2 + normal[:, 2] ** 2)
    return np.asarray(normal / np.where(size > 0.0, size, 1.0)[:, None])


def outlines(faces: Int) -> list[list[int]]:
    """Return the boundary loops of triangles (f, 3), as lists of points."""
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    inner = {(b, a) for a, b in sides}
    after: dict[int, list[int]] = {}
    for a, b in sides:
        if (a, b) not in inner:
            after.setdefault(a, []).append(b)
    loops = []
    while any(after.values()):
        loop = [next(point for point, ends in after.items() if ends)]
        while (point := after[loop[-1]].pop()) != loop[0]:
            loop.append(point)
        loops.append(loop)
    return loops
