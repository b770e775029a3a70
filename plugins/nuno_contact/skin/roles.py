"""The joints of a motion's skeleton that correspond to a body's, by name: see nuno_contact.colliders.radii."""

from __future__ import annotations

import re

from nuno_contact.colliders.radii import find_part
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import Mover

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
