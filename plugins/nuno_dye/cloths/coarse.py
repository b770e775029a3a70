"""The same cloth in fewer, larger cells: their layout, and the tortuosities of their faces.

A cell in the place of n x n others has n^2 times their area, and its middle is n cells from the next one's. Flow from
cell to cell in a layer is proportional to T over that distance: faces between cells of one kind keep their T, and a
face between two kinds conducts like n faces in series,

    n / T' = (n - 1) / 2 (1 / T_a + 1 / T_b) + 1 / T_ab.

Flow to the other layer, and into fibre, is proportional to T and D_ab over the square of a cell's side, which stands
for the distance of the layers, and of fibre from liquor. It stays the same in larger cells with n^2 T and n^2 D_ab.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nuno_schemas.dye import Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Int


class Layout(NamedTuple):
    """The layout of a layer's yarns, by cell across them.

    yarn   (n,) int32  the yarn whose pitch contains the cell
    fibre  (n,) bool   whether the cell is in the yarn, not in a gap
    """

    yarn: Int
    fibre: Bool


def thin_out(layout: Layout, times: int) -> Layout:
    """Return the layout at the middle of every `times` cells. Raises BadInput if it could miss a yarn or a gap."""
    if times == 1:
        return layout
    label = np.where(layout.fibre, layout.yarn + 1, 0)
    starts = np.flatnonzero(np.diff(label)) + 1
    finest = int(np.diff(starts).min(initial=len(label)))
    if finest < times:
        raise BadInput(
            "a yarn or a gap is narrower than a cell would be", field="coarser", value=times,
            limit=f"{finest} cells, the narrowest yarn or gap between yarns",
            remedy="a smaller number, or larger cells with yarns given in them",
        )  # fmt: skip
    places = slice(times // 2, len(label) // times * times, times)
    return Layout(layout.yarn[places], layout.fibre[places])


def coarsen(tortuosity: Tortuosity, times: int) -> Tortuosity:
    """Return the tortuosities of cells that are `times` as large."""
    t, n = tortuosity, times
    # tau 2 multiplies only the middle face, between fibre above and below, not the rest of the way.
    weave = _in_series(n, 1.0, t.weave, 1.0)
    return replace(t, layers=n * n * t.layers, rim=_in_series(n, t.beside, t.rim, t.gap), weave=weave)


def _in_series(n: int, before: float, between: float, after: float) -> float:
    """Return T of n faces in series, the middle one between two kinds; 0 if one lets nothing pass."""
    rest = 0.5 * (n - 1)
    if between == 0.0 or (rest and 0.0 in (before, after)):
        return 0.0
    return n / (1.0 / between + (rest / before + rest / after if rest else 0.0))
