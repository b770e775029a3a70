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
    from nuno_schemas.units import Plausible, quantity

    # Measured: DrapeTester's cantilever data, whose 5th and 95th percentiles are given. A tenth and ten times of them
    # are still taken, for there are veils and carpets.
    FABRICS = "nine in ten of 618 measured fabrics have"
    WEIGHT = Plausible(0.003, 5.0, ("g/m^2",), f"{FABRICS} 0.031 to 0.488")
    BENDING = Plausible(1e-7, 1e-3, ("uN*m", "gf*cm"), f"{FABRICS} 9e-7 to 1.1e-4")
    TENSION = Plausible(0.1, 2e6, ("kN/m",))
    AIR = Plausible(0.05, 1100.0, ("g/m^3",))
    Number = quantity("")
    Ratio = quantity("", ge=0)
    Length = quantity("m", gt=0)
    Metres = quantity("m")
    Speed = quantity("m/s")
    Angle = quantity("rad")
    Density = quantity("kg/m^2", WEIGHT, gt=0)
    AirDensity = quantity("kg/m^3", AIR, ge=0)
    Tensile = quantity("N/m", TENSION, gt=0)
    Modulus = quantity("N/m", TENSION, ge=0)
    Rigidity = quantity("N*m", BENDING, ge=0)
    SpringDamping = quantity("N*s/m", ge=0)
    Newtons = quantity("N")
    Scale = quantity("m", gt=0, le=1e6)
    Fullness = quantity("", ge=1, le=6)
    Flatness = quantity("", gt=0.2, lt=5)
