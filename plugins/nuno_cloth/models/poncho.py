"""A flat piece with a hole for a head: it begins level, as low on a body's shoulders as it can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nuno_cloth.models.placement import Over
from nuno_cloth.models.stance import check_stance
from nuno_cloth.models.wearer import find_wearer
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int


def put_on(over: Over, hole: float, x: Float, faces: Int, worn: Sequence[Fabric]) -> Float:
    """(3,) where the middle of a hole of this radius [m] is: round the neck of a body x (v, 3) [m], faces (f, 3), above
    all of it, and of what it has `worn` before, that is below the neck and beyond the hole.

    Raises BadInput for a body without neck and arms, and a hole that is too narrow for the neck.
    """
    check_stance(x, faces, over.body)
    wearer = find_wearer(x, faces)
    _, base, back = wearer.neck
    points = np.concatenate([x, *(one.position for one in worn)])
    far = np.hypot(points[:, 0] - wearer.middle, points[:, 2] - back)
    below = points[(points[:, 1] < base) & (far > hole - over.clearance), 1]
    if not len(below):
        problem, remedy = "the hole is so wide that nothing of the body holds the cloth", "a smaller hole"
        raise BadInput(problem, field="hole", value=f"{100.0 * hole:.3g} cm", remedy=remedy)
    middle = np.array([wearer.middle, float(below.max()) + over.clearance, back])
    neck = wearer.trunk(float(middle[1]))
    if neck is not None:
        wide = float(np.hypot(*(neck.points - middle)[:, [0, 2]].T).max()) + over.clearance
        if wide > hole:
            problem, remedy = "the hole is too narrow for the neck", f"hole: {np.ceil(1e3 * wide) / 10.0:g} cm"
            raise BadInput(problem, field="hole", value=f"{100.0 * hole:.3g} cm", limit="its clearance off the neck",
                           remedy=remedy)  # fmt: skip
    return middle
