"""A preset's bending rigidity makes a strip sag as the elastica says, to second order in the mesh."""

from __future__ import annotations

import numpy as np
import pytest

from nuno_cloth.fabrics.kes import elastic_energy, minimise
from nuno_cloth.fabrics.material import Measured
from nuno_cloth.models.sheet import Sheet, SheetConfig
from nuno_schemas.fabric import Float

GRAVITY, DENSITY, LENGTH = 9.81, 0.2, 0.2
DROP = {1.0: 0.123471, 3.0: 0.339648}
"""Drop / length of the heavy cantilever at w L^3 / B, from theta'' = -Gamma (1 - s) cos theta."""


def sag(gamma: float, rows: int) -> float:
    """Drop / length of a strip of square cells whose first two rows are clamped.

    The clamp holds the direction of the first step, which is the slope at its middle: the free
    length starts there.
    """
    step = LENGTH / (rows - 1.5)
    rigidity = DENSITY * GRAVITY * LENGTH**3 / gamma
    fabric = Measured(density=DENSITY, warp=4e3, weft=4e3, shear=4e2, bend_warp=rigidity, bend_weft=rigidity)
    config = SheetConfig(size=(step, step * (rows - 1)), resolution=(2, rows), plane="xz", fabric=fabric)
    piece = Sheet().build(config, None, 0)  # type: ignore[arg-type]
    free = np.arange(piece.number) >= 4
    x = piece.position.copy()

    def evaluate(values: Float) -> tuple[float, Float]:
        x[free] = values.reshape(-1, 3)
        energy, gradient = elastic_energy(piece, x)
        gradient[:, 1] += GRAVITY * piece.mass
        return energy + GRAVITY * float(piece.mass @ x[:, 1]), gradient[free].ravel()

    x[free] = minimise(evaluate, x[free].ravel(), 1e-14).reshape(-1, 3)
    return -float(x[-2:, 1].mean()) / LENGTH


@pytest.mark.parametrize(("gamma", "resolutions"), [(1.0, (8, 12, 16)), (3.0, (8, 12))])
def test_a_clamped_strip_sags_as_the_elastica(gamma: float, resolutions: tuple[int, ...]) -> None:
    """Order 2 +- 0.1, and 1.2 % at eight rows."""
    errors = np.array([sag(gamma, rows) / DROP[gamma] - 1 for rows in resolutions])
    order = -np.polyfit(np.log(np.array(resolutions) - 1.5), np.log(np.abs(errors)), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)
    assert np.abs(errors).max() < 0.012
