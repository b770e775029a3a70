"""A motion of one skeleton, retargeted to a body of other proportions.

Of every part the motion gives the rotation R(t) against the skeleton at rest, whose bones lie otherwise than the
body's: a T-pose and an A-pose. So a part turns by R(t) A, where A is fixed and lays the body's bone along the
skeleton's: for limbs the least turn that does, for the trunk, head and feet none but that from the body's axes to the
skeleton's. Joints then follow by the body's own bones. The hips go as the skeleton's do, by as much as the body's legs
are longer, beginning where the body stands and as it faces. Feet go on the floor that the body stands on, by the median
of the lowest point over the first two seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nuno_contact.colliders.body_parts import carrier_of
from nuno_contact.motions.rotations import (
    AXES,
    ease,
    from_axis_angle,
    from_matrices,
    invert,
    multiply,
    rest_positions,
    slerp,
)
from nuno_contact.skinning.figure import Figure
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.plugin import Mover
from nuno_schemas.vectors import compose, dot, norm, turn

ALONG = {"arm": "forearm", "forearm": "hand", "thigh": "shin", "shin": "foot"}
"""joints at the ends of bones whose directions are aligned"""
LOOKED = np.arange(0.0, 2.05, 0.1)
"""times [s] at which the height over the floor is measured"""
STILL = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Gait:
    """Poses of a body's parts, in an order in which what carries comes before what it carries.

    carrier (p,) number of what carries each, -1 for the hips; joint (p,) of the motion; hips: its hip joints; chest and
    arms: numbers of parts; place (p, 3) [m] in the body; aligned (p, 4) the turn A of each; follows (j,) the part that
    each joint of the motion goes with; heading (4,) the turn about y that has the motion begin as the body faces; scale
    of lengths; first (3,) [m] the skeleton's hips as they begin, lift [m] how much higher than in the body the hips
    begin; spread [rad] by how much more the arms are raised off the trunk than in the motion; stand, blend [s]
    """

    motion: Mover
    carrier: tuple[int, ...]
    joint: tuple[int, ...]
    hips: tuple[int, int]
    chest: int
    arms: tuple[tuple[int, ...], tuple[int, ...]]
    place: Float
    aligned: Float
    follows: Int
    heading: Float
    scale: float
    first: Float
    lift: float
    spread: float
    stand: float
    blend: float

    def pose(self, t: float) -> tuple[Float, Float]:
        """Return world rotation (j, 4) and translation (j, 3) [m] of the motion's joints at time t [s]: for `stand` the
        body's own, from there on over `blend` into the motion.
        """
        since = t - self.stand
        share = 1.0 if since >= self.blend else ease(since / self.blend) if since > 0.0 else 0.0
        if share == 0.0:
            rotation, place = np.tile(STILL, (len(self.place), 1)), self.place
        else:
            rotation, place = self.place_parts(*self.turns(max(since, 0.0)), share)
        return rotation[self.follows], place[self.follows]

    def turns(self, t: float) -> tuple[Float, Float]:
        """Return the parts' rotations (p, 4) in the world, and the hips' place (3,), at the motion's time t [s]."""
        rotation, place = self.motion.pose(t)
        turned = multiply(self.heading, multiply(rotation[list(self.joint)], self.aligned))
        chest = turned[self.chest]
        for side, arm in zip((1.0, -1.0), self.arms, strict=True):
            # About the chest's own axis ahead.
            raised = multiply(multiply(chest, from_axis_angle(AXES[2], side * self.spread)), invert(chest))
            turned[list(arm)] = multiply(raised, turned[list(arm)])
        way = self.scale * (0.5 * (place[self.hips[0]] + place[self.hips[1]]) - self.first)
        root = self.place[0] + turn(rotation_matrices(self.heading[None])[0], way)
        return turned, root + np.array([0.0, self.lift, 0.0])

    def place_parts(self, turned: Float, root: Float, share: float) -> tuple[Float, Float]:
        """Return parts' rotation (p, 4) and translation (p, 3), a `share` of the way from the body's own to a pose."""
        matrix, place = rotation_matrices(turned), np.zeros_like(self.place)
        if share < 1.0:
            local = turned.copy()
            for part, carrier in enumerate(self.carrier):
                if carrier >= 0:
                    local[part] = multiply(invert(turned[carrier]), turned[part])
            matrix = rotation_matrices(slerp(np.broadcast_to(STILL, local.shape), local, share))
        for part, carrier in enumerate(self.carrier):
            if carrier < 0:
                place[part] = (1.0 - share) * self.place[part] + share * root
                continue
            place[part] = place[carrier] + turn(matrix[carrier], self.place[part] - self.place[carrier])
            if share < 1.0:
                matrix[part] = compose(matrix[carrier], matrix[part])
        return (from_matrices(matrix) if share < 1.0 else turned), place


def fit_gait(motion: Mover, roles: dict[str, int], figure: Figure, spread: float, stand: float, blend: float) -> Gait:
    """Retarget a motion whose joints have the parts `roles` to a body.

    Raises BadInput for a skeleton at rest that does not stand, and one whose limbs have no length.
    """
    parts = list(roles)
    rest = rest_positions(motion.parents, motion.offsets)
    axes = _axes_of(rest, roles)
    aligned = [_align(part, roles, rest, figure, axes) for part in parts]
    hips = roles["left_thigh"], roles["right_thigh"]
    rotation, place = motion.pose(0.0)
    ahead = turn(rotation_matrices(multiply(rotation[roles["hips"]], from_matrices(axes))[None])[0], AXES[2])
    heading = from_axis_angle(AXES[1], -math.atan2(float(ahead[0]), float(ahead[2])))
    carriers = [carrier_of(part, roles) for part in parts]
    bones = ("thigh", "shin"), ("shin", "foot")
    legs = [(f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in bones]
    theirs = sum(float(norm(rest[roles[b]] - rest[roles[a]])) for a, b in legs)
    return Gait(
        motion=motion,
        carrier=tuple(parts.index(name) if name else -1 for name in carriers),
        joint=tuple(roles.values()),
        hips=hips,
        chest=parts.index("chest"),
        arms=(_arm_of("left", parts), _arm_of("right", parts)),
        place=np.stack([figure[part] for part in parts]),
        aligned=np.stack(aligned),
        follows=_follow(motion, list(roles.values())),
        heading=heading,
        scale=sum(float(norm(figure[b] - figure[a])) for a, b in legs) / theirs,
        first=0.5 * (place[hips[0]] + place[hips[1]]),
        lift=0.0,
        spread=spread,
        stand=stand,
        blend=blend,
    )


def _arm_of(side: str, parts: list[str]) -> tuple[int, ...]:
    """Return the numbers of the parts of an arm."""
    return tuple(parts.index(f"{side}_{name}") for name in ("arm", "forearm", "hand"))


def find_lift(gait: Gait, x: Float, feet: dict[int, Bool]) -> float:
    """Return how much higher the hips must begin [m] for feet to walk on the floor that the body x (v, 3) stands on;
    `feet` are the vertices (v,) of parts by number.
    """
    lowest = []
    for t in LOOKED.tolist():
        turned, root = gait.turns(t)
        rotation, place = gait.place_parts(turned, root, 1.0)
        matrix = rotation_matrices(rotation)
        lowest.append(min(
            float((turn(matrix[part], x[mine] - gait.place[part]) + place[part])[:, 1].min())
            for part, mine in feet.items() if mine.any()
        ))  # fmt: skip
    return float(x[:, 1].min()) - float(np.median(lowest))


def _axes_of(rest: Float, roles: dict[str, int]) -> Float:
    """Return the body's axes (left, up, ahead) in the skeleton's at rest (3, 3), each the nearest of its own."""
    left = rest[roles["left_thigh"]] - rest[roles["right_thigh"]]
    up = rest[roles["head"]] - rest[roles["hips"]]
    found = []
    for way in (left, up):
        axis = int(np.argmax(np.abs(way)))
        found.append(math.copysign(1.0, float(way[axis])) * AXES[axis])
    if float(norm(left)) == 0.0 or float(norm(up)) == 0.0 or float(dot(found[0], found[1])) != 0.0:
        raise BadInput(
            "the motion's skeleton does not stand at rest: its head is not above its hips, or its hip joints are not "
            "beside each other", field="motion", remedy="take a motion whose rest pose is a T-pose or an A-pose",
        )  # fmt: skip
    return np.stack([*found, np.cross(*found)], axis=1)


def _align(part: str, roles: dict[str, int], rest: Float, figure: Figure, axes: Float) -> Float:
    """Return the turn A of a part (4,)."""
    body_way = from_matrices(axes)
    side, _, name = part.partition("_")
    name = "forearm" if name == "hand" else name
    if name not in ALONG:
        return body_way
    first, last = f"{side}_{name}", f"{side}_{ALONG[name]}"
    theirs = rest[roles[last]] - rest[roles[first]]
    if float(norm(theirs)) == 0.0:
        raise BadInput(f"the motion's {first} has no length", field="motion")
    bone = turn(axes, figure[last] - figure[first])
    return multiply(_least_turn(bone / norm(bone), theirs / norm(theirs)), body_way)


def _least_turn(a: Float, b: Float) -> Float:
    """Return the least turn (4,) from unit vector a to b. Opposite ones have none; a limb's directions are nearer."""
    turned = np.concatenate([[1.0 + float(dot(a, b))], np.cross(a, b)])
    return np.asarray(turned / norm(turned))


def _follow(motion: Mover, joints: list[int]) -> Int:
    """Return the part (j,) that each joint of a motion goes with: its own, or the next joint's towards the root."""
    follows = np.zeros(len(motion.joints), np.int32)
    for j, parent in enumerate(motion.parents.tolist()):
        follows[j] = joints.index(j) if j in joints else follows[parent] if parent >= 0 else 0
    return follows
