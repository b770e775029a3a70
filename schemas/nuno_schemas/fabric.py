"""Fabric (constant) and state (varying), as a model builds them. SI units throughout.

Springs and hinges are stored as runs: `count` elements whose indices all grow by `stride`.
A 256 x 256 sheet has 1,536 spring runs instead of 392,000 index pairs, and kernels vectorise
over runs; an irregular mesh has runs of one. Constants are given per run or per element,
whichever is shorter, and `pairs()` or `quads()` returns the plain list.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.layout import Bounds

Float = NDArray[np.float64]
Int = NDArray[np.int32]
Bool = NDArray[np.bool_]


# Elasticity of triangle meshes of a measured fabric, independent of the mesh: membrane, bending, bending friction.


@dataclass(frozen=True)
class Membrane:
    """Triangles of constant strain: energy A (C_w e_w^2 + C_f e_f^2 + 2 C_wf e_w e_f + G g^2) / 2 each.

    The cloth's unit vectors along warp and weft become F_w = a (x1 - x0) + b (x2 - x0) and F_f; the strains are
    e_w = |F_w| - 1, e_f = |F_f| - 1 and g = F_w.F_f, the angle of shear where they are small.

    faces    (t, 3) int32  vertices x0, x1, x2
    along    (t, 2)        a, b of F_w [1/m]
    across   (t, 2)        a, b of F_f [1/m]
    area     (t,)          A, at rest [m^2]
    moduli   (4, t)        C_w, C_f, C_wf and G [N/m]; C_wf^2 <= C_w C_f
    damping  (3, t)        damping of e_w, e_f and g [N s/m]
    """

    faces: Annotated[NDArray[np.int32], "t", 3, Bounds(0, below="n")]
    along: Annotated[NDArray[np.float64], "t", 2]
    across: Annotated[NDArray[np.float64], "t", 2]
    area: Annotated[NDArray[np.float64], "t", Bounds(above=0.0)]
    moduli: Annotated[NDArray[np.float64], 4, "t"]
    damping: Annotated[NDArray[np.float64], 3, "t", Bounds(0.0)]

    @property
    def number(self) -> int:
        return int(self.faces.shape[0])

    def shares(self) -> Float:
        """Return the derivatives of F_w and F_f by each corner, shape (2, t, 3) [1/m]."""
        yarns = np.stack([self.along, self.across])
        return np.concatenate([-yarns.sum(axis=2, keepdims=True), yarns], axis=2)

    def stiffness(self) -> Float:
        """Return the largest stiffness of each corner within its triangle alone, shape (t, 3) [N/m]."""
        (warp, weft), (c_w, c_f, _, g) = np.square(self.shares()), self.moduli[..., None]
        return np.asarray(self.area[:, None] * ((c_w + g) * warp + (c_f + g) * weft))

    def sides(self) -> Float:
        """Return the rest lengths of x0 x1, x1 x2 and x2 x0, shape (t, 3) [m]."""
        first, second = np.linalg.inv(np.stack([self.along, self.across], axis=2)).transpose(2, 0, 1)
        return np.asarray(np.linalg.norm(np.stack([first, second - first, second], axis=1), axis=2))

    def edges(self) -> tuple[Int, Float]:
        """Return the vertices (e, 2) of every edge, each once, and its rest length (e,) [m]."""
        ends = np.sort(np.stack([self.faces, np.roll(self.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        pairs, first = np.unique(ends, axis=0, return_index=True)
        return pairs, self.sides().reshape(-1)[first]


@dataclass(frozen=True)
class Bending:
    """Bending as a quadratic form of the positions: energy sum of weight |x_j - x_i|^2 / 2 over pairs.

    pairs    (p, 2) int32  vertices i < j, each pair once
    weight   (p,)          [N/m], of either sign; the form is never negative, and 0 for every affine motion
    """

    pairs: Annotated[NDArray[np.int32], "p", 2, Bounds(0, below="n")]
    weight: Annotated[NDArray[np.float64], "p"]

    @property
    def number(self) -> int:
        return int(self.pairs.shape[0])


@dataclass(frozen=True)
class BendingFriction:
    """Internal friction against bending, in patches of vertices; nuno_kernels.forces.bending_friction computes it.

    vertices (b, k) int32  patches, each padded with its first vertex
    shares   (b, 5, k)     derivatives of the tangents along warp and weft [1/m], and of the second derivatives along
                           warp, weft and between them [1/m^2], by each vertex; rows sum to 0
    area     (b,)          area of the patch [m^2]
    limit    (2, b)        moment per width at which friction slips, of warp and weft [N]
    slip     (b,)          change of curvature at which friction slips [1/m]
    """

    vertices: Annotated[NDArray[np.int32], "b", "k", Bounds(0, below="n")]
    shares: Annotated[NDArray[np.float64], "b", 5, "k"]
    area: Annotated[NDArray[np.float64], "b", Bounds(above=0.0)]
    limit: Annotated[NDArray[np.float64], 2, "b", Bounds(0.0)]
    slip: Annotated[NDArray[np.float64], "b", Bounds(above=0.0)]

    @property
    def number(self) -> int:
        return int(self.vertices.shape[0])

    @staticmethod
    def join(parts: list[BendingFriction]) -> BendingFriction:
        """Join several (at least one) into one, with patches padded to the largest."""
        most = max(part.vertices.shape[1] for part in parts)
        vertices = [
            np.concatenate([p.vertices, np.repeat(p.vertices[:, :1], most - p.vertices.shape[1], axis=1)], axis=1)
            for p in parts
        ]
        shares = [np.pad(p.shares, ((0, 0), (0, 0), (0, most - p.shares.shape[2]))) for p in parts]
        limit = np.concatenate([p.limit for p in parts], axis=1)
        area, slip = (np.concatenate([getattr(p, name) for p in parts]) for name in ("area", "slip"))
        return BendingFriction(np.concatenate(vertices), np.concatenate(shares), area, limit, slip)


# Lines that are drawn on cloth, and the heights by which they raise its rest shape.

SPLIT, RAISED, TAKEN = 0, 1, 2
"""Kinds of lines: one that has split triangles, one that raises the rest shape, and one that is taken back."""


@dataclass(frozen=True)
class Relief:
    """Lines drawn on a fabric, in order, and the heights by which they raise its rest shape; heights add up.

    kind   (l,)   int8    SPLIT, RAISED or TAKEN
    hinges (l,)   int32   hinges of each line whose fold is kept: the last of `Fabric.hinges`, line after line
    line, vertex (e,)     lines and vertices with a height
    height (e,)           [m]
    """

    kind: Annotated[NDArray[np.int8], "l", Bounds(0, 2)]
    hinges: Annotated[Int, "l", Bounds(0)]
    line: Annotated[Int, "e", Bounds(0, below="l")]
    vertex: Annotated[Int, "e", Bounds(0, below="n")]
    height: Annotated[Float, "e"]

    def total(self, n: int) -> Float:
        """Return the height of each of n vertices, shape (n,) [m]."""
        return np.bincount(self.vertex, self.height, n).astype(np.float64)


# Yarns of a fabric: springs that are links of yarns.


@dataclass(frozen=True)
class Yarns:
    """Springs that are links of yarns, along which tension passes: T'_n = T_n + mu (T_(n-1) + T_(n+1)).

    links (l,)    int32    springs yarn by yarn, each sharing a vertex with the one before it.
                           A yarn that ends with its first link is a ring; apart from that a
                           spring occurs at most once
    ptr   (y + 1,) int32   yarn y is links[ptr[y]:ptr[y + 1]]
    mu    (y,)    float64  share of tension passed on, 0 <= mu < 1/2
    kind  (y,)    int8     index into `names`, for reports and pictures
    names                  e.g. ("nylon", "support")
    density (y,)  float64  linear density [kg/m], for the thickness in pictures; None if unknown

    The force T' acts along the link, equal and opposite on its ends. A spring without a yarn, or the only
    link of its yarn, keeps its tension.
    """

    links: Annotated[NDArray[np.int32], "l", Bounds(0)]
    ptr: Annotated[NDArray[np.int32], "p", Bounds(0)]
    mu: Annotated[NDArray[np.float64], "y", Bounds(0.0, np.nextafter(0.5, 0.0))]
    kind: Annotated[NDArray[np.int8], "y", Bounds(0)]
    names: tuple[str, ...] = ("yarn",)
    density: Annotated[NDArray[np.float64], "y", Bounds(above=0.0)] | None = None

    @property
    def number(self) -> int:
        return int(self.mu.shape[0])

    def thickness(self) -> Float:
        """Return the thickness of every yarn over that of a yarn of mean linear density, shape (y,); 1 if unknown.

        It is the root of the ratio of linear densities: with one bulk density, cross sections are proportional to them.
        """
        return np.ones(self.number) if self.density is None else np.sqrt(self.density / self.density.mean())

    def neighbours(self) -> tuple[Int, Int]:
        """Return the pairs (p, 2) of consecutive links of a yarn, and the yarn (p,) of each pair."""
        yarn = np.repeat(np.arange(self.number, dtype=np.int32), np.diff(self.ptr))
        same = yarn[1:] == yarn[:-1]
        return np.stack([self.links[:-1], self.links[1:]], axis=1)[same], yarn[1:][same]

    def lengths(self, springs: Springs, each: Float | None = None) -> Float:
        """Return the rest length of every yarn, shape (y,) [m], or the sum of `each`, lengths of all springs (s,) [m];
        a ring counts each link once.
        """
        rest = (springs.per_spring(springs.rest) if each is None else each)[self.links]
        total = np.add.reduceat(rest, self.ptr[:-1]) if self.number else np.zeros(0)
        first, last = self.ptr[:-1], self.ptr[1:] - 1
        ring = (last > first) & (self.links[first] == self.links[last])
        return np.asarray(total - np.where(ring, rest[last], 0.0))

    @staticmethod
    def join(parts: list[tuple[Yarns, int]]) -> Yarns:
        """Join several sets (at least one), each with the offset of its spring indices."""
        names = tuple(dict.fromkeys(name for yarns, _ in parts for name in yarns.names))
        sizes = np.concatenate([np.diff(yarns.ptr) for yarns, _ in parts])
        densities = [yarns.density for yarns, _ in parts if yarns.density is not None]
        return Yarns(
            np.concatenate([(yarns.links + offset).astype(np.int32) for yarns, offset in parts]),
            np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32),
            np.concatenate([yarns.mu for yarns, _ in parts]),
            np.concatenate([[names.index(yarns.names[k]) for k in yarns.kind] for yarns, _ in parts]).astype(np.int8),
            names,
            np.concatenate(densities) if len(densities) == len(parts) else None,
        )


STRUCTURAL, SHEAR, BENDING, ELASTIC = 0, 1, 2, 3
"""Kinds of springs."""


def _expand(first: Int, count: Int, stride: Int) -> Int:
    """Return the indices of all elements: (m, w) first indices, (m,) counts and strides -> (total, w)."""
    run = np.repeat(np.arange(len(count)), count)
    step = (np.arange(len(run)) - (np.cumsum(count) - count).take(run)) * stride.take(run)
    indices = first.take(run, axis=0)
    indices += step.astype(np.int32)[:, None]
    return indices


@dataclass(frozen=True)
class Springs:
    """Damped linear springs between two vertices.

    first  (m, 2) int32  the two vertices of each run's first spring
    count  (m,)   int32  springs in the run
    stride (m,)   int32  added to both indices from one spring to the next
    k      (m,) or (s,)  stiffness [N/m], per run or per spring, s = count.sum()
    rest   (m,) or (s,)  rest length [m]
    c      (m,) or (s,)  damping along the spring [N s/m]
    kind   (m,)   int8   STRUCTURAL, SHEAR, BENDING, or ELASTIC, an elastic band's (for reports only)
    lock, k_lock (m,) or (s,), both or neither: a spring's tension is k e up to the elongation e = lock * rest and
           grows by k_lock [N/m] from there: k_lock >= k, as of a covered yarn once its cover is straight
    """

    first: Annotated[Int, "m", 2, Bounds(0, below="n")]
    count: Annotated[Int, "m", Bounds(0, strided=True)]
    stride: Annotated[Int, "m", Bounds(strided=True)]
    k: Annotated[Float, ("m", "number"), Bounds(0.0)]
    rest: Annotated[Float, ("m", "number"), Bounds(0.0)]
    c: Annotated[Float, ("m", "number"), Bounds(0.0)]
    kind: Annotated[NDArray[np.int8], "m", Bounds(0, strided=True)]
    lock: Annotated[Float, ("m", "number"), Bounds(0.0)] | None = None
    k_lock: Annotated[Float, ("m", "number"), Bounds(0.0)] | None = None

    @property
    def number(self) -> int:
        return int(self.count.sum())

    def stiffest(self) -> Springs:
        """Return these springs with the greatest stiffness that each has at any elongation."""
        if self.k_lock is None:
            return self
        k = np.maximum(*(self.per_spring(values) for values in (self.k, self.k_lock)))
        return replace(self, k=k, lock=None, k_lock=None)

    @property
    def per_run(self) -> bool:
        """Whether all constants are given per run."""
        constants = (self.k, self.rest, self.c, self.lock, self.k_lock)
        return all(values is None or values.shape == self.count.shape for values in constants)

    def pairs(self) -> Int:
        """Return the vertices of every spring, shape (s, 2) int32, in a new array."""
        if self.first.shape[0] == self.number:
            return self.first.copy()
        return _expand(self.first, self.count, self.stride)

    def per_spring(self, values: Float) -> Float:
        """Return the values per spring, shape (s,), of a constant that may be stored per run."""
        return values if values.shape[0] == self.number else np.repeat(values, self.count)

    def of_kind(self, kind: int) -> Bool:
        """Return whether each spring is of a kind, shape (s,)."""
        return np.repeat(self.kind == kind, self.count)

    @staticmethod
    def from_pairs(
        pairs: Int, k: Float, rest: Float, c: Float, kind: int = 0, lock: Float | None = None,
        k_lock: Float | None = None,
    ) -> Springs:  # fmt: skip
        """Return runs of one spring each, with constants per spring."""
        number = pairs.shape[0]
        one = np.broadcast_to(np.int32(1), number)  # no memory: a net may have millions
        kinds = np.broadcast_to(np.int8(kind), number)
        return Springs(np.ascontiguousarray(pairs, np.int32), one, one, k, rest, c, kinds, lock, k_lock)

    @staticmethod
    def join(parts: list[Springs]) -> Springs:
        """Join several sets (at least one) into one, with constants per run if all sets have them per run."""
        locks = any(p.lock is not None for p in parts)
        if locks:
            # A spring that does not lock keeps its stiffness.
            parts = [p if p.lock is not None else replace(p, lock=np.zeros_like(p.k), k_lock=p.k) for p in parts]
        per_run = all(p.per_run for p in parts)

        def joined(name: str) -> Any:
            arrays = [getattr(p, name) for p in parts]
            if name in ("k", "rest", "c", "lock", "k_lock") and not per_run:
                arrays = [p.per_spring(a) for p, a in zip(parts, arrays, strict=True)]
            return np.concatenate(arrays)

        names = ("first", "count", "stride", "k", "rest", "c", "kind", *(("lock", "k_lock") if locks else ()))
        return Springs(*(joined(name) for name in names))


@dataclass(frozen=True)
class Hinges:
    """Bending between two triangles that share an edge: energy k (1 - cos(angle - rest)).

    first  (m, 4) int32  edge start, edge end, opposite vertex left, opposite vertex right
    count, stride        as in Springs
    k      (m,) or (h,)  stiffness [N m], per run or per hinge
    rest   (m,) or (h,)  rest angle [rad], 0 is flat

    For small angles the energy is k angle^2 / 2. A stiffness of k = B e^2 / (A1 + A2), with e
    the edge length and A1, A2 the two areas, stores B curvature^2 / 2 per area.
    """

    first: Annotated[Int, "m", 4, Bounds(0, below="n")]
    count: Annotated[Int, "m", Bounds(0, strided=True)]
    stride: Annotated[Int, "m", Bounds(strided=True)]
    k: Annotated[Float, ("m", "number"), Bounds(0.0)]
    rest: Annotated[Float, ("m", "number")]

    @property
    def number(self) -> int:
        return int(self.count.sum())

    def quads(self) -> Int:
        """Return the vertices of every hinge, shape (h, 4) int32."""
        return _expand(self.first, self.count, self.stride)

    def per_hinge(self, values: Float) -> Float:
        """Return the values per hinge, shape (h,), of a constant that may be stored per run."""
        return values if values.shape[0] == self.number else np.repeat(values, self.count)


@dataclass(frozen=True)
class Binding:
    """Pinned vertices that move rigidly with a body's frame.

    vertices (b,) int32; body and frame are names, e.g. "dancer" and "hips", frame None: the body's only frame;
    local (b, 3) positions in the frame [m], None: their start positions.
    """

    vertices: Annotated[Int, "b", Bounds(0, below="n")]
    body: str
    frame: str | None = None
    local: Annotated[Float, "b", 3] | None = None

    def __post_init__(self) -> None:
        if self.local is not None and len(self.local) != len(self.vertices):
            raise ValueError(f"a binding of {len(self.vertices)} vertices has {len(self.local)} places")


@dataclass(frozen=True)
class Panels:
    """The flat panels of sewn garments in texture coordinates, warp along v.

    names (q,)              of the panels
    of    (f,)   int32      panel of each triangle, -1 for no panel
    edge  (f, 3) int32      panel edge along each side of a triangle, from one corner to the next; -1 for no edge
    unit  (q,)   float64    [m] per unit of texture coordinates, by panel: rest shapes at their true size
    pairs (k, 2) int32      points of `Corners` that are sewn together, along the two edges of each seam
    seam  (k,)   int32      seam of each pair
    """

    names: Annotated[tuple[str, ...], "q"]
    of: Annotated[Int, "f", Bounds(-1, below="q")]
    edge: Annotated[Int, "f", 3, Bounds(-1)]
    unit: Annotated[Float, "q", Bounds(above=0.0)]
    pairs: Annotated[Int, "k", 2, Bounds(0, below="p")]
    seam: Annotated[Int, "k", Bounds(0)]

    @staticmethod
    def letters(seam: int) -> str:
        """Return the name of a seam: A to Z, then AA, AB, and so on."""
        return (Panels.letters(seam // 26 - 1) if seam >= 26 else "") + chr(ord("A") + seam % 26)


@dataclass(frozen=True)
class Corners:
    """Texture coordinates per corner of a triangle, for vertices with several: along the seams of a sewn garment.

    points (p, 2) float32  texture coordinates, as in `Fabric.uv`
    vertex (p,)   int32    vertex of each point
    faces  (f, 3) int32    points of each triangle, in the order of `Fabric.faces`, which is vertex[faces]
    panels                 panels of the triangles, or None
    """

    points: Annotated[NDArray[np.float32], "p", 2]
    vertex: Annotated[Int, "p", Bounds(0, below="n")]
    faces: Annotated[Int, "f", 3, Bounds(0, below="p")]
    panels: Panels | None = None

    @staticmethod
    def of(faces: Int, uv: NDArray[np.floating[Any]]) -> Corners:
        """Return the corners of triangles (f, 3) at coordinates (f, 3, 2); equal ones of a vertex become one point."""
        each = np.column_stack([faces.reshape(-1), uv.reshape(-1, 2).astype(np.float32)])
        distinct, index = np.unique(each, axis=0, return_inverse=True)
        points, vertex = np.ascontiguousarray(distinct[:, 1:], np.float32), distinct[:, 0].astype(np.int32)
        return Corners(points, vertex, index.reshape(-1, 3).astype(np.int32))

    @property
    def in_image(self) -> NDArray[np.float32]:
        """Return the points (p, 2) in an image, whose rows run down: (u, 1 - v)."""
        return np.asarray(self.points * np.array([1, -1], np.float32) + np.array([0, 1], np.float32), np.float32)


@dataclass(frozen=True)
class Fabric:
    """The constant data of one or several pieces of cloth.

    position (n, 3) float64  [m] at the start; velocity (n, 3) [m/s]
    mass     (n,)   float64  [kg], > 0
    pinned   (n,)   bool     fixed in place, or moved by a binding
    faces    (f, 3) int32    triangles, counter-clockwise seen from outside; f may be 0
    uv       (n, 2) float32  texture coordinates in [0, 1], or None: u to the right as seen from
                             outside, v upwards: (0, 1) is the image's upper left corner, as in
                             OBJ files. Image rows run down, so samplers of images, such as
                             drawing.Mesh and glTF, use (u, 1 - v) with (0, 0) at the upper left
    corners                  texture coordinates that differ along seams, instead of uv, or None
    springs, hinges, membrane, bending, friction  or None
    relief                   lines that raise the rest shape, or None
    yarns                    springs that are links of yarns, or None
    cells (c, 4) int32       quads between points of a net, counter-clockwise seen from outside, or None: they give
                             a net without faces areas and normals
    bindings                 pinned vertices that follow a body
    texture                  path of an image, or None
    numbers  (n,)   int32    the user's number of each vertex, if the fabric was renumbered; else None
    merged   (g,)   int32    the vertex that each vertex of its file has become, each of the first ones once at least,
                             if a mesh was merged; else None
    origin                   properties of the fabric as built, noted by an operation that changed it; of an unchanged
                             fabric at most k_bend [N/m], the stiffness of bending springs, for a mesh without an inner
                             edge, whose elements do not show it
    """

    name: str
    position: Annotated[Float, "n", 3]
    velocity: Annotated[Float, "n", 3]
    mass: Annotated[Float, "n", Bounds(above=0.0)]
    pinned: Annotated[Bool, "n"]
    faces: Annotated[Int, "f", 3, Bounds(0, below="n")]
    springs: Springs | None = None
    hinges: Hinges | None = None
    uv: Annotated[NDArray[np.float32], "n", 2] | None = None
    bindings: tuple[Binding, ...] = ()
    texture: str | None = None
    yarns: Yarns | None = None
    cells: Annotated[Int, "c", 4, Bounds(0, below="n")] | None = None
    membrane: Membrane | None = None
    bending: Bending | None = None
    friction: BendingFriction | None = None
    relief: Relief | None = None
    numbers: Annotated[Int, "n", Bounds(0, below="n")] | None = None
    merged: Annotated[Int, "g", Bounds(0, below="n")] | None = None
    corners: Corners | None = None
    origin: Mapping[str, float] = field(default_factory=dict)

    @property
    def number(self) -> int:
        return int(self.mass.shape[0])

    def told(self, vertex: int) -> int:
        """Return the user's number of a vertex."""
        return vertex if self.numbers is None else int(self.numbers[vertex])

    def named(self) -> Int:
        """Return the vertex (g,) of each number of the user: those of its file, then those added by operations."""
        if self.merged is None:
            return np.arange(self.number, dtype=np.int32)
        added = np.arange(self.merged.max(initial=-1) + 1, self.number, dtype=np.int32)
        return np.concatenate([self.merged, added])

    @property
    def laid_out(self) -> Corners | None:
        """The texture coordinates per corner of a triangle, or None."""
        if self.corners is not None or self.uv is None:
            return self.corners
        return Corners(self.uv, np.arange(self.number, dtype=np.int32), self.faces)

    def stiffness(self) -> Float:
        """Return the sum of the stiffness of each vertex's springs and triangles (n,) [N/m]."""
        at, k = [np.empty(0, np.int32)], [np.empty(0)]
        if self.springs is not None:
            at, k = list(self.springs.pairs().T), 2 * [self.springs.per_spring(self.springs.k)]
        if self.membrane is not None:
            at, k = [*at, self.membrane.faces.reshape(-1)], [*k, self.membrane.stiffness().reshape(-1)]
        return np.bincount(np.concatenate(at), np.concatenate(k), self.number).astype(np.float64)

    @property
    def bears_tension(self) -> bool:
        """Whether it has any springs or triangles of a membrane."""
        return any(part is not None and part.number > 0 for part in (self.springs, self.membrane))


@dataclass
class State:
    """Positions x (n, 3) [m] and velocities v (n, 3) [m/s], float64, at time t [s].

    They lie in memory as kernels read them: x.T and v.T are C-contiguous rows (3, n). Arrays that lie otherwise are
    copied.
    """

    x: Annotated[Float, "n", 3, Bounds(strided=True)]
    v: Annotated[Float, "n", 3, Bounds(strided=True)]
    t: float = 0.0
    begun: tuple[Float, Float] | None = None
    """x and v at the start of the frame that is stepped, where the caller has copies: a solver only reads them."""

    def __post_init__(self) -> None:
        self.x, self.v = np.asfortranarray(self.x), np.asfortranarray(self.v)

    def copy(self) -> State:
        return State(self.x.copy(order="F"), self.v.copy(order="F"), self.t)


@dataclass
class Memory:
    """A solver's memory between frames.

    arrays are part of the state (friction anchors, adaptive step): checkpointed and restored.
    work can be rebuilt at any time (kernel layouts, buffers) and is never stored.
    bounds limit the entries of arrays that are read from a file. Every array of integers needs bounds, even if any
    integer is allowed: a kernel does not check an index. Floats of a term must be finite unless bounds allow others.
    about describes for the report how the kernels run the system: the number of threads, and why.
    lists names the terms that rebuild lists only in some steps: only real steps show their cost.
    timeless tells that nothing depends on the time: after a frame that changes nothing none is stepped.
    """

    arrays: dict[str, NDArray[np.generic]] = field(default_factory=dict)
    work: object = None
    bounds: dict[str, Bounds] = field(default_factory=dict)
    about: str = ""
    lists: tuple[str, ...] = ()
    timeless: bool = False
