"""A person of rounded limbs, of no one's data, who stands in an A-pose, and a bar that bends: skins to test with."""

from __future__ import annotations

from functools import cache

import numpy as np

from nuno_geometry.check import volume
from nuno_geometry.isosurface import find_isosurface
from nuno_schemas.bodies import SKIN, Geometry, Skin
from nuno_schemas.fabric import Float, Int

ROUNDING = 0.02
"""How far limbs are blended into each other [m]."""
ARMS = np.radians(50.0)
"""From the plumb line."""


def limbs(arms: float) -> list[tuple[list[float], list[float], float, float]]:
    """From, to [m], and radius at both ends [m]; the left side is at x > 0."""
    found = [
        ([0.0, 0.93, 0.0], [0.0, 1.05, 0.0], 0.13, 0.11), ([0.0, 1.05, 0.0], [0.0, 1.28, 0.0], 0.11, 0.13),
        ([0.0, 1.35, 0.0], [0.0, 1.50, 0.0], 0.06, 0.05), ([0.0, 1.53, 0.01], [0.0, 1.62, 0.01], 0.08, 0.08),
    ]  # fmt: skip
    for side in (1.0, -1.0):
        down = np.array([side * np.sin(arms), -np.cos(arms), 0.0])
        shoulder = np.array([0.16 * side, 1.36, 0.0])
        elbow, wrist, tip = (shoulder + length * down for length in (0.30, 0.54, 0.70))
        found += [
            ([0.0, 1.33, 0.0], shoulder.tolist(), 0.07, 0.06), (shoulder.tolist(), elbow.tolist(), 0.055, 0.045),
            (elbow.tolist(), wrist.tolist(), 0.045, 0.04), (wrist.tolist(), tip.tolist(), 0.042, 0.042),
            ([0.09 * side, 0.90, 0.0], [0.10 * side, 0.48, 0.0], 0.08, 0.055),
            ([0.10 * side, 0.48, 0.0], [0.11 * side, 0.08, -0.02], 0.055, 0.046),
            ([0.11 * side, 0.04, -0.03], [0.12 * side, 0.04, 0.13], 0.048, 0.045),
        ]  # fmt: skip
    return found


@cache
def person(spacing: float = 0.02, arms: float = ARMS) -> tuple[Float, Int]:
    """Vertices (n, 3) [m], soles at y = 0, and triangles (f, 3)."""

    def field(x: Float, y: Float, z: Float) -> Float:
        least: Float | None = None
        for start, end, thick, thin in limbs(arms):
            a, b = np.array(start), np.array(end)
            along = b - a
            share = (x - a[0]) * along[0] + (y - a[1]) * along[1] + (z - a[2]) * along[2]
            share = np.clip(share / (along * along).sum(), 0.0, 1.0)
            away = np.sqrt(sum((c - a[k] - share * along[k]) ** 2 for k, c in enumerate((x, y, z))))
            own = away - (thick + share * (thin - thick))
            if least is None:
                least = own
                continue
            near = np.maximum(ROUNDING - np.abs(least - own), 0.0)
            least = np.minimum(least, own) - near * near / (4.0 * ROUNDING)
        assert least is not None
        return least

    x, faces = find_isosurface(field, np.array([-1.0, -0.1, -0.25]), np.array([1.0, 1.8, 0.25]), spacing)
    return np.ascontiguousarray(x - np.array([0.0, x[:, 1].min(), 0.0])), faces


def write_mesh(x: Float, faces: Int) -> str:
    """As an OBJ file."""
    lines = [f"v {a!r} {b!r} {c!r}" for a, b, c in x.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return "\n".join(lines) + "\n"


@cache
def person_file(spacing: float) -> str:
    """The person as an OBJ file."""
    return write_mesh(*person(spacing))


def bar(length: float = 0.24, width: float = 0.03, parts: int = 24) -> tuple[Float, Int]:
    """A closed bar along x of so many parts."""
    at = length * (np.arange(parts + 1) / parts - 0.5)
    ring = width * np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]])
    x = np.concatenate([np.column_stack([np.full(4, a), ring]) for a in at] + [[[at[0], 0, 0], [at[-1], 0, 0]]])
    faces, last, end = [], 4 * parts, len(x)
    for c in range(4):
        d = (c + 1) % 4
        faces += [[end - 2, d, c], [end - 1, last + c, last + d]]
        for k in range(0, last, 4):
            faces += [[k + c, k + d, k + c + 4], [k + d, k + d + 4, k + c + 4]]
    triangles = np.array(faces, np.int32)
    return x, triangles if volume(x, triangles) > 0.0 else np.ascontiguousarray(triangles[:, ::-1])


def as_skin(x: Float, faces: Int, right: Float, friction: float = 0.3) -> Geometry:
    """A closed mesh that is a skin of two frames, bound at the origin; right (v,) is the second one's weight."""
    weight = np.stack([1.0 - right, right], axis=1)
    order = np.argsort(-weight, axis=1, kind="stable")
    skin = Skin(np.zeros((2, 3)), order.astype(np.int32), np.take_along_axis(weight, order, axis=1))
    one, none = np.ones(1), np.zeros(1, np.int32)
    return Geometry(
        ("bar",), ("bar/left", "bar/right"), np.array([SKIN], np.int8), none, none, x.min(axis=0)[None],
        x.max(axis=0)[None], np.zeros(1), np.nan * one, 0.5 * one, friction * one, x, faces,
        np.zeros(len(faces), np.int32), skins=(skin,),
    )  # fmt: skip


def skinned(friction: float = 0.3) -> Geometry:
    """A bar bound at its middle: one frame carries the left half and the other the right one, and weights pass over a
    fifth of the length.
    """
    x, faces = bar()
    return as_skin(x, faces, np.clip(0.5 + x[:, 0] / (0.2 * np.ptp(x[:, 0])), 0.0, 1.0), friction)
