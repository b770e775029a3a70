"""The body that wears a garment: its landmarks, found from its mesh, and checks of its stance and of cloth inside of
it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nuno_cloth.models.triangles import Edges
from nuno_geometry.check import place_of
from nuno_geometry.closest_point import closest_points
from nuno_geometry.sections import Loop, cut_mesh, section_about
from nuno_geometry.tree import Tree
from nuno_schemas.bodies import fits_person
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import dot, norm

# Check that cloth starts outside of the body that wears it.


def require_outside(x: Float, clear: Float, body: Tree, what: str, remedy: str) -> None:
    """Raise BadInput if points (n, 3) [m] of the piece `what` are not outside of a body by `clear` (n,) [m]."""
    away = closest_points(body, x).distance
    worst = int(np.argmin(away / clear))
    if away[worst] < clear[worst]:
        raise not_outside(float(away[worst]), x[worst], float(clear[worst]), what, remedy)


def not_outside(away: float, place: Float, clear: float, what: str, remedy: str) -> BadInput:
    """Return the error for a point (3,) of `what` that is `away` off a body [m] (negative: inside), not `clear`."""
    value = f"{abs(1e3 * away):.3g} mm {'inside' if away < 0.0 else 'from it'}, {place_of(place)}"
    problem, limit = f"the {what} would start inside of the body, or too near to it", f"{1e3 * clear:.3g} mm outside"
    return BadInput(problem, field="over", value=value, limit=limit, remedy=remedy)


# The landmarks of a body, found from its mesh: trunk, neck and arms, from which garments take measures.
#
# The body stands upright, y up, faces +z, and holds its arms off its sides: a level plane then cuts the trunk out in a
# loop of its own up to the armpits.

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


# Check that a body stands upright, y up, faces +z, and is where a garment's panels are placed.

WIDEST = 1.2
"""A body with its arms held out is hardly wider than it is high; one that lies on its side is."""
SOLE, ANKLE = 0.02, 0.07
"""Heights of feet and ankles, as shares of a body's."""
TOES = 0.012
"""Feet reach forward of the ankles by more than this share of the height; if by less, the direction is not checked."""
SIDEWAYS = 45.0
"""Farther off +z than this a body faces another way [deg]."""
OFF = 0.05
"""A garment may extend past a body's ends by this share of its height more than if the body stood on y = 0."""
BESIDE = 0.5
"""Largest distance of panels from a body in x and z [m]."""
AROUND = 0.25, 0.1
"""Panels round a trunk are wider than this share of a body's height, and deeper than this [m]."""
ASIDE, WITHIN = 0.15, 0.25
"""A trunk whose middle is farther than this from the panels' [m] is next to them if less than this share of their
middle line, and more of its own, is in it."""


def check_stance(x: Float, faces: Int, body: str) -> None:
    """Raise BadInput if a body x (v, 3) [m], faces (f, 3) of this name lies, or its feet do not point towards +z."""
    width, height, depth = np.ptp(x, axis=0).tolist()
    if max(width, depth) > WIDEST * height:
        value = f"{body}, {width:.2f} m wide, {height:.2f} m high, {depth:.2f} m deep"
        raise BadInput("the body lies", field="over.body", value=value, limit="upright, y up", remedy=TURN)
    low = float(x[:, 1].min())
    sole, ankle = (_middle(x, faces, low + share * height) for share in (SOLE, ANKLE))
    way = sole - ankle
    if not float(np.hypot(*way)) > TOES * height:
        return
    off = abs(math.degrees(math.atan2(way[0], way[1])))
    if off > SIDEWAYS:
        value = f"{body}, whose feet point {off:.0f} degrees off +z"
        raise BadInput("the body faces another way", field="over.body", value=value, limit="towards +z", remedy=TURN)


def check_place(placed: Float, x: Float, body: str, tree: Tree | None = None) -> None:
    """Raise BadInput if a body x (v, 3) [m] is not where panels (n, 3) [m] are placed, with the shift that brings it
    onto y = 0, round the y axis, as patterns expect.

    A garment may hang below a bust. It is misplaced if it is above a head, or below a whole person's feet, and would
    not be with the body on y = 0; and, with the body's tree, if it is for a trunk, and that is next to it in x or z.
    """
    (low, high), (least, most) = ((part.min(axis=0), part.max(axis=0)) for part in (x, placed))

    def beyond(shift: float) -> float:
        below = low[1] + shift - least[1] if fits_person(high[1] - low[1]) else 0.0
        return max(float(most[1] - high[1] - shift), 0.0) + max(float(below), 0.0)

    misplaced = np.maximum(low - most, least - high) > BESIDE
    misplaced[1] = beyond(0.0) - beyond(-low[1]) > OFF * (high[1] - low[1])
    # Cloth may have one sleeve, or hang mostly before or behind a body.
    middle = np.array([placed[:, 0].mean(), 0.0, 0.5 * (least[2] + most[2])])
    off, (wide, _, deep) = 0.5 * (low + high) - middle, most - least
    aside = np.abs(off) > [ASIDE, np.inf, ASIDE]
    if tree is not None and aside.any() and wide >= AROUND[0] * (high[1] - low[1]) and deep >= AROUND[1]:
        line = middle + np.linspace(least[1], most[1], 40)[:, None] * [0.0, 1.0, 0.0]
        lines = np.concatenate([line, line + off * [1, 0, 1]])
        within = np.asarray(closest_points(tree, lines).distance) < 0.0
        misplaced |= aside & (within[:40].mean() < WITHIN <= within[40:].mean())
    if not misplaced.any():
        return
    axis = int(np.argmax(misplaced))
    centre = np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    shift_text = ",".join(f"{along:.4g}" for along in np.where(misplaced, -centre, 0.0) + 0.0)
    spans = [f"{box[0][axis]:.2f} to {box[1][axis]:.2f} m" for box in ((low, high), (least, most))]
    raise BadInput(
        "the body does not stand where the garment's panels are placed", field="over.body",
        value=f"{body} at {'xyz'[axis]} = {spans[0]}, panels at {spans[1]}", limit="on y = 0, round x = z = 0",
        remedy=f"move the body: --set bodies.{body}.collider.centre=[{shift_text}], or place the panels round it",
    )  # fmt: skip


def check_openings(x: Float, edges: Edges, tree: Tree, body: str) -> None:
    """Raise BadInput if nothing of a body with this tree is in any opening of a garment with these edges that starts at
    x (n, 3) [m]. A garment with one outline, such as a cape, has no opening.
    """
    a, b = edges.pairs[edges.count == 1].T
    part = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(len(x), len(x))), directed=False)[1]
    rings = [x[np.unique(a[part[a] == k])] for k in np.unique(part[a])]
    share = np.linspace(0.0, 1.0, 24)[:, None, None]
    fans = [ring.mean(axis=0) + share * (ring - ring.mean(axis=0)) for ring in rings]
    if len(fans) < 2 or any((closest_points(tree, fan.reshape(-1, 3)).distance < 0.0).any() for fan in fans):
        return
    raise BadInput(
        "nothing of the body goes through an opening of the garment", field="over.body", value=body,
        limit="a body that wears it", remedy="take the body that it is cut for, or place the panels round what it is "
        "worn on",
    )  # fmt: skip


def _middle(x: Float, faces: Int, height: float) -> Float:
    """Return x and z (2,) [m] of the mean of a level plane's loops, weighted by their lengths; NaN without loops."""
    loops = cut_mesh(x, faces, x[:, 1] - height)
    girth = np.array([loop.girth for loop in loops])
    middles = np.array([loop.centroid()[[0, 2]] for loop in loops]).reshape(-1, 2)
    return np.asarray((girth[:, None] * middles).sum(axis=0) / girth.sum()) if len(loops) else np.full(2, np.nan)
