"""The flat pattern of a shirt: two pieces, front and back, each with half of both sleeves cut on.

Half of the front, with the wearer's centre on the left, v upwards from where the neck meets the shoulder:

           neck  N______
          ..--''        ''--..__  T      overarm N-T falls by `slope` and is straight
     C  .'                      /        sleeve hem T-B stands square on it
        |                .--'' B         underarm B-A meets the side in a curve about A
        |              A                 side A-H
        |_____________ H                 hem, C-H wide

Sewn along sides, underarms and overarms, the two pieces are the shirt; on these lines they are alike, and they differ
in the depth of the neck only. So the shirt can lie flat on a table, front over back, without a fold or a stretch: that
is its rest shape. Rejected: separate sleeves set into armholes, whose seams have two lengths at rest.

The triangles are drawn on the cut for a standard body and carried over to others by harmonic displacements from the
outline (as patterns are graded), so that the number of vertices does not depend on the wearer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from nuno_cloth.models.delaunay import fill_outline
from nuno_geometry.centreline import lengths
from nuno_geometry.harmonic import solve_harmonic
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.vectors import norm

CURVE = 0.07
"""Length of the side and of the underarm that is rounded off about A [m]; at most CURVED of the underarm."""
CURVED = 0.6


@dataclass(frozen=True)
class Cut:
    """Measures of the flat shirt [m].

    width, hem     of half the front, at the underarm A and at the hem
    length, depth  from N down to the hem, and to A
    neck           half the neck's width; front and back: its depth
    overarm        length N-T; cuff: of the sleeve's hem T-B; slope: angle of the overarm below level [rad]
    """

    width: float
    hem: float
    length: float
    depth: float
    neck: float
    front: float
    back: float
    overarm: float
    cuff: float
    slope: float

    @property
    def along(self) -> Float:
        """Direction (2,) from N to T."""
        return np.array([np.cos(self.slope), -np.sin(self.slope)])

    @property
    def across(self) -> Float:
        """Direction (2,) from T to B."""
        return np.array([-np.sin(self.slope), -np.cos(self.slope)])

    def corners(self) -> dict[str, Float]:
        """Return the places (2,) of the named corners."""
        tip = np.array([self.neck, 0.0]) + self.overarm * self.along
        return {
            "N": np.array([self.neck, 0.0]),
            "T": tip,
            "B": tip + self.cuff * self.across,
            "A": np.array([self.width, -self.depth]),
            "H": np.array([self.hem, -self.length]),
        }

    def curve(self) -> tuple[Float, Float]:
        """Return the ends (2,) of the curve about A, on the side and on the underarm."""
        c = self.corners()
        ways = [c[name] - c["A"] for name in ("H", "B")]
        lengths = [float(norm(way)) for way in ways]
        side, under = min(CURVE, 0.5 * lengths[0]), min(CURVE, CURVED * lengths[1])
        return c["A"] + side / lengths[0] * ways[0], c["A"] + under / lengths[1] * ways[1]


@dataclass(frozen=True)
class Flat:
    """Half of a piece: points (n, 2) [m], triangles (f, 3) counter-clockwise, and the lines that points of its outline
    lie on.

    The outline's points come first: those of the side, the underarm, the sleeve's hem and the overarm are the same in
    front and back. seam and centre: points that are shared with the other piece, and with the other half; neck: points
    round the neck; outline: number of the outline's points.
    """

    points: Float
    faces: Int
    seam: Int
    centre: Int
    neck: Int
    outline: int


def outline_of(cut: Cut, depth: float) -> list[Float]:
    """Return the sides of half a piece with a neck of this depth [m], counter-clockwise from the middle of the hem."""
    c = cut.corners()
    a, b = cut.curve()
    t = np.linspace(0.0, 1.0, 33)[:, None]
    curve = (1.0 - t) ** 2 * a + 2.0 * t * (1.0 - t) * c["A"] + t * t * b
    turn = np.linspace(0.5 * np.pi, 0.0, 33)
    neck = np.stack([cut.neck * np.sin(turn), -depth * np.cos(turn)], axis=1)
    start, middle = np.array([0.0, -cut.length]), np.array([0.0, -depth])
    return [
        np.stack([start, c["H"]]), np.concatenate([c["H"][None], curve, c["B"][None]]), np.stack([c["B"], c["T"]]),
        np.stack([c["T"], c["N"]]), neck, np.stack([middle, start]),
    ]  # fmt: skip


def _spread(line: Float, steps: int) -> Float:
    """Return points (steps, 2) in equal steps along a line, without its end."""
    along = lengths(line)
    at = along[-1] * np.arange(steps) / steps
    return np.stack([np.interp(at, along, line[:, k]) for k in (0, 1)], axis=1)


def _steps(cut: Cut, depth: float, spacing: float) -> list[int]:
    lengths = [float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in outline_of(cut, depth)]
    return [max(2, round(length / spacing)) for length in lengths]


@lru_cache(maxsize=16)
def _mesh_half(standard: Cut, depth: float, spacing: float) -> Flat:
    """Mesh half a piece of a standard cut with a neck of this depth [m], in triangles about `spacing` [m] wide."""
    steps = _steps(standard, depth, spacing)
    lines = [_spread(line, n) for line, n in zip(outline_of(standard, depth), steps, strict=True)]
    points, faces = fill_outline(np.concatenate(lines), spacing)
    at = np.concatenate([[0], np.cumsum(steps)])
    seam = np.concatenate([np.arange(at[1], at[2] + 1), np.arange(at[3], at[4] + 1)])
    centre = np.concatenate([np.arange(at[5], at[6]), [0]])
    neck = np.arange(at[4], at[5] + 1)
    return Flat(points, faces, seam.astype(np.int32), centre.astype(np.int32), neck.astype(np.int32), int(at[-1]))


def draw_half(cut: Cut, standard: Cut, front: bool, spacing: float) -> Flat:
    """Return half of the front or the back, with the triangles that its standard has at `spacing` [m]. Raises BadInput
    for measures that give no pattern.
    """
    standard_depth, depth = (standard.front, cut.front) if front else (standard.back, cut.back)
    flat = _mesh_half(standard, standard_depth, spacing)
    steps = _steps(standard, standard_depth, spacing)
    rim = np.concatenate([_spread(line, n) for line, n in zip(outline_of(cut, depth), steps, strict=True)])
    fixed = np.arange(len(flat.points)) < flat.outline
    level = np.concatenate([flat.points, np.zeros((len(flat.points), 1))], axis=1)
    points = flat.points.copy()
    for k in (0, 1):
        displacement = np.zeros(len(points))
        displacement[: flat.outline] = rim[:, k] - points[: flat.outline, k]
        points[:, k] += solve_harmonic(level, flat.faces, fixed, displacement)
    corner = points[flat.faces]
    one, other = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    if area.min() <= 0.05 * np.median(area):
        raise BadInput(
            "no shirt can be cut to these measures", value=", ".join(f"{k} {v:.3g}" for k, v in vars(cut).items()),
            remedy="longer sleeves, less ease, or less slope",
        )  # fmt: skip
    return replace(flat, points=points)


@dataclass(frozen=True)
class Sewn:
    """The whole shirt as it lies on a table.

    flat (n, 3) places [m], the front towards +z; front (n,) +1 in front, -1 behind, 0 on the seams between;
    side (n,) +1 on the wearer's left (u > 0), -1 on the right, 0 in the middle; neck (n,) round the neck;
    faces (f, 3) outwards.
    """

    flat: Float
    front: Int
    side: Int
    neck: Bool
    faces: Int


def sew(cut: Cut, standard: Cut, spacing: float) -> Sewn:
    """Sew front and back of a cut together, with the triangles that its standard has at `spacing` [m]. Raises BadInput
    for measures that give no pattern.
    """
    flat: list[Float] = []
    signs: list[Int] = []
    faces: list[Int] = []
    number: dict[tuple[int, int], Int] = {}
    total = 0
    for facing in (1, -1):
        half = draw_half(cut, standard, facing > 0, spacing)
        masks = [np.isin(np.arange(len(half.points)), points) for points in (half.seam, half.centre, half.neck)]
        for side in (1, -1):
            index = np.full(len(half.points), -1, np.int32)
            if side < 0:
                index[half.centre] = number[facing, 1][half.centre]
            if facing < 0:
                index[half.seam] = number[1, side][half.seam]
            new = np.flatnonzero(index < 0)
            index[new] = total + np.arange(len(new))
            total += len(new)
            number[facing, side] = index
            flat.append(half.points[new] * [side, 1.0])
            seam, centre, neck = (mask[new] for mask in masks)
            signs.append(
                np.stack([np.where(seam, 0, facing), np.where(centre, 0, side), neck], axis=1).astype(np.int32)
            )
            # As meshed, triangles face outwards on the left in front and on the right behind.
            faces.append(index[half.faces if facing == side else half.faces[:, ::-1]])
    front, left, neck = np.concatenate(signs).T
    level = np.concatenate([np.concatenate(flat), np.zeros((total, 1))], axis=1)
    return Sewn(level, front, left, neck > 0, np.ascontiguousarray(np.concatenate(faces), np.int32))
