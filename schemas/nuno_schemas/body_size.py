"""Whether a body that wears something has a body's size: one whose file is in another unit than metres has not."""

from __future__ import annotations

import math

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

SMALLEST, LARGEST = 0.02, 5.0
"""Longest side of the box about a body that can wear something [m]: from a doll's leg to twice a person."""
UNITS = {"1mm": 1e-3, "1cm": 1e-2, "1inch": 0.0254, "1m": 1.0, "1km": 1e3}
"""Lengths that a file's unit may be [m]; that is proposed which makes the body about a metre long."""


def check_size(x: Float, body: str, worn: str) -> None:
    """Raises BadInput for a body x (v, 3) [m] that no one has; `body` is its name, `worn` what it is to wear."""
    size = float((x.max(axis=0) - x.min(axis=0)).max())
    if SMALLEST <= size <= LARGEST:
        return
    unit = min(UNITS, key=lambda name: abs(math.log(size * UNITS[name])))
    raise BadInput(
        f"the body is too small or too large to wear {worn}: its file may be in another unit than metres",
        field="over.body", value=f"{body}, {size:.3g} m long", limit=f"{SMALLEST:g} to {LARGEST:g} m",
        remedy=f"say how long its unit is: --set bodies.{body}.collider.scale={unit}",
    )  # fmt: skip
