"""Prints on sewn panels: each triangle lies in the image as it is cut, but for where it lies and the grain's turn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sewing_patterns import FEW, REAL, read_pattern

from nuno.scene.files import SceneFiles
from nuno_cloth.models.pattern import lay_out
from nuno_cloth.sewing.sew import sew


@pytest.mark.quick(garment=FEW, grain=[30.0])
@pytest.mark.parametrize("grain", [0.0, 30.0])
@pytest.mark.parametrize("garment", REAL)
def test_triangles_lie_in_the_image_as_they_are_cut(shared_data: Path, garment: str, grain: float) -> None:
    """Sides of triangles along the warp and the weft are those of the panel, at one scale, also along seams."""
    sewn = sew(read_pattern(SceneFiles(shared_data / "patterns"), f"{garment}.json"), 0.03)
    cosine, sine = np.cos(np.radians(grain)), np.sin(np.radians(grain))
    x, y = sewn.warp.T
    sewn = replace(sewn, warp=np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1))
    uv, unit = lay_out(sewn)
    assert uv.min(axis=0) == pytest.approx([0.0, 0.0]) and uv.max() == pytest.approx(1.0)

    cut, shown = (points[np.roll(sewn.faces, -1, axis=1)] - points[sewn.faces] for points in (sewn.flat, uv))
    warp = sewn.warp[sewn.panel][:, None]
    weft = np.stack([warp[..., 1], -warp[..., 0]], axis=-1)
    expected = np.stack([(cut * weft).sum(axis=-1), (cut * warp).sum(axis=-1)], axis=-1)
    assert np.abs(shown - expected / unit).max() < 1e-12

    low, high = (
        np.array([f(uv[sewn.faces[sewn.panel == k], 0]) for k in range(len(sewn.names))]) for f in (np.min, np.max)
    )
    assert (low[1:] >= high[:-1] - 1e-12).all()
