"""Cloth that is dyed: two layers of cells, what they hold, and how dye passes between them.

Arrays are (2, ny, nx): layer 0 is the weft, whose yarns run along x (the last axis), layer 1 the warp, along y.
Amounts are fractions of what a cell can hold at most (`v_max`), per cell.
"""

from __future__ import annotations

from dataclasses import dataclass

from nuno_schemas.fabric import Bool, Float


@dataclass(frozen=True)
class Tortuosity:
    """How straight the way from a cell to its neighbour is, in [0, 1]; 0 lets nothing pass (dye paper, figure 4).

    layers  to the other layer (I)
    beside  in a layer, across the yarn (II)
    rim     between fibre and gap (III)
    gap     between gap and gap (IV)
    yarn    in a layer, along the yarn (V)
    weave   additional, in a layer, between fibre above and fibre below (tau 2)
    """

    layers: float
    beside: float
    rim: float
    gap: float
    yarn: float
    weave: float


@dataclass(frozen=True)
class Cells:
    """A woven cloth as diffusion cells.

    fibre     (2, ny, nx) bool   fibre or gap
    up        (2, ny, nx) bool   whether the yarn is above the other layer's there
    porosity  (2, ny, nx)        P, share of a cell that is not fibre, in [0, 1]
    twist     (2, ny, nx)        tau 1 of the yarn, in [0, 1]
    resist    (2, ny, nx)        B, share of the room for mobile dye that paste or binding takes, in [0, 1]
    size      [m]                side of a cell
    v_max                        most that a cell holds
    """

    fibre: Bool
    up: Bool
    porosity: Float
    twist: Float
    resist: Float
    size: float
    tortuosity: Tortuosity
    v_max: float = 1.0

    @property
    def mobile_room(self) -> Float:
        """(2, ny, nx) V_u = V_max P (1 - B), capacity for mobile dye (dye paper, equation 9)."""
        room: Float = self.v_max * self.porosity * (1.0 - self.resist)
        return room

    @property
    def fixed_room(self) -> Float:
        """(2, ny, nx) V_d = (1 - P) V_max, capacity for fixed dye (equation 6); fibre alone holds any."""
        room: Float = (1.0 - self.porosity) * self.v_max * self.fibre
        return room
