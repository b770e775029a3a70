"""Heights and widths of wrinkles are those of ridges whose shape is known."""

from __future__ import annotations

import numpy as np
import pytest

from nuno_bench.gallery.kind import ShownScene, compare
from nuno_bench.gallery.wrinkle import DIFFERENCES, KIND, Drawn
from nuno_schemas.fabric import Float, Int

STEP = 0.005


def sheet(rows: int, columns: int) -> tuple[Float, Int]:
    """A level sheet of cells STEP wide, facing up, its middle line along x at z = 0."""
    z, x = np.meshgrid(STEP * (np.arange(rows) - rows // 2), STEP * np.arange(columns), indexing="ij")
    row, column = np.divmod(np.arange((rows - 1) * (columns - 1)), columns - 1)
    a = row * columns + column
    b, c, d = a + 1, a + columns, a + columns + 1
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.int32)
    return np.stack([x.reshape(-1), 0.0 * x.reshape(-1), z.reshape(-1)], axis=1), faces


@pytest.mark.parametrize(("height", "base"), [(0.004, 0.02), (-0.002, 0.03)])
def test_a_roof_is_as_high_and_half_as_wide_at_half_its_height(height: float, base: float) -> None:
    """A roof of slopes from z = -base to base is `base` wide at half its height, sunk, tilted and shifted or not."""
    flat, faces = sheet(41, 61)
    own = 20 * 61 + np.arange(5, 56)
    crests = np.stack([own, own - 10 * 61, own + 10 * 61, own - 1, own + 1]).astype(np.int32)
    drawn = Drawn(flat, faces, crests, [flat[own]])
    x = flat.copy()
    x[:, 1] = height * np.maximum(1.0 - np.abs(x[:, 2]) / base, 0.0)
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    for places in (x, x @ turn.T - [0.0, 0.01, 0.0]):
        (found,) = drawn.measure(places)
        assert found.height == pytest.approx(abs(height), rel=1e-9)
        assert found.width == pytest.approx(base, rel=1e-9)


def test_crests_belong_to_the_nearest_line_and_a_line_without_any_has_no_height() -> None:
    flat, faces = sheet(41, 61)
    own = 20 * 61 + np.arange(5, 56)
    crests = np.stack([own, own - 10 * 61, own + 10 * 61, own - 1, own + 1]).astype(np.int32)
    x = flat + [0.0, 0.01, 0.0] * (np.abs(flat[:, 2:]) < 0.001)
    there, none = Drawn(flat, faces, crests, [flat[own], flat[own] + [0.0, 0.0, 0.2]]).measure(x)
    assert there.height == pytest.approx(0.01)
    assert there.width == pytest.approx(STEP)
    assert np.isnan(none).all()


def test_what_thins_and_fades_meets_the_bar_and_what_stays_misses() -> None:
    measures = [measure for one in DIFFERENCES for _, measure in (one.high, one.low)]
    for values, verdict in (
        ((0.05, 0.02, 4e-3, 1e-3, 1.0, 0.25), "bar met"),
        ((0.05, 0.05, 4e-3, 4e-3, 1.0, 1.0), "missed"),
    ):
        shown = ShownScene("shirt-wrinkles", "", measured=dict(zip(measures, values, strict=True)))
        assert [row[-1] for row in compare(DIFFERENCES, {shown.name: shown})] == [verdict] * 3
    assert "shirt-wrinkles" in KIND.scenes()
