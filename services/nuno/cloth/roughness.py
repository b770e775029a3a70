"""An uneven start: what flat cloth needs to leave its plane.

In a plane nothing pushes cloth out of it: without an unevenness a hung sheet keeps z = 0 for ever, and a strip stands
on its edge whatever its length. Rejected: noise for each vertex, of which a finer mesh has more and steeper bumps, so
that its springs would start strained; waves in space are the same unevenness on any mesh.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nuno.collision.surfaces import vertex_normals
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

WAVES, SHORTEST = 64, 8.0
"""Waves that are added up, between the cloth's size (the diagonal of its bounding box) and so small a part of it."""


def roughen(fabric: Fabric, height: float, seed: int) -> Fabric:
    """The fabric with its free vertices moved along their normals by `height` [m], root mean square.

    Springs and hinges stay as they are: at rest the cloth is as flat as it was. Raises BadInput where it has no faces.
    """
    if len(fabric.faces) == 0:
        raise BadInput("only cloth with triangles has a normal to be rough along", remedy="leave it out")
    moved = height * _waves(fabric.position, np.random.default_rng(seed))
    held = fabric.pinned.copy()
    for binding in fabric.bindings:
        held[binding.vertices] = True
    moved[held] = 0.0
    return replace(fabric, position=fabric.position + moved[:, None] * vertex_normals(fabric.position, fabric.faces))


def _waves(x: Float, random: np.random.Generator) -> Float:
    """(n,) a sum of waves at places (n, 3), of mean square 1; numbers are added in an order that never changes."""
    size = math.hypot(*np.ptp(x, axis=0).tolist()) or 1.0
    total = np.zeros(len(x))
    for _ in range(WAVES):
        number = 2.0 * math.pi / size * SHORTEST ** random.uniform()
        up, turn, phase = random.uniform(-1.0, 1.0), *random.uniform(0.0, 2.0 * math.pi, 2)
        level = math.sqrt(1.0 - up**2)
        along = level * math.cos(turn) * x[:, 0] + up * x[:, 1] + level * math.sin(turn) * x[:, 2]
        total += np.cos(number * along + phase)
    return math.sqrt(2.0 / WAVES) * total
