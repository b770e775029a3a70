"""Types of quantities with units that configurations of dyeing use; a type checker sees floats."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    Length = float
    CellSize = float
    Metres = float
    Moment = float
    Angle = float
    Share = float
    Positive = float
else:
    from nuno_schemas.units import Plausible, quantity

    SMALL = Plausible(0.0, 5.0, ("mm", "cm"))
    Length = quantity("m", SMALL, gt=0)
    CellSize = quantity("m", Plausible(1e-6, 1e-3, ("mm", "um")), gt=0)
    Metres = quantity("m", SMALL)
    Moment = quantity("s", ge=0)
    Angle = quantity("rad")
    Share = quantity("", ge=0, le=1)
    Positive = quantity("", gt=0)

Place = tuple[Metres, Metres]
"""x to the right and y down from the cloth's upper left corner [m]."""
