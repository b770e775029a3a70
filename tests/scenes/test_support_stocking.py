"""The stocking of nylon and elastane: at rest, with the pressure of Laplace's law and of hosiery, from any start."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from nuno.collision.bodies import build_bodies
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno.simulation.yarns import find_pressure, named_heights
from nuno_kernels.forces.yarn_tension import lengths, link_tensions
from nuno_knit.pressure import shares
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

COARSE = (
    "objects.0.model.wales=20", "objects.0.model.courses=45", "objects.0.model.yarns.0.ea=132 N",
    "objects.0.model.yarns.1.ea=0.96 N", "objects.0.model.yarns.1.ea_lock=132 N", "bodies.0.collider.resolution=48",
)  # fmt: skip
"""Half as many courses, each of twice as many yarns."""
IMPLICIT = (
    "solver={plugin: implicit_euler, dt: 100 ms, residual: 1e-6}", "damping=0", "objects.0.model.frequency=10000 1/s",
)  # fmt: skip


@cache
def fit(*overrides: str) -> Simulation:
    return settle("knit/stocking-support", *overrides)


def settle(scene: str, *overrides: str) -> Simulation:
    loaded = scene_file.read(shipped.find(scene), overrides)
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    simulation = Simulation(loaded, bodies.geometry, poses, 1)
    while not simulation.finished:
        assert simulation.advance(poses, poses).report.status == "ok"
    assert simulation.balanced
    return simulation


def pressures(simulation: Simulation) -> dict[str, float]:
    found = find_pressure(simulation.loaded, simulation.fabric, simulation.state.x).facts
    return {place: found[place] for place in named_heights(simulation.loaded)}


def membrane(simulation: Simulation) -> tuple[Float, Float, Float]:
    """Height of each row, its mean pressure, and Laplace's law for it, (rows,): p = T_h 2 pi / G - T_m G'' / (2 pi).

    T_h and T_m are the knit's tension per length round the limb and along it, by links' tension and direction; G is the
    girth along the limb. A section's curvatures sum up to 2 pi, whatever its shape, and -G'' / (2 pi) is the mean
    curvature along the limb, as of a body of revolution.
    """
    fabric, x = simulation.fabric, simulation.state.x
    assert fabric.springs is not None and fabric.cells is not None
    columns = 2 * simulation.loaded.models[0].config.model_dump()["wales"]
    grid = x.reshape(-1, columns, 3)
    area, normal, _ = shares(x, fabric.cells)
    around = (np.roll(grid, -1, axis=1) - np.roll(grid, 1, axis=1)).reshape(-1, 3)
    pairs, (d, length), tension = fabric.springs.pairs(), lengths(fabric.springs, x), link_tensions(fabric, x)

    def unit(a: Float) -> Float:
        return np.asarray(a / np.linalg.norm(a, axis=1, keepdims=True))

    hoop = unit(unit(around)[pairs].sum(axis=1))
    along = np.cross(unit(normal[pairs].sum(axis=1)), hoop)
    row_area = area.reshape(-1, columns).sum(axis=1)

    def per_length(way: Float) -> Float:
        work = 0.5 * tension * (d * way).sum(axis=1) ** 2 / length
        return np.asarray(sum(np.bincount(end // columns, work, len(grid)) for end in pairs.T) / row_area)

    girth = np.linalg.norm(np.roll(grid, -1, axis=1) - grid, axis=2).sum(axis=1)
    place = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(grid, axis=0), axis=2).mean(axis=1))])
    bend = np.zeros(len(grid))
    slope = np.diff(girth) / np.diff(place)
    bend[1:-1] = np.diff(slope) / (0.5 * (place[2:] - place[:-2]))
    law = per_length(hoop) * 2.0 * np.pi / girth - per_length(along) * bend / (2.0 * np.pi)
    pressure = np.asarray(find_pressure(simulation.loaded, fabric, x).arrays["pressure"])
    mean = (pressure * area).reshape(-1, columns).sum(axis=1) / row_area
    return grid[..., 1].mean(axis=1), mean, law


@pytest.mark.full
def test_it_comes_to_rest_and_presses_as_laplaces_law_says() -> None:
    simulation = fit()
    height, pressure, law = membrane(simulation)
    on_leg = (height >= named_heights(simulation.loaded)["ankle"]) & (np.arange(len(height)) < len(height) - 2)
    assert on_leg.sum() > 70
    assert np.abs(pressure / law - 1.0)[on_leg].max() < 0.02


@pytest.mark.full
def test_it_presses_as_compression_class_1() -> None:
    """RAL-GZ 387: 2.4 to 2.8 kPa at the ankle, half to 0.8 of it at the calf, 0.2 to 0.6 at the thigh."""
    found = pressures(fit())
    ankle = found["ankle"]
    assert 2400.0 <= ankle <= 2800.0
    assert 0.5 <= found["calf"] / ankle <= 0.8 and 0.2 <= found["thigh"] / ankle <= 0.6
    assert ankle > found["calf"] > found["knee"] > found["thigh"]


@pytest.mark.full
def test_a_stocking_knitted_to_shape_presses_less_up_the_leg() -> None:
    found = pressures(settle("knit/stocking-compression"))
    assert found["ankle"] > 1.2 * found["calf"] and found["calf"] > 1.2 * found["thigh"]


@pytest.mark.full
@pytest.mark.parametrize(
    "overrides",
    [
        ("bodies.0.friction=0.15",), ("bodies.0.friction=0.5",), ("objects.0.model.over.clearance=1 mm",),
        ("objects.0.model.over.clearance=15 mm",), ("solver={plugin: leapfrog, dt: auto}",), ("solver.dt=4 ms",),
        IMPLICIT,
    ],
)  # fmt: skip
def test_its_pressure_hardly_depends_on_start_solver_and_friction(overrides: tuple[str, ...]) -> None:
    one, other = pressures(fit(*COARSE)), pressures(fit(*COARSE, *overrides))
    assert abs(other["ankle"] / one["ankle"] - 1.0) < 0.06
    assert all(abs(other[place] / one[place] - 1.0) < 0.03 for place in ("calf", "knee", "thigh"))


def test_a_yarn_without_stiffness_is_named_by_its_line_and_field(tmp_path: Path) -> None:
    lines = shipped.find("knit/stocking-support").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if "name: support" in line)
    lines[at] = "        - {name: support, density: 660 dtex}"
    path = tmp_path / "soft.yaml"
    path.write_text("\n".join(lines))
    with pytest.raises(BadInput, match="give ea") as found:
        scene_file.read(path)
    assert f"soft.yaml:{at + 1}: objects[0].model.yarns[1]" in str(found.value)
