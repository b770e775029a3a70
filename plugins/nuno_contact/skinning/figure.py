"""The joints of a standing person, found from the mesh alone.

The person stands upright, y up, and faces +z, with feet and arms apart as in a T-pose or an A-pose. Legs are found by
level sections, arms by the way over the surface from the neck: their tips are the farthest for how little lower they
lie. Where along a limb, and up a trunk, its joints come is by shares of its length: hip joints, knees, ankles and trunk
as read off sections of a real body of 1.666 m (a CC0 mesh; see nuno_contact.motions.hula), arms by the segments of
R. Drillis and R. Contini, Body segment parameters, New York University, 1966: hand, forearm and upper arm are 0.108,
0.146 and 0.186 of the height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_geometry.centreline import way_from
from nuno_geometry.sections import Loop, cut_mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import dot, norm

TRUNK = {"spine": 0.63, "chest": 0.73, "neck": 0.825, "head": 0.88}
"""heights of joints, as shares of the body's; the hip joints have HIP"""
HIP, KNEE, ANKLE = 0.52, 0.505, 0.045
"""shares of the height; the knee's is of the way from the ankle to the hip joint"""
OVER_CROTCH = 0.04
"""share of the height by which the hip joints lie above where the thighs meet"""
HAND, FOREARM, UPPER_ARM = 0.108, 0.146, 0.186
ARM = HAND + FOREARM + UPPER_ARM
BEYOND_PIT = 0.03
"""share of the height by which the shoulder joint lies beyond the section through the armpit, along the arm"""
CROTCH = (0.38, 0.56)
"""shares of the height between which thighs meet"""
LOWEST_HAND = 0.3
WIDENS = 1.5
"""factor on the least girth of the upper arm at which an arm ends"""
STANDS = "a person who stands upright (y up), faces +z, feet and arms apart"
TURN = "turn it by `up: z` or in the program that it comes from"

SIDES = (("left", 1.0), ("right", -1.0))


@dataclass(frozen=True)
class Figure:
    """Joints and ends of bones of a body by name, each (3,) [m]: hips (midway between the hip joints), spine, chest,
    neck, head, top, and of either side, as left_arm: arm, forearm, hand, hand_end, thigh, shin, foot, foot_end, heel.
    """

    places: dict[str, Float]
    height: float

    def __getitem__(self, name: str) -> Float:
        return self.places[name]


def find_figure(x: Float, faces: Int) -> Figure:
    """Find the figure of a closed mesh x (n, 3) [m], faces (f, 3). Raises BadInput for one that does not stand so."""
    size = np.ptp(x, axis=0)
    height = float(size[1])
    if height < 0.7 * float(size.max()):
        width = f"{height:.3g} m high, {float(size.max()):.3g} m long"
        raise _refused("the body lies down, or y does not point up in its file", width)
    floor = float(x[:, 1].min())
    legs = [_leg_loops(x, faces, floor + share * height) for share in (0.06, 0.15, 0.25)]
    if any(len(pair) != 2 for pair in legs):
        sections = ", ".join(str(len(pair)) for pair in legs)
        raise _refused("no two legs are found on the body", f"{sections} in sections below the knees")
    middle = float(np.mean([loop.centroid()[0] for loop in legs[0]]))
    crotch = _find_crotch(x, faces, floor, height, middle)
    places: dict[str, Float] = {}
    for side, sign in SIDES:
        leg = _find_leg(x, faces, floor, height, crotch, middle, sign)
        places |= {f"{side}_{name}": at for name, at in leg.items()}
    places["hips"] = 0.5 * (places["left_thigh"] + places["right_thigh"])
    hip = float(places["hips"][1])
    for name, share in TRUNK.items():
        y = hip + (share - HIP) / (1.0 - HIP) * (floor + height - hip)
        places[name] = _trunk_middle(x, faces, y, middle)
    places["top"] = np.array([places["head"][0], floor + 0.97 * height, places["head"][2]])
    way = way_from(x, faces, places["neck"])
    for side, sign in SIDES:
        arm = _find_arm(x, faces, way, floor, height, middle, sign, float(places["neck"][1]))
        places |= {f"{side}_{name}": at for name, at in arm.items()}
    return Figure(places, height)


def _refused(problem: str, value: str | None = None) -> BadInput:
    return BadInput(problem, field="file", value=value, limit=STANDS, remedy=TURN)


def _leg_loops(x: Float, faces: Int, y: float) -> list[Loop]:
    """Return the two longest loops of a level section, if they lie side by side; else all of them."""
    loops = sorted(cut_mesh(x, faces, x[:, 1] - y), key=lambda loop: -loop.girth)
    if len(loops) < 2:
        return loops
    pair = sorted(loops[:2], key=lambda loop: -float(loop.centroid()[0]))
    apart = float(pair[0].points[:, 0].min() - pair[1].points[:, 0].max())
    return pair if apart > 0.0 and pair[1].girth > 0.5 * pair[0].girth else loops[:1]


def _find_crotch(x: Float, faces: Int, floor: float, height: float, middle: float) -> float:
    """Return the height of the lowest section [m] with a loop about the middle."""
    for share in np.arange(0.26, CROTCH[1], 0.005):
        y = floor + float(share) * height
        for loop in cut_mesh(x, faces, x[:, 1] - y):
            low, high = float(loop.points[:, 0].min()), float(loop.points[:, 0].max())
            if low < middle - 0.02 * height and high > middle + 0.02 * height:
                if share < CROTCH[0]:
                    raise _refused("the legs are not apart", f"they meet at {share:.0%} of the height")
                return y
    raise _refused("no trunk is found above the legs")


def _find_leg(
    x: Float, faces: Int, floor: float, height: float, crotch: float, middle: float, sign: float
) -> dict[str, Float]:
    """Return the joints of a leg. Raises BadInput for a foot that does not point to +z."""
    hip_y, ankle_y = crotch + OVER_CROTCH * height, floor + ANKLE * height
    which = 0 if sign > 0.0 else 1

    def centre(y: float) -> Float:
        loops = _leg_loops(x, faces, y)
        if len(loops) != 2:
            raise _refused("no two legs are found on the body", f"at a height of {y:.3g} m")
        return loops[which].centroid()

    thigh, ankle = centre(crotch - 0.02 * height), centre(floor + 0.06 * height)
    foot = x[(x[:, 1] < floor + 0.05 * height) & (sign * (x[:, 0] - middle) > 0.0)]
    ahead, behind = float(foot[:, 2].max() - ankle[2]), float(ankle[2] - foot[:, 2].min())
    if ahead < 1.2 * behind or ahead < float(np.abs(foot[:, 0] - ankle[0]).max()):
        reach = f"a foot reaches {ahead:.2g} m to +z of its ankle, {behind:.2g} m to -z"
        raise _refused("the body does not face +z", reach)
    tip = foot[int(foot[:, 2].argmax())]
    return {
        "thigh": np.array([thigh[0], hip_y, thigh[2]]),
        "shin": centre(ankle_y + KNEE * (hip_y - ankle_y)),
        "foot": np.array([ankle[0], ankle_y, ankle[2]]),
        "foot_end": np.array([tip[0], floor + 0.012 * height, tip[2] - 0.012 * height]),
        "heel": np.array([ankle[0], floor + 0.02 * height, ankle[2] - 0.6 * behind]),
    }


def _trunk_middle(x: Float, faces: Int, y: float, middle: float) -> Float:
    """Return the middle of the loop about the plane of symmetry (3,)."""
    loops = cut_mesh(x, faces, x[:, 1] - y)
    about = [loop for loop in loops if loop.points[:, 0].min() < middle < loop.points[:, 0].max()]
    if not about:
        raise _refused("no trunk is found above the legs", f"at a height of {y:.3g} m")
    loop = max(about, key=lambda one: one.girth)
    return np.array([middle, y, 0.5 * float(loop.points[:, 2].min() + loop.points[:, 2].max())])


def _find_arm(
    x: Float, faces: Int, way: Float, floor: float, height: float, middle: float, sign: float, neck: float
) -> dict[str, Float]:
    """Return the joints of an arm; `way` (n,) [m] is the way from the neck over the surface."""
    side = (sign * (x[:, 0] - middle) > 0.0) & (x[:, 1] > floor + LOWEST_HAND * height) & np.isfinite(way)
    tip = int(np.argmax(np.where(side, way - 0.7 * np.abs(neck - x[:, 1]), -np.inf)))
    back = way_from(x, faces, x[tip])
    along = np.arange(0.02, 0.6, 0.005) * height
    rings = [max(cut_mesh(x, faces, back - d), key=lambda loop: loop.girth, default=None) for d in along]
    girth = np.array([np.inf if ring is None else ring.girth for ring in rings])
    upper = (along > 0.24 * height) & (along < 0.32 * height)
    ends = np.flatnonzero((along > 0.26 * height) & (girth > WIDENS * girth[upper].min()))
    if not len(ends) or along[ends[0]] > 0.5 * height or not np.isfinite(girth[upper]).all():
        raise _refused("no arms are found that are apart from the trunk", "the left" if sign > 0.0 else "the right")
    length = float(along[ends[0]]) + BEYOND_PIT * height

    def ring_at(share: float) -> Float:
        found = rings[int(np.argmin(np.abs(along - share * length)))]
        assert found is not None
        return found.centroid()

    hand, forearm = ring_at(HAND / ARM), ring_at((HAND + FOREARM) / ARM)
    last = rings[int(ends[0]) - 3]
    assert last is not None
    line = last.centroid() - forearm
    arm = forearm + UPPER_ARM / ARM * length * line / norm(line)
    reach = x[tip] - hand
    fingers = hand + 0.9 * reach if float(dot(reach, hand - forearm)) > 0.0 else hand + 0.5 * (hand - forearm)
    return {"arm": arm, "forearm": forearm, "hand": hand, "hand_end": fingers}
