"""No triangle of cloth enters a body from which its corners keep their margins: meshes, penalty's boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from cloth_in_bodies import meeting
from contact_world import box, contact_for, geometry
from sliding_world import STILL, body, loose

from nuno.scene.scene_file import read
from nuno.simulation.run import Simulation
from nuno_contact.margins import STRETCHED, mesh_margins, round_margin, roundness, triangle_spread
from nuno_contact.penalty.contact import pose_bodies
from nuno_contact.penalty.distance import Bodies, primitive_distance
from nuno_contact.sliding.plugin import Sliding, SlidingConfig
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

HERE = Poses(0.0, STILL, np.zeros((1, 3)))
MESHES = {
    "sphere": trimesh.creation.icosphere(2, 0.4),
    "capsule": trimesh.creation.capsule(0.6, 0.2, count=[12, 12]),
    "limb": trimesh.creation.capsule(0.8, 0.05, count=[12, 12]),
    "cylinder": trimesh.creation.cylinder(0.2, 0.8, sections=8),
    "box": trimesh.creation.box((0.6, 0.4, 0.2)),
    "finer box": trimesh.creation.box((0.6, 0.4, 0.2)).subdivide_to_size(0.06),
    "plate": trimesh.creation.box((0.6, 0.6, 0.01)),
    "turned plate": trimesh.creation.box((0.6, 0.6, 0.002), trimesh.transformations.euler_matrix(0.7, 0.4, 0.2)),
    "cone": trimesh.creation.cone(0.2, 0.6, sections=24),
}


@pytest.mark.quick(name=["sphere", "limb", "box"])
@pytest.mark.parametrize("name", MESHES)
def test_no_triangle_enters_a_mesh_whose_corners_keep_their_margin(name: str) -> None:
    """Triangles at random, much smaller and much larger than the body, slivers among them, are moved off its surface
    until each corner is at its margin; without a margin some enter.
    """
    mesh, rng, number = MESHES[name], np.random.default_rng(3), 400
    x, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    tree, solid = build_tree(x, faces), body((x, faces))
    at, on = trimesh.sample.sample_surface(mesh, number, seed=1)
    way = mesh.face_normals[on] + 0.5 * rng.standard_normal((number, 3))
    size = rng.choice([0.02, 0.1, 0.3], (number, 1, 1)) * rng.choice([1.0, 0.1], (number, 1, 3))
    triangles = size * rng.standard_normal((number, 3, 3))
    triangles -= triangles.mean(axis=1, keepdims=True)
    corners = np.arange(3 * number, dtype=np.int32).reshape(-1, 3)
    margin = mesh_margins(triangle_spread(triangles.reshape(-1, 3), corners) / STRETCHED**2, x, faces)
    entered = []
    for least in (margin, 0.0 * margin):
        low, high = np.zeros(number), np.full(number, 4.0)
        for _ in range(32):
            middle = 0.5 * (low + high)
            points = (triangles + (at + middle[:, None] * way)[:, None]).reshape(-1, 3)
            clear = (closest_points(tree, points).distance >= least).reshape(-1, 3).all(axis=1)
            low, high = np.where(clear, low, middle), np.where(clear, middle, high)
        placed = (triangles + (at + high[:, None] * way)[:, None]).reshape(-1, 3)
        entered.append(int(meeting(placed, corners, solid, HERE).sum()))
    assert entered[0] == 0 < entered[1]


def test_a_triangle_of_equal_sides_at_its_margin_touches_a_boxs_corner() -> None:
    """So no smaller margin would do, of a box under penalty and of one of triangles."""
    side, middle = 0.1, np.full(3, 0.3)
    corners = middle + side * np.sqrt(0.5) * (np.eye(3) - 1.0 / 3.0)
    spread = float(triangle_spread(corners, np.array([[0, 1, 2]]))[0]) / STRETCHED**2
    assert spread == pytest.approx(side**2 / 3.0, rel=1e-12)
    contact = contact_for(geometry(box((0, 0, 0), middle)), np.ones(1), 1.0)
    pose_bodies(0.0, contact)
    bodies = Bodies(contact.kind, contact.frame, contact.posed, contact.frames)
    for corner in corners:
        assert primitive_distance(tuple(corner), spread, 0.0, 0, 0, bodies, None)[0] == pytest.approx(0.0, abs=1e-15)
    mesh = trimesh.creation.box(2.0 * middle)
    margin = round_margin(spread, *roundness(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)))
    assert np.linalg.norm(np.maximum(corners[0] - middle, 0.0)) == pytest.approx(margin, rel=1e-6)


def test_a_mesh_is_as_round_as_what_it_stands_for() -> None:
    """Of finer and finer spheres the margin tends to sqrt(r^2 + S) - r."""
    spread, radius = 4e-4, 0.1
    exact = np.hypot(radius, np.sqrt(spread)) - radius
    off = []
    for finer in (2, 3, 4):
        ball = trimesh.creation.icosphere(finer, radius)
        shape = roundness(np.asarray(ball.vertices), np.asarray(ball.faces, np.int32))
        off.append(round_margin(spread, *shape) - exact)
    assert off[0] > off[1] > off[2] > 0.0 and off[2] < 0.2 * exact


def test_vertices_without_triangles_have_no_margin() -> None:
    """Knits rest at their gap, to the bit, also beside cloth of triangles."""
    x = np.array([[0.0, 0.3, 0.0], [0.1, 0.3, 0.0], [0.0, 0.3, 0.1], [0.0, 0.4, 0.0]])
    cloth = loose(x)
    shape = body((np.asarray(MESHES["sphere"].vertices), np.asarray(MESHES["sphere"].faces, np.int32)))

    def gaps(**fields: object) -> Float:
        term = Sliding().prepare(SlidingConfig(gap=1e-3, **fields), cloth, shape, np.zeros(3))
        return np.asarray(term.data[0].gap)

    np.testing.assert_array_equal(gaps(), np.full((1, 4), 1e-3))
    object.__setattr__(cloth, "faces", np.array([[0, 1, 2]], np.int32))
    assert gaps()[0, 3] == 1e-3 and (gaps()[0, :3] > 4e-3).all()
    np.testing.assert_array_equal(gaps(margin=2e-3), [[3e-3, 3e-3, 3e-3, 1e-3]])
    np.testing.assert_array_equal(gaps(margin=0.0), np.full((1, 4), 1e-3))
    with pytest.raises(BadInput, match="as thick as a limb"):
        gaps(margin=0.4)


SOLVERS = {"symplectic_euler": "auto", "xpbd": "4.1666667 ms", "implicit_euler": "16.6666667 ms"}


@pytest.mark.quick(solver=["symplectic_euler"], shape=["limb"])
@pytest.mark.parametrize("shape", ["limb", "box", "sphere"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_stiff_coarse_cloth_never_enters_a_sliding_body_that_moves(solver: str, shape: str, tmp_path: Path) -> None:
    """Leather of cells of 6 cm is caught by a body that comes up and turns; without a margin it is cut through."""
    MESHES[shape].export(tmp_path / "body.obj")
    motion = {"plugin": "keyframes", "times": [0.0, 0.5], "positions": [[0, 0, 0], [0, 0.3, 0]]}
    motion["rotations"] = [[0, 0, 0], [0.5, 1.0, 0.0]]
    cloth = {"plugin": "sheet", "size": [0.6, 0.6], "resolution": [11, 11], "plane": "xz", "fabric": "leather"}
    height = float(np.max(MESHES[shape].vertices[:, 1])) + 0.1
    contact: dict[str, object] = {"plugin": "sliding", "gap": 1e-4}
    entered = []
    for more in ({}, {"margin": 0}):
        data = {
            "nuno": 1, "name": "moving", "duration": 0.6, "frame_rate": 60, "damping": 0.5,
            "solver": {"plugin": solver, "dt": SOLVERS[solver]}, "contact": contact | more,
            "objects": [{"name": "cloth", "model": cloth | {"centre": [0.02, height, 0.01]}}],
            "bodies": [{"name": "body", "collider": {"plugin": "mesh", "file": "body.obj"}, "motion": motion}],
        }  # fmt: skip
        path = tmp_path / "scene.yaml"
        path.write_text(yaml.safe_dump(data))
        simulation = Simulation.with_bodies(read(path), threads=1)
        assert simulation.geometry is not None
        entered.append(0)
        while not simulation.finished:
            assert simulation.step().report.status == "ok"
            assert simulation.poses is not None
            cut = meeting(simulation.state.x, simulation.fabric.faces, simulation.geometry, simulation.poses)
            entered[-1] += int(cut.sum())
    assert entered[0] == 0 < entered[1]
