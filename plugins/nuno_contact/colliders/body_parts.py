"""Parts of a body by the names of joints: their thickness as a share of its height, and the joints that correspond."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Int
from nuno_schemas.plugin import Mover

# Thicknesses of the parts of a body, as fractions of its height.
#
# Measured on horizontal sections of a real body of 1.666 m with arms half raised (a CC0 mesh): the
# radius of the circle with the section's girth, girth/(2 pi), at the height given. Waist and pelvis
# are much wider than deep (at 0.52 of the height half widths are 0.104 and 0.071), so the pelvis is
# a capsule lying across, as thick as the body is deep, and a skirt still meets the right width.
#
# A profile lists (where along the part, 0 at its upper or inner end to 1; radius / height).

PELVIS_HALF_WIDTH = 0.106
"""Half width of the hips, mean of the sections at 0.50 and 0.52."""

PROFILES: dict[str, tuple[tuple[float, float], ...]] = {
    "pelvis": ((0.0, 0.068), (1.0, 0.068)),  # half depth, mean of 0.50 to 0.56
    "back": ((0.0, 0.0645), (0.35, 0.0655), (1.0, 0.0770)),  # 0.64; 0.67; 0.73 below the armpits
    "neck": ((0.0, 0.0330), (1.0, 0.0306)),  # 0.85; 0.86
    "head": ((0.0, 0.0520), (1.0, 0.0520)),  # mean of 0.90 to 0.96
    "shoulder": ((0.0, 0.0400), (1.0, 0.0357)),  # upright sections beside the neck and at the arm
    "arm": ((0.0, 0.0310), (1.0, 0.0240)),  # oblique sections, divided by the slant
    "forearm": ((0.0, 0.0240), (1.0, 0.0160)),
    "hand": ((0.0, 0.0180), (1.0, 0.0150)),
    "thigh": ((0.0, 0.0540), (0.25, 0.0514), (0.5, 0.0466), (0.75, 0.0400), (1.0, 0.0335)),  # 0.465 to 0.29
    "shin": (  # 0.285, 0.20, 0.165, 0.14, 0.105, 0.075, 0.05
        *((0.0, 0.0332), (0.35, 0.0339), (0.5, 0.0302), (0.6, 0.0257)),
        *((0.75, 0.0214), (0.88, 0.0196), (1.0, 0.0209)),
    ),
    "foot": ((0.0, 0.0230), (1.0, 0.0190)),
    "toe": ((0.0, 0.0150), (1.0, 0.0120)),
}

PIECES = {"back": 2, "thigh": 3, "shin": 2}
"""capsules that a part is cut into (the skirt paper's numbers); 1 for other parts"""

_PATTERNS = (
    ("", r"thumb|finger|index|middle|ring|pinky"),
    ("toe", r"toe"),
    ("hand", r"hand|wrist"),
    ("forearm", r"fore_?arm|lower_?arm|elbow"),
    ("shoulder", r"shoulder|clavicle|collar"),
    ("arm", r"arm"),
    ("pelvis", r"hip_?joint|hips|pelvis|root|waist"),
    ("thigh", r"up_?leg|upper_?leg|thigh|femur|hip"),
    ("shin", r"leg|shin|calf|knee|tibia"),
    ("foot", r"foot|ankle|heel"),
    ("head", r"head|skull"),
    ("neck", r"neck"),
    ("back", r"back|spine|chest|torso|abdomen|thorax|trunk"),
)


def find_part(joint: str) -> str | None:
    """Return the part of the body that the bone starting at `joint` belongs to, from the joint's name.

    "" for fingers, which have no shape of their own; None for a name that says nothing.
    """
    for part, pattern in _PATTERNS:
        if re.search(pattern, joint.lower()):
            return part
    return None


TRUNK = {"back", "neck", "head"}


def is_person(joints: Sequence[str]) -> bool:
    """Return whether joints are named after a trunk and legs; those of a robot, a prop or half a person are not."""
    return all(not parts.isdisjoint(map(find_part, joints)) for parts in (TRUNK, {"thigh", "shin", "foot"}))


RESTS = 0.85
"""A skeleton stands at rest if it is then at least this share as high as in its tallest pose."""


def choose_height(at_rest: float, posed: float) -> float:
    """Return a skeleton's height, from that at rest and in its tallest pose, both without arms.

    Many captured files have a skeleton that lies at rest, or has all bones along one axis.
    """
    return at_rest if at_rest >= RESTS * posed else posed


def find_arms(joints: Sequence[str], parents: Int) -> Bool:
    """Return which joints (j,) belong to arms, of a skeleton with a trunk; parents come before children."""
    arm = np.array([find_part(joint) in ("arm", "forearm", "hand") for joint in joints])
    for j, parent in enumerate(parents):
        arm[j] |= parent >= 0 and arm[parent]
    return arm & any(find_part(joint) in TRUNK for joint in joints)


def default_radius(part: str, first: float, last: float) -> float:
    """Return the mean radius over body height between two places in [0, 1] along a part."""
    at, radius = zip(*PROFILES[part], strict=True)
    return float(np.interp(np.linspace(first, last, 17), at, radius).mean())


# The joints of a motion's skeleton that correspond to a body's, by name.

PARENTS = {
    "hips": "", "spine": "hips", "chest": "spine", "neck": "chest", "head": "neck",
    **{f"{side}_{name}": parent.format(side) for side in ("left", "right") for name, parent in (
        ("arm", "chest"), ("forearm", "{}_arm"), ("hand", "{}_forearm"),
        ("thigh", "hips"), ("shin", "{}_thigh"), ("foot", "{}_shin"))},
}  # fmt: skip
"""the parent of each part of a body; a motion may lack spine and neck, whose children then go with the next part"""
OPTIONAL = ("spine", "neck")
_SIDE = {
    "left": re.compile(r"[Ll]eft|LEFT|(^|[^A-Za-z])[lL]([^a-z]|$)|^[lL][A-Z]"),
    "right": re.compile(r"[Rr]ight|RIGHT|(^|[^A-Za-z])[rR]([^a-z]|$)|^[rR][A-Z]"),
}


def find_roles(mover: Mover) -> dict[str, int]:
    """Return the numbers of joints by the part of the body that each moves, all of PARENTS but OPTIONAL ones, in order.

    Raises BadInput for a motion whose joints' names are not of a body, with the missing parts.
    """
    parts = [find_part(joint) for joint in mover.joints]
    parents = mover.parents.tolist()
    found: dict[str, int] = {}
    if "pelvis" in parts:
        found["hips"] = parts.index("pelvis")
    if "head" in parts:
        found["head"] = parts.index("head")
        path = _path(found["head"], parents)
        back = [j for j in path if parts[j] == "back"]
        if back:
            found["chest"] = back[-1]
        if len(back) > 1:
            found["spine"] = back[(len(back) - 1) // 2]
        neck = [j for j in path if parts[j] == "neck"]
        if neck:
            found["neck"] = neck[0]
    for side, pattern in _SIDE.items():
        mine = [j for j, joint in enumerate(mover.joints) if pattern.search(joint)]
        for part in ("forearm", "hand", "thigh", "shin", "foot", "arm"):
            named = [j for j in mine if parts[j] == part]
            if named:
                found[f"{side}_{part}"] = named[0]
        # If a clavicle is called collar, the joint called shoulder is the arm's.
        if f"{side}_arm" not in found and (child := found.get(f"{side}_forearm")) is not None:
            found[f"{side}_arm"] = parents[child]
    _check(mover, found, parents)
    return {part: found[part] for part in PARENTS if part in found}


def _path(joint: int, parents: list[int]) -> list[int]:
    """Return the joints from the root to one, with it."""
    path = [joint]
    while parents[path[-1]] >= 0:
        path.append(parents[path[-1]])
    return path[::-1]


def _check(mover: Mover, found: dict[str, int], parents: list[int]) -> None:
    missing = [part for part in PARENTS if part not in found and part not in OPTIONAL]
    if missing:
        raise BadInput(
            "the motion's skeleton is not that of a body: no joint is named after " + ", ".join(missing),
            field="motion", value=", ".join(mover.joints[:40]),
            limit="hips, a back (spine, chest), head, and left and right arm, forearm, hand, thigh, shin, foot",
            remedy="name its joints so, as `left_forearm`, `LeftForeArm` or `lElbow`",
        )  # fmt: skip
    for part, joint in found.items():
        carrier = carrier_of(part, found)
        if carrier and found[carrier] not in _path(joint, parents)[:-1]:
            raise BadInput(
                f"the motion's {part} does not hang on its {carrier}", field="motion",
                value=f"{mover.joints[joint]}, {mover.joints[found[carrier]]}",
                limit="a skeleton whose root is the hips",
            )  # fmt: skip


def carrier_of(part: str, found: dict[str, int]) -> str:
    """Return the parent part among those found; empty for the hips."""
    carrier = PARENTS[part]
    while carrier and carrier not in found:
        carrier = PARENTS[carrier]
    return carrier
