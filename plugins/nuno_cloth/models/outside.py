"""Check that cloth starts outside of the body that wears it."""

from __future__ import annotations

import numpy as np

from nuno_geometry.check import place_of
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import Tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float


def require_outside(x: Float, clear: Float, body: Tree, what: str, remedy: str) -> None:
    """Raise BadInput if points (n, 3) [m] of the piece `what` are not outside of a body by `clear` (n,) [m]."""
    away = closest_points(body, x).distance
    worst = int(np.argmin(away / clear))
    if away[worst] < clear[worst]:
        raise not_outside(float(away[worst]), x[worst], float(clear[worst]), what, remedy)


def not_outside(away: float, place: Float, clear: float, what: str, remedy: str) -> BadInput:
    """Return the error for a point (3,) of `what` that is `away` off a body [m] (negative: inside), not `clear`."""
    value = f"{abs(1e3 * away):.3g} mm {'inside' if away < 0.0 else 'from it'}, {place_of(place)}"
    problem, limit = f"the {what} would start inside of the body, or too near to it", f"{1e3 * clear:.3g} mm outside"
    return BadInput(problem, field="over", value=value, limit=limit, remedy=remedy)
