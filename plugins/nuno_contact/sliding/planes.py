"""A movement constrained by planes, with Coulomb friction: the motion of a vertex that meets a surface.

The movement m that a vertex would make is changed by the least that keeps it out of up to two planes
with normals n1 and n2,

    m' = m + a n1 + b n2,   a, b >= 0,   m'. n1 >= h1,   m'. n2 >= h2,

each of a and b 0 or its condition met exactly (a linear complementarity problem of two unknowns, solved by
cases). This is the sliding projection of the stocking paper: what would enter is projected onto the plane, or
onto the line where two planes meet. Friction then takes mu (a + b) off the movement along the plane, or along
the line, at most all of it. The same acts on velocities, where a + b is the impulse per mass: a vertex sticks
where the force along the plane is no more than mu times that into it, at any step.
"""

from __future__ import annotations

import math

from nuno_geometry.poses import Vector
from nuno_kernels import kernel

PARALLEL = 1e-6
"""squared sine between normals below which two planes are one"""


@kernel
def share_planes(g1: float, g2: float, cosine: float) -> tuple[float, float]:
    """Return the least a, b >= 0 with a + b cosine >= g1 and a cosine + b >= g2."""
    if g1 <= 0.0 and g2 <= 0.0:
        return 0.0, 0.0
    if g1 > 0.0 and g1 * cosine >= g2:
        return g1, 0.0
    if g2 > 0.0 and g2 * cosine >= g1:
        return 0.0, g2
    square = 1.0 - cosine * cosine
    if square < PARALLEL:
        return (g1, 0.0) if g1 >= g2 else (0.0, g2)
    return max(0.0, (g1 - cosine * g2) / square), max(0.0, (g2 - cosine * g1) / square)


@kernel
def hold_off(m: Vector, n1: Vector, h1: float, n2: Vector, h2: float, two: bool, mu: float) -> Vector:
    """Return the movement m constrained by one plane, or by `two`, with friction mu; h1 and h2 are the least movement
    along the unit normals n1 and n2.
    """
    g1 = h1 - (m[0] * n1[0] + m[1] * n1[1] + m[2] * n1[2])
    a, b = max(g1, 0.0), 0.0
    if two:
        cosine = n1[0] * n2[0] + n1[1] * n2[1] + n1[2] * n2[2]
        a, b = share_planes(g1, h2 - (m[0] * n2[0] + m[1] * n2[1] + m[2] * n2[2]), cosine)
    x = m[0] + a * n1[0] + b * n2[0]
    y = m[1] + a * n1[1] + b * n2[1]
    z = m[2] + a * n1[2] + b * n2[2]
    if mu == 0.0 or a + b == 0.0:
        return x, y, z
    if a > 0.0 and b > 0.0:
        tx, ty, tz = n1[1] * n2[2] - n1[2] * n2[1], n1[2] * n2[0] - n1[0] * n2[2], n1[0] * n2[1] - n1[1] * n2[0]
        along = (x * tx + y * ty + z * tz) / (tx * tx + ty * ty + tz * tz)
        tx, ty, tz = along * tx, along * ty, along * tz
    else:
        nx, ny, nz = n1 if a > 0.0 else n2
        along = x * nx + y * ny + z * nz
        tx, ty, tz = x - along * nx, y - along * ny, z - along * nz
    size = math.sqrt(tx * tx + ty * ty + tz * tz)
    friction = 1.0 if size <= mu * (a + b) else mu * (a + b) / size
    return x - friction * tx, y - friction * ty, z - friction * tz
