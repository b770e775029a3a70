"""Compiled forces of other packages that the contributors' page shows: fused into the step as nuno's own are."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from foreign_packages import Packages, packages, shown
from scenes import write_scene

import nuno
from nuno_schemas.fabric import Float

__all__ = ["packages"]

PLAIN = """

class Plain(Magnet):
    name = "plain"

    def prepare(self, config, fabric, seed):
        def pull(x, v, t, out):
            out -= config.stiffness * x

        return Term("plain", pull)
"""


def run(folder: Path, force: str, solver: str, **changed: object) -> nuno.Result:
    forces = [{"plugin": force, "stiffness": 0.02}, {"plugin": "particle_wind", "strength": 1e-3}]
    fields = {"forces": forces, "duration": 0.1, "solver": {"plugin": solver, "dt": 2e-4}} | changed
    return nuno.run(write_scene(folder, **fields))


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", ["symplectic_euler", "implicit_euler"])
def test_it_does_what_the_same_force_does_in_python(packages: Packages, tmp_path: Path, solver: str) -> None:
    packages.add_shown("magnets", PLAIN, "plain = magnets:Plain")
    fused, plain = (run(tmp_path, force, solver) for force in ("magnet", "plain"))
    still = run(tmp_path, "magnet", solver, forces=[])
    moved: Float = fused.x - still.x
    assert np.abs(moved).max() > 1e-4
    assert np.abs(fused.x - plain.x).max() < (1e-12 if solver == "symplectic_euler" else 1e-6)


def test_its_energy_is_in_the_balance(packages: Packages, tmp_path: Path) -> None:
    """Undamped, weightless: the sum of all kinds changes by what a step of first order loses, not by the pull's."""
    packages.add_shown("magnets", PLAIN, "plain = magnets:Plain")
    forces = [{"plugin": "magnet", "stiffness": 0.02}]
    first, last = run(tmp_path, "magnet", "symplectic_euler", forces=forces, gravity=[0, 0, 0]).report["energy"]
    change = abs(last["magnet"] - first["magnet"])
    assert change > 0.0
    assert abs(sum(last.values()) - sum(first.values())) < 0.05 * change


LATE = """
from typing import NamedTuple
from nuno_kernels.forces.vertex import vertex_force

@vertex_force("late")
class Late(NamedTuple):
    strength: float

    def force(self, t):
        return (self.strength if t > 0.05 else 0.0), 0.0, 0.0

class LateGust:
    name, Config = "late", Config

    def prepare(self, config, fabric, seed):
        return Term("late", (Late(1e-3),))
"""


def test_a_force_that_begins_later_finds_cloth_that_stands_still(packages: Packages, tmp_path: Path) -> None:
    """Frames that change nothing are not left out where a force depends on the time."""
    packages.add("gusts", LATE, "late = gusts:LateGust")
    still, moved = (run(tmp_path, "late", "symplectic_euler", forces=forces, gravity=[0, 0, 0], duration=duration).x
                    for forces, duration in (([], 0.1), ([{"plugin": "late"}], 0.1)))  # fmt: skip
    assert np.abs(moved - still)[1:, 0].min() > 1e-6


@pytest.mark.full
@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core")
def test_it_gives_equal_bytes_for_one_and_two_threads(packages: Packages, tmp_path: Path) -> None:
    packages.add_shown("magnets", PLAIN, "plain = magnets:Plain")
    sheet = {"plugin": "sheet", "size": [0.5, 0.5], "resolution": [66, 66], "fabric": "denim"}
    fields = {"objects": [{"name": "sheet", "model": sheet}], "forces": [{"plugin": "magnet", "stiffness": 0.02}]}
    scene = write_scene(tmp_path, duration=0.02, solver={"plugin": "symplectic_euler", "dt": 5e-5}, **fields)
    one, two = (nuno.run(scene, threads=threads) for threads in (1, 2))
    assert one.report["threads"].startswith("1 thread") and two.report["threads"].startswith("2 threads")
    assert one.digest == two.digest


@pytest.mark.full
def test_what_changes_in_it_is_compiled_anew(packages: Packages, tmp_path: Path) -> None:
    """By the next process: the kernel that is kept calls it by its type alone, and no name leads there."""
    packages.add_shown("magnets", PLAIN, "plain = magnets:Plain")
    record, source = tmp_path / "run.mcap", packages.folder / "magnets" / "magnets.py"
    scene = write_scene(tmp_path, duration=0.1, forces=[{"plugin": "magnet", "stiffness": 0.02}])
    command = [sys.executable, "-m", "nuno", "run", str(scene), "--no-view", "--record", str(record)]
    ends = []
    for sign in ("-", "+"):
        source.write_text(shown("magnets").replace("return -self", f"return {sign}self"))
        subprocess.run(command, env=os.environ | {"PYTHONPATH": str(source.parent)}, check=True, timeout=120)
        with nuno.open(record) as recording:
            ends.append(recording.last_checkpoint().x)
    assert np.abs(ends[0] - ends[1]).max() > 1e-4
    write_scene(tmp_path, duration=0.1)
    subprocess.run(command, check=True, timeout=120)  # the package is gone, and what was kept of it hinders nobody


STITCHES = {"plugin": "stitches", "pairs": [[0, 5], [1, 4]], "stiffness": 2e3}
LOOSE = """
from typing import Annotated, NamedTuple

from nuno_kernels import kernel
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import register
from nuno_schemas.fabric import Int


class Loose(NamedTuple):
    partner: Annotated[Int, "n"]
    stiffness: float


@kernel
def add_stitches(loose, block, origin, x, v, force):
    for c in range(min(BLOCK, x.shape[1] - origin)):
        for row in range(3):
            force[row, c] += loose.stiffness * (x[row, loose.partner[origin + c]] - x[row, origin + c])


register(Loose, name="loose", block=add_stitches)


class LooseStitches(Stitches):
    name = "loose"

    def prepare(self, config, fabric, seed):
        pairs, partner = np.array(config.pairs, np.int32).T, np.arange(fabric.number, dtype=np.int32)
        partner[pairs[0]], partner[pairs[1]] = pairs[1], pairs[0]
        return Term("loose", (Loose(partner, config.stiffness),))
"""
"""The same force without matrix and constraints."""


def sewn(folder: Path, plugin: str, solver: str, dt: float, **settings: object) -> nuno.Result:
    forces = [STITCHES | {"plugin": plugin}]
    return nuno.run(write_scene(folder, forces=forces, duration=0.1, solver={"plugin": solver, "dt": dt} | settings))


@pytest.mark.full
def test_with_its_matrix_newton_takes_fewer_steps_to_the_same_end(packages: Packages, tmp_path: Path) -> None:
    packages.add_shown("stitches", LOOSE, "loose = stitches:LooseStitches")
    one, other = (sewn(tmp_path, plugin, "implicit_euler", 5e-3).report for plugin in ("stitches", "loose"))
    assert 5 * one["totals"]["newton_steps"] < other["totals"]["newton_steps"]
    assert one["totals"]["halvings"] == 0 < other["totals"]["halvings"]
    assert "without a matrix, by differences: loose" in other["threads"]
    assert "without a matrix" not in one["threads"]
    ends = [sewn(tmp_path, plugin, "implicit_euler", 1e-4, residual=1e-9).x for plugin in ("stitches", "loose")]
    assert np.abs(ends[0] - ends[1]).max() < 1e-7


@pytest.mark.full
def test_xpbd_solves_for_its_constraints_at_any_step(packages: Packages, tmp_path: Path) -> None:
    """To where backward Euler's step ends; without them the step is limited as an explicit solver's is."""
    packages.add_shown("stitches", LOOSE, "loose = stitches:LooseStitches")
    one, other = sewn(tmp_path, "stitches", "xpbd", 1e-3, iterations=100), sewn(tmp_path, "loose", "xpbd", 1e-4)
    exact = sewn(tmp_path, "stitches", "implicit_euler", 1e-3, residual=1e-9)
    assert np.abs(one.x - exact.x).max() < 1e-7
    assert one.report["dt_limit"] is None
    assert other.report["dt_limit"] < 5e-3
    assert "without a constraint, as at the start of each step: loose" in other.report["threads"]
    assert "without a constraint" not in one.report["threads"]
