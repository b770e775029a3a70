"""Types of quantities with units that configurations here use.

A type checker sees floats, for `quantity` builds its types while the program runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    Number = float
    Length = float
    Size = float
    Reach = float
    Angle = float
    Spin = float
    Tilt = float
    Turn = float
    Time = float
    Later = float
    Span = float
    Rate = float
    Tempo = float
else:
    from nuno_schemas.units import ANY, quantity

    Number = quantity("")
    Length = quantity("m")
    Size = quantity("m", gt=0)
    Reach = quantity("m", ge=0)
    Angle = quantity("rad")
    Spin = quantity("rad", ANY)  # a body may turn many times
    Tilt = quantity("rad", ge=0, le=0.5)
    Turn = quantity("rad", ge=0, le=0.8)
    Time = quantity("s")
    Later = quantity("s", gt=0)
    Span = quantity("s", ge=0)
    Rate = quantity("Hz", gt=0)
    Tempo = quantity("Hz", ge=0)

Point = tuple[Length, Length, Length]
Direction = tuple[Number, Number, Number]
