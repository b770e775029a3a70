"""Implicit steps on sliding bodies: at steps as long as a frame cloth rests on them, slides as Coulomb says, and goes
where they go.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial import Delaunay

from nuno.scene.scene_file import read
from nuno.simulation.body_forces import feel
from nuno.simulation.run import Simulation
from nuno_schemas.fabric import Float

pytestmark = pytest.mark.full

G, GAP, MU = 9.81, 1e-3, 0.5
FRAME, QUARTER = "16.6666667 ms", "4.1666667 ms"


def made(folder: Path, shape: trimesh.Trimesh, solver: dict[str, Any], cloth: dict[str, Any], **fields: Any) -> Any:
    """A cloth and a body of a triangle mesh, before the first frame."""
    shape.export(folder / "body.obj")
    own = {"name": "body", "collider": {"plugin": "mesh", "file": "body.obj"}, "friction": MU}
    own |= {"contact": {"plugin": "sliding", "gap": GAP}} | fields.pop("body", {})
    data = {"nuno": 1, "name": "rest", "duration": 3, "frame_rate": 60, "solver": solver, "bodies": [own]}
    scene = folder / "scene.yaml"
    scene.write_text(yaml.safe_dump(data | {"objects": [{"name": "cloth", "model": cloth}]} | fields))
    return Simulation.with_bodies(read(scene), threads=1)


def sheet(size: float, points: int, height: float, **more: Any) -> dict[str, Any]:
    grid = {"plugin": "sheet", "size": [size, size], "resolution": [points, points], "plane": "xz"}
    return grid | {"centre": [0.003, height, 0.002], "fabric": "interlock"} | more


def triangles(folder: Path, size: float, points: int, height: float) -> dict[str, Any]:
    """The same of triangles in no order."""
    random = np.random.default_rng(7)
    edge = np.linspace(-0.5, 0.5, points)
    x = np.stack(np.meshgrid(edge, edge), axis=-1).reshape(-1, 2)
    inner = (np.abs(x) < 0.49).all(axis=1)
    x[inner] += random.uniform(-0.3, 0.3, (int(inner.sum()), 2)) / (points - 1)
    places = np.insert(size * x, 1, height, axis=1)
    trimesh.Trimesh(places, Delaunay(x).simplices, process=False).export(folder / "cloth.obj")
    return {"plugin": "mesh", "file": "cloth.obj", "fabric": "interlock"}


def kinetic(simulation: Simulation) -> float:
    return float(0.5 * (simulation.fabric.mass[:, None] * simulation.state.v**2).sum())


@pytest.mark.parametrize("kind", ["grid", "triangles"])
@pytest.mark.parametrize("dt", [FRAME, QUARTER])
@pytest.mark.parametrize("name", ["implicit_euler", "tr_bdf2"])
def test_a_sheet_comes_to_rest_on_a_ball(tmp_path: Path, name: str, dt: str, kind: str) -> None:
    """It stays there, its motion dies away, and the ball feels its weight within 1 %."""
    radius = 0.1
    cloth = sheet(0.3, 13, radius + 0.004) if kind == "grid" else triangles(tmp_path, 0.3, 13, radius + 0.004)
    ball = trimesh.creation.icosphere(3, radius)
    simulation = made(tmp_path, ball, {"plugin": name, "dt": dt}, cloth, damping=2.0)
    mass = simulation.fabric.mass
    weight, moving = float(mass.sum()) * G, []
    while not simulation.finished:
        simulation.step()
        moving.append(kinetic(simulation))
        assert np.linalg.norm(simulation.state.x, axis=1).min() > 0.98 * radius, "facets lie inside of the ball"
    # A thousandth of the energy of a fall by a millimetre.
    assert max(moving[-30:]) < 1e-3 * weight * 1e-3
    middle = (mass[:, None] * simulation.state.x).sum(axis=0) / mass.sum()
    assert np.hypot(middle[0], middle[2]) < 0.1 * radius and middle[1] > 0.0
    (felt,) = feel(simulation)[0].bodies
    assert felt.force == pytest.approx((0.0, -weight, 0.0), abs=0.01 * weight)


def on_slab(folder: Path, name: str, dt: str, gravity: Float, path: list[list[float]] | None = None) -> Any:
    """A sheet after half a second on a slab that stands or goes along a path, and how far it has moved."""
    slab = trimesh.creation.box((4.0, 0.1, 1.0))
    motion = {"plugin": "keyframes", "times": np.linspace(0.0, 0.5, 31).tolist(), "positions": path}
    fields: dict[str, Any] = {"body": {"motion": motion}} if path else {}
    solver, cloth = {"plugin": name, "dt": dt, "residual": 1e-6}, sheet(0.2, 6, 0.05 + GAP)
    simulation = made(folder, slab, solver, cloth, damping=0.0, gravity=gravity.tolist(), duration=0.5, **fields)
    x = simulation.state.x.copy()
    while not simulation.finished:
        simulation.step()
    return simulation, simulation.state.x - x


@pytest.mark.parametrize("dt", [FRAME, QUARTER])
@pytest.mark.parametrize("name", ["implicit_euler", "tr_bdf2"])
def test_a_sheet_on_a_slab_sticks_slides_and_is_carried(tmp_path: Path, name: str, dt: str) -> None:
    """None below tan alpha = mu, else at g (sin alpha - mu cos alpha); up with a lift; sideways with what friction can
    bear of 2 m/s^2, and with mu g where it cannot, of 6.5 m/s^2.
    """
    for share in (0.98, 1.5):
        alpha = math.atan(share * MU)
        simulation, moved = on_slab(tmp_path, name, dt, G * np.array([math.sin(alpha), -math.cos(alpha), 0.0]))
        pull = max(0.0, G * (math.sin(alpha) - MU * math.cos(alpha)))
        assert np.abs(moved[:, 0]).max() == pytest.approx(0.5 * pull * 0.25, rel=0.05, abs=1e-9)
        assert simulation.state.v == pytest.approx(np.tile([0.5 * pull, 0.0, 0.0], (36, 1)), rel=0.01, abs=1e-6)
        assert np.abs(moved[:, 1]).max() < 1e-9
    down, times = np.array([0.0, -G, 0.0]), np.linspace(0.0, 0.5, 31)
    _, moved = on_slab(tmp_path, name, dt, down, [[0.0, 0.4 * float(t), 0.0] for t in times])
    assert moved == pytest.approx(np.tile([0.0, 0.2, 0.0], (36, 1)), abs=1e-6)
    for given, had in ((2.0, 2.0), (6.5, MU * G)):
        simulation, _ = on_slab(tmp_path, name, dt, down, [[0.5 * given * float(t * t), 0.0, 0.0] for t in times])
        # A body's velocity in a frame is that of its middle.
        assert simulation.state.v[:, 0] == pytest.approx(np.full(36, had * (0.5 - 1.0 / 120.0)), rel=0.02)


def test_a_run_goes_on_from_a_checkpoint_in_the_same_bits(tmp_path: Path) -> None:
    """What is held, and what rubs, is part of the state."""
    slab = trimesh.creation.box((4.0, 0.1, 1.0))
    parts = slab, {"plugin": "implicit_euler", "dt": FRAME}, sheet(0.2, 6, 0.05 + GAP)
    one, other = (made(tmp_path, *parts, damping=0.0, gravity=[5.0, -8.0, 0.0], duration=0.2) for _ in range(2))
    for _ in range(6):
        one.step()
    other.resume(one.keep())
    for simulation in (one, other):
        while not simulation.finished:
            simulation.step()
    assert one.digest() == other.digest()
    assert one.state.v[:, 0].min() > 0.1, "it slides"
