"""Whether a body stands and faces as a garment is put on it: upright, y up, towards +z."""

from __future__ import annotations

import math

import numpy as np

from nuno_cloth.models.wearer import TURN
from nuno_kernels.meshes.loops import cut_mesh
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


def _middle(x: Float, faces: Int, height: float) -> Float:
    """(2,) x and z of the middle of all that a level plane cuts, each loop as much as it is long [m]; NaN for none."""
    loops = cut_mesh(x, faces, x[:, 1] - height)
    girth = np.array([loop.girth for loop in loops])
    middles = np.array([loop.centroid()[[0, 2]] for loop in loops]).reshape(-1, 2)
    return np.asarray((girth[:, None] * middles).sum(axis=0) / girth.sum()) if len(loops) else np.full(2, np.nan)
