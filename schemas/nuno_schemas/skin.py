"""A skin that follows frames: each vertex goes with a few of them, by fixed weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from nuno_schemas.fabric import Float, Int
from nuno_schemas.layout import Bounds


@dataclass(frozen=True)
class Skin:
    """What carries the s vertices of a skin: k of the q frames from that of its primitive on.

    place  (q, 3) [m]    where the frames lie, unturned, in the vertices as they stand in the geometry
    joint  (s, k) int32  which of these frames, from 0, the one with the largest weight first
    weight (s, k)        how much of the vertex each carries, one in all

    The lengths s and q are a skin's own: a geometry has v vertices and f frames of all its bodies.
    """

    place: Annotated[Float, "q", 3]
    joint: Annotated[Int, "s", "k", Bounds(0, below="q")]
    weight: Annotated[Float, "s", "k", Bounds(0.0, 1.0)]

    def bend(self, x: Float, rotation: Float, translation: Float) -> Float:
        """(s, 3) where vertices x (s, 3) are [m], with the q frames turned by quaternions (q, 4) and at (q, 3) [m].

        Each frame's motion since the skin was bound is a dual quaternion, of which those of a vertex are added by
        weight, and the sum is made one of length 1 (L. Kavan et al., Geometric skinning with approximate dual
        quaternion blending, ACM Transactions on Graphics 27(4), 2008). Sums of matrices instead, linear blend skinning,
        are no turns any more, and draw joints thin. Added up by hand, for the same bits everywhere.
        """
        shift = translation - _turned(rotation, self.place)
        w, v = rotation[:, :1], rotation[:, 1:]
        # Half of the shift times the rotation, as quaternions.
        dual = 0.5 * np.concatenate([-(shift * v).sum(axis=1, keepdims=True), w * shift + np.cross(shift, v)], axis=1)
        real, moved, first = np.zeros((len(x), 4)), np.zeros((len(x), 4)), rotation[self.joint[:, 0]]
        for k in range(self.joint.shape[1]):
            of = self.joint[:, k]
            turn = rotation[of]
            # A quaternion and its negative are one rotation: that nearer to the first counts.
            signed = np.where((turn * first).sum(axis=1) < 0.0, -1.0, 1.0) * self.weight[:, k]
            real += signed[:, None] * turn
            moved += signed[:, None] * dual[of]
        length = np.sqrt((real * real).sum(axis=1, keepdims=True))
        real, moved = real / length, moved / length
        w, v, e, d = real[:, :1], real[:, 1:], moved[:, :1], moved[:, 1:]
        return np.asarray(_turned(real, x) + 2.0 * (w * d - e * v + np.cross(v, d)))


def _turned(rotation: Float, x: Float) -> Float:
    """Vectors x (n, 3) turned by unit quaternions (n, 4)."""
    w, v = rotation[:, :1], rotation[:, 1:]
    half = np.cross(v, x) + w * x
    return np.asarray(x + 2.0 * np.cross(v, half))
