"""Where a garment ends, and which parts of the body go through there: a neckline round trunk and arms has slid down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno.collision.surfaces import outlines
from nuno.fit.slices import cut
from nuno_schemas.fabric import Float, Int
from nuno_schemas.triangles import Membrane

THIN = 0.01
"""A part of the body with less than this share of the area of the largest one is a fold of its mesh [-]."""


@dataclass(frozen=True)
class Opening:
    """Heights of its lowest and highest point [m], how long it was cut [m], and a tape round each part of the body that
    goes through it [m], the longest first.
    """

    low: float
    high: float
    cut: float
    through: tuple[float, ...]


def find_openings(x: Float, membrane: Membrane, corners: Float, body: tuple[Float, Int]) -> list[Opening]:
    """A garment's openings, from the top: x (n, 3) [m] its vertices, corners (t, 3, 2) of each triangle as it was cut,
    and the body's mesh.
    """
    sides = np.stack([membrane.faces, np.roll(membrane.faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).reshape(-1).tolist()
    length, found = dict(zip(map(tuple, sides), lengths, strict=True)), list[Opening]()
    for loop in outlines(membrane.faces):
        height, cut_length = x[loop, 1], sum(length[side] for side in zip(loop, [*loop[1:], loop[0]], strict=True))
        found.append(Opening(float(height.min()), float(height.max()), cut_length, _through(x[loop], *body)))
    return sorted(found, key=lambda one: -one.high)


def _through(loop: Float, x: Float, faces: Int) -> tuple[float, ...]:
    """Tapes [m] round the parts of a body x (m, 3), faces (g, 3), that go through a loop (k, 3), by the plane that it
    lies about.
    """
    centre = loop.mean(axis=0)
    normal = np.cross(loop - centre, np.roll(loop, -1, axis=0) - centre).sum(axis=0)
    if not (size := float(np.linalg.norm(normal))) > 0.0:
        return ()
    # Axes of which the second is across the plane: what is level then is in it.
    up = normal / size
    side = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    side /= np.linalg.norm(side)
    turn = np.stack([np.cross(up, side), up, side], axis=1)
    outline, placed = (loop - centre) @ turn, (x - centre) @ turn
    parts = [part.hull() for part in cut(placed, faces, 0.0).curves()]
    parts = [part for part in parts if abs(_turns(outline[:, [2, 0]] - part[2])) > 0.5]
    most = max((area for _, area, _ in parts), default=0.0)
    return tuple(sorted((girth for girth, area, _ in parts if area > THIN * most), reverse=True))


def _turns(at: Float) -> float:
    """How often a polygon (k, 2) goes round the origin."""
    to = np.roll(at, -1, axis=0)
    angle = np.arctan2(at[:, 0] * to[:, 1] - at[:, 1] * to[:, 0], (at * to).sum(axis=1))
    return float(angle.sum() / (2.0 * np.pi))
