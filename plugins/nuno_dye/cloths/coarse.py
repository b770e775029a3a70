"""The same cloth in fewer, larger cells: what lies beside what, and what its faces let pass in all.

A cell in the place of n x n others has n^2 times their area, and its middle is n cells from the next one's. What passes
from cell to cell in a layer goes as T over that distance: faces between cells of one kind keep their T, and a face
between two kinds lets pass what n faces do one after the other,

    n / T' = (n - 1) / 2 (1 / T_a + 1 / T_b) + 1 / T_ab.

What passes to the other layer, and into fibre, goes as T and D_ab over the square of a cell's side, a distance that is
that of layers, and of fibre from liquor. It is the same in larger cells: n^2 T, and n^2 D_ab.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nuno_schemas.dye import Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Int


class Lay(NamedTuple):
    """How a layer's yarns lie side by side, by cell across them.

    yarn   (n,) int32  the yarn in whose pitch a cell lies
    fibre  (n,) bool   whether it lies in the yarn itself
    """

    yarn: Int
    fibre: Bool


def thin_out(lay: Lay, times: int) -> Lay:
    """What lies in the middle of every `times` cells. Raises BadInput where a yarn or a gap could fall between them."""
    if times == 1:
        return lay
    label = np.where(lay.fibre, lay.yarn + 1, 0)
    starts = np.flatnonzero(np.diff(label)) + 1
    finest = int(np.diff(starts).min(initial=len(label)))
    if finest < times:
        raise BadInput(
            "a yarn or a gap is narrower than a cell would be", field="coarser", value=times,
            limit=f"{finest} cells, the narrowest yarn or gap between yarns",
            remedy="a smaller number, or larger cells with yarns given in them",
        )  # fmt: skip
    places = slice(times // 2, len(label) // times * times, times)
    return Lay(lay.yarn[places], lay.fibre[places])


def coarsen(tortuosity: Tortuosity, times: int) -> Tortuosity:
    """Faces of cells that are `times` as large."""
    t, n = tortuosity, times
    # tau 2 multiplies a face of fibre and fibre, as I to V do not: the rest of the way is not multiplied with it.
    weave = _in_a_row(n, 1.0, t.weave, 1.0)
    return replace(t, layers=n * n * t.layers, rim=_in_a_row(n, t.beside, t.rim, t.gap), weave=weave)


def _in_a_row(n: int, before: float, between: float, after: float) -> float:
    """T of n faces one after the other, the middle one between two kinds; 0 where one lets nothing pass."""
    rest = 0.5 * (n - 1)
    if between == 0.0 or (rest and 0.0 in (before, after)):
        return 0.0
    return n / (1.0 / between + (rest / before + rest / after if rest else 0.0))
