"""Whether a body stands and faces as a garment is put on it: upright, y up, towards +z, where its panels are placed."""

from __future__ import annotations

import math

import numpy as np

from nuno_cloth.models.wearer import TURN
from nuno_kernels.meshes.loops import cut_mesh
from nuno_schemas.bodies import fits_person
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

WIDEST = 1.2
"""A body with its arms held out is hardly wider than it is high; one that lies on its side is."""
SOLE, ANKLE = 0.02, 0.07
"""Heights, as shares of a body's, at which its feet and its ankles are looked at."""
TOES = 0.012
"""Feet reach forward of the ankles by more than this share of the height; with less there is nothing to tell by."""
SIDEWAYS = 45.0
"""Farther off +z than this a body faces another way [deg]."""
OFF = 0.05
"""A garment may be beyond a body's ends by so much more than if it stood on y = 0, as a share of its height."""
BESIDE = 0.5
"""Panels are placed before, behind and beside a body, but no farther off than this [m]."""


def check_stance(x: Float, faces: Int, body: str) -> None:
    """Raises BadInput for a body x (v, 3) [m], faces (f, 3) of this name that lies, or whose feet point another way."""
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


def check_place(placed: Float, x: Float, body: str) -> None:
    """Raises BadInput for a body x (v, 3) [m] that is not where panels (n, 3) [m] are placed, with the shift that would
    bring it onto y = 0, round the y axis, as patterns expect.

    A garment may hang below a bust. One above a head, or below a whole person's feet, that would not be there were the
    body on y = 0, is not where it is meant to be.
    """
    (low, high), (least, most) = ((part.min(axis=0), part.max(axis=0)) for part in (x, placed))

    def beyond(shift: float) -> float:
        below = low[1] + shift - least[1] if fits_person(high[1] - low[1]) else 0.0
        return max(float(most[1] - high[1] - shift), 0.0) + max(float(below), 0.0)

    beside = np.maximum(low - most, least - high) > BESIDE
    beside[1] = beyond(0.0) - beyond(-low[1]) > OFF * (high[1] - low[1])
    if not beside.any():
        return
    centre = np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    shown = ",".join(f"{along:.4g}" for along in np.where(beside, -centre, 0.0) + 0.0)
    off = int(np.argmax(beside))
    spans = [f"{box[0][off]:.2f} to {box[1][off]:.2f} m" for box in ((low, high), (least, most))]
    raise BadInput(
        "the body does not stand where the garment's panels are placed", field="over.body",
        value=f"{body} at {'xyz'[off]} = {spans[0]}, panels at {spans[1]}", limit="on y = 0, round x = z = 0",
        remedy=f"move the body: --set bodies.{body}.collider.centre=[{shown}], or place the panels round it",
    )  # fmt: skip


def _middle(x: Float, faces: Int, height: float) -> Float:
    """(2,) x and z of the middle of all that a level plane cuts, each loop as much as it is long [m]; NaN for none."""
    loops = cut_mesh(x, faces, x[:, 1] - height)
    girth = np.array([loop.girth for loop in loops])
    middles = np.array([loop.centroid()[[0, 2]] for loop in loops]).reshape(-1, 2)
    return np.asarray((girth[:, None] * middles).sum(axis=0) / girth.sum()) if len(loops) else np.full(2, np.nan)
