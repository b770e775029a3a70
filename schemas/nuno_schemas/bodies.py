"""Bodies that cloth meets: rigid primitives on moving frames, and skins that follow several of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.layout import Bounds

# A skin that follows frames: each vertex goes with a few of them, by fixed weights.

TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Skin:
    """Skinning of s vertices: each follows k of the skin's q frames, which begin at the frame of its primitive.

    place  (q, 3) [m]    origins of the frames, unrotated, in the bind pose, which is that of the geometry's vertices
    joint  (s, k) int32  frames of each vertex, from 0, the one with the largest weight first
    weight (s, k)        weights of these frames, with a sum of 1

    The lengths s and q belong to this skin alone: a geometry has v vertices and f frames of all its bodies.
    """

    place: Annotated[Float, "q", 3]
    joint: Annotated[Int, "s", "k", Bounds(0, below="q")]
    weight: Annotated[Float, "s", "k", Bounds(0.0, 1.0)]

    def bend(self, x: Float, rotation: Float, translation: Float) -> Float:
        """Return the positions (s, 3) of vertices x (s, 3) [m] for frames with rotation (q, 4) and translation (q, 3).

        The motion of each frame since the bind pose is a dual quaternion; those of a vertex are added by weight, and
        the sum is normalised (L. Kavan et al., Geometric skinning with approximate dual quaternion blending, ACM
        Transactions on Graphics 27(4), 2008). Linear blend skinning adds matrices instead: their sum is not a rotation,
        and joints become thin. The sums are written out, for the same bits on every machine.
        """
        real, moved, first = np.zeros((len(x), 4)), np.zeros((len(x), 4)), rotation[self.joint[:, 0]]
        dual = self.dual(rotation, translation)
        for k in range(self.joint.shape[1]):
            frame = self.joint[:, k]
            turn = rotation[frame]
            # A quaternion and its negative are the same rotation: take the sign nearer to the first frame's.
            signed = np.where((turn * first).sum(axis=1) < 0.0, -1.0, 1.0) * self.weight[:, k]
            real += signed[:, None] * turn
            moved += signed[:, None] * dual[frame]
        length = np.sqrt((real * real).sum(axis=1, keepdims=True))
        real, moved = real / length, moved / length
        w, v, e, d = real[:, :1], real[:, 1:], moved[:, :1], moved[:, 1:]
        return np.asarray(_turned(real, x) + 2.0 * (w * d - e * v + np.cross(v, d)))

    @property
    def is_surface(self) -> bool:
        """Whether each vertex has a frame of its own, as those of a surface that is animated from outside."""
        return self.joint.shape == (len(self.place), 1)

    def dual(self, rotation: Float, translation: Float) -> Float:
        """Return half of the shift of each frame since the bind pose times its rotation, quaternions (q, 4)."""
        shift, w, v = translation - _turned(rotation, self.place), rotation[:, :1], rotation[:, 1:]
        return 0.5 * np.concatenate([-(shift * v).sum(axis=1, keepdims=True), w * shift + np.cross(shift, v)], axis=1)

    def beside(self, points: Float, x: Float, faces: Int) -> Skin:
        """Return a skin for points (n, 3) near this skin, with vertices x (v, 3) [m] and triangles faces (f, 3): each
        point gets the interpolated weights of its projection to the nearest triangle around its nearest vertex.
        """
        whole = np.zeros((len(points), len(self.place)))
        for point, joints in zip(points, whole, strict=True):
            nearest = ((x - point) ** 2).sum(axis=1).argmin()
            around = faces[(faces == nearest).any(axis=1)]
            a, b, c = (x[around[:, k]] for k in range(3))
            areas = [np.cross(p - point, q - point) for p, q in ((b, c), (c, a), (a, b))]
            share = np.maximum((np.stack(areas) * np.cross(b - a, c - a)).sum(axis=2), 0.0)
            share /= np.maximum(share.sum(axis=0), TINY)
            off = (share[:, :, None] * np.stack([a, b, c])).sum(axis=0) - point
            best = (off * off).sum(axis=1).argmin()
            for corner, part in zip(around[best], share[:, best], strict=True):
                np.add.at(joints, self.joint[corner], part * self.weight[corner])
        most = max(1, int((whole > 0.0).sum(axis=1).max(initial=1)))
        joint = np.argsort(-whole, axis=1, kind="stable")[:, :most].astype(np.int32)
        weight = np.take_along_axis(whole, joint, axis=1)
        return Skin(self.place, joint, weight / weight.sum(axis=1, keepdims=True))

    def unbend(self, x: Float, rotation: Float, translation: Float) -> Float:
        """Return the bind-pose positions (v, 3) of vertices that are bent to x (v, 3) [m]: the inverse of `bend`."""
        origin, *axes = (
            self.bend(np.broadcast_to(point, x.shape), rotation, translation) for point in (np.zeros(3), *np.eye(3))
        )
        return np.stack([((x - origin) * (axis - origin)).sum(axis=1) for axis in axes], axis=1)


NO_SKIN = Skin(np.zeros((0, 3)), np.zeros((0, 1), np.int32), np.zeros((0, 1)))


def join_skins(skins: Sequence[Skin]) -> Skin:
    """Join skins into one, on all their frames in order, with as many weights per vertex as the largest has."""
    if not skins:
        return NO_SKIN
    most = max(skin.joint.shape[1] for skin in skins)
    starts = np.cumsum([0, *(len(skin.place) for skin in skins)])
    joint = [
        np.pad(skin.joint + np.int32(start), ((0, 0), (0, most - skin.joint.shape[1])), "edge")
        for skin, start in zip(skins, starts, strict=False)
    ]
    weight = [np.pad(skin.weight, ((0, 0), (0, most - skin.weight.shape[1]))) for skin in skins]
    return Skin(*(np.concatenate(part) for part in ([skin.place for skin in skins], joint, weight)))


def _turned(rotation: Float, x: Float) -> Float:
    """Rotate vectors x (n, 3) by unit quaternions (n, 4)."""
    w, v = rotation[:, :1], rotation[:, 1:]
    half = np.cross(v, x) + w * x
    return np.asarray(x + 2.0 * np.cross(v, half))


# A sampled signed distance field: cells of many sizes, with the distance and its gradient at their corners.


@dataclass(frozen=True)
class DistanceField:
    """Signed distance from a closed surface, negative inside, interpolated trilinearly in the cell of a point.

    low       (3,) [m]      lowest corner of a box of whole cells
    size      [m]           edge of a whole cell
    shape     (3,) int32    whole cells along x, y and z
    tolerance [m]           largest error within `band` [m] of the surface; farther away it grows with the distance
    band      [m]
    child     (c,) int32    an octree: first the whole cells, z fastest, then the eight children of each divided cell,
                            z fastest. The index of a cell's first child, or -1 - (number of a leaf)
    corners   (l, 32) float32  distance [m] and gradient x, y, z at the eight corners of each leaf, z fastest
    """

    low: Annotated[Float, 3]
    size: Annotated[float, Bounds(above=0.0)]
    shape: Annotated[Int, 3, Bounds(1)]
    tolerance: Annotated[float, Bounds(above=0.0)]
    band: float
    child: Annotated[Int, "c"]
    corners: Annotated[NDArray[np.float32], "l", 32]

    @property
    def nbytes(self) -> int:
        """Memory of its arrays [bytes]."""
        return self.child.nbytes + self.corners.nbytes


@runtime_checkable
class ClosedForm(Protocol):
    """A signed distance [m] by a formula, negative inside: a named tuple of numbers with this compiled method
    (nuno_kernels.formula).
    """

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Return the distance from points in the frame [m]: numbers, or arrays that broadcast."""
        ...


CAPSULE, PLANE, BOX, MESH, FIELD, SKIN = 0, 1, 2, 3, 4, 5
OF_TRIANGLES = (MESH, FIELD, SKIN)
"""Kinds of primitives that have a mesh; the mesh of a FIELD may have holes, and that of a SKIN bends."""


def no_rows(kind: type[np.generic], *columns: int) -> NDArray[Any]:
    """Return an empty array of shape (0, *columns)."""
    return np.zeros((0, *columns), kind)


@dataclass(frozen=True)
class Geometry:
    """Everything about bodies that does not change: sent once.

    bodies     names of the b bodies; frames: names "body/frame" of the f frames
    kind       (p,) int8     CAPSULE (a sphere where a = b), PLANE, BOX, MESH, FIELD or SKIN
    frame      (p,) int32    frame that carries the primitive; of a skin the first of its frames
    body       (p,) int32    body it belongs to; a body is the union of its primitives
    a, b       (p, 3)        in the frame [m]: capsule ends; plane point and unit normal;
                             box centre and half extents; lowest and highest corner of a mesh or field, and of a
                             skin in its bind pose
    radius     (p,)          [m], capsules only, else 0
    stiffness  (b,)          penalty stiffness per cloth vertex [N/m]; NaN = chosen by the solver
    damping    (b,)          damping of the normal velocity in contact, as a ratio of critical
    friction   (b,)          Coulomb coefficient
    vertices   (v, 3)        vertices of all meshes, in their primitives' frames, of skins in their bind pose [m]
    faces      (t, 3) int32  triangles of the meshes, counter-clockwise seen from outside, each MESH closed, and
                             each SKIN but for parts that then have no inside
    owner      (t,) int32    primitive of each triangle
    fields                   distances of the FIELD primitives, in their order, sampled or by a closed form; None if
                             contact uses the triangles; empty if the bodies are only drawn
    skins                    skins of the SKIN primitives, in their order
    """

    bodies: Annotated[tuple[str, ...], "b"]
    frames: Annotated[tuple[str, ...], "f"]
    kind: Annotated[NDArray[np.int8], "p", Bounds(CAPSULE, SKIN)]
    frame: Annotated[Int, "p", Bounds(0, below="f")]
    body: Annotated[Int, "p", Bounds(0, below="b")]
    a: Annotated[Float, "p", 3]
    b: Annotated[Float, "p", 3]
    radius: Annotated[Float, "p"]
    stiffness: Annotated[Float, "b", Bounds(finite=False)]
    damping: Annotated[Float, "b"]
    friction: Annotated[Float, "b"]
    vertices: Annotated[Float, "v", 3] = field(default_factory=partial(no_rows, np.float64, 3))
    faces: Annotated[Int, "t", 3, Bounds(0, below="v")] = field(default_factory=partial(no_rows, np.int32, 3))
    owner: Annotated[Int, "t", Bounds(0, below="p")] = field(default_factory=partial(no_rows, np.int32))
    fields: tuple[DistanceField | ClosedForm | None, ...] = ()
    skins: tuple[Skin, ...] = ()

    @property
    def own_frames(self) -> Int:
        """Numbers (k,) of the frames that are not of a single vertex of a surface each."""
        own = np.ones(len(self.frames), bool)
        for first, skin in zip(self.frame[self.kind == SKIN].tolist(), self.skins, strict=True):
            own[first : first + len(skin.place)] = not skin.is_surface
        return np.flatnonzero(own).astype(np.int32)

    def skin(self, primitive: int) -> Skin | None:
        """Return the skin of a SKIN primitive, None for others."""
        return self.skins[int((self.kind[:primitive] == SKIN).sum())] if self.kind[primitive] == SKIN else None

    def distance_field(self, primitive: int) -> DistanceField | ClosedForm | None:
        """Return the distance field that contact with a primitive reads, or None."""
        if self.kind[primitive] != FIELD or not self.fields:
            return None
        return self.fields[int((self.kind[:primitive] == FIELD).sum())]

    def of_primitives(self, chosen: Sequence[int]) -> Geometry:
        """Return only the primitives of ascending numbers `chosen`, with all bodies and frames."""
        arrays = {name: getattr(self, name)[chosen] for name in ("kind", "frame", "body", "a", "b", "radius")}
        kept = np.isin(self.owner, chosen)
        return replace(
            self, **arrays, faces=self.faces[kept], owner=np.searchsorted(chosen, self.owner[kept]).astype(np.int32),
            fields=tuple(self.distance_field(i) for i in chosen if self.kind[i] == FIELD),
            skins=tuple(skin for i in chosen if (skin := self.skin(i)) is not None),
        )  # fmt: skip

    def of_bodies(self, chosen: Sequence[int]) -> Geometry:
        """Return only the bodies of ascending numbers `chosen`, with all frames."""
        part = self.of_primitives(np.flatnonzero(np.isin(self.body, chosen)).tolist())
        arrays = {name: getattr(self, name)[chosen] for name in ("stiffness", "damping", "friction")}
        body = np.searchsorted(chosen, part.body).astype(np.int32)
        return replace(part, **arrays, bodies=tuple(self.bodies[i] for i in chosen), body=body)

    def mesh(self, primitive: int) -> tuple[Float, Int]:
        """Return the vertices (n, 3) [m], in ascending order, and faces (f, 3) of a primitive that has a mesh."""
        used, numbers = np.unique(self.faces[self.owner == primitive], return_inverse=True)
        return self.vertices[used], numbers.reshape(-1, 3).astype(np.int32)

    def placed(self, primitive: int, poses: Poses) -> tuple[Float, Int]:
        """Return the mesh with its vertices in the world. Raises IndexError for poses with too few frames.

        The sum is written out: the bits of a matrix product differ between machines, and cloth is built on this mesh.
        """
        x, faces = self.mesh(primitive)
        frame = int(self.frame[primitive])
        if (skin := self.skin(primitive)) is not None:
            return poses.bend(skin, frame, x), faces
        turn = rotation_matrices(poses.rotation[frame][None])[0]
        turned = x[:, :1] * turn[:, 0] + x[:, 1:2] * turn[:, 1] + x[:, 2:] * turn[:, 2]
        return turned + poses.translation[frame], faces


@dataclass(frozen=True)
class Poses:
    """Poses of the frames at time t [s]: world = R(rotation) local + translation.

    rotation    (f, 4) unit quaternions w, x, y, z
    translation (f, 3) [m]
    Within a frame of animation both are interpolated (slerp, linear), and the velocity of that
    interpolation is the body's velocity. Vertices of skins move in a straight line from start to end of the frame.
    """

    t: Annotated[float, Bounds()]
    rotation: Annotated[Float, "f", 4]
    translation: Annotated[Float, "f", 3]

    def bend(self, skin: Skin, first: int, x: Float, by: Callable[..., Float] = Skin.bend) -> Float:
        """Return the world positions (v, 3) [m] of the vertices x (v, 3) of a skin with frames from number `first` on;
        `by` does what Skin.bend does.

        Raises IndexError for poses with too few frames.
        """
        frames = slice(first, first + len(skin.place))
        if len(self.rotation[frames]) < len(skin.place):
            raise IndexError(f"a skin on {len(skin.place)} frames from number {first} on, of {len(self.rotation)}")
        return by(skin, x, self.rotation[frames], self.translation[frames])

    def same_place(self, other: Poses) -> bool:
        """Return whether the frames have the same poses as others, to the last bit."""
        return np.array_equal(self.rotation, other.rotation) and np.array_equal(self.translation, other.translation)


STILL = np.array([[1.0, 0.0, 0.0, 0.0]])


def all_rotations(rotation: Float, frames: int) -> Float:
    """Return rotations (f, 4) of so many frames: the given ones, and frames after them that do not turn."""
    return np.concatenate([rotation, np.tile(STILL, (max(frames - len(rotation), 0), 1))])


def rotation_matrices(q: Float) -> Float:
    """Convert (f, 4) unit quaternions to (f, 3, 3) matrices."""
    w, x, y, z = (q[..., i] for i in range(4))
    m = np.empty((*q.shape[:-1], 3, 3))
    m[..., 0, 0], m[..., 0, 1], m[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    m[..., 1, 0], m[..., 1, 1], m[..., 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    m[..., 2, 0], m[..., 2, 1], m[..., 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return m


SMALLEST, LARGEST = 0.02, 5.0
"""Longest side of the bounding box of a body that can wear cloth [m]: from a doll's leg to twice a person."""
PERSON = 0.95, 2.35
"""Height of a standing person, from a small child on [m]: units differ by more, so that only one fits a person."""
METRES = 0.3, 2.4
"""A body or part of a body of this size is taken to be in metres: in no other unit would it be a person's size [m]."""
WORN = 0.8, 1.9
"""Height of the wearer over the height up to which a garment's pattern is placed [-]: from a hood to a waist."""
UNITS = {"1mm": 1e-3, "1cm": 1e-2, "1inch": 0.0254, "1dm": 0.1, "1ft": 0.3048, "1m": 1.0,
         "10m": 10.0, "100m": 100.0, "1km": 1e3}  # fmt: skip
"""Possible units of a file [m]; those over a metre are for bodies that were divided by 10 to 1000."""


def fits_person(height: float) -> bool:
    """Return whether a height [m] is that of a person."""
    return PERSON[0] <= height <= PERSON[1]


def unit_of(size: float, worn: float = 0.0) -> str:
    """Return the unit of a body's file, from the longest side of its bounding box in that unit; empty if no unit fits.

    `worn` is the height up to which the pattern of its garment is placed [m], 0 if unknown.
    """
    if METRES[0] <= size <= METRES[1]:
        return "1m"
    wearers = [(WORN[0] * worn, WORN[1] * worn)] if worn > 0.0 else []
    fits = (name for low, high in (*wearers, PERSON) for name, unit in UNITS.items() if low <= size * unit <= high)
    return next(fits, "")


def units_for(size: float) -> dict[str, float]:
    """Return the units in which a file's size is that of a person, a part of one or a garment, each with it in [m]."""
    return {unit: size * long for unit, long in UNITS.items() if METRES[0] <= size * long <= METRES[1]}


def check_size(x: Float, body: str, scale: float) -> None:
    """Raise BadInput for a body x (v, 3) [m] of an implausible size; `body` is its name, `scale` the assumed length of
    its file's unit [m].
    """
    size = float(np.ptp(x, axis=0).max())
    if SMALLEST <= size <= LARGEST:
        return
    setting, assumed = f"bodies.{body}.collider.scale", "metres" if scale == 1.0 else f"the {scale:g} m of its scale"
    # It may be a part of a person: more than one unit may fit.
    fits = units_for(size / scale)
    units = [f"{unit} if it is {long:.3g} m long" for unit, long in fits.items()] if len(fits) > 1 else list(fits)
    remedy = f"say how long its unit is: --set {setting}={', '.join(units) or 'LENGTH'}"
    raise BadInput(
        f"the body is too small or too large to wear anything: its file may be in another unit than {assumed}",
        field="over.body", value=f"{body}, {size:.3g} m long", limit=f"{SMALLEST:g} to {LARGEST:g} m",
        remedy=f"it seems to be in metres: leave {setting} out, or --set {setting}=1m" if "1m" in fits else remedy,
    )  # fmt: skip
