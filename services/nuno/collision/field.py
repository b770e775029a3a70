"""Distances read from a sampled field, apart from the kernel that contact uses."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Float
from nuno_schemas.field import DistanceField


def field_distance(p: Float, field: DistanceField) -> Float:
    """(n,) distance [m] of points (n, 3) in the field's frame; outside of its box that of the box's nearest point,
    and so much longer as that is away.
    """
    place = np.clip((p - field.low) / field.size, 0.0, field.shape)
    away = np.linalg.norm(p - field.low - field.size * place, axis=1)
    cell = np.minimum(np.floor(place).astype(np.int64), field.shape - 1)
    place = place - cell
    at = field.child[(cell[:, 0] * field.shape[1] + cell[:, 1]) * field.shape[2] + cell[:, 2]].astype(np.int64)
    while (inner := at >= 0).any():
        place = np.where(inner[:, None], 2.0 * place, place)
        part = inner[:, None] & (place >= 1.0)
        place = place - part
        at = np.where(inner, field.child[np.where(inner, at + part @ np.array([4, 2, 1]), 0)], at)
    values = field.corners[-1 - at, ::4].astype(np.float64).reshape(-1, 2, 2, 2)
    for axis in range(3):
        share = place[:, axis].reshape(-1, *(1,) * (2 - axis))
        values = values[:, 0] * (1.0 - share) + values[:, 1] * share
    return np.asarray(values + away)
