"""Pressure of a knit: Laplace's law on a cylinder, balance of forces, and a body that bears it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nets import accelerations, make_system
from yarn_nets import chains, reference

from nuno_kernels.forces.yarn_tension import link_tensions, point_forces
from nuno_knit.knit import Knit, KnitConfig
from nuno_knit.pressure import Pressure, PressureConfig, shares
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State

FILES: Any = None
K, SPACING = 40.0, (0.01, 0.012)


def tube(wales: int, stretch: float = 1.5, lengthwise: float = 1.0, mu: float = 0.0, **more: Any) -> Fabric:
    yarn = {"name": "one", "k": K, "mu": mu, "density": "100 dtex", **more}
    config = KnitConfig.model_validate(
        {
            "form": "tube",
            "wales": wales,
            "courses": 12,
            "spacing": SPACING,
            "stretch": [stretch, lengthwise],
            "yarns": [yarn],
        }
    )
    return Knit().build(config, FILES, 0)


def pressures(fabric: Fabric, x: Float, **config: Any) -> tuple[Float, dict[str, float]]:
    made = Pressure().apply(PressureConfig(**config), fabric, State(x, 0.0 * x), None)
    return made.arrays["pressure"], dict(made.facts)


@pytest.mark.parametrize("mu", [0.0, 0.2])
@pytest.mark.parametrize("wales", [6, 24, 96])
def test_hoops_on_a_cylinder_follow_laplaces_law(wales: int, mu: float) -> None:
    """p = T / (r w), w the distance of the rows; what legs take over from arcs runs along the axis."""
    fabric = tube(wales, mu=mu)
    radius = float(np.hypot(fabric.position[0, 0], fabric.position[0, 2]))
    tension = K * 0.5 * SPACING[0]
    _, facts = pressures(fabric, fabric.position)
    expected = tension / (radius * SPACING[1])
    for name in ("min", "mean", "max"):
        assert facts[name] == pytest.approx(expected, rel=1e-9)


def test_uneven_rows_and_an_ellipse_follow_it_within_two_percent() -> None:
    """p = T kappa / w at every point: kappa of an ellipse, w the mean distance of a row's neighbours."""
    fabric, (a, b) = tube(96), (0.5, 0.35)
    fine = np.linspace(0.0, 2.0 * np.pi, 100_001)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(a * np.sin(fine)), np.diff(b * np.cos(fine))))])
    angle = np.interp(np.arange(192) / 192 * along[-1], along, fine)
    heights = np.cumsum(SPACING[1] * (1.0 + 0.2 * np.sin(np.arange(13))))
    x = np.empty((13, 192, 3))
    x[..., 0], x[..., 2], x[..., 1] = a * np.sin(angle), b * np.cos(angle), heights[:, None]
    found, _ = pressures(fabric, x.reshape(-1, 3))
    tension = K * (along[-1] / 192 - SPACING[0])
    curvature = a * b / ((a * np.cos(angle)) ** 2 + (b * np.sin(angle)) ** 2) ** 1.5
    expected = tension * curvature[None] / np.gradient(heights)[:, None]
    assert np.abs(found.reshape(13, 192) / expected - 1.0)[1:-1].max() < 0.02


def test_pressure_and_area_bear_the_whole_inward_force() -> None:
    fabric = tube(20, lengthwise=1.2, mu=0.2)
    x = fabric.position + 2e-4 * np.random.default_rng(1).standard_normal(fabric.position.shape)
    found, _ = pressures(fabric, x)
    assert fabric.cells is not None
    area, normal, _ = shares(x, fabric.cells)
    force = point_forces(fabric, x)
    np.testing.assert_allclose(found * area, -(force * normal).sum(axis=1), rtol=1e-12, atol=1e-15)
    whole = 2.0 * np.pi * np.hypot(*fabric.position[0, [0, 2]]) * 12 * SPACING[1] * 1.2
    assert area.sum() == pytest.approx(whole, rel=0.02)


def test_normals_point_outwards_and_flat_knits_press_on_nothing() -> None:
    fabric = tube(20)
    assert fabric.cells is not None
    _, normal, inner = shares(fabric.position, fabric.cells)
    assert (normal[:, [0, 2]] * fabric.position[:, [0, 2]]).sum(axis=1).min() > 0.0
    assert inner.sum() == 11 * 40
    config = KnitConfig.model_validate({"wales": 5, "courses": 6, "stretch": [1.5, 1.2], "yarns": ["nylon", "support"]})
    panel = Knit().build(config, FILES, 0)
    found, facts = pressures(panel, panel.position)
    assert np.abs(found).max() == 0.0 and facts["max"] == 0.0


def test_places_are_averages_of_their_bands() -> None:
    """A tube that is tighter above: each place has what its rows have, and one beyond the knit is left out."""
    fabric = tube(20)
    x = fabric.position.copy()
    x[x[:, 1] > 0.0] *= np.array([1.2, 1.0, 1.2])
    found, facts = pressures(fabric, x, heights={"low": -0.03, "high": 0.03, "knee": 1.0}, band=0.02)
    rows = np.repeat(np.arange(13), 40)
    for name, height in (("low", -0.03), ("high", 0.03)):
        there = np.abs(x[:, 1] - height) <= 0.01
        assert there.sum() in (40, 80) and (rows[there] > 0).all()
        assert facts[name] == pytest.approx(found[there].mean(), rel=1e-6)
    assert facts["high"] > 1.2 * facts["low"] > 0.0 and "knee" not in facts


@pytest.mark.parametrize("locks", [False, True])
def test_tensions_are_those_of_the_kernels(locks: bool) -> None:
    fabric = chains(60, 40, 1)
    assert fabric.springs is not None
    if locks:
        n = fabric.springs.number
        springs = replace(fabric.springs, lock=np.full(n, 0.1), k_lock=2.0 * fabric.springs.k)
        fabric = replace(fabric, springs=springs)
    x = fabric.position
    force = point_forces(fabric, x)
    assert np.abs(force - reference(fabric, x, 0.0 * x)).max() < 1e-12 * np.abs(force).max()
    assert np.abs(force - accelerations(make_system(fabric), x, 0.0 * x)).max() < 1e-12 * np.abs(force).max()
    assert len(link_tensions(fabric, x)) == fabric.springs.number if fabric.springs else False


def test_what_has_no_cells_is_refused() -> None:
    fabric = chains(60, 40, 1)
    with pytest.raises(BadInput, match="cells"):
        pressures(fabric, fabric.position)
