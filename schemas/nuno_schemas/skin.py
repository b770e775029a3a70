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
        shift = translation - _turned(rotation, self.place)
        w, v = rotation[:, :1], rotation[:, 1:]
        # Half of the shift times the rotation, as quaternions.
        dual = 0.5 * np.concatenate([-(shift * v).sum(axis=1, keepdims=True), w * shift + np.cross(shift, v)], axis=1)
        real, moved, first = np.zeros((len(x), 4)), np.zeros((len(x), 4)), rotation[self.joint[:, 0]]
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
            share /= np.maximum(share.sum(axis=0), SMALLEST)
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
