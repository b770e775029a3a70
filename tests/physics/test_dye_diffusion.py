"""Explicit diffusion in woven cloth: the sums of a plain loop, closed forms, dye kept, the same bits for any bands."""

from __future__ import annotations

import numpy as np
import pytest
from dye_reference import PLAIN, random_cells, spread, step_plainly

from nuno_dye.laws.faces import face_values, largest_sum
from nuno_dye.solvers.diffusion import GHOST
from nuno_schemas.dye import Cells, Tortuosity


def test_equals_a_plain_loop() -> None:
    cells = random_cells(9, 13)
    phi = np.random.default_rng(5).random(cells.fibre.shape)
    faces = face_values(cells)
    scale = 0.9 / largest_sum(faces)
    exact, steps = phi, GHOST + 3
    for _ in range(steps):
        exact = step_plainly(exact, cells, scale)
    assert np.abs(spread(phi, faces, scale, steps) - exact).max() < 1e-14 * steps


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (GHOST, 7), (3 * GHOST + 1, 17), (61, 64)])
def test_bands_and_passes_change_no_bit(shape: tuple[int, int]) -> None:
    cells = random_cells(*shape)
    phi = np.random.default_rng(7).random(cells.fibre.shape)
    faces = face_values(cells)
    scale = 0.9 / max(largest_sum(faces), 1e-9)
    whole = spread(phi, faces, scale, 2 * GHOST + 5)
    for bands in (2, 3, 5):
        assert np.array_equal(spread(phi, faces, scale, 2 * GHOST + 5, bands), whole)
    bit_by_bit = phi
    for _ in range(2 * GHOST + 5):
        bit_by_bit = spread(bit_by_bit, faces, scale, 1)
    assert np.array_equal(bit_by_bit, whole)


def test_dye_is_kept_and_stays_between_what_there_was() -> None:
    cells = random_cells(50, 60)
    phi = (np.random.default_rng(11).random(cells.fibre.shape) > 0.7).astype(float)
    faces, steps = face_values(cells), 4000
    end = spread(phi, faces, 1.0 / largest_sum(faces), steps, 2)
    assert abs(end.sum() - phi.sum()) <= 1e-13 * np.sqrt(steps) * phi.sum()
    assert end.min() >= 0.0 and end.max() <= 1.0
    blocked = cells.porosity == 0.0
    assert blocked.any() and np.array_equal(end[blocked], phi[blocked])


def test_a_point_spreads_as_the_closed_form_says() -> None:
    """M / (4 pi t sqrt(Dx Dy)) exp(-x^2 / 4 Dx t - y^2 / 4 Dy t), each layer along its own yarns."""
    n, scale, errors = 201, 0.2, []
    open_cloth = Tortuosity(layers=0.0, beside=0.25, rim=1.0, gap=1.0, yarn=1.0, weave=1.0)
    ones = np.ones((2, n, n))
    faces = face_values(Cells(ones > 0, ones > 0, ones, ones, 0 * ones, 1.0, open_cloth))
    phi = np.zeros((2, n, n))
    phi[:, n // 2, n // 2] = 1.0
    place = np.arange(n) - n // 2
    for steps in (200, 800):
        end, t = spread(phi, faces, scale, steps, 2), scale * steps
        fast, slow = (np.exp(-(place**2) / (4.0 * d * t)) / np.sqrt(4.0 * np.pi * d * t) for d in (1.0, 0.25))
        exact = np.stack([slow[:, None] * fast, fast[:, None] * slow])
        errors.append(np.abs(end - exact).max() / exact.max())
    # The distance to the continuum falls with the width in cells squared, which grows with t.
    assert errors[1] < 0.005 and errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)


def test_two_layers_exchange_exponentially() -> None:
    """The difference of two cells falls by 1 - 2 w in every step."""
    ones = np.ones((2, 3, 3))
    closed = Tortuosity(layers=0.4, beside=0.0, rim=0.0, gap=0.0, yarn=0.0, weave=1.0)
    faces = face_values(Cells(ones > 0, ones > 0, 0.5 * ones, ones, 0 * ones, 1.0, closed))
    phi = np.stack([np.ones((3, 3)), np.zeros((3, 3))])
    end = spread(phi, faces, 0.3, 50)
    assert end[0] - end[1] == pytest.approx(np.full((3, 3), (1.0 - 2.0 * 0.3 * 0.5 * 0.4) ** 50), rel=1e-12)


def test_a_line_of_resist_lets_nothing_through() -> None:
    """Where porosity is 0 a face passes nothing, in either layer."""
    ones = np.ones((2, 20, 30))
    ones[:, :, 15] = 0.0
    cells = Cells(ones >= 0, ones > 1, ones, np.ones_like(ones), 0 * ones, 1.0, PLAIN)
    phi = np.zeros_like(ones)
    phi[:, :, :15] = 1.0
    end = spread(phi, face_values(cells), 0.2, 500)
    assert not end[:, :, 15:].any() and end[:, :, :15] == pytest.approx(1.0, abs=1e-12)
