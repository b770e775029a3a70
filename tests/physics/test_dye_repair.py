"""What leaves its bounds goes to the nearest cells that can take or give it, and no dye is lost."""

from __future__ import annotations

from math import fsum

import numpy as np
import pytest

from nuno_dye.solvers.diffusion import LEFT, Weights
from nuno_dye.solvers.long_steps import repair
from nuno_schemas.fabric import Float

MARGIN = 2


def faces(ny: int, nx: int) -> Weights:
    """Weights of 1 between all cells of two layers, in the kernels' layout."""
    r, w = ny + 2 * MARGIN, LEFT + nx + 8
    along, down, across = np.zeros((2 * r, w)), np.zeros((2 * r, w)), np.zeros((r, w))
    for layer in range(2):
        top = layer * r + MARGIN
        along[top : top + ny, LEFT : LEFT + nx - 1] = 1.0
        down[top : top + ny - 1, LEFT : LEFT + nx] = 1.0
    across[MARGIN : MARGIN + ny, LEFT : LEFT + nx] = 1.0
    return Weights(along, down, across)


def laid(amounts: Float) -> Float:
    """(2, ny, nx) in the kernels' layout."""
    _, ny, nx = amounts.shape
    out = np.zeros((2, ny + 2 * MARGIN, LEFT + nx + 8))
    out[:, MARGIN : MARGIN + ny, LEFT : LEFT + nx] = amounts
    return out.reshape(-1, out.shape[2])


def mend(amounts: Float, most: Float, floor: Float | None = None) -> tuple[Float, int]:
    """Amounts (2, ny, nx) after repair, and how many cells are still outside."""
    _, ny, nx = amounts.shape
    phi = laid(amounts)
    floor = np.zeros(most.shape) if floor is None else floor
    left = repair(phi, laid(most), laid(floor), faces(ny, nx), MARGIN, MARGIN + ny - 1, nx)
    return phi.reshape(2, -1, phi.shape[1])[:, MARGIN : MARGIN + ny, LEFT : LEFT + nx], left


@pytest.mark.parametrize("seed", range(5))
def test_any_amounts_come_within_bounds_and_none_is_lost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    most = rng.uniform(0.0, 1.0, (2, 17, 23)) * (rng.random((2, 17, 23)) > 0.2)
    amounts = most * rng.choice([1.0, 0.999], most.shape) + rng.normal(0.0, 0.02, most.shape)
    amounts -= 0.03 * most  # there is room for all
    after, left = mend(amounts, most)
    assert left == 0 and after.min() >= 0.0 and np.all(after <= most)
    assert fsum(after.reshape(-1)) == pytest.approx(fsum(amounts.reshape(-1)), rel=1e-14)


def test_excess_goes_through_full_cells_to_the_nearest_room() -> None:
    """Room lies 39 columns to the right and 59 to the left."""
    most = np.ones((2, 3, 100))
    amounts = np.ones((2, 3, 100))
    amounts[0, 1, 60] = 1.25
    amounts[:, :, 99], amounts[:, :, 0] = 0.5, 0.5
    after, left = mend(amounts, most)
    assert left == 0 and np.all(after[:, :, 1:99] == 1.0) and np.all(after[:, :, 0] == 0.5)
    assert after[0, 1, 99] == 0.75 and after[:, :, 99].sum() == pytest.approx(3.25, rel=1e-15)


def test_a_lack_is_made_good_by_the_nearest_dye() -> None:
    amounts = np.zeros((2, 3, 100))
    amounts[0, 1, 60] = -0.25
    amounts[:, :, 99], amounts[:, :, 0] = 0.5, 0.5
    after, left = mend(amounts, np.ones(amounts.shape))
    assert left == 0 and np.all(after[:, :, 1:99] == 0.0) and np.all(after[:, :, 0] == 0.5)
    assert after[0, 1, 99] == 0.25


def test_room_that_one_round_fills_up_sends_the_rest_on() -> None:
    """The nearest room takes 0.1 of 1; the rest goes on to where there is more."""
    most = np.ones((2, 1, 50))
    amounts = np.ones((2, 1, 50))
    amounts[0, 0, 25], amounts[:, 0, 30], amounts[:, 0, 45] = 2.0, 0.95, 0.0
    after, left = mend(amounts, most)
    assert left == 0 and np.all(after[:, 0, 30] == 1.0)
    assert after[:, 0, 45].sum() == pytest.approx(0.9, rel=1e-14)


def test_a_cell_that_is_kept_up_may_lack_and_excess_without_any_room_is_told() -> None:
    amounts, most = np.ones((2, 4, 5)), np.ones((2, 4, 5))
    floor = np.zeros(most.shape)
    amounts[0, 1, 1], floor[0, 1, 1] = -0.5, 0.5
    after, left = mend(amounts, most, floor)
    assert left == 0 and after[0, 1, 1] == -0.5
    amounts[0, 1, 1] = 1.5
    after, left = mend(amounts, most)
    assert left == 1 and after[0, 1, 1] == 1.5
