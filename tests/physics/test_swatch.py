"""Flat pieces: as large as they are cut, in triangles of one size."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nuno_cloth.models.swatch import SwatchConfig, lay
from nuno_schemas.fabric import Float


def corners(seed: int = 0, **fields: Any) -> Float:
    """(f, 3, 2) of a piece's triangles [m]."""
    points, faces = lay(SwatchConfig.model_validate(fields), seed)
    return np.asarray(points[faces])


def area_of(flat: Float) -> float:
    one, other = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    return 0.5 * float((one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum())


def polygon(radius: float, edge: float) -> float:
    """Area of as many corners on a circle as edges of this length go round it [m^2]."""
    around = max(12, round(2.0 * np.pi * radius / edge))
    return 0.5 * around * radius**2 * float(np.sin(2.0 * np.pi / around))


@pytest.mark.parametrize("layout", ["irregular", "aligned", "crossed"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_disc_is_filled_with_triangles_of_one_size(seed: int, layout: str) -> None:
    """Up to its rim all round: no side is much longer than others."""
    flat = corners(seed, radius=0.3, edge=0.02, layout=layout)
    sides = np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2)
    assert sides.max() < 2.2 * 0.02
    assert area_of(flat) == pytest.approx(polygon(0.3, 0.02), rel=1e-12) == pytest.approx(np.pi * 0.3**2, rel=1e-3)
