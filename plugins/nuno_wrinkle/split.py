r"""Algorithm 2 of the wrinkle paper: new vertices in triangles, and flips of these triangles' edges.

     a ------ b          a ------ b          a        b
      \\  f   /            \\  p  //            \\   //|     p is joined to the corners of its triangle f; then
       \\    /              \\ \\/ /              \\ p  |     each edge of f with a triangle g beyond gives way to
        \\  /      ->        \\|/       ->        \\|\\ |     one from p to the opposite corner of g: so no bending
         c                   c                   c \\q     spring lies beside a structural one.

Every edge is tested once, also if both its triangles are split: then it connects two new vertices, and the line becomes
a chain of edges. These edges stay: one whose other diagonal exists (at a vertex that would keep only two edges), one
whose two triangles are not a convex quad (a triangle would turn over, before or after raising), and a fold of 90
degrees and more (its crease would be cut). Flips change no count: a strip of n split triangles inside of a mesh has V +
n, E + 3 n, F + 2 n whatever is flipped.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_kernels import kernel
from nuno_schemas.fabric import Float, Int

CONVEX = 0.02
"""Least area of a triangle after a flip, as a share of the quad's."""
STEEP = 0.02
"""Least cosine between the normals of such a triangle before and after raising."""


@kernel
def _set_neighbour(faces: Int, across: Int, face: int, a: int, b: int, to: int) -> None:
    """Set the neighbour of `face` across its edge from a to b to `to`."""
    if face >= 0:
        for c in range(3):
            if faces[face, c] == a and faces[face, (c + 1) % 3] == b:
                across[face, c] = to


@kernel
def _has_edge(faces: Int, across: Int, face: int, p: int, q: int) -> bool:
    """Return whether an edge connects p, which has triangles all round and is a corner of `face`, to q."""
    here = face
    while True:
        corner = 0
        for c in range(3):
            if faces[here, c] == q:
                return True
            if faces[here, c] == p:
                corner = c
        here = across[here, corner]
        if here == face:
            return False


@kernel
def _area_vector(x: Float, a: int, b: int, c: int, out: Float) -> None:
    """Write twice the area of the triangle a, b, c times its normal into out (3,)."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[k] = (x[b, i] - x[a, i]) * (x[c, j] - x[a, j]) - (x[b, j] - x[a, j]) * (x[c, i] - x[a, i])


@kernel
def _may_flip(x: Float, u: int, v: int, p: int, q: int) -> bool:
    """Return whether the triangles u, v, p and v, u, q form a convex quad, seen along the sum of their normals."""
    s, g, one, other = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    _area_vector(x, u, v, p, s)
    _area_vector(x, v, u, q, g)
    _area_vector(x, p, u, q, one)
    _area_vector(x, q, v, p, other)
    fold, size_s, size_g = 0.0, 0.0, 0.0
    for k in range(3):
        fold += s[k] * g[k]
        size_s += s[k] * s[k]
        size_g += g[k] * g[k]
    size_s, size_g = np.sqrt(size_s), np.sqrt(size_g)
    if fold <= 0.0:
        return False
    area_one, area_other, area = 0.0, 0.0, 0.0
    for k in range(3):
        m = s[k] / size_s + g[k] / size_g
        area_one += one[k] * m
        area_other += other[k] * m
        area += (s[k] + g[k]) * m
    return bool(area_one > CONVEX * area and area_other > CONVEX * area)


@kernel
def _keeps_facing(x: Float, raised: Float, a: int, b: int, c: int) -> bool:
    """Return whether the triangle a, b, c faces the same way after raising."""
    before, after = np.empty(3), np.empty(3)
    _area_vector(x, a, b, c, before)
    _area_vector(raised, a, b, c, after)
    dot, one, other = 0.0, 0.0, 0.0
    for k in range(3):
        dot += before[k] * after[k]
        one += before[k] * before[k]
        other += after[k] * after[k]
    return bool(dot > STEEP * np.sqrt(one * other))


@kernel
def split_faces(x: Float, raised: Float, split: Int, n: int, faces: Int, across: Int, share: Float) -> tuple[int, int]:
    """Split triangles and flip their edges, in place. Return the numbers of edges flipped and of edges kept.

    x, raised (n + m, 3)  positions before and after raising; the m new vertices, in their triangles, follow the n old
                          ones
    split (m,)           the triangles of the new vertices, ascending
    faces, across (f + 2 m, 3)  triangles and `surface.link_faces` of them, f of them filled in
    share (f + 2 m,)     a value of each old triangle, which parts keep; a flip gives both triangles the mean
    """
    f = len(faces) - 2 * len(split)
    parts: Any = np.empty(3, np.int32)
    for j in range(len(split)):
        i, p = split[j], n + j
        parts[0], parts[1], parts[2] = i, f + 2 * j, f + 2 * j + 1
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        outer_b, outer_c = across[i, 1], across[i, 2]
        faces[parts[0], 2] = p
        faces[parts[1], 0], faces[parts[1], 1], faces[parts[1], 2] = b, c, p
        faces[parts[2], 0], faces[parts[2], 1], faces[parts[2], 2] = c, a, p
        across[parts[1], 0], across[parts[2], 0] = outer_b, outer_c
        for k in range(3):
            across[parts[k], 1], across[parts[k], 2] = parts[(k + 1) % 3], parts[(k + 2) % 3]
            share[parts[k]] = share[i]
        _set_neighbour(faces, across, outer_b, c, b, parts[1])
        _set_neighbour(faces, across, outer_c, a, c, parts[2])
    flipped, left = 0, 0
    done = np.zeros(len(faces), np.bool_)
    own = np.zeros(len(faces), np.bool_)
    own[f:] = True
    for j in range(len(split)):
        own[split[j]] = True
    for j in range(len(split)):
        parts[0], parts[1], parts[2] = split[j], f + 2 * j, f + 2 * j + 1
        for s in parts:
            g = across[s, 0]
            if done[s] or g < 0:
                continue
            u, v, p = faces[s, 0], faces[s, 1], faces[s, 2]
            c = 0
            for k in range(3):
                if faces[g, k] == v and faces[g, (k + 1) % 3] == u:
                    c = k
            q = faces[g, (c + 2) % 3]
            done[s] = True
            done[g] = own[g]
            stays = p == q or _has_edge(faces, across, s, p, q) or not _may_flip(x, u, v, p, q)
            if stays or not (_keeps_facing(x, raised, p, u, q) and _keeps_facing(x, raised, q, v, p)):
                left += 1
                continue
            beyond_uq, beyond_qv = across[g, (c + 1) % 3], across[g, (c + 2) % 3]
            beyond_vp, beyond_pu = across[s, 1], across[s, 2]
            faces[s, 0], faces[s, 1], faces[s, 2] = p, u, q
            faces[g, 0], faces[g, 1], faces[g, 2] = q, v, p
            across[s, 0], across[s, 1], across[s, 2] = beyond_pu, beyond_uq, g
            across[g, 0], across[g, 1], across[g, 2] = beyond_qv, beyond_vp, s
            _set_neighbour(faces, across, beyond_uq, q, u, s)
            _set_neighbour(faces, across, beyond_vp, p, v, g)
            share[s] = share[g] = 0.5 * (share[s] + share[g])
            flipped += 1
    return flipped, left


@kernel
def smooth(x: Float, moved: Int, start: Int, neighbours: Int, passes: int, shrink: float, inflate: float) -> None:
    """Smooth by Taubin's lambda|mu (SIGGRAPH 1995) on x (n, 3), in place, by uniform weights.

    moved (m,) vertices, of which the i-th has the neighbours neighbours[start[i]:start[i + 1]]; one without stays. A
    pass scales a wave with the eigenvalue kappa of the Laplacian by (1 - lambda kappa)(1 - mu kappa).
    """
    step = np.empty((len(moved), 3))
    for turn in range(2 * passes):
        factor = shrink if turn % 2 == 0 else inflate
        for i in range(len(moved)):
            for k in range(3):
                total = 0.0
                for e in range(start[i], start[i + 1]):
                    total += x[neighbours[e], k]
                count = start[i + 1] - start[i]
                step[i, k] = factor * (total / count - x[moved[i], k]) if count else 0.0
        for i in range(len(moved)):
            for k in range(3):
                x[moved[i], k] += step[i, k]
