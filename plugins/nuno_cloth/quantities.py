"""Types of quantities with units that configurations here use.

A type checker sees floats, for `quantity` builds its types while the program runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    Number = float
    Ratio = float
    Length = float
    Metres = float
    Speed = float
    Angle = float
    Density = float
    AirDensity = float
    Tensile = float
    Modulus = float
    Rigidity = float
    SpringDamping = float
    Newtons = float
    Scale = float
    Fullness = float
    Flatness = float
else:
    from nuno_schemas.units import quantity

    Number = quantity("")
    Ratio = quantity("", ge=0)
    Length = quantity("m", gt=0)
    Metres = quantity("m")
    Speed = quantity("m/s")
    Angle = quantity("rad")
    Density = quantity("kg/m^2", gt=0)
    AirDensity = quantity("kg/m^3", ge=0)
    Tensile = quantity("N/m", gt=0)
    Modulus = quantity("N/m", ge=0)
    Rigidity = quantity("N*m", ge=0)
    SpringDamping = quantity("N*s/m", ge=0)
    Newtons = quantity("N")
    Scale = quantity("m", gt=0, le=1e6)
    Fullness = quantity("", ge=1, le=6)
    Flatness = quantity("", gt=0.2, lt=5)
