"""The landmarks of a body, found from its mesh: trunk, neck and arms, from which garments take measures.

The body stands upright, y up, faces +z, and holds its arms off its sides: a level plane then cuts the trunk out in a
loop of its own up to the armpits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_kernels.meshes.loops import Loop, cut_mesh, section_about
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import dot, norm

STEP = 0.005
"""Distance between sections [m]."""
ARMPIT = 0.04
"""Where the trunk's loop widens to a side by more than this from one section to the next, an arm has joined it [m]."""
NECK = 1.3
"""The neck ends where its width is this multiple of its least width."""
REACH = 0.30
"""Upper bound of the distance from an armpit to its shoulder, and to the neck's thinnest place [m]."""
CENTRAL = 0.05
"""Largest distance of the middle of a loop round trunk or neck from the plane of symmetry [m]."""
OUT, ALONG = 0.03, 0.10
"""Distances of one section of an arm from the armpit, and of a second from that, which give its direction [m]."""

STANDS = "upright (y up), facing +z, arms off its sides"
TURN = "in the scene, also one that nuno sew wrote, turn it by the collider's `up: z` or `rotate`, and give its `scale`"


@dataclass(frozen=True)
class Arm:
    """An arm: its middle at the armpit (3,) [m], and the unit direction down it (3,)."""

    root: Float
    way: Float


@dataclass(frozen=True)
class Wearer:
    """A body's mesh x (n, 3) [m], faces (f, 3), and its landmarks.

    middle: x of the plane of symmetry; armpit: height of the lower of both; neck: half the width and the height of
    the neck's base, and z of its middle; arms: the left (towards +x) and the right [m]
    """

    x: Float
    faces: Int
    middle: float
    armpit: float
    neck: tuple[float, float, float]
    arms: tuple[Arm, Arm]

    def trunk(self, height: float) -> Loop | None:
        """Return the loop round the trunk at a height [m], or None."""
        return trunk_at(self.x, self.faces, self.middle, height)

    def across(self, arm: Arm, along: float) -> Loop | None:
        """Return the loop round an arm in the plane normal to it, `along` [m] from the armpit; None beyond its end."""
        point = arm.root + along * arm.way
        loop = section_about(self.x, self.faces, point, arm.way)
        return loop if loop is not None and float(norm(loop.centroid() - point)) < REACH / 4 else None

    def top(self, aside: float) -> float:
        """Return the height of the shoulder `aside` [m] from the middle, as the mean of both sides."""
        heights = []
        for way in (1.0, -1.0):
            loops = cut_mesh(self.x, self.faces, way * (self.x[:, 0] - self.middle) - aside)
            tops = [float(loop.points[:, 1].max()) for loop in loops]
            heights.append(max((y for y in tops if y < self.neck[1] + 2 * STEP), default=self.neck[1]))
        return float(np.mean(heights))


def trunk_at(x: Float, faces: Int, middle: float, height: float) -> Loop | None:
    """Return the longest loop that a level plane cuts about the middle; other loops may be arms or a chin."""
    loops = [loop for loop in cut_mesh(x, faces, x[:, 1] - height) if abs(float(loop.centroid()[0]) - middle) < CENTRAL]
    return max(loops, key=lambda loop: loop.girth, default=None)


def find_wearer(x: Float, faces: Int) -> Wearer:
    """Return a body's landmarks. Raises BadInput for a mesh that does not stand, face and hold its arms as above."""
    middle = 0.5 * float(x[:, 0].min() + x[:, 0].max())
    levels = np.arange(x[:, 1].max() - STEP, x[:, 1].min(), -STEP)
    loops = {i: loop for i, y in enumerate(levels) if (loop := trunk_at(x, faces, middle, y)) is not None}
    left = {i: float(loop.points[:, 0].max()) for i, loop in loops.items()}
    right = {i: float(loop.points[:, 0].min()) for i, loop in loops.items()}
    widened = [i for i in loops if i - 1 in loops and max(left[i - 1] - left[i], right[i] - right[i - 1]) > ARMPIT]
    below = [i for i in widened if left[i] - middle > 0.05 and middle - right[i] > 0.05]
    if not below:
        raise BadInput(
            "no armpits are found on this body", field="over.body",
            limit=STANDS, remedy=TURN,
        )  # fmt: skip
    pit = max(below)
    width = {i: 0.5 * (left[i] - right[i]) for i in loops if levels[i] - levels[pit] < REACH and i < pit}
    thin = min(width, key=lambda i: (width[i], i))
    base = min((i for i in width if i > thin and width[i] > NECK * width[thin]), default=thin)
    at_neck = loops[base].centroid()
    sides = tuple(_find_arm(x, faces, (left, right)[k][pit], (1.0, -1.0)[k], levels[pit]) for k in (0, 1))
    return Wearer(x, faces, middle, float(levels[pit]), (width[base], float(levels[base]), float(at_neck[2])), sides)  # type: ignore[arg-type]


def _find_arm(x: Float, faces: Int, pit: float, side: float, height: float) -> Arm:
    """Return the arm beyond the trunk's edge x = `pit` at the armpit's height, towards `side` * x."""
    inner, outer = (_arm_loop(x, faces, pit + side * out, side, height) for out in (OUT, OUT + ALONG))
    if inner is None or outer is None:
        raise BadInput("no arms are found on this body", field="over.body", limit=STANDS, remedy=TURN)
    way = outer.centroid() - inner.centroid()
    way /= norm(way)
    middle = inner.centroid()
    # Move on to where the plane normal to the arm passes through the armpit: before, it would cut the trunk.
    shift = float(dot(np.array([pit, height, middle[2]]) - middle, way))
    return Arm(middle + shift * way, way)


def _arm_loop(x: Float, faces: Int, at: float, side: float, height: float) -> Loop | None:
    """Return the loop of an arm in the plane x = `at`: of those near the armpit's height, the highest."""
    loops = [loop for loop in cut_mesh(x, faces, side * (x[:, 0] - at)) if loop.girth > 0.1]
    near = [loop for loop in loops if abs(float(loop.centroid()[1]) - height) < REACH]
    return max(near, key=lambda loop: float(loop.centroid()[1]), default=None)
