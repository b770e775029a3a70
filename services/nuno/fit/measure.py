"""Fit of a garment of triangles: its girths and the body's, strain of its yarns, and pressure."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nuno.collision.bodies import outlines
from nuno.fit.places import trunk
from nuno.fit.seams import Seam
from nuno.fit.slices import Slice, cut, turns
from nuno_schemas.fabric import Bool, Float, Int, Membrane, Panels

# Openings of a garment, and the parts of the body through them: a neckline around trunk and arms has slid down.

THIN = 0.01
"""A part of the body with less than this share of the area of the largest part is a fold of its mesh [-]."""


NESTED = 0.5
"""A part of the body has passed through two openings if more than this share of the smaller part is in the larger."""


@dataclass(frozen=True)
class Opening:
    """Heights of an opening's lowest and highest point [m], its length as cut [m], and the girth of each part of the
    body through it [m], the longest first.

    edges   edges of panels around it, if the garment was sewn
    passed  numbers, from 0, of openings within its part of the body: the body passes through them and through this one
            as well, as an arm does through a neckline that has slipped off its shoulder
    """

    low: float
    high: float
    cut: float
    through: tuple[float, ...]
    edges: tuple[str, ...] = ()
    passed: tuple[int, ...] = ()


def find_openings(
    x: Float, membrane: Membrane, corners: Float, body: tuple[Float, Int], panels: Panels | None = None
) -> list[Opening]:
    """Return a garment's openings, from the top: x (n, 3) [m] are its vertices, corners (t, 3, 2) those of each
    triangle as cut, body is the body's mesh, and panels are those of the membrane's triangles.
    """
    sides = np.stack([membrane.faces, np.roll(membrane.faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    number = {side: i for i, side in enumerate(map(tuple, sides))}
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).reshape(-1)
    openings, beyond = list[Opening](), list[Bool]()
    for loop in sorted(outlines(membrane.faces), key=lambda one: -x[one, 1].max()):
        border = [number[side] for side in zip(loop, [*loop[1:], loop[0]], strict=True)]
        height, (tapes, out) = x[loop, 1], _through(x[loop], *body)
        edges = () if panels is None else _edges(panels, np.array(border))
        openings.append(Opening(float(height.min()), float(height.max()), float(lengths[border].sum()), tapes, edges))
        beyond.append(out)
    passed = [tuple(j for j, other in enumerate(beyond) if j != i and _within(other, one))
              for i, one in enumerate(beyond)]  # fmt: skip
    return [replace(one, passed=those) for one, those in zip(openings, passed, strict=True)]


def _edges(panels: Panels, sides: Int) -> tuple[str, ...]:
    """Return the panel edges of sides of triangles, each once."""
    of, edge = panels.of[sides // 3].tolist(), panels.edge[sides // 3, sides % 3].tolist()
    return tuple(dict.fromkeys(f"{panels.names[k]}[{j}]" for k, j in zip(of, edge, strict=True) if k >= 0 and j >= 0))


def _within(one: Bool, other: Bool) -> bool:
    """Return whether a part of the body is mostly within a larger part."""
    return bool(0 < one.sum() < other.sum() and (one & other).sum() > NESTED * one.sum())


def _through(loop: Float, x: Float, faces: Int) -> tuple[tuple[float, ...], Bool]:
    """Return the girths [m] of the parts of a body x (m, 3), faces (g, 3), through a loop (k, 3), in its mean plane;
    and which (m,) of the body's vertices are beyond the plane and connected with these parts.

    The loop has the cloth on its left, seen from outside, as the sides of triangles do.
    """
    centre = loop.mean(axis=0)
    # The area vector of a bag's mouth points into the bag.
    inwards = np.cross(loop - centre, np.roll(loop, -1, axis=0) - centre).sum(axis=0)
    if not (size := float(np.linalg.norm(inwards))) > 0.0:
        return (), np.zeros(len(x), np.bool_)
    # The second axis is normal to the plane, which is then level.
    up = -inwards / size
    side = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    side /= np.linalg.norm(side)
    turn = np.stack([np.cross(up, side), up, side], axis=1)
    outline, placed = (loop - centre) @ turn, (x - centre) @ turn
    parts = [(part, *part.hull()) for part in cut(placed, faces, 0.0).curves()]
    at = outline[:, [2, 0]]
    parts = [part for part in parts if abs(turns(at - part[3], np.roll(at, -1, axis=0) - part[3])) > 0.5]
    most = max((area for _, _, area, _ in parts), default=0.0)
    parts = [part for part in parts if part[2] > THIN * most]
    tapes = tuple(sorted((girth for _, girth, _, _ in parts), reverse=True))
    crossed = np.concatenate([np.empty(0, np.int32), *(part.face for part, *_ in parts)])
    return tapes, _beyond(faces, placed[:, 1] >= 0.0, crossed)


def _beyond(faces: Int, above: Bool, crossed: Int) -> Bool:
    """Return which of a body's vertices (m,) are connected with those above a plane in the triangles that it cuts,
    after the cut: none, if the body is still connected around it.
    """
    whole = np.ones(len(faces), np.bool_)
    whole[crossed] = False
    ends = np.concatenate([faces[whole][:, [0, 1]], faces[whole][:, [1, 2]], _same_side(faces[crossed], above)])
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(above), len(above)))
    part = connected_components(graph, directed=False)[1]
    at = faces[crossed].reshape(-1)
    return np.isin(part, np.setdiff1d(part[at[above[at]]], part[at[~above[at]]]))


def _same_side(faces: Int, above: Bool) -> Int:
    """Return the ends (k, 2) of the sides of triangles that do not cross the plane."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.asarray(sides[above[sides[:, 0]] == above[sides[:, 1]]])


ROUND = 0.5
"""Least share of a turn around a body with which a curve of cloth counts as worn at that height."""
HIGH = 0.95
"""Share of the area for the high value of strain and pressure: the 95th percentile."""


@dataclass(frozen=True)
class Girth:
    """A named height [m], and the girths there [m]: of the body's trunk, of the cloth as cut, and as worn; and the
    share of a turn that the cloth covers, 1 if it is closed.

    With several layers of cloth, such as tiers, it is the one with the shortest girth; None for missing values.
    """

    name: str
    height: float
    body: float | None
    cut: float | None
    worn: float | None
    share: float | None

    @property
    def ease(self) -> float | None:
        """Girth of the cloth as cut minus that of the body [m]; None for open cloth, or no cloth or body."""
        if self.body is None or self.cut is None or self.share is None or self.share < 1.0 - 1e-6:
            return None
        return self.cut - self.body


@dataclass(frozen=True)
class Spread:
    """Distribution of a quantity over the garment's area: median, 95th percentile, and maximum."""

    median: float
    high: float
    most: float


@dataclass(frozen=True)
class Pressed:
    """Pressure of a garment on bodies: contact area [m^2], mean and 95th percentile there [Pa], and total force [N]."""

    area: float
    mean: float
    high: float
    force: float


@dataclass(frozen=True)
class Fit:
    """Fit of one garment on its body, as `measure` returns it."""

    name: str
    girths: list[Girth]
    openings: list[Opening]
    """Openings from the top."""
    strains: dict[str, Spread] = field(default_factory=dict)
    pressed: Pressed | None = None
    seams: list[Seam] = field(default_factory=list)

    @property
    def off(self) -> bool:
        """Whether no part of the garment touches the body."""
        return self.pressed is not None and self.pressed.area == 0.0

    @property
    def on(self) -> bool:
        """Whether the garment is worn: it touches the body, and no part of the body passes through two openings, as an
        arm does through a neckline that has slipped.
        """
        return not self.off and not any(one.passed for one in self.openings)


def measure(
    name: str,
    x: Float,
    membrane: Membrane,
    body: tuple[Float, Int],
    heights: dict[str, float],
    panels: Panels | None = None,
) -> Fit:
    """Measure girths, openings and strains of a garment.

    x (n, 3) [m] are its vertices, y up; membrane its triangles; body the body's mesh, vertices (m, 3) and faces (g, 3);
    heights [m] by name; panels those of the membrane's triangles.
    """
    corners = _corners(membrane)
    girths = [_girth(place, height, x, membrane, corners, body) for place, height in heights.items()]
    return Fit(name, girths, find_openings(x, membrane, corners, body, panels), _strains(x, membrane))


def measure_pressure(membrane: Membrane, force: Float, normal: Float) -> Pressed:
    """Return the pressure on a body from contact forces (n, 3) [N] on a garment's vertices: their component along its
    normal (n, 3) at the closest point, over the area of each vertex. Forces between layers of cloth are opposite, and
    cancel.
    """
    area = np.bincount(membrane.faces.reshape(-1), np.repeat(membrane.area / 3.0, 3), len(force))
    outwards = (force * normal).sum(axis=1)
    touching = (outwards > 0.0) & (area > 0.0)
    if not touching.any():
        return Pressed(0.0, 0.0, 0.0, float(outwards.sum()))
    pressed = float(area[touching].sum())
    high = _spread(outwards[touching] / area[touching], area[touching]).high
    return Pressed(pressed, float(outwards[touching].sum()) / pressed, high, float(outwards.sum()))


def _corners(membrane: Membrane) -> Float:
    """Return the corners of each triangle as cut, shape (t, 3, 2), along warp and weft from the first [m]."""
    # The two sides from the first corner, as columns, times (along, across) are the cloth's unit vectors.
    sides = np.linalg.inv(np.stack([membrane.along, membrane.across], axis=2))
    return np.concatenate([np.zeros((len(sides), 1, 2)), sides.transpose(0, 2, 1)], axis=1)


def _flat_length(one: Slice, corners: Float) -> float:
    """Return the length of a curve on the cloth as cut [m]."""
    ends = np.einsum("mec,mcd->med", one.shares, corners[one.face])
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())


def _girth(name: str, height: float, x: Float, membrane: Membrane, corners: Float, body: tuple[Float, Int]) -> Girth:
    wearer = trunk(cut(*body, height))
    if wearer is None:
        return Girth(name, height, None, None, None, None)
    tape, _, middle = wearer.hull()
    curves = [
        (share, _flat_length(one, corners), one.length())
        for one in cut(x, membrane.faces, height).curves()
        if (share := abs(one.turns(middle))) > ROUND
    ]
    if not curves:
        return Girth(name, height, tape, None, None, None)
    share, flat, worn = min(curves, key=lambda one: one[1])
    return Girth(name, height, tape, flat, worn, min(share, 1.0))


def _strains(x: Float, membrane: Membrane) -> dict[str, Spread]:
    a, b, c = np.take(x, membrane.faces.T, axis=0)
    strains = {}
    for name, yarns in (("warp", membrane.along), ("weft", membrane.across)):
        stretched = yarns[:, :1] * (b - a) + yarns[:, 1:] * (c - a)
        strains[name] = _spread(np.linalg.norm(stretched, axis=1) - 1.0, membrane.area)
    return strains


def _spread(values: Float, area: Float) -> Spread:
    order = np.argsort(values, kind="stable")
    below = np.cumsum(area[order]) / area.sum()
    median, high = (float(values[order[np.searchsorted(below, share)]]) for share in (0.5, HIGH))
    return Spread(median, high, float(values.max()))
