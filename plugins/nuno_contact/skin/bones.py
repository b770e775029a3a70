"""Lines in a body that carry its skin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nuno_contact.skin.figure import Figure
from nuno_schemas.fabric import Float, Int

LINES = {
    "hips": (("hips", "spine"), ("hips", "left_thigh"), ("hips", "right_thigh")),
    "spine": (("spine", "chest"),),
    "chest": (("chest", "neck"), ("neck", "left_arm"), ("neck", "right_arm")),
    "neck": (("neck", "head"),),
    "head": (("head", "top"),),
    **{f"{side}_{part}": tuple((f"{side}_{a}", f"{side}_{b}") for a, b in lines) for side in ("left", "right") for
       part, lines in (
        ("arm", (("arm", "forearm"),)), ("forearm", (("forearm", "hand"),)), ("hand", (("hand", "hand_end"),)),
        ("thigh", (("thigh", "shin"),)), ("shin", (("shin", "foot"),)),
        ("foot", (("foot", "foot_end"), ("foot", "heel"))))},
}  # fmt: skip
"""From where to where the bones of each part go."""


def bones_of(figure: Figure, parts: Sequence[str]) -> tuple[Float, Int]:
    """Ends (b, 2, 3) [m] of the bones of parts of a body, and the number (b,) of the part that each is of.

    Bones of parts that are not among them, a spine or a neck, are of the part before.
    """
    ends, of = [], []
    for part, lines in LINES.items():
        if part in parts:
            number = parts.index(part)
        ends += [np.stack([figure[a], figure[b]]) for a, b in lines]
        of += [number] * len(lines)
    return np.stack(ends), np.array(of, np.int32)
