"""Explicit diffusion in woven cloth: the sums of a plain loop, closed forms, dye kept, the same bits for any bands."""

from __future__ import annotations

import numpy as np
import pytest
from dye_reference import random_cells, spread, step_plainly

from nuno_dye.laws.faces import face_values, largest_sum
from nuno_dye.solvers.diffusion import GHOST


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
