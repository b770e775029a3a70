"""Whether a triangle mesh is closed, oriented and free of self-intersections, and where it is not."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from nuno_geometry.normals import edge_numbers
from nuno_geometry.tree import DEPTH, Tree, build_tree
from nuno_kernels import kernel, parallel_kernel, threads_available
from nuno_kernels.lanes import WIDTH, first_lane, higher, lanes_up_to, load
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int

BLOCK = 64
ROUNDING = 1e-14
"""share of its terms that a volume is off by at most, with rounded coordinates"""


def place_of(x: Float, scale: float | None = None) -> str:
    """Describe a place x (3,) [m], in the file's unit of `scale` [m] if given."""
    unit = "m" if scale is None else "in the file's own axes and unit"
    return f"at [{', '.join(f'{value:.6g}' for value in x / (scale or 1.0))}] {unit}"


def check_closed(x: Float, faces: Int, scale: float | None = None) -> None:
    """Raise BadInput, with the first edge and its place, for a mesh (n, 3), (f, 3) whose surface has a rim, more than
    two faces at an edge, or neighbours that face opposite ways; and for one that is inside out. `scale` as in
    `place_of`.
    """
    numbers, pairs = edge_numbers(faces)
    count = np.bincount(numbers.reshape(-1), minlength=len(pairs))
    way = np.where(faces < np.roll(faces, -1, axis=1), 1, -1)
    balance = np.bincount(numbers.reshape(-1), way.reshape(-1), len(pairs))
    for bad, problem, remedy in (
        (count == 1, "the mesh has a hole: edges with one triangle", "mend: true fills holes"),
        (count > 2, "edges with more than two triangles", "split the mesh there in a mesh editor"),
        (balance != 0, "neighbouring triangles face opposite ways", "mend: true turns them"),
    ):
        if bad.any():
            edge = int(np.argmax(bad))
            ends = pairs[edge]
            raise BadInput(
                f"{problem} ({int(bad.sum())})", field=f"edge {ends[0]}-{ends[1]}",
                value=place_of(x[ends].mean(axis=0), scale), limit="a closed surface", remedy=remedy,
            )  # fmt: skip
    if volume(x, faces) <= 0.0:
        raise BadInput("the mesh is inside out", value=f"a volume of {volume(x, faces):.3g} m^3",
                       limit="> 0", remedy="mend: true turns it")  # fmt: skip


def closed_parts(faces: Int) -> Bool:
    """Return which faces (f, 3) are of a connected part of the surface that has two of them at each edge: only such
    parts have an inside.
    """
    numbers, pairs = edge_numbers(faces)
    opened = np.zeros(int(faces.max(initial=-1)) + 1, bool)
    opened[pairs[np.bincount(numbers.reshape(-1), minlength=len(pairs)) != 2]] = True
    while (mixed := opened[faces].any(axis=1) & ~opened[faces].all(axis=1)).any():
        opened[faces[mixed]] = True
    return np.asarray(~opened[faces[:, 0]])


def volume(x: Float, faces: Int) -> float:
    """Return the signed volume of a closed mesh [m^3], by the divergence theorem."""
    a, b, c = (x[faces[:, k]] - x[0] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def check_crossings(x: Float, faces: Int, tree: Tree | None = None) -> None:
    """Raise BadInput, with the first two faces and the place, for a mesh that passes through itself."""
    tree = build_tree(x, faces) if tree is None else tree
    other = np.full(len(faces), -1, np.int32)
    threads_available()
    find_crossings(x, faces, tree.boxes, tree.child, tree.face, other)
    crossed = np.flatnonzero(other >= 0)
    if len(crossed):
        face = int(crossed[0])
        raise BadInput(
            f"the mesh passes through itself ({len(crossed)} faces)", field=f"faces {face} and {other[face]}",
            value=place_of(x[faces[face]].mean(axis=0)), limit="a surface without self-intersections",
            remedy="take the parts apart in a mesh editor",
        )  # fmt: skip


@kernel
def edge_crosses(x: Float, p: int, q: int, face: Int) -> bool:
    """Whether the open edge from vertex p to vertex q passes through the inside of a triangle of three others."""
    a, b, c = x[face[0]], x[face[1]], x[face[2]]
    first, second = orient(a, b, c, x[p]), orient(a, b, c, x[q])
    if not (first * second < 0.0):
        return False
    u, v, w = orient(x[p], x[q], a, b), orient(x[p], x[q], b, c), orient(x[p], x[q], c, a)
    return (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0)


@kernel
def orient(a: Float, b: Float, c: Float, d: Float) -> float:
    """Return six times the volume of the tetrahedron a, b, c, d; 0 if that is within rounding.

    Neighbours in one plane neither cross nor part, whatever their corners' last digits are.
    """
    ax, ay, az = a[0] - d[0], a[1] - d[1], a[2] - d[2]
    bx, by, bz = b[0] - d[0], b[1] - d[1], b[2] - d[2]
    cx, cy, cz = c[0] - d[0], c[1] - d[1], c[2] - d[2]
    value = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    size = abs(ax) * (abs(by * cz) + abs(bz * cy)) + abs(ay) * (abs(bz * cx) + abs(bx * cz))
    size += abs(az) * (abs(bx * cy) + abs(by * cx))
    return value if abs(value) > ROUNDING * size else 0.0


@kernel
def find_crossing(
    i: int, x: Float, faces: Int, boxes: Float, child: NDArray[np.int64], face: Int, waiting: NDArray[np.int64]
) -> int:
    """Return the lowest triangle without a vertex of triangle i that is crossed by one of its edges; -1 for none."""
    lowest = -1
    for k in range(3):
        p, q = faces[i, k], faces[i, (k + 1) % 3]
        x0, x1 = min(x[p, 0], x[q, 0]), max(x[p, 0], x[q, 0])
        y0, y1 = min(x[p, 1], x[q, 1]), max(x[p, 1], x[q, 1])
        z0, z1 = min(x[p, 2], x[q, 2]), max(x[p, 2], x[q, 2])
        waiting[0] = 0
        top = 1
        while top > 0:
            top -= 1
            node = waiting[top]
            if node < 0:
                for place in range(WIDTH * (-1 - node), WIDTH * (-node)):
                    j = face[place]
                    shared = False
                    for c in range(3):
                        shared |= faces[j, c] == p or faces[j, c] == q
                    if shared:
                        continue
                    if (lowest < 0 or j < lowest) and edge_crosses(x, p, q, faces[j]):
                        lowest = j
                continue
            row = 6 * node
            along = higher(load(boxes, row, 0) - x1, x0 - load(boxes, row + 3, 0))
            along = higher(along, higher(load(boxes, row + 1, 0) - y1, y0 - load(boxes, row + 4, 0)))
            along = higher(along, higher(load(boxes, row + 2, 0) - z1, z0 - load(boxes, row + 5, 0)))
            bits, first = lanes_up_to(along, 0.0), child[node]
            while bits != 0:
                lane = first_lane(bits)
                bits &= bits - 1
                waiting[top] = first + lane if first >= 0 else first - lane
                top += 1
    return lowest


@parallel_kernel
def find_crossings(x: Float, faces: Int, boxes: Float, child: NDArray[np.int64], face: Int, other: Int) -> None:
    """Write other (f,) int32: for each triangle that of `find_crossing`."""
    for block in prange((faces.shape[0] + BLOCK - 1) // BLOCK):
        waiting = np.empty(DEPTH, np.int64)
        for i in range(block * BLOCK, min((block + 1) * BLOCK, faces.shape[0])):
            other[i] = find_crossing(i, x, faces, boxes, child, face, waiting)


def crossing_notes(x: Float, faces: Int) -> tuple[str, ...]:
    """Describe a mesh that passes through itself, for contact that accepts it."""
    try:
        check_crossings(x, faces)
    except BadInput as error:
        return (f"{error.problem}: {error.field} {error.value}",)
    return ()
