"""Types of quantities with units that configurations here use."""

from __future__ import annotations

from typing import Annotated

from nuno_schemas.units import ANY, quantity

Number = Annotated[float, quantity("")]
Length = Annotated[float, quantity("m")]
Size = Annotated[float, quantity("m", gt=0)]
Reach = Annotated[float, quantity("m", ge=0)]
Angle = Annotated[float, quantity("rad")]
Spin = Annotated[float, quantity("rad", ANY)]  # a body may turn several times
Tilt = Annotated[float, quantity("rad", ge=0, le=0.5)]
Turn = Annotated[float, quantity("rad", ge=0, le=0.8)]
Time = Annotated[float, quantity("s")]
Later = Annotated[float, quantity("s", gt=0)]
Silence = Annotated[float, quantity("s", gt=0, le=100)]  # shorter than a run waits for any of its services
Span = Annotated[float, quantity("s", ge=0)]
Rate = Annotated[float, quantity("Hz", gt=0)]
Speed = Annotated[float, quantity("m/s", gt=0)]
TurnRate = Annotated[float, quantity("rad/s", gt=0)]
Tempo = Annotated[float, quantity("Hz", ge=0)]

Point = tuple[Length, Length, Length]
Direction = tuple[Number, Number, Number]
