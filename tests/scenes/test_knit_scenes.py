"""The knit paper's checks: how fast the stitches settle, where, and how they differ by direction."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_integrators.implicit import linear_solve as solver
from nuno_integrators.implicit.plugin import ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.step.acceleration import evaluate
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System

LEGS = 90
"""Of 9 courses and 10 columns; arcs follow."""


def simulate(name: str, frames: int) -> tuple[Simulation, list[Float]]:
    """Positions after each frame; a frame is a step."""
    simulation = Simulation(scene_file.read(shipped.scenes("knit")[f"knit/{name}"]), None, None, 1)
    assert simulation.steps == 1
    positions = []
    for _ in range(frames):
        assert simulation.advance(None, None).report.status == "ok"
        positions.append(simulation.state.x.copy())
    return simulation, positions


def balance(system: System) -> Float:
    """(n, 3) where all forces vanish, by Newton's method with a derivative taken by differences."""
    fabric, packed = system.fabric, pack(system)
    free = np.flatnonzero(np.repeat(~fabric.pinned, 3))
    x = fabric.position.reshape(-1).copy()

    def force(x: Float) -> Float:
        out = np.zeros((3, fabric.number))
        evaluate(to_rows(x.reshape(-1, 3)), 0.0 * out, 0.0, out, packed, None)
        return np.asarray((out.T * fabric.mass[:, None]).reshape(-1)[free])

    for _ in range(12):
        slope = np.empty((free.size, free.size))
        for column, i in enumerate(free):
            ahead, behind = x.copy(), x.copy()
            ahead[i] += 1e-6
            behind[i] -= 1e-6
            slope[:, column] = (force(ahead) - force(behind)) / 2e-6
        x[free] -= np.linalg.solve(slope, force(x))
    assert np.abs(force(x)).max() < 1e-12
    return x.reshape(-1, 3)


def test_the_panel_settles_in_a_hundred_steps() -> None:
    simulation, positions = simulate("stitch-10x10", 100)
    assert simulation.fabric.number == 100 and simulation.fabric.pinned.sum() == 36
    rest = balance(simulation.system)
    left = np.linalg.norm(positions[-1] - rest) / np.linalg.norm(simulation.fabric.position - rest)
    assert 0.01 < left < 0.05


def test_it_comes_to_rest_where_newton_says() -> None:
    simulation, positions = simulate("stitch-10x10", 1400)
    assert np.abs(positions[-1] - balance(simulation.system)).max() < 1e-8


@pytest.mark.parametrize(("patience", "most"), [(solver.PATIENCE, 12), (0.0, 7)], ids=["gradients", "factorised"])
def test_newton_finds_rest_in_few_steps(monkeypatch: pytest.MonkeyPatch, patience: float, most: int) -> None:
    """One step of 1e10 s, to a residual of 1e-12: with the matrix of links alone it takes 28."""
    monkeypatch.setattr(solver, "PATIENCE", patience)
    system, plugin = simulate("stitch-10x10", 0)[0].system, ImplicitEuler()
    state = State(system.fabric.position.copy(), system.fabric.velocity.copy())
    memory = plugin.prepare(plugin.Config(residual=1e-12, most_iterations=100), system, state)
    report = plugin.advance(system, state, memory, None, 1, 1e10)
    assert report.status == "ok" and report.totals["newton_steps"] <= most
    assert np.abs(state.x - balance(system)).max() < 1e-10


@cache
def settled(direction: str) -> tuple[Fabric, Float]:
    simulation, positions = simulate(f"stitch-stretch-{direction}", 600)
    assert np.abs(positions[-1] - positions[-2]).max() < 1e-4
    return simulation.fabric, positions[-1]


def elongation(fabric: Fabric, x: Float, k: float, arcs: bool) -> float:
    """Mean |d| / L - 1 of the legs or the arcs of stiffness k."""
    assert fabric.springs is not None
    pairs = fabric.springs.pairs()
    stretch = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / fabric.springs.rest - 1.0
    mine = (fabric.springs.k == k) & ((np.arange(len(pairs)) >= LEGS) == arcs)
    return float(stretch[mine].mean())


@pytest.mark.parametrize(("direction", "arcs"), [("course", True), ("wale", False)])
def test_soft_yarn_takes_the_stretch_along_it(direction: str, arcs: bool) -> None:
    """Links of the two yarns are in series both ways, and the soft ones open by several times the stiff ones."""
    fabric, x = settled(direction)
    assert elongation(fabric, x, 1.0, arcs) > 0.5
    assert elongation(fabric, x, 1.0, arcs) > 4.0 * elongation(fabric, x, 10.0, arcs) > 0.0


def zigzag(x: Float) -> float:
    """Mean second difference to the side, in rest lengths, along the middle four columns: 0 of a straight wale."""
    grid = x.reshape(10, 10, 3)
    return float(np.abs(np.diff(grid[:, 3:7, 0], n=2, axis=0)).mean())


def test_stitches_deform_differently_by_direction() -> None:
    """Figure 9. Stretched along the courses, soft arcs lie above stiff ones and the wales zigzag; along the wales
    whole courses open and the wales stay straight.
    """
    (_, along), (_, up) = settled("course"), settled("wale")
    assert zigzag(along) > 5.0 * zigzag(up)
    heights = np.diff(up.reshape(10, 10, 3)[:, 3:7, 1], axis=0).mean(axis=1)
    assert (heights[0::2] > 1.5 * heights[1::2].max()).all()
    heights = np.diff(along.reshape(10, 10, 3)[1:-1, 3:7, 1], axis=0).mean(axis=1)
    assert heights.max() < 1.5 * heights.min()
