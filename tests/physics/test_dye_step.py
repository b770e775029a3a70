"""The whole step of dyeing: adsorption, capacities and resist, against a plain loop; dye kept, never too much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dye_reference import (
    ISOTHERMS,
    plain_step,
    random_cells,
    resisted,
    spread,
    start,
    step_plainly,
)

from nuno_dye.laws.adsorption import NOTHING, Uptake
from nuno_dye.laws.faces import face_values, largest_sum
from nuno_dye.solvers.bands import Cut, make_dye_bands, read_bands
from nuno_dye.solvers.dyeing import LEVELS, dye
from nuno_schemas.dye import Cells
from nuno_schemas.fabric import Float


def run(
    phi: Float,
    fixed: Float,
    cells: Cells,
    scale: float,
    rate: float,
    isotherm: str,
    steps: int,
    bands: int = 1,
    steepest: float = 1.0,
) -> tuple[Float, Float]:
    packed = make_dye_bands(phi, cells, face_values(cells), scale, bands, steepest)
    kind, k, b = ISOTHERMS[isotherm]
    bound, fibre = Cut(phi.shape, bands, 2 * LEVELS).fill(fixed, cells.fixed_room)
    uptake = None if kind == NOTHING else Uptake(bound, fibre, kind, k, b, rate)
    dye(steps, packed, uptake, None, None, np.zeros(1, np.int64))
    return read_bands(packed, packed.phi, np.empty_like(phi)), read_bands(packed, bound, np.empty_like(phi))


@pytest.mark.parametrize("isotherm", ISOTHERMS)
def test_equals_a_plain_loop(isotherm: str) -> None:
    cells = resisted(11, 14)
    phi, fixed = start(cells)
    scale, steps = 0.95 / largest_sum(face_values(cells)), 2 * LEVELS + 2
    exact = phi, fixed
    for _ in range(steps):
        exact = plain_step(*exact, cells, scale, 0.05, isotherm)
    found = run(phi, fixed, cells, scale, 0.05, isotherm, steps)
    for a, b in zip(found, exact, strict=True):
        assert np.abs(a - b).max() < 1e-12
    assert (exact[1].max() > 0.0) == (isotherm != "nothing")


def test_fibre_takes_no_more_than_there_is_however_fast_it_takes() -> None:
    """At a rate of 5, fibre with room would take five times the mobile dye; none is lost, and no cell owes any."""
    cells = replace(resisted(11, 14), v_max=10.0)
    phi, fixed = start(cells)
    scale = 0.95 / largest_sum(face_values(cells))
    found = run(phi, fixed, cells, scale, 5.0, "langmuir", LEVELS)
    exact = phi, fixed
    for _ in range(LEVELS):
        exact = plain_step(*exact, cells, scale, 5.0, "langmuir")
    assert found[0].min() >= 0.0 and found[1].max() > 0.0
    assert found[0].sum() + found[1].sum() == pytest.approx(phi.sum(), rel=1e-13)
    for a, b in zip(found, exact, strict=True):
        assert np.abs(a - b).max() < 1e-12


def test_without_a_limit_that_binds_it_is_diffusion_to_the_last_bit() -> None:
    cells = replace(random_cells(23, 30), v_max=1e6)
    phi = np.random.default_rng(5).random(cells.fibre.shape) * (cells.porosity > 0.0)
    fixed = np.zeros_like(phi)
    faces = face_values(cells)
    scale = 0.9 / largest_sum(faces)
    assert np.array_equal(run(phi, fixed, cells, scale, 0.0, "nothing", 20)[0], spread(phi, faces, scale, 20))
    assert np.abs(spread(phi, faces, scale, 1) - step_plainly(phi, cells, scale)).max() < 1e-14


def test_what_cannot_empty_a_cell_has_the_bits_of_what_could() -> None:
    """Factors of what flows out are 1 where they are not asked for."""
    cells = resisted(23, 30)
    phi, fixed = start(cells)
    scale = 0.98 / largest_sum(face_values(cells))
    asked, not_asked = (run(phi, fixed, cells, scale, 0.05, "langmuir", 50, steepest=most) for most in (2.0, 1.0))
    assert all(map(np.array_equal, asked, not_asked))


@pytest.mark.parametrize("isotherm", ["partition", "langmuir"])
def test_bands_and_passes_change_no_bit(isotherm: str) -> None:
    cells = resisted(47, 33)
    phi, fixed = start(cells)
    scale, steps = 0.95 / largest_sum(face_values(cells)), 3 * LEVELS + 1
    whole = run(phi, fixed, cells, scale, 0.02, isotherm, steps)
    singly = phi, fixed
    for _ in range(steps):
        singly = run(*singly, cells, scale, 0.02, isotherm, 1)
    for other in (*(run(phi, fixed, cells, scale, 0.02, isotherm, steps, n) for n in (2, 3, 5)), singly):
        assert all(map(np.array_equal, other, whole))


@pytest.mark.parametrize("isotherm", ISOTHERMS)
def test_dye_is_kept_and_no_cell_holds_less_than_none_or_more_than_it_can(isotherm: str) -> None:
    cells, steps = resisted(40, 37), 3000
    phi, fixed = start(cells)
    mobile, bound = run(phi, fixed, cells, 1.0 / largest_sum(face_values(cells)), 0.03, isotherm, steps, 2)
    assert abs(mobile.sum() + bound.sum() - phi.sum()) <= 1e-13 * np.sqrt(steps) * phi.sum()
    assert mobile.min() >= 0.0 and bound.min() >= 0.0
    assert (mobile <= cells.mobile_room).all() and (bound <= cells.fixed_room).all()
