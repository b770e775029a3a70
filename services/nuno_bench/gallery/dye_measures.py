"""What dyed cloth shows, in numbers: how far dye came, how mottled and how streaked it is, which weave it follows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_schemas.dye import Cells
from nuno_schemas.fabric import Bool, Float

NEAR = 2e-3
"""Around the middle of the dye [m]: what lies farther is too pale to be judged by eye."""


class Dyed(NamedTuple):
    """A cloth, the amounts (2, ny, nx) of one dye in it, mobile and fixed, and the pitch of its yarns [cells]."""

    cells: Cells
    phi: Float
    fixed: Float
    pitch: int

    @property
    def shown(self) -> Float:
        """(ny, nx) all dye of the upper yarns."""
        total = self.phi + self.fixed
        upper: Float = np.where(self.cells.up[1], total[1], total[0])
        return upper


def spread_radius(dyed: Dyed) -> float:
    """Root mean square distance of all dye from its middle [m]."""
    amount = (dyed.phi + dyed.fixed).sum(axis=0)
    x, y, _ = _around(amount)
    return float(np.sqrt((amount * (x * x + y * y)).sum() / amount.sum()) * dyed.cells.size)


def fixed_radius(dyed: Dyed) -> float:
    """Radius of a disc as large as the part where fibre has fixed half of the most [m]."""
    amount = dyed.fixed.sum(axis=0)
    return float(np.sqrt((amount > 0.5 * amount.max()).sum() / np.pi) * dyed.cells.size)


def mottle(dyed: Dyed) -> float:
    """Deviation of the crossings that show from the mean of those around them, as a share of the mean amount."""
    rest, near, mean = _uneven(dyed)
    return float(rest[near].std() / mean)


def streaks(dyed: Dyed) -> float:
    """How much more the weft differs from yarn to yarn than along a yarn: a ratio of deviations, 1 for none.

    Of each crossing from the mean of its two neighbours, which a smooth spread hardly has.
    """
    weft = crossings((dyed.phi + dyed.fixed)[0], dyed.pitch)
    across = (weft[1:-1] - 0.5 * (weft[2:] + weft[:-2]))[:, 1:-1]
    along = (weft[:, 1:-1] - 0.5 * (weft[:, 2:] + weft[:, :-2]))[1:-1]
    near = _near(weft, dyed)[1:-1, 1:-1]
    return float(np.sqrt(np.square(across[near]).mean() / np.square(along[near]).mean()))


def follows(dyed: Dyed, weave: Cells) -> float:
    """How well what shows follows a weave, -1 to 1: a correlation over the crossings.

    Dye runs along yarns. To the right and left of its middle, then, crossings whose weft is above are darker
    than those around them, and above and below the middle those whose warp is.
    """
    rest, near, _ = _uneven(dyed)
    _, _, sector = _around(crossings(dyed.shown, dyed.pitch))
    warp = crossings(weave.up[1].astype(np.float64), dyed.pitch)
    lighter = (0.5 - warp) * sector
    near = near & (sector != 0.0)
    return float(np.corrcoef(rest[near], (lighter - _smooth(lighter))[near])[0, 1])


def crossings(values: Float, pitch: int) -> Float:
    """(ny / pitch, nx / pitch) means of values (ny, nx) over the crossings of yarns."""
    ny, nx = (n // pitch for n in values.shape)
    means: Float = values[: ny * pitch, : nx * pitch].reshape(ny, pitch, nx, pitch).mean(axis=(1, 3))
    return means


def _uneven(dyed: Dyed) -> tuple[Float, Bool, float]:
    """Crossings less the mean of those around them, which of them are near the dye, and their mean amount."""
    shown = crossings(dyed.shown, dyed.pitch)
    near = _near(shown, dyed)
    return shown - _smooth(shown), near, float(shown[near].mean())


def _smooth(values: Float) -> Float:
    """Means over 3 x 3 neighbours."""
    wide, (ny, nx) = np.pad(values, 1, mode="edge"), values.shape
    parts = [wide[i : i + ny, j : j + nx] for i in range(3) for j in range(3)]
    mean: Float = np.mean(parts, axis=0)
    return mean


def _near(values: Float, dyed: Dyed) -> Bool:
    x, y, _ = _around(values)
    near: Bool = np.hypot(x, y) * dyed.pitch * dyed.cells.size < NEAR
    return near


def _around(amount: Float) -> tuple[Float, Float, Float]:
    """Places x, y from the middle of an amount (ny, nx); 1 to its right and left, -1 above and below, 0 between."""
    y, x = (np.arange(n, dtype=np.float64) for n in amount.shape)
    x, y = x[None] - (amount.sum(axis=0) @ x) / amount.sum(), y[:, None] - (amount.sum(axis=1) @ y) / amount.sum()
    return x, y, np.sign(np.abs(x) - np.abs(y))
