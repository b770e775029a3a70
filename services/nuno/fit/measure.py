"""How a garment of triangles fits: girths against the body's, strain of its yarns, and what it presses with."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from nuno.fit.openings import Opening, find_openings
from nuno.fit.places import trunk
from nuno.fit.seams import Seam
from nuno.fit.slices import Slice, cut
from nuno_schemas.fabric import Float, Int, Panels
from nuno_schemas.triangles import Membrane

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
