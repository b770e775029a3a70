"""Types of quantities with units that configurations of knits use; a type checker sees floats."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    Length = float
    Reach = float
    Metres = float
    Mass = float
    LinearDensity = float
    Newtons = float
    Stiffness = float
    SpringDamping = float
    Ratio = float
    Share = float
    Rate = float
    Point = tuple[float, float, float]
else:
    from nuno_schemas.units import Plausible, quantity

    Length = quantity("m", gt=0)
    Reach = quantity("m", ge=0)
    Metres = quantity("m")
    Mass = quantity("kg", Plausible(1e-10, 0.01, ("mg", "g")), gt=0)
    LinearDensity = quantity("kg/m", Plausible(1e-7, 0.01, ("dtex", "tex")), gt=0)
    Newtons = quantity("N", gt=0)
    Stiffness = quantity("N/m", gt=0)
    SpringDamping = quantity("N*s/m", ge=0)
    Ratio = quantity("", gt=0)
    Share = quantity("", ge=0)
    Rate = quantity("1/s", gt=0)
    Point = tuple[Metres, Metres, Metres]
