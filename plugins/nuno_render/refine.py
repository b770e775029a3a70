"""Cloth as it is drawn: finer triangles on a smooth surface through the simulated vertices, with hems and seams.

The surface is that of PN triangles (Vlachos, Peters, Boyd, Mitchell: Curved PN triangles, I3D 2001): over each triangle
a cubic patch from its corners and their normals alone. It goes through every vertex, so that what touched a body or
other cloth still does, and bulges to the side to which normals turn, so that cloth on a convex body does not cut into
it. Its edge depends on its two ends alone: there are no cracks, also where two vertices at one place have texture
coordinates of their own. Where normals turn by 60 degrees and more along an edge, it is flattened: a fold is then as
narrow as the triangles, and no curve through it is more likely than another. So are edges near other cloth, or a fold
of the same: layers may be a tenth of a millimetre apart, and curved ones would cut through each other. Rejected: Loop's
subdivision, which moves the vertices; the modified butterfly, which swings where the mesh is irregular; and normals
that vary quadratically, which show the triangles as scallops along narrow folds.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_render.scene import FAR, check_mesh, find_twins, vertex_normals
from nuno_render.sight import sight_of
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.pictures import Camera, Mesh
from nuno_schemas.vectors import unit_rows

Index = NDArray[np.int64]
CROWDED = 0.7
"""Vertices that are nearer to each other than this share of an edge, and no neighbours, are of layers in contact, or of
a fold as narrow as a triangle."""
ALIKE = 8
"""Most vertices in a cell that are compared."""
PRIMES = np.array([73_856_093, 19_349_663, 83_492_791])
"""Factors of a cell's number (M. Teschner and others, Optimized spatial hashing, VMV 2003)."""
PIXELS, MOST_PARTS, MOST_FACES = 5.0, 4, 300_000
"""Length of a drawn edge [pixels] that triangles are divided to, at most so many parts an edge, and triangles."""
THICK, OF_EXTENT = 1.2e-3, 0.003
"""Thickness of a hem [m], two or three layers of cloth, and the most of it as a share of the cloth's extent."""
HEM = np.array([(-3.0, 0.0), (-2.7, 0.5), (-0.2, 0.5), (0.2, 0.35), (0.35, 0.0), (0.2, -0.35), (-0.2, -0.5),
                (-2.7, -0.5), (-3.0, 0.0)])  # fmt: skip
"""Section through the fold at an edge of cloth, in its thickness: outwards, and along the normal."""
SEAM = np.array([(-1.0, 0.0), (-0.7, 0.3), (0.7, 0.3), (1.0, 0.0), (0.7, -0.3), (-0.7, -0.3), (-1.0, 0.0)])


def refine(meshes: list[Mesh], camera: Camera) -> list[Mesh]:
    """Return meshes as they are drawn from the camera: cloth, which is two-sided, refined, and bodies with creases.

    Raises BadInput for arrays of the wrong shape and for face indices out of range.
    """
    sight, target = sight_of(camera), np.asarray(camera.target, np.float64)
    for number, mesh in enumerate(meshes):
        check_mesh(mesh, f"meshes[{number}]")
    eye, free = sight.eye + target, iter(_free([mesh for mesh in meshes if mesh.two_sided]))
    return [_refined(mesh, next(free), eye, sight.focal) if mesh.two_sided else _creased(mesh) for mesh in meshes]


def _free(meshes: list[Mesh]) -> list[Bool]:
    """Return for each mesh which vertices (n,) have no other layer of cloth near them."""
    if not meshes:
        return []
    sizes = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    x = np.nan_to_num(np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float64))
    twins, faces = find_twins(x), np.concatenate([m.faces + at for m, at in zip(meshes, sizes, strict=False)])
    sides = twins[np.concatenate([faces[:, [i, j]] for i in range(3) for j in range(3) if i != j])].astype(np.int64)
    count = len(x)
    reach = CROWDED * float(np.median(np.linalg.norm(x[sides[:, 1]] - x[sides[:, 0]], axis=1))) if len(sides) else 0.0
    edges = np.unique(sides @ np.array([count, 1]))
    free, pairs = np.ones(count, bool), [np.zeros((0, 2), np.int64)]
    for shift in np.ndindex(2, 2, 2) if reach > 0.0 else ():  # two points that near are in one cell of one of the grids
        cell = np.floor(0.5 * x / reach + 0.5 * np.array(shift)).astype(np.int64) @ PRIMES
        order = np.argsort(cell, kind="stable")
        for step in range(1, ALIKE):
            same = cell[order[:-step]] == cell[order[step:]]
            pair = twins[np.stack([order[:-step][same], order[step:][same]], axis=1)].astype(np.int64)
            pairs.append(pair[(np.abs(x[pair[:, 0]] - x[pair[:, 1]]).max(axis=1) < reach) & (pair[:, 0] != pair[:, 1])])
    pair = np.concatenate(pairs)
    numbers = pair @ np.array([count, 1])
    apart = edges[np.minimum(np.searchsorted(edges, numbers), len(edges) - 1)] != numbers if len(edges) else []
    free[pair[apart]] = False
    return np.split(free[twins], sizes[1:-1])


def _creased(mesh: Mesh) -> Mesh:
    """Return a body with flat triangles where their normals are more than 45 degrees off their corners', as a box's."""
    x, faces = np.asarray(mesh.vertices, np.float64), mesh.faces
    smooth = vertex_normals(x, faces, np.arange(len(x), dtype=np.int32))[faces]
    flat = unit_rows(np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]))[:, None]
    sharp = (smooth * flat).sum(axis=2, keepdims=True) < np.sqrt(0.5)
    if not sharp.any():
        return mesh
    own, apart = faces.reshape(-1), np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    return replace(
        mesh, vertices=x[own], faces=apart, normals=np.where(sharp, flat, smooth).reshape(-1, 3),
        colours=None if mesh.colours is None else mesh.colours[own], uv=None if mesh.uv is None else mesh.uv[own],
    )  # fmt: skip


def _refined(mesh: Mesh, free: Bool, eye: Float, focal: float) -> Mesh:
    x = np.asarray(mesh.vertices, np.float64)
    finite: Bool = np.logical_and.reduce(np.abs(x) <= FAR, axis=1)
    faces = np.ascontiguousarray(mesh.faces[finite[mesh.faces].all(axis=1)], np.int32)
    if not len(faces):
        return mesh
    twins = np.arange(len(x), dtype=np.int32) if mesh.uv is None else find_twins(x)
    corners, normals = x[faces], vertex_normals(x, faces, twins)
    length = float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
    away = float(np.linalg.norm(np.median(corners, axis=(0, 1)) - eye))
    most = min(MOST_PARTS, int(np.sqrt(MOST_FACES / len(faces))))
    parts = max(1, min(most, int(np.ceil(length * focal / max(away, 1e-9) / PIXELS))))
    shares, _, small = _pattern(parts)
    points, bent = divide(corners, normals[faces], shares, free[faces])
    thick = min(THICK, OF_EXTENT * float(np.ptp(corners.reshape(-1, 3), axis=0).max()))
    first = np.arange(len(faces))[:, None, None] * len(shares)
    made = [(points, bent, (first + small).reshape(-1, 3), np.arange(len(points)))]
    for chains, section in zip(_edges(x, faces, twins, parts), (HEM, SEAM), strict=True):
        made.append(_fold(points, bent, chains, thick * section))
    starts = np.cumsum([0, *(len(one[0]) for one in made)])
    origin = np.concatenate([one[3] for one in made])

    def spread(values: NDArray[Any] | None) -> NDArray[Any] | None:
        return (
            None if values is None else np.einsum("tk,fkc->ftc", shares, values[faces]).reshape(len(points), -1)[origin]
        )

    return replace(
        mesh, vertices=np.concatenate([one[0] for one in made]), normals=np.concatenate([one[1] for one in made]),
        faces=np.concatenate([one[2] + start for one, start in zip(made, starts, strict=False)]).astype(np.int32),
        colours=spread(mesh.colours), uv=spread(mesh.uv),
    )  # fmt: skip


@cache
def _pattern(parts: int) -> tuple[Float, Index, Index]:
    """Return for a triangle divided into `parts` along its sides: the shares (t, 3) of its corners in each point; the
    points (3, p + 1) along its sides; and its triangles (p^2, 3).
    """
    place = {(i, j): k for k, (i, j) in enumerate((i, j) for i in range(parts + 1) for j in range(parts + 1 - i))}
    shares = np.array([(parts - i - j, i, j) for i, j in place]) / parts
    steps = range(parts + 1)
    sides = [[place[k, 0] for k in steps], [place[parts - k, k] for k in steps], [place[0, parts - k] for k in steps]]
    faces = [(place[i, j], place[i + 1, j], place[i, j + 1]) for i, j in place if i + j < parts]
    faces += [(place[i + 1, j], place[i + 1, j + 1], place[i, j + 1]) for i, j in place if i + j < parts - 1]
    return shares, np.array(sides), np.array(faces)


def divide(p: Float, n: Float, shares: Float, free: Bool) -> tuple[Float, Float]:
    """Return points and unit normals (f t, 3) of PN triangles with corners p and normals n (f, 3, 3), at shares (t, 3)
    of the corners; sides are straight that end at a corner which is not `free` (f, 3).
    """
    after, n_after = np.roll(p, -1, axis=1), np.roll(n, -1, axis=1)
    chord, bend = after - p, np.clip(2.0 * (n * n_after).sum(axis=2, keepdims=True), 0.0, 1.0)
    bend = bend * (free & np.roll(free, -1, axis=1))[..., None]
    near = (2.0 * p + after - bend * (chord * n).sum(axis=2, keepdims=True) * n) / 3.0
    far = (2.0 * after + p + bend * (chord * n_after).sum(axis=2, keepdims=True) * n_after) / 3.0
    ring = (near + far).sum(axis=1) / 6.0
    points = 6.0 * shares.prod(axis=1)[:, None] * (1.5 * ring - 0.5 * p.mean(axis=1))[:, None]
    for k in range(3):
        w, v = shares[:, k, None], shares[:, (k + 1) % 3, None]
        points = points + w**3 * p[:, None, k] + 3.0 * w * v * (w * near[:, None, k] + v * far[:, None, k])
    return points.reshape(-1, 3), unit_rows(np.einsum("tk,fkc->ftc", shares, n).reshape(-1, 3))


def _edges(x: Float, faces: Int, twins: Int, parts: int) -> list[tuple[Index, Index]]:
    """Return points (s, p + 1) along the sides at the edges of cloth, and along one side of each seam, where texture
    coordinates differ; each with numbers that are the same for the ends of sides that meet.
    """
    (shares, along, _), count = _pattern(parts), len(twins)
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).astype(np.int64)
    joint, own = (np.sort(one, axis=-1) @ np.array([count, 1]) for one in (twins[ends].astype(np.int64), ends))
    _, first, back, sides = np.unique(joint, return_index=True, return_inverse=True, return_counts=True)
    alone = (sides[back].reshape(joint.shape) == 1) & (np.abs(x[ends[..., 0]] - x[ends[..., 1]]).max(axis=2) > 1e-9)
    _, back, sides = np.unique(own, return_inverse=True, return_counts=True)
    seam = (sides[back].reshape(joint.shape) == 1) & ~alone & np.isin(np.arange(joint.size), first).reshape(joint.shape)
    points = np.arange(len(faces))[:, None, None] * len(shares) + along
    same = points + count
    same[:, :, [0, -1]] = twins[ends]
    return [(points[chosen], same[chosen]) for chosen in (alone, seam)]


def _fold(x: Float, normals: Float, chains: tuple[Index, Index], section: Float) -> tuple[Float, Float, Index, Index]:
    """Return a strip of a section (k, 2) [m], outwards and along the normal, along chains of points: its vertices and
    normals (m, 3), triangles (g, 3), and the point (m,) on which each vertex stands.
    """
    points, same = chains
    places, inverse = np.unique(same, return_inverse=True)
    inverse = inverse.reshape(points.shape)
    stands, width = np.zeros(len(places), np.int64), len(section)
    stands[inverse] = points
    x, n = x[stands], normals[stands]
    sides = np.stack([inverse[:, :-1], inverse[:, 1:]])
    out = np.zeros_like(x)
    for ends in sides:
        np.add.at(out, ends, np.cross(x[sides[1]] - x[sides[0]], n[ends]))
    out, slope = unit_rows(out)[:, None], np.gradient(section, axis=0)
    placed = (x[:, None] + section[:, :1] * out + section[:, 1:] * n[:, None]).reshape(-1, 3)
    faced = unit_rows((slope[:, :1] * n[:, None] - slope[:, 1:] * out).reshape(-1, 3))
    a, b = (ends.reshape(-1, 1) * width + np.arange(width - 1) for ends in sides)
    faces = np.concatenate([np.stack([a, b, b + 1], -1), np.stack([a, b + 1, a + 1], -1)]).reshape(-1, 3)
    p = placed[faces]
    wrong = (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) * faced[faces].sum(axis=1)).sum(axis=1) < 0.0
    faces[wrong] = faces[wrong][:, ::-1]
    return placed, faced, faces, np.repeat(stands, width)
