"""How large a texture is on cloth: that of a sheet is the sheet's, of a cone its mean, of panels their own."""

from __future__ import annotations

import numpy as np
import pytest

from nuno.plugin_contract import registry
from nuno.simulation.cloth.texture import texture_size
from nuno_schemas.fabric import Fabric


def built(name: str, **config: object) -> Fabric:
    model = registry.load("nuno.models", name)
    made: Fabric = model.build(model.Config(**config), None, 0)
    return made


@pytest.mark.parametrize("cells", ["quads", "triangles"])
def test_a_sheets_texture_is_as_large_as_the_sheet(cells: str) -> None:
    sheet = built("sheet", size=(0.6, 0.4), resolution=(13, 9), plane="xz", cells=cells, fabric="denim")
    assert texture_size(sheet) == pytest.approx((0.6, 0.4), rel=1e-6)


def test_a_skirts_is_as_wide_as_its_mean_circle_and_as_high_as_it_is_long() -> None:
    """u runs once round it; the mean is by area, which goes with the circle: int r^2 over int r."""
    low, high, long = 0.2, 0.3, 0.4
    skirt = built("skirt", waist_radius=low, hem_radius=high, length=long, columns=128, rows=33, fabric="denim")
    mean = (high**3 - low**3) / 3.0 / ((high**2 - low**2) / 2.0)
    width, height = texture_size(skirt)
    assert width == pytest.approx(2.0 * np.pi * mean, rel=2e-3)
    assert height == pytest.approx(long, rel=2e-3)


def test_cloth_without_a_texture_has_none() -> None:
    with pytest.raises(ValueError, match="without texture"):
        texture_size(built("knit", form="tube", wales=8, courses=15))
