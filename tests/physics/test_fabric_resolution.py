"""A finer mesh of the same fabric hangs the same."""

from __future__ import annotations

import numpy as np
import pytest
from hanging_sheets import GRAVITY, hanging_drop, hanging_sheet, sunk

from nuno_cloth.fabrics.presets import PRESETS
from nuno_cloth.models.skirt import Skirt, SkirtConfig
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_schemas.fabric import State
from nuno_schemas.system import System

NUMBERS = (24, 32, 128)
"""Vertices along each side of the sheets that are compared."""


@pytest.mark.quick(preset=["denim"])
@pytest.mark.parametrize("preset", PRESETS)
def test_a_finer_sheet_hangs_the_same(preset: str) -> None:
    """The bar is 5 % from 24 x 24 to 128 x 128; what is left is 0.2 %, the sheet's border."""
    drops = np.array([hanging_drop(preset, n) for n in NUMBERS])
    assert np.ptp(drops) < 0.003 * drops.min()


@pytest.mark.quick(n=[24])
@pytest.mark.parametrize("n", [24, 96])
def test_a_simulation_settles_where_statics_say(n: int) -> None:
    """Started unstretched and damped near critically, the sheet comes to rest at the static drop.

    Lengthwise its slowest motion is a quarter wave of speed sqrt(C / rho): omega = (pi / 2 L) sqrt(C / rho).
    """
    fabric, material = hanging_sheet("interlock", n), PRESETS["interlock"]
    slowest = 0.5 * np.pi * np.sqrt(material.warp / material.density)
    system = System(fabric, np.array([0.0, -GRAVITY, 0.0]), 2 * slowest)
    solver, state = SymplecticEuler(), State(fabric.position.copy(), np.zeros_like(fabric.position))
    dt = 0.7 * solver.limit(solver.Config(), system, state).dt
    memory = solver.prepare(solver.Config(), system, state)
    report = solver.advance(system, state, memory, None, int(20 / slowest / dt), dt)
    assert report.status == "ok"
    assert sunk(fabric, state.x) == pytest.approx(hanging_drop("interlock", n), rel=1e-4)


def test_the_drop_is_that_of_a_hanging_sheet() -> None:
    """Between rho g L^2 / (3 C) with the width held and with free sides."""
    material = PRESETS["swimwear"]
    free = material.warp - material.shear**2 / material.weft
    load = material.density * GRAVITY / 3
    assert load / material.warp < hanging_drop("swimwear", 32) < load / free * 1.02


@pytest.mark.parametrize("fullness", [1.0, 1.4])
def test_a_finer_skirt_is_the_same_cloth(fullness: float) -> None:
    """Mass, area and the stiffness of whole rows do not depend on the mesh."""

    def sums(rows: int, columns: int) -> list[float]:
        fabric = Skirt().build(SkirtConfig(rows=rows, columns=columns, fullness=fullness, pleats=8), None, 0)  # type: ignore[arg-type]
        assert fabric.springs is not None and fabric.hinges is not None
        pairs = fabric.springs.pairs()
        across = fabric.springs.per_spring(fabric.springs.rest)[pairs[:, 0] // columns == pairs[:, 1] // columns]
        hem = across.reshape(rows, columns)[-1].sum()
        k, rest = fabric.springs.per_spring(fabric.springs.k), fabric.springs.per_spring(fabric.springs.rest)
        return [float(fabric.mass.sum()), float(hem), float((k * rest**2).sum())]

    assert sums(49, 192) == pytest.approx(sums(25, 96), rel=5e-3)
