"""Types of the quantities with units in configurations of dyeing."""

from __future__ import annotations

from typing import Annotated

from nuno_schemas.units import Plausible, quantity

SMALL = Plausible(0.0, 5.0, ("mm", "cm"))
Length = Annotated[float, quantity("m", SMALL, gt=0)]
CellSize = Annotated[float, quantity("m", Plausible(1e-6, 1e-3, ("mm", "um")), gt=0)]
Metres = Annotated[float, quantity("m", SMALL)]
Moment = Annotated[float, quantity("s", ge=0)]
Angle = Annotated[float, quantity("rad")]
Share = Annotated[float, quantity("", ge=0, le=1)]
Positive = Annotated[float, quantity("", gt=0)]

Place = tuple[Metres, Metres]
"""A place: x to the right and y down from the cloth's upper left corner [m]."""
