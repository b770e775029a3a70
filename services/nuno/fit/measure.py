"""How a garment of triangles fits: girths against the body's, strain of its yarns, and what it presses with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nuno.collision.surfaces import outlines
from nuno.fit.places import trunk
from nuno.fit.seams import Seam
from nuno.fit.slices import Slice, cut, turns
from nuno_schemas.fabric import Bool, Float, Int, Panels
from nuno_schemas.triangles import Membrane

# Where a garment ends, and which parts of the body go through there: a neckline round trunk and arms has slid down.

THIN = 0.01
"""A part of the body with less than this share of the area of the largest one is a fold of its mesh [-]."""


NESTED = 0.5
"""A part of the body has gone out through two openings where this share of the smaller one is in the larger one, too.
"""


@dataclass(frozen=True)
class Opening:
    """Heights of its lowest and highest point [m], how long it was cut [m], and a tape round each part of the body that
    goes through it [m], the longest first.

    edges   of panels round it, if the garment was sewn
    passed  numbers, from 0, of openings within its part of the body: what goes out through them goes out through this
            one as well, as an arm does through a neckline that has slipped off its shoulder
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
    """A garment's openings, from the top: x (n, 3) [m] its vertices, corners (t, 3, 2) of each triangle as it was cut,
    the body's mesh, and the panels that the membrane's triangles are of.
    """
    sides = np.stack([membrane.faces, np.roll(membrane.faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    number = {side: i for i, side in enumerate(map(tuple, sides))}
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).reshape(-1)
    found, beyond = list[Opening](), list[Bool]()
    for loop in sorted(outlines(membrane.faces), key=lambda one: -x[one, 1].max()):
        own = [number[side] for side in zip(loop, [*loop[1:], loop[0]], strict=True)]
        height, (tapes, out) = x[loop, 1], _through(x[loop], *body)
        edges = () if panels is None else _edges(panels, np.array(own))
        found.append(Opening(float(height.min()), float(height.max()), float(lengths[own].sum()), tapes, edges))
        beyond.append(out)
    passed = [tuple(j for j, other in enumerate(beyond) if j != i and _within(other, one))
              for i, one in enumerate(beyond)]  # fmt: skip
    return [replace(one, passed=those) for one, those in zip(found, passed, strict=True)]


def _edges(panels: Panels, sides: Int) -> tuple[str, ...]:
    """Edges of panels that sides of triangles are of, each once."""
    of, edge = panels.of[sides // 3].tolist(), panels.edge[sides // 3, sides % 3].tolist()
    return tuple(dict.fromkeys(f"{panels.names[k]}[{j}]" for k, j in zip(of, edge, strict=True) if k >= 0 and j >= 0))


def _within(one: Bool, other: Bool) -> bool:
    """Whether a part of the body is in a larger one."""
    return bool(0 < one.sum() < other.sum() and (one & other).sum() > NESTED * one.sum())


def _through(loop: Float, x: Float, faces: Int) -> tuple[tuple[float, ...], Bool]:
    """Tapes [m] round the parts of a body x (m, 3), faces (g, 3), that go through a loop (k, 3), by the plane that it
    lies about; and which (m,) of the body's vertices are beyond the plane by way of these parts.

    The loop has the cloth on its left, seen from outside, as the sides of triangles do.
    """
    centre = loop.mean(axis=0)
    # The area within, of a bag's mouth, looks into the bag.
    inwards = np.cross(loop - centre, np.roll(loop, -1, axis=0) - centre).sum(axis=0)
    if not (size := float(np.linalg.norm(inwards))) > 0.0:
        return (), np.zeros(len(x), np.bool_)
    # Axes of which the second is across the plane: what is level then is in it.
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
    """(m,) which of a body's vertices hang together with those above a plane in the triangles that it is cut at, once
    it is: none of a body that still hangs together round it.
    """
    whole = np.ones(len(faces), np.bool_)
    whole[crossed] = False
    ends = np.concatenate([faces[whole][:, [0, 1]], faces[whole][:, [1, 2]], _same_side(faces[crossed], above)])
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(above), len(above)))
    part = connected_components(graph, directed=False)[1]
    at = faces[crossed].reshape(-1)
    return np.isin(part, np.setdiff1d(part[at[above[at]]], part[at[~above[at]]]))


def _same_side(faces: Int, above: Bool) -> Int:
    """(k, 2) ends of the sides of triangles that do not cross."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.asarray(sides[above[sides[:, 0]] == above[sides[:, 1]]])


ROUND = 0.5
"""Share of the way round a body that a curve of cloth goes at least, to count as worn at that height."""
HIGH = 0.95
"""Share of the area of which strain and pressure are told to be below."""


@dataclass(frozen=True)
class Girth:
    """A height [m], by its name, and what goes round there [m]: a tape round the body's trunk, the cloth as it was cut,
    and as it is worn; and what share of the way round the cloth goes, 1 where it is closed.

    Of cloth in layers, as of tiers, that with the shortest way; None of what is not there.
    """

    name: str
    height: float
    body: float | None
    cut: float | None
    worn: float | None
    share: float | None

    @property
    def ease(self) -> float | None:
        """How much longer the cloth was cut than the tape is [m]; none where it is open, or there is nothing."""
        if self.body is None or self.cut is None or self.share is None or self.share < 1.0 - 1e-6:
            return None
        return self.cut - self.body


@dataclass(frozen=True)
class Spread:
    """Of a quantity over the garment's area: its median, what 95 % of it is below, and the most."""

    median: float
    high: float
    most: float


@dataclass(frozen=True)
class Pressed:
    """What presses on bodies: area [m^2], mean and high pressure there [Pa], and all of it [N]."""

    area: float
    mean: float
    high: float
    force: float


@dataclass(frozen=True)
class Fit:
    """One garment on its body: see `measure`."""

    name: str
    girths: list[Girth]
    openings: list[Opening]
    """From the top."""
    strains: dict[str, Spread] = field(default_factory=dict)
    pressed: Pressed | None = None
    seams: list[Seam] = field(default_factory=list)

    @property
    def off(self) -> bool:
        """Whether nothing of the garment lies on the body."""
        return self.pressed is not None and self.pressed.area == 0.0

    @property
    def on(self) -> bool:
        """Whether it is worn: it lies on the body, and nothing that goes out through one opening goes out through
        another, too, as an arm does from which a neckline has slipped.
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
    """Girths, openings and strains of a garment.

    x (n, 3) [m] its vertices, y up; membrane over them; body its mesh, vertices (m, 3) and faces (g, 3); heights [m] by
    name; panels that the membrane's triangles are of.
    """
    corners = _corners(membrane)
    girths = [_girth(place, height, x, membrane, corners, body) for place, height in heights.items()]
    return Fit(name, girths, find_openings(x, membrane, corners, body, panels), _strains(x, membrane))


def measure_pressure(membrane: Membrane, force: Float, normal: Float) -> Pressed:
    """What contact forces (n, 3) [N] on a garment's vertices press with on a body: their part along its normal (n, 3)
    at the closest point, over the area that belongs to each vertex. Between layers of cloth forces are opposite, and
    leave what the body is pressed with.
    """
    area = np.bincount(membrane.faces.reshape(-1), np.repeat(membrane.area / 3.0, 3), len(force))
    outwards = (force * normal).sum(axis=1)
    there = (outwards > 0.0) & (area > 0.0)
    if not there.any():
        return Pressed(0.0, 0.0, 0.0, float(outwards.sum()))
    pressed = float(area[there].sum())
    high = _spread(outwards[there] / area[there], area[there]).high
    return Pressed(pressed, float(outwards[there].sum()) / pressed, high, float(outwards.sum()))


def _corners(membrane: Membrane) -> Float:
    """(t, 3, 2) corners of each triangle as it was cut, along warp and weft from the first [m]."""
    # The two sides from the first corner, as columns, times (along, across) are the cloth's unit vectors.
    sides = np.linalg.inv(np.stack([membrane.along, membrane.across], axis=2))
    return np.concatenate([np.zeros((len(sides), 1, 2)), sides.transpose(0, 2, 1)], axis=1)


def _flat_length(one: Slice, corners: Float) -> float:
    """Length of a curve as the cloth was cut [m]."""
    ends = np.einsum("mec,mcd->med", one.shares, corners[one.face])
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())


def _girth(name: str, height: float, x: Float, membrane: Membrane, corners: Float, body: tuple[Float, Int]) -> Girth:
    wearer = trunk(cut(*body, height))
    if wearer is None:
        return Girth(name, height, None, None, None, None)
    tape, _, middle = wearer.hull()
    found = [
        (share, _flat_length(one, corners), one.length())
        for one in cut(x, membrane.faces, height).curves()
        if (share := abs(one.turns(middle))) > ROUND
    ]
    if not found:
        return Girth(name, height, tape, None, None, None)
    share, flat, worn = min(found, key=lambda one: one[1])
    return Girth(name, height, tape, flat, worn, min(share, 1.0))


def _strains(x: Float, membrane: Membrane) -> dict[str, Spread]:
    a, b, c = np.take(x, membrane.faces.T, axis=0)
    found = {}
    for name, yarns in (("warp", membrane.along), ("weft", membrane.across)):
        stretched = yarns[:, :1] * (b - a) + yarns[:, 1:] * (c - a)
        found[name] = _spread(np.linalg.norm(stretched, axis=1) - 1.0, membrane.area)
    return found


def _spread(values: Float, area: Float) -> Spread:
    order = np.argsort(values, kind="stable")
    below = np.cumsum(area[order]) / area.sum()
    median, high = (float(values[order[np.searchsorted(below, share)]]) for share in (0.5, HIGH))
    return Spread(median, high, float(values.max()))
