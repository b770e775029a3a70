"""Closest points of a vertex and a triangle, and of two edges, as weights of their four vertices.

A pair is four vertices of which some make up its first primitive and the others its second: a vertex and a triangle
(1 and 3) or two edges (2 and 2). With weights w, positive on the first and negative on the second, each summing to 1,
the vector from the closest point of the second to that of the first is sum w_i x_i.

By regions, as Ericson has it (Real-Time Collision Detection, 2005, 5.1.5 and 5.1.9).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from nuno_geometry.poses import Index, Vector
from nuno_kernels import forced_inline
from nuno_kernels.lanes import dot, minus
from nuno_schemas.fabric import Float

INSIDE, ON_AB, ON_BC, ON_CA, AT_A, AT_B, AT_C = 0, 1, 2, 3, 4, 5, 6
"""feature of a triangle on which the point closest to a vertex lies"""

Four = tuple[float, float, float, float]
Corners = tuple[Vector, Vector, Vector, Vector]


class Closest(NamedTuple):
    """Weights of four vertices at the closest points, and their feature: of a vertex and a triangle one of the names
    above, of two edges 0 if both are inside of their edges and 1 if one of them is an end.
    """

    weights: Four
    where: int


@forced_inline
def point(x: Float, i: Index) -> Vector:
    """Return column i of x (3, n)."""
    return x[0, i], x[1, i], x[2, i]


@forced_inline
def weigh(w: Four, p: Corners) -> Vector:
    """Return the sum of w_i p_i."""
    a, b, c, d = p
    return (
        w[0] * a[0] + w[1] * b[0] + w[2] * c[0] + w[3] * d[0],
        w[0] * a[1] + w[1] * b[1] + w[2] * c[1] + w[3] * d[1],
        w[0] * a[2] + w[1] * b[2] + w[2] * c[2] + w[3] * d[2],
    )


@forced_inline
def to_triangle(p: Vector, a: Vector, b: Vector, c: Vector) -> Closest:
    """Return the closest points of a vertex p and a triangle a b c."""
    ab, ac, ap = minus(b, a), minus(c, a), minus(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return Closest((1.0, -1.0, 0.0, 0.0), AT_A)
    bp = minus(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return Closest((1.0, 0.0, -1.0, 0.0), AT_B)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return Closest((1.0, t - 1.0, -t, 0.0), ON_AB)
    cp = minus(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return Closest((1.0, 0.0, 0.0, -1.0), AT_C)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return Closest((1.0, t - 1.0, 0.0, -t), ON_CA)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return Closest((1.0, 0.0, t - 1.0, -t), ON_BC)
    scale = 1.0 / (va + vb + vc)
    s, t = vb * scale, vc * scale
    return Closest((1.0, -(1.0 - s - t), -s, -t), INSIDE)


@forced_inline
def clamped(a: float) -> float:
    """Clamp a number to [0, 1]."""
    a = a if a > 0.0 else 0.0
    return a if a < 1.0 else 1.0


@forced_inline
def to_edge(p: Vector, q: Vector, a: Vector, b: Vector) -> Closest:
    """Return the closest points of two edges p q and a b of nonzero length."""
    d1, d2, r = minus(q, p), minus(b, a), minus(p, a)
    aa, ee, f = dot(d1, d1), dot(d2, d2), dot(d2, r)
    c, bb = dot(d1, r), dot(d1, d2)
    det = aa * ee - bb * bb
    # Without branches: the region cannot be predicted, and a wrong prediction takes as long as all of this.
    s = clamped((bb * f - c * ee) / det) if det > 1e-14 * aa * ee else 0.0
    along = (bb * s + f) / ee
    t = clamped(along)
    again = clamped((bb * t - c) / aa)
    s = s if t == along else again
    ends = s <= 0.0 or s >= 1.0 or t <= 0.0 or t >= 1.0
    return Closest((1.0 - s, s, t - 1.0, -t), 1 if ends else 0)


@forced_inline
def closest(of_edges: bool, p: Corners) -> Closest:
    """Return the closest points of two edges, or of a vertex and a triangle."""
    if of_edges:
        return to_edge(p[0], p[1], p[2], p[3])
    return to_triangle(p[0], p[1], p[2], p[3])


@forced_inline
def between(of_edges: bool, n: Vector, p: Corners) -> tuple[float, float]:
    """Return, along n, the lowest of the first primitive, and the highest of the second. If the first is larger, a
    plane across n keeps them apart.
    """
    a, b, c, d = dot(n, p[0]), dot(n, p[1]), dot(n, p[2]), dot(n, p[3])
    if of_edges:
        return min(a, b), max(c, d)
    return a, max(max(b, c), d)


@forced_inline
def unit(v: Vector) -> tuple[Vector, float]:
    """Return v at length 1, and its length; v itself if that is 0."""
    length = math.sqrt(dot(v, v))
    if length <= 0.0:
        return v, 0.0
    scale = 1.0 / length
    return (scale * v[0], scale * v[1], scale * v[2]), length
