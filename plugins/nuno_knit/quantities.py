"""Types of the quantities with units in configurations of knits."""

from __future__ import annotations

from typing import Annotated

from nuno_schemas.units import Plausible, quantity

Length = Annotated[float, quantity("m", gt=0)]
Reach = Annotated[float, quantity("m", ge=0)]
Metres = Annotated[float, quantity("m")]
Mass = Annotated[float, quantity("kg", Plausible(1e-10, 0.01, ("mg", "g")), gt=0)]
LinearDensity = Annotated[float, quantity("kg/m", Plausible(1e-7, 0.01, ("dtex", "tex")), gt=0)]
Newtons = Annotated[float, quantity("N", gt=0)]
Stiffness = Annotated[float, quantity("N/m", gt=0)]
SpringDamping = Annotated[float, quantity("N*s/m", ge=0)]
Ratio = Annotated[float, quantity("", gt=0)]
Share = Annotated[float, quantity("", ge=0)]
Rate = Annotated[float, quantity("1/s", gt=0)]
Point = tuple[Metres, Metres, Metres]
