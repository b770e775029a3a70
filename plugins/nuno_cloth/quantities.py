"""Types of the quantities with units in configurations here."""

from __future__ import annotations

from typing import Annotated

from nuno_schemas.units import Plausible, quantity

# Measured: 5th and 95th percentiles of DrapeTester's cantilever data. Values from a tenth to ten times of these pass,
# for veils and carpets.
FABRICS = "nine in ten of 618 measured fabrics have"
WEIGHT = Plausible(0.003, 5.0, ("g/m^2",), f"{FABRICS} 0.031 to 0.488")
BENDING = Plausible(1e-7, 1e-3, ("uN*m", "gf*cm"), f"{FABRICS} 9e-7 to 1.1e-4")
HYSTERESIS = Plausible(1e-6, 1.0, ("mN", "gf"))
TENSION = Plausible(0.1, 2e6, ("kN/m",))
AIR = Plausible(0.05, 1100.0, ("g/m^3",))
Number = Annotated[float, quantity("")]
Ratio = Annotated[float, quantity("", ge=0)]
Length = Annotated[float, quantity("m", gt=0)]
EdgeLength = Annotated[float, quantity("m", ge=1e-3, le=0.2)]
Reach = Annotated[float, quantity("m", ge=0, le=1.0)]
Metres = Annotated[float, quantity("m")]
Speed = Annotated[float, quantity("m/s")]
Time = Annotated[float, quantity("s")]
Angle = Annotated[float, quantity("rad")]
Density = Annotated[float, quantity("kg/m^2", WEIGHT, gt=0)]
AirDensity = Annotated[float, quantity("kg/m^3", AIR, ge=0)]
Tensile = Annotated[float, quantity("N/m", TENSION, gt=0)]
Modulus = Annotated[float, quantity("N/m", TENSION, ge=0)]
Rigidity = Annotated[float, quantity("N*m", BENDING, ge=0)]
MomentPerWidth = Annotated[float, quantity("N", HYSTERESIS, ge=0)]
SpringDamping = Annotated[float, quantity("N*s/m", ge=0)]
Newtons = Annotated[float, quantity("N")]
Scale = Annotated[float, quantity("m", gt=0, le=1e6)]
Fullness = Annotated[float, quantity("", ge=1, le=6)]
Flatness = Annotated[float, quantity("", gt=0.2, lt=5)]
