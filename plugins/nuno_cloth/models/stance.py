"""Check that a body stands upright, y up, faces +z, and is where a garment's panels are placed."""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nuno_cloth.models.triangles import Edges
from nuno_cloth.models.wearer import TURN
from nuno_geometry.closest_point import closest_points
from nuno_geometry.section import cut_mesh
from nuno_geometry.tree import Tree
from nuno_schemas.bodies import fits_person
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

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
