"""Make the meshes of funnel, knot, scarf, sphere and star: python scenes/contact/make_meshes.py

funnel.obj      a cone with a tube below it, rounded at its corners: cloth is kept out of it by its vertices, and an
                edge between two of them would cut a sharp corner
knot-left.obj   the ribbons of a loose reef knot. Each is a bight: its ends lie on one side, and on the other it goes
knot-right.obj  round the ends of the other. The left one goes over the other's bight, under its legs and over its
                ends; turned by half a turn about y it is the right one
table.obj       the top of a table, for sphere.yaml: sliding contact, by which nothing sinks in, is with meshes
star.obj        a star with blades for edges, of twenty triangles larger than those of the cloth that falls on it
scarf.obj       a scarf one turn and a half round a dancer's neck, rising by more than its width each turn

Ribbons and scarf stand on edge, so that they are bent and not stretched; where they rise and sink they are cut askew.
`--across 16` makes the knot's ribbons about as fine as the published ones, of 18.6 k vertices in all.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

FOLDER = Path(__file__).parent
Points = NDArray[np.float64]
Mesh = tuple[Points, NDArray[Any]]
"""Vertices (n, 3) [m] and triangles (f, 3)."""

AROUND, THROAT, NECK, WALL = 72, 0.05, 0.03, 0.012
"""Of the funnel: vertices round its axis, y, radius of its tube inside, of the bend above, and thickness [m]."""
BOTTOM, TUBE, CONE, SLOPE = 0.32, 0.08, 0.33, np.radians(45.0)
"""Height of the tube's end, lengths of tube and cone [m], and the cone's angle against the axis."""

TABLE = (1.5, 0.03)
"""Its sides and thickness [m]; its top is at y = 0."""

STAR, NOTCH, RIDGE, POINTS = 0.22, 0.085, 0.06, 5
"""Radii of its points and of the notches between them, half of its thickness in the middle [m], and how many points."""

RIBBON, LIFT = 0.016, 0.0115
"""Width of a ribbon, and how far its middle line rises and sinks [m]."""
LEG = np.array([
    [-0.210, 0.010, 0.0], [-0.150, 0.010, 0.0], [-0.095, 0.012, 0.3], [-0.062, 0.015, 1.0], [-0.030, 0.021, 0.4],
    [0.000, 0.028, -1.0], [0.026, 0.034, -0.2], [0.052, 0.028, 0.8], [0.064, 0.012, 1.0],
])  # fmt: skip
"""Places x, y [m] and heights [LIFT] of one leg from its end to near the middle; the other mirrors it in y."""
MIDDLE = np.array([[0.066, 0.0, 1.0]])

ASKEW = 1.2
"""Ratio of a cell's diagonals from which on it is askew."""

SCARF, NECKLINE, PITCH, TAIL = 0.07, 1.345, 0.082, 0.55
"""Width of the scarf, height of its lower tail's middle, rise each turn, and length of the level tails [m]."""
COILS, INNER, OUTER = 1.5, 0.100, 0.108
"""Turns round the neck, and its radii about the axis, y, where they begin and end [m]."""


def wall() -> Points:
    """(p, 2) radius and height [m] once round the funnel's wall: up its inside, and down its outside."""
    turn, half = np.linspace(0.0, SLOPE, 8), np.linspace(0.0, np.pi, 7)
    along, out = np.array([np.sin(SLOPE), np.cos(SLOPE)]), np.array([np.cos(SLOPE), -np.sin(SLOPE)])
    centre = np.array([THROAT + NECK, BOTTOM + TUBE])
    arc = np.stack([-np.cos(turn), np.sin(turn)], axis=1)
    rim = centre + NECK * arc[-1] + CONE * along + 0.5 * WALL * out
    over = rim + 0.5 * WALL * (np.sin(half)[:, None] * along - np.cos(half)[:, None] * out)
    end = np.array([THROAT + 0.5 * WALL, BOTTOM])
    under = end + 0.5 * WALL * np.stack([np.cos(half), -np.sin(half)], axis=1)
    return np.concatenate([centre + NECK * arc, over, centre + (NECK - WALL) * arc[::-1], under])


def make_funnel() -> Mesh:
    """A solid of revolution, its outside out."""
    ring, angle = wall(), 2.0 * np.pi * np.arange(AROUND) / AROUND
    x = np.empty((len(ring), AROUND, 3))
    x[..., 0], x[..., 2] = np.outer(ring[:, 0], np.cos(angle)), np.outer(ring[:, 0], np.sin(angle))
    x[..., 1] = ring[:, 1:]
    number = np.arange(len(ring) * AROUND).reshape(len(ring), AROUND)
    beside, above = np.roll(number, -1, axis=1), np.roll(number, -1, axis=0)
    across = np.roll(above, -1, axis=1)
    faces = [np.stack([number, beside, above], axis=-1), np.stack([beside, across, above], axis=-1)]
    return x.reshape(-1, 3), np.concatenate([part.reshape(-1, 3) for part in faces])


def make_table() -> Mesh:
    """A flat box."""
    corners = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]) - [0.5, 1.0, 0.5]
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [triangle for a, b, c, d in sides for triangle in ([a, b, c], [a, c, d])]
    return corners * [TABLE[0], TABLE[1], TABLE[0]], np.array(faces)


def make_star() -> Mesh:
    """Upright, about the z axis, one point up."""
    angle = np.pi / POINTS * np.arange(2 * POINTS)
    radius = np.where(np.arange(2 * POINTS) % 2 == 0, STAR, NOTCH)
    rim = np.stack([radius * np.sin(angle), radius * np.cos(angle), 0.0 * angle], axis=1)
    here, after, middle = np.arange(2 * POINTS), (np.arange(2 * POINTS) + 1) % (2 * POINTS), 2 * POINTS + 0 * angle
    faces = [np.stack([middle, after, here], axis=1), np.stack([middle + 1, here, after], axis=1)]
    return np.concatenate([rim, [[0.0, 0.0, RIDGE], [0.0, 0.0, -RIDGE]]]), np.concatenate(faces).astype(int)


def follow(places: Points, step: float) -> Points:
    """(p, d) points about `step` apart [m] on a smooth curve through places (k, d)."""
    fine = CubicSpline(_along(places), places)(np.linspace(0.0, _along(places)[-1], 4000))
    along = _along(fine)
    even = np.linspace(0.0, along[-1], 1 + round(along[-1] / step))
    return np.stack([np.interp(even, along, axis) for axis in fine.T], axis=1)


def _along(places: Points) -> Points:
    """(k,) length of a chain of places (k, d) up to each of them."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])


def make_strip(line: Points, width: Points, columns: int) -> Mesh:
    """A band of cloth along its middle line (p, 3), as wide as the vector `width` (3,) says.

    Diagonals alternate; those of cells that are askew are the shorter ones, for springs along the sides of obtuse
    triangles cannot bear shear.
    """
    x = line[:, None] + np.linspace(-0.5, 0.5, columns)[:, None] * width
    number = np.arange(len(line) * columns).reshape(len(line), columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    ad, bc = np.linalg.norm(x[:-1, :-1] - x[1:, 1:], axis=-1), np.linalg.norm(x[:-1, 1:] - x[1:, :-1], axis=-1)
    even = np.add.outer(np.arange(len(line) - 1), np.arange(columns - 1)) % 2 == 0
    even = np.where(np.maximum(ad, bc) > ASKEW * np.minimum(ad, bc), ad < bc, even)[..., None]
    first = np.where(even, np.stack([a, b, d], axis=-1), np.stack([a, b, c], axis=-1))
    second = np.where(even, np.stack([a, d, c], axis=-1), np.stack([b, d, c], axis=-1))
    return x.reshape(-1, 3), np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


def make_ribbon(columns: int) -> Mesh:
    """The left ribbon of the knot."""
    places = np.concatenate([LEG, MIDDLE, LEG[::-1] * [1.0, -1.0, 1.0]]) * [1.0, 1.0, LIFT]
    return make_strip(follow(places, RIBBON / (columns - 1)), np.array([0.0, 0.0, RIBBON]), columns)


def make_scarf(columns: int) -> Mesh:
    """The scarf, its tails level as if they were held: from ahead past the left of the neck, round it, and ahead."""
    turn = np.linspace(0.0, 2.0 * np.pi * COILS, 60)
    share = turn / turn[-1]
    radius, height = INNER + (OUTER - INNER) * share, NECKLINE + PITCH * COILS * share
    coil = np.stack([radius * np.cos(turn), height, -radius * np.sin(turn)], axis=1)
    ahead = np.linspace(TAIL, 0.0, 24, endpoint=False)[:, None] * [0.0, 0.0, 1.0]
    line = follow(np.concatenate([coil[0] + ahead, coil, coil[-1] + ahead[::-1]]), SCARF / (columns - 1))
    return make_strip(line, np.array([0.0, SCARF, 0.0]), columns)


def write(name: str, mesh: Mesh) -> None:
    """As an OBJ beside this file."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh[0]] + [f"f {a} {b} {c}" for a, b, c in mesh[1] + 1]
    (FOLDER / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Make the meshes of these scenes.")
    parser.add_argument("--across", type=int, default=5, help="vertices across a ribbon (default: %(default)s)")
    points, faces = make_ribbon(parser.parse_args().across)
    write("knot-left.obj", (points, faces))
    write("knot-right.obj", (points * [-1.0, 1.0, -1.0], faces))
    write("funnel.obj", make_funnel())
    write("table.obj", make_table())
    write("star.obj", make_star())
    write("scarf.obj", make_scarf(6))
