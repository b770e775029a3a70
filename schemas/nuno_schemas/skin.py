"""A skin that follows frames: each vertex goes with a few of them, by fixed weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from nuno_schemas.fabric import Float, Int
from nuno_schemas.layout import Bounds

SMALLEST = float(np.finfo(float).tiny)


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

    def beside(self, points: Float, x: Float, faces: Int) -> Skin:
        """What carries points (n, 3) beside this skin, whose vertices are x (v, 3) [m], in triangles faces (f, 3): each
        as its place on the nearest triangle of those round the nearest vertex goes, by the weights of the corners.
        """
        whole = np.zeros((len(points), len(self.place)))
        for point, joints in zip(points, whole, strict=True):
            nearest = ((x - point) ** 2).sum(axis=1).argmin()
            around = faces[(faces == nearest).any(axis=1)]
            a, b, c = (x[around[:, k]] for k in range(3))
            areas = [np.cross(p - point, q - point) for p, q in ((b, c), (c, a), (a, b))]
            share = np.maximum((np.stack(areas) * np.cross(b - a, c - a)).sum(axis=2), 0.0)
            share /= np.maximum(share.sum(axis=0), SMALLEST)
            off = (share[:, :, None] * np.stack([a, b, c])).sum(axis=0) - point
            best = (off * off).sum(axis=1).argmin()
            for corner, own in zip(around[best], share[:, best], strict=True):
                np.add.at(joints, self.joint[corner], own * self.weight[corner])
        most = max(1, int((whole > 0.0).sum(axis=1).max(initial=1)))
        joint = np.argsort(-whole, axis=1, kind="stable")[:, :most].astype(np.int32)
        weight = np.take_along_axis(whole, joint, axis=1)
        return Skin(self.place, joint, weight / weight.sum(axis=1, keepdims=True))

    def unbend(self, x: Float, rotation: Float, translation: Float) -> Float:
        """(v, 3) where vertices that are bent to x (v, 3) are as the skin is bound [m]: the way back of `bend`."""
        origin, *axes = (
            self.bend(np.broadcast_to(at, x.shape), rotation, translation) for at in (np.zeros(3), *np.eye(3))
        )
        return np.stack([((x - origin) * (axis - origin)).sum(axis=1) for axis in axes], axis=1)


NO_SKIN = Skin(np.zeros((0, 3)), np.zeros((0, 1), np.int32), np.zeros((0, 1)))


def join_skins(skins: Sequence[Skin]) -> Skin:
    """All of them as one, on the frames of one after the other; of as many weights as the one that has most."""
    if not skins:
        return NO_SKIN
    most = max(skin.joint.shape[1] for skin in skins)
    starts = np.cumsum([0, *(len(skin.place) for skin in skins)])
    joint = [
        np.pad(skin.joint + np.int32(at), ((0, 0), (0, most - skin.joint.shape[1])), "edge")
        for skin, at in zip(skins, starts, strict=False)
    ]
    weight = [np.pad(skin.weight, ((0, 0), (0, most - skin.weight.shape[1]))) for skin in skins]
    return Skin(*(np.concatenate(part) for part in ([skin.place for skin in skins], joint, weight)))


def _turned(rotation: Float, x: Float) -> Float:
    """Vectors x (n, 3) turned by unit quaternions (n, 4)."""
    w, v = rotation[:, :1], rotation[:, 1:]
    half = np.cross(v, x) + w * x
    return np.asarray(x + 2.0 * np.cross(v, half))
