"""What the contributors' page shows, in packages of others, as it is written there: solver, collider, contract."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
import yaml
from dye_scene import write_scene as write_dye_scene
from foreign_packages import POINTS, Packages, blocks, packages, shown
from scenes import write_scene

import nuno
from nuno.collision.messages import decode_geometry
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float
from nuno_schemas.messages import GEOMETRY, PENETRATION
from nuno_testing import bodies, integrators
from nuno_testing import checks as forces
from nuno_testing import integrators as rides
from nuno_testing.subject import Subject, make_subject

__all__ = ["packages"]


def sheet(vertices: int, **fields: Any) -> list[dict[str, Any]]:
    model = {"plugin": "sheet", "resolution": [vertices, vertices], "plane": "xz", "fabric": "interlock"} | fields
    return [{"name": "sheet", "model": model}]


def end(folder: Path, solver: str, dt: float, **fields: Any) -> nuno.Result:
    return nuno.run(write_scene(folder, solver={"plugin": solver, "dt": dt}, **fields))


@pytest.mark.parametrize(("solver", "order", "most"), [("heun3", 3, 1e-5), ("drift_kick", 2, 1e-4)])
def test_the_solvers_run_to_where_another_goes(
    packages: Packages, tmp_path: Path, solver: str, order: int, most: float
) -> None:
    packages.add_shown(solver)
    steps = ((solver, 1e-3), (solver, 5e-4), ("rk4", 1e-4))
    coarse, fine, exact = (end(tmp_path, name, dt, duration=0.2).x for name, dt in steps)
    first, second = (float(np.abs(x - exact).max()) for x in (coarse, fine))
    assert first < most
    assert 0.8 * 2**order < first / second < 1.2 * 2**order


@pytest.mark.full
@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core")
def test_the_solver_gives_equal_bytes_for_one_and_two_threads(packages: Packages, tmp_path: Path) -> None:
    packages.add_shown("heun3")
    fields = {"objects": sheet(66, size=[0.5, 0.5]), "duration": 0.02, "forces": [{"plugin": "wind"}]}
    scene = write_scene(tmp_path, solver={"plugin": "heun3", "dt": 5e-5}, **fields)
    one, two = (nuno.run(scene, threads=threads) for threads in (1, 2))
    assert one.report["threads"].startswith("1 thread") and two.report["threads"].startswith("2 threads")
    assert one.digest == two.digest


@pytest.mark.quick(contact=["sliding"])
@pytest.mark.parametrize("contact", ["penalty", "sliding"])
def test_the_collider_holds_up_a_sheet(packages: Packages, tmp_path: Path, contact: str) -> None:
    """What would be 1.2 m lower by now rests on the torus, around it on top, and is nowhere in it; what is recorded of
    the torus is a mesh of it, which is read without the plugin.
    """
    packages.add_shown("ring")
    bodies = yaml.safe_load(blocks("yaml")[0])["bodies"]
    bodies[0]["contact"] = {"plugin": contact, "margin": 0}
    fields = {"objects": sheet(25, size=[0.9, 0.9], centre=[0, 0.06, 0]), "damping": 1.0}
    found = end(tmp_path, "symplectic_euler", 5e-4, bodies=bodies, **fields)
    distance = torus(found.x)
    assert distance.min() > -1e-3  # penalty contact gives way by 0.1 mm; triangles are as much inside of the torus
    resting = found.x[(distance < 1e-3) & (found.x[:, 1] > 0.03)]
    assert len(resting) > 20
    assert np.abs(resting.mean(axis=0)).max() < 0.05
    assert found.x[:, 1].mean() > -0.2
    with nuno.open(found.path) as recording:
        depths = [recording.json(m.payload)["depth"] for m in recording.messages([PENETRATION.name])]
        shape = decode_geometry(next(recording.messages([GEOMETRY.name])).payload)
    assert max(depths) == pytest.approx(-min(distance.min(), 0.0), abs=2e-3)
    assert np.abs(torus(shape.vertices)).max() < 1e-12 and shape.fields == ()


def torus(x: Float) -> Float:
    return np.hypot(np.hypot(x[:, 0], x[:, 2]) - 0.3, x[:, 1]) - 0.05


def test_the_film_swings_at_the_frequency_of_a_membrane(packages: Packages, tmp_path: Path) -> None:
    """A square film of side L, tension T and density s, held at its rim: z goes as cos(pi sqrt(2 T / s) t / L)."""
    packages.add_shown("films")
    side, cells, density, tension = 0.2, 24, 0.1, 0.1
    u, w = np.meshgrid(*(np.linspace(0.0, 1.0, cells + 1),) * 2, indexing="ij")
    bulge = 1e-4 * np.sin(np.pi * u) * np.sin(np.pi * w)
    places = np.stack([side * u, side * w, bulge], axis=-1).reshape(-1, 3)
    number = np.arange(len(places)).reshape(u.shape) + 1
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    lines = [
        *(f"v {x!r} {y!r} {z!r}" for x, y, z in places.tolist()),
        *(f"f {i} {j} {k}" for i, j, k in faces.tolist()),
    ]
    (tmp_path / "square.obj").write_text("\n".join(lines) + "\n")
    fabric = {"density": density, "structural": 20, "shear": 20, "bending": 0, "damping": 0}
    rim = np.flatnonzero((u * (1.0 - u) * w * (1.0 - w)).ravel() == 0.0).tolist()
    model = {"plugin": "mesh", "file": "square.obj", "fabric": fabric, "pin": rim}
    third = float(2.0 / 3.0 * side / np.sqrt(2.0 * tension / density))  # of a period
    fields = {"objects": [{"name": "film", "model": model}], "forces": [{"plugin": "film", "tension": tension}]}
    still = {"duration": third, "frame_rate": 1.0 / third, "gravity": [0, 0, 0], "damping": 0}
    found = end(tmp_path, "leapfrog", 2e-4, **fields, **still)
    assert found.x[:, 2].max() < 1e-6
    assert found.x[:, 2] @ bulge.ravel() / (bulge**2).sum() == pytest.approx(-0.5, abs=0.01)


@pytest.mark.parametrize("module", ["ring", "temkin"])
def test_a_collider_and_an_isotherm_are_short(module: str) -> None:
    assert len(shown(module).splitlines()) <= 30


@pytest.mark.full
def test_the_lines_shown_hold_all_of_them_to_the_contract(packages: Packages, tmp_path: Path) -> None:
    for module in POINTS:
        packages.add_shown(module)
    (lines,) = (code for code in blocks("python") if "import contract" in code)
    (tmp_path / "test_mine.py").write_text(lines)
    path = os.pathsep.join(str(packages.folder / module) for module in POINTS)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path / "test_mine.py")]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, text=True, capture_output=True, timeout=900)
    assert done.returncode == 0, done.stdout
    assert "passed" in done.stdout and "failed" not in done.stdout


def test_a_loop_that_takes_more_room_than_there_is_is_refused(packages: Packages, tmp_path: Path) -> None:
    """Before its first step, which would overwrite memory of others."""
    group, point, _ = POINTS["drift_kick"]
    code = shown("drift_kick").replace("stages[0], stages[1]", "stages[0], stages[16]")
    packages.add("drift_kick", code, point, group=group, head="")
    with pytest.raises(RunFailed, match=r"'drift_kick' .* failed in limit: IndexError: index 16 is out of bounds"):
        end(tmp_path, "drift_kick", 1e-3, duration=0.2)


FAULTS: list[tuple[str, dict[str, object], str, str, Callable[[Subject], None]]] = [
    ("magnets", {"stiffness": 0.02}, "0.5 * self", "0.6 * self", forces.it_is_the_downhill_slope_of_its_energy),
    ("films", {"tension": 0.02}, "0.5 * film.tension / math", "0.6 * film.tension / math",
     forces.it_is_the_downhill_slope_of_its_energy),
    ("heun3", {}, "1 / 4, 0, 3 / 4", "1 / 2, 0, 1 / 2", integrators.the_error_falls_with_the_stated_order),
    ("drift_kick", {}, "add(u, v, dt / 2", "add(u, v, dt", integrators.the_error_falls_with_the_stated_order),
    ("drift_kick", {}, "stages[1]", "stages[16]", integrators.a_step_of_the_stated_limit_lets_nothing_grow),
    ("drift_kick", {}, "commit(x, v, (step + 1) / steps", "commit(x, v, 0.0",
     rides.all_is_the_same_on_a_body_that_moves_evenly),
    ("drift_kick", {}, "(step + 1 / 2) / steps, a", "0.0, a", rides.all_is_the_same_on_a_body_that_moves_evenly),
    ("drift_kick", {}, "commit(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)", "pass",
     rides.friction_slows_what_slides_and_holds_what_stands),
    ("drift_kick", {}, "add(u, v, dt / 2", "add(u, v, dt / (2 if p.threads is None else 2.0000001)",
     rides.any_number_of_threads_gives_the_same_bits),
    ("ring", {"radius": 0.3, "tube": 0.05}, "y * y", "2.0 * y * y",
     bodies.distances_are_those_to_points_of_its_surface),
    ("ring", {"radius": 0.3, "tube": 0.05}, "- self.tube\n",
     "- self.tube\n\n    def gradient(self, x, y, z):\n        return 0.0, 1.0, 0.0\n",
     bodies.distances_are_those_to_points_of_its_surface),
    ("ring", {"radius": 0.3, "tube": 0.05}, "(config.radius, ", "(config.radius - 1e-9 * id(object()), ",
     bodies.it_stands_on_the_joints_of_its_motion),
]  # fmt: skip


OF_LOOPS = (
    integrators.the_error_falls_with_the_stated_order,
    integrators.a_step_of_the_stated_limit_lets_nothing_grow,
)
"""Checks that find a loop's fault in the quick cases: each fault of a loop is a whole solver compiled."""


@pytest.mark.quick(wrong=[wrong for name, _, _, wrong, check in FAULTS if name != "drift_kick" or check in OF_LOOPS])
@pytest.mark.parametrize(("module", "fields", "right", "wrong", "check"), FAULTS)
def test_the_contract_finds_what_is_wrong(
    packages: Packages, module: str, fields: dict[str, object], right: str, wrong: str, check: Callable[[Subject], None]
) -> None:
    group, point, _ = POINTS[module]
    assert right in shown(module)
    # By another name: of two types of one name in a process the second could be given the first one's machine code.
    code = shown(module).replace(right, wrong).replace("Pull", "Faulty")
    packages.add(module, code, point, group=group, head="")
    subject = make_subject(group, point.split(" ")[0], fields, packages.folder)
    with pytest.raises((AssertionError, RunFailed)):
        check(subject)


@pytest.mark.quick(solver=["explicit"])
@pytest.mark.parametrize("solver", ["explicit", "rkl2", "implicit"])
def test_the_isotherm_is_what_fibre_holds_in_the_end(packages: Packages, tmp_path: Path, solver: str) -> None:
    """Fibre beside dye that stays in its cell: phi + A is kept, and A comes to k ln(1 + a phi), found by bisection, but
    for what the last explicit step took too much: that falls with the step.
    """
    packages.add_shown("temkin")
    total, law, cells = 0.3, {"plugin": "temkin", "k": 0.1, "a": 10.0}, np.ones((2, 1, 1))
    data = {"fibre": cells > 0, "up": cells < 0, "porosity": 0.5 * cells, "tau1": cells, "resist": 0.0 * cells,
            "phi": total * cells, "fixed": 0.0 * cells}  # fmt: skip
    low, high = 0.0, total
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle + 0.1 * np.log1p(10.0 * middle) < total else (low, middle)
    rounding = 1e-15 if solver == "explicit" else 1e-13
    dye, errors = {"name": "dye", "D0": "1.93 mm^2/h", "adsorption": 0.5, "isotherm": law}, []
    for dt in ("1 s", "0.1 s"):
        chosen = {"plugin": solver, "dt": dt}
        scene = write_dye_scene(tmp_path, data=data, dyes=[dye], solver=chosen, duration="60 s", frame_rate="1/s")
        with nuno.run(scene, record=tmp_path / "run.mcap").recording as recording:
            point = recording.last_checkpoint(topic="dye/checkpoint")
        assert point.state["phi"] + point.state["fixed"] == pytest.approx(np.full((1, 2, 1, 1), total), abs=rounding)
        errors.append(float(np.abs(point.state["phi"] - low).max()))
    assert (errors[0] < 2e-3 and errors[1] < errors[0] / 5.0) if solver == "explicit" else max(errors) < rounding
