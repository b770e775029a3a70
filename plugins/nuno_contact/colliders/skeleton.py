"""Skeletons as capsules: each bone is one, or cut into pieces with radii of their own."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.colliders.body_parts import (
    PELVIS_HALF_WIDTH,
    PIECES,
    PROFILES,
    choose_height,
    default_radius,
    find_arms,
    find_part,
)
from nuno_contact.motions.rotations import rest_positions
from nuno_contact.quantities import Size
from nuno_contact.skinning.drawn_person import draw_person
from nuno_schemas.bodies import CAPSULE
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape, Config, Files, Mover
from nuno_schemas.vectors import norm


class SkeletonConfig(Config):
    """Capsules on the bones of a motion's skeleton.

    A bone runs from a joint to one of its children and is called by that joint's name.
    """

    split: bool = Field(
        default=True,
        description="cut bones into pieces with their own radii; off: one capsule a bone (to measure what splitting "
        "buys: with one capsule the skirt paper's contact was misjudged)",
    )
    height: Size | None = Field(
        default=None, description="of the body [m], which scales default radii; the skeleton's unless given"
    )
    radii: dict[str, Size | Annotated[list[Size], Field(min_length=1)]] = Field(
        default_factory=dict,
        description="[m] of bones by joint, or of parts of the body (pelvis, back, neck, head, shoulder, arm, "
        "forearm, hand, thigh, shin, foot, toe): one number, or a list, one for each piece from the inner end on; a "
        "joint's name goes before the name of a part",
    )
    bones: tuple[str, ...] | None = Field(default=None, description="joints or parts to build; all unless given")
    drawn: Literal["capsules", "person"] = Field(
        default="capsules",
        description="how the body looks: the capsules that the cloth meets, or a person's skin on the same joints",
    )


@dataclass(frozen=True)
class Bone:
    """A segment in the frame of joint `frame`: from `a` to `b` (3,) [m], part of the body `part`.

    before, after  length of the same part towards the trunk and away from it [m]; a back of
                   several bones is one part
    ends           the last capsule's cap stays within the bone: no bone follows, or only the neck,
                   into which a cap as wide as the chest would reach
    """

    frame: int
    part: str
    a: Float
    b: Float
    before: float = 0.0
    after: float = 0.0
    ends: bool = False

    @property
    def length(self) -> float:
        return float(norm(self.b - self.a))


def find_height(mover: Mover) -> float:
    """Return the skeleton's extent at rest [m] along the axis in which its head lies from its root (the widest, if no
    joint is called head or neck); its height as the motion begins, if it does not stand so.
    """
    rest = rest_positions(mover.parents, mover.offsets)
    extent = np.ptp(rest, axis=0)
    tops = [j for j, joint in enumerate(mover.joints) if find_part(joint) in ("head", "neck")]
    own = float(extent[np.argmax(np.abs(rest[tops[-1]] - rest[0]))] if tops else extent.max())
    posed = mover.pose(0.0)[1][~find_arms(mover.joints, mover.parents), 1]
    return choose_height(own, float(np.ptp(posed)))


def name_parts(mover: Mover, named: Collection[str]) -> list[str]:
    """Return the part of the body that the bones from every joint belong to, "" for none.

    Raises BadInput for a joint with children whose name says nothing, unless it is in `named`
    (then its part is called "bone").
    """
    parents = set(mover.parents.tolist())
    parts = []
    for j, joint in enumerate(mover.joints):
        part = find_part(joint)
        if part is None and joint not in named and j in parents:
            raise BadInput(
                "the joint's name does not say which part of the body it is", field="radii", value=joint,
                remedy=f"give its radius: radii: {{{joint}: 3 cm}}",
            )  # fmt: skip
        parts.append(part if part is not None else "bone")
    return parts


def find_bones(mover: Mover, named: Collection[str], half_width: float) -> list[Bone]:
    """Return the bones of nonzero length, in the order of the joints they lead to.

    The two bones from the pelvis to the thighs are one, across the body and `half_width` [m] to either side of its
    middle at most: the hip joints lie further apart than a pelvis's round end may begin. Joints of the pelvis are
    assumed not to turn against each other.
    """
    parts, size = name_parts(mover, named), norm(mover.offsets)
    hips = [j for j, p in enumerate(mover.parents) if p >= 0 and (parts[p], parts[j]) == ("pelvis", "thigh")]
    crossing = len(hips) == 2
    led: list[str] = []
    before, after = np.zeros(len(parts)), np.zeros(len(parts))
    for j, p in enumerate(mover.parents):
        part = parts[p]
        if part in ("pelvis", "back", "neck") and parts[j] in ("arm", "shoulder"):
            part = "shoulder"
        led.append("" if p < 0 or size[j] == 0.0 else part)
        if led[j] and led[j] == led[p]:
            before[j] = before[p] + size[p]
    for j in range(len(parts) - 1, 0, -1):
        p = mover.parents[j]
        if led[j] and led[j] == led[p]:
            after[p] = max(after[p], after[j] + size[j])
    bones = [cross_pelvis(mover, parts, hips, half_width)] if crossing else []
    inner = set(mover.parents.tolist())
    for j, p in enumerate(mover.parents):
        if led[j] and not (crossing and j in hips):
            ends = j not in inner or (led[j] == "back" and after[j] == 0.0)
            bones.append(Bone(int(p), led[j], np.zeros(3), mover.offsets[j], before[j], after[j], ends))
    return bones


def cross_pelvis(mover: Mover, parts: list[str], hips: list[int], half_width: float) -> Bone:
    """Return the bone across the pelvis between two hip joints, carried by the topmost pelvis joint."""
    carrier = int(mover.parents[hips[0]])
    while mover.parents[carrier] >= 0 and parts[mover.parents[carrier]] == "pelvis":
        carrier = int(mover.parents[carrier])
    rest = rest_positions(mover.parents, mover.offsets)
    left, right = (rest[j] - rest[carrier] for j in hips)
    middle, across = 0.5 * (left + right), 0.5 * (left - right)
    reach = float(norm(across))
    across = across * (min(half_width, reach) / reach if reach > 0.0 else 0.0)
    return Bone(carrier, "pelvis", middle - across, middle + across)


def choose_radii(bone: Bone, own: float | list[float] | None, height: float, split: bool) -> list[float]:
    """Return the radii [m] of a bone's pieces, from its inner end to its outer; one if it is not `split`."""
    if own is None:
        whole = bone.before + bone.length + bone.after
        share = bone.length / whole if whole > 0.0 else 0.0
        pieces = max(1, round(PIECES.get(bone.part, 1) * share))
        cuts = (bone.before + np.linspace(0.0, bone.length, pieces + 1)) / (whole or 1.0)
        radii = [height * default_radius(bone.part, *ends) for ends in itertools.pairwise(cuts)]
    else:
        radii = own if isinstance(own, list) else [own]
    return radii if split else [sum(radii) / len(radii)]


def cut(bone: Bone, radii: list[float]) -> list[tuple[Float, Float, float]]:
    """Return (a, b, radius) of pieces of equal length, end to end. With `ends`, the last piece is shortened by its
    round cap.
    """
    pieces = []
    for i, radius in enumerate(radii):
        s0, s1 = i / len(radii), (i + 1) / len(radii)
        if bone.ends and i == len(radii) - 1:
            s1 = max(s0, s1 - radius / bone.length)
        pieces.append((bone.a + s0 * (bone.b - bone.a), bone.a + s1 * (bone.b - bone.a), radius))
    return pieces


def check_names(field: str, names: Collection[str], mover: Mover) -> None:
    """Raise BadInput for a name that is neither a joint nor a part of the body."""
    for name in names:
        if name not in mover.joints and name not in PROFILES:
            raise BadInput("no such bone", field=field, value=name, remedy=nearest(name, (*mover.joints, *PROFILES)))


class Skeleton:
    """Capsules on a skeleton's bones: back in 2 pieces, pelvis 1, thighs 3, shins 2 (the skirt paper)."""

    name: ClassVar[str] = "skeleton"
    Config: ClassVar[type[BaseModel]] = SkeletonConfig

    def build(self, config: SkeletonConfig, mover: Mover | None, files: Files) -> BodyShape:
        """Raises BadInput without a motion that has a skeleton, and for names that it does not have."""
        if mover is None or len(mover.joints) < 2:
            raise BadInput("a skeleton needs a motion with joints", field="motion", remedy="add a motion: hula or bvh")
        if config.drawn == "person" and config.bones is not None:
            remedy = "leave bones out, or drawn: capsules"
            raise BadInput("a person is drawn into the capsules of all bones", field="bones", remedy=remedy)
        check_names("radii", config.radii, mover)
        check_names("bones", config.bones or (), mover)
        height = config.height or find_height(mover)
        girdle = config.radii.get("pelvis", height * default_radius("pelvis", 0.0, 1.0))
        half_width = max(0.0, height * PELVIS_HALF_WIDTH - float(np.max(girdle)))
        frames, pieces = [], []
        for bone in find_bones(mover, config.radii, half_width):
            joint = mover.joints[bone.frame]
            if bone.part == "" or (config.bones is not None and not {joint, bone.part} & set(config.bones)):
                continue
            own = config.radii.get(joint, config.radii.get(bone.part))
            found = cut(bone, choose_radii(bone, own, height, config.split))
            pieces += found
            frames += [bone.frame] * len(found)
        if not pieces:
            raise BadInput("the skeleton has no bone of nonzero length", field="collider")
        frame, (a, b, radius) = np.array(frames, np.int32), (np.array(part) for part in zip(*pieces, strict=True))
        return BodyShape(
            frames=mover.joints,
            kind=np.full(len(pieces), CAPSULE, np.int8),
            frame=frame,
            a=a,
            b=b,
            radius=radius,
            drawn=draw_person(mover, height, frame, a, b, radius) if config.drawn == "person" else None,
        )
