"""Virtual KES tests: a preset's measures come back from its springs and hinges, at any mesh."""

from __future__ import annotations

import numpy as np
import pytest

from nuno_cloth.fabrics.kes import TURN, bend, elastic_energy, hinge_energy, measure, relax, spring_energy, stretch
from nuno_cloth.fabrics.material import HandSet, Measured
from nuno_cloth.fabrics.presets import PRESETS
from nuno_cloth.models.sheet import Sheet, SheetConfig
from nuno_schemas.fabric import Fabric, Float

SIZE = (0.04, 0.04)
RESOLUTIONS = {(9, 9): (0.05, 0.05), (13, 9): (0.05, 0.04), (6, 9): (0.04, 0.05)}


def build(resolution: tuple[int, int], size: tuple[float, float], fabric: str | HandSet = "denim") -> Fabric:
    return Sheet().build(SheetConfig(resolution=resolution, size=size, fabric=fabric), None, 0)  # type: ignore[arg-type]


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_presets_give_their_own_measures(preset: str, resolution: tuple[int, int]) -> None:
    """Tension and shear are exact but for geometry, of order strain^2 C / G; bending but for 1 - cos."""
    wanted, got = PRESETS[preset], measure(build(resolution, size := RESOLUTIONS[resolution], preset), resolution, size)
    for name in ("warp", "weft", "density"):
        assert getattr(got, name) == pytest.approx(getattr(wanted, name), rel=1e-7)
    geometry = 1e-8 * max(wanted.warp, wanted.weft) / wanted.shear
    assert got.shear == pytest.approx(wanted.shear, rel=1e-7 + geometry)
    for name in ("bend_warp", "bend_weft"):
        assert getattr(got, name) == pytest.approx(getattr(wanted, name) * (1 - TURN**2 / 12), rel=1e-6)


@pytest.mark.parametrize("preset", ["interlock", "trousers"])
def test_free_sides_lose_what_narrowing_gives(preset: str) -> None:
    """Long specimens with free sides approach C - G^2 / C', the modulus that is left."""
    material = PRESETS[preset]
    piece = build((5, 41), (0.02, 0.2), preset)
    expected = material.warp - material.shear**2 / material.weft
    got = stretch(piece, 41, 5, along=1, sides_held=False)
    assert expected < got < material.warp
    assert got == pytest.approx(expected, rel=0.03 * (material.shear / material.weft) ** 0.5)


def test_bending_is_the_minimum_whatever_the_start() -> None:
    """The cylinder is not only stationary: nothing that vertices do among themselves relieves it.

    Hinges on the edges of alternating triangles fail here: they keep three quarters.
    """
    piece = build((7, 7), (0.03, 0.03), "trousers")
    step, radius = 0.005, 0.0025 / np.sin(0.5 * TURN)
    angle = piece.position[:, 1] / step * TURN
    cylinder = np.stack([piece.position[:, 0], radius * np.sin(angle), radius * (np.cos(angle) - 1)], 1)
    held = np.zeros((7, 7), bool)
    held[[0, 1, -2, -1]] = True
    fixed = np.repeat(held.ravel()[:, None], 3, axis=1)
    noise = np.random.default_rng(1).normal(0, 1e-5, cylinder.shape) * ~fixed
    energy, _ = relax(piece, cylinder + noise, fixed)
    assert energy == pytest.approx(elastic_energy(piece, cylinder)[0], rel=1e-4)


@pytest.mark.parametrize("curvature", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.7, -0.4, 0.5)])
@pytest.mark.parametrize("resolution", [(6, 6), (7, 12)])
def test_hinges_are_an_orthotropic_plate(curvature: tuple[float, float, float], resolution: tuple[int, int]) -> None:
    """(Bf kx^2 + Bw ky^2 + 2 D t^2) / 2 per area, each curvature over what its hinges stand for."""
    kx, ky, t = (1e-4 * value for value in curvature)
    width, height = 0.6, 0.7
    piece, material = build(resolution, (width, height)), PRESETS["denim"]
    a, b = width / (resolution[0] - 1), height / (resolution[1] - 1)
    x, y = piece.position[:, 0], piece.position[:, 1]
    bent = np.stack([x, y, 0.5 * (kx * x * x + 2 * t * x * y + ky * y * y)], 1)
    twist = np.sqrt(material.bend_warp * material.bend_weft)
    weft, warp = material.bend_weft * kx**2 * (width - a) * height, material.bend_warp * ky**2 * width * (height - b)
    expected = 0.5 * (weft + warp + 2 * twist * t**2 * width * height)
    assert hinge_energy(piece, bent)[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("angle", [0.3, 0.785, 1.2])
def test_bending_has_no_grain(angle: float) -> None:
    """With equal yarns a cylinder costs the same whatever its axis, but for the half cells at borders
    that carry no moment (1/40 of the parts along the yarns).
    """
    rigidity, curvature = 1e-5, 1e-3
    fabric = Measured(preset="trousers", bend_warp=rigidity, bend_weft=rigidity)
    config = SheetConfig(resolution=(41, 41), size=(0.4, 0.4), fabric=fabric)
    piece = Sheet().build(config, None, 0)  # type: ignore[arg-type]
    c, s = np.cos(angle), np.sin(angle)
    bent = np.array(piece.position)
    bent[:, 2] = 0.5 * curvature * (bent[:, 0] * c + bent[:, 1] * s) ** 2
    whole = 0.5 * rigidity * curvature**2 * 0.4**2
    expected = whole * ((c**4 + s**4) * (1 - 1 / 40) + 2 * (c * s) ** 2)
    assert hinge_energy(piece, bent)[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("energy", [spring_energy, hinge_energy])
def test_forces_are_gradients(energy: object) -> None:
    piece = build((4, 5), (0.03, 0.04), "interlock")
    generator = np.random.default_rng(3)
    x = piece.position + generator.normal(0, 2e-3, piece.position.shape)
    direction = generator.normal(size=x.shape)
    assert callable(energy)

    def along(size: float) -> float:
        return float(energy(piece, x + size * direction)[0])

    h = 1e-6
    slope = (8 * (along(h) - along(-h)) - along(2 * h) + along(-2 * h)) / (12 * h)
    assert float((energy(piece, x)[1] * direction).sum()) == pytest.approx(slope, rel=1e-7)


def test_hand_set_constants_follow_the_mesh() -> None:
    """The papers' springs: what a spring constant amounts to doubles when the mesh gets finer."""
    fabric = HandSet(density=0.2, structural=(50.0, 50.0), shear=10.0, hinge=1e-6)
    coarse, fine = (measure(build((n, n), SIZE, fabric), (n, n), SIZE) for n in (9, 17))
    assert fine.shear == pytest.approx(coarse.shear, rel=1e-6)
    assert bend_per_cell(fine.bend_warp, 17) == pytest.approx(bend_per_cell(coarse.bend_warp, 9), rel=1e-6)


def bend_per_cell(rigidity: float, lines: int) -> float:
    """Hinges of the same constant on n lines of n - 1 cells: rigidity goes with n / (n - 1)."""
    return rigidity * (lines - 1) / lines


def test_papers_bending_springs_have_no_linear_stiffness() -> None:
    """A spring two apart stores an energy of the fourth order in the angle: halving the curvature
    leaves a quarter of the rigidity.
    """
    fabric = HandSet(density=0.2, structural=(1e4, 1e4), bending=(1e3, 1e3))
    config = SheetConfig(resolution=(9, 9), size=(0.08, 0.08), fabric=fabric)
    piece = Sheet().build(config, None, 0)  # type: ignore[arg-type]
    full, half = (spring_energy(piece, roll(piece, turn))[0] / turn**2 for turn in (0.02, 0.01))
    assert half / full == pytest.approx(0.25, rel=1e-3)
    assert bend(piece, 9, 9, along=1) > 0


def roll(piece: Fabric, turn: float) -> Float:
    step, radius = 0.01, 0.005 / np.sin(0.5 * turn)
    angle = piece.position[:, 1] / step * turn
    return np.stack([piece.position[:, 0], radius * np.sin(angle), radius * (np.cos(angle) - 1)], 1)
