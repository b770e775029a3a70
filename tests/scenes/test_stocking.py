"""A small stocking on a leg: never inside, at rest by a count of its own, and the same at any step."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nuno
from nuno.cli import main
from nuno.collision.bodies import build_bodies
from nuno.scene import scene_file, shipped
from nuno.simulation.relax import BALANCED
from nuno.simulation.run import Simulation
from nuno_integrators.diagnostics import profile_steps
from nuno_integrators.packing import to_rows
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int

GAP = 5e-5
SMALL = ("objects.0.model.wales=15", "objects.0.model.courses=29", "bodies.0.collider.resolution=24")


def prepare(*overrides: str) -> tuple[Simulation, Any]:
    loaded = scene_file.read(shipped.find("knit/stocking-150"), (*SMALL, *overrides))
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    return Simulation(loaded, bodies.geometry, poses, 1), poses


@cache
def fit(*overrides: str) -> tuple[Simulation, list[Float]]:
    """A finished fit, and the positions after every frame."""
    simulation, poses = prepare(*overrides)
    positions = [simulation.state.x.copy()]
    while not simulation.finished:
        assert simulation.advance(poses, poses).report.status == "ok"
        positions.append(simulation.state.x.copy())
    assert simulation.balanced
    return simulation, positions


def corners_of(simulation: Simulation) -> Float:
    assert simulation.geometry is not None
    x, faces = simulation.geometry.mesh(0)
    return np.asarray(x[faces])


def crossings(points: Float, corners: Float) -> Int:
    """(n,) how often a ray from each point passes through a closed mesh: odd inside. All in one direction that no
    edge has.
    """
    way, _ = np.linalg.qr(np.array([[0.31, 0.77, -0.2], [0.9, -0.4, 0.1], [0.2, 0.3, 1.0]]))
    p, (a, b, c) = points @ way, np.moveaxis(corners @ way, 1, 0)
    u, v, size = b - a, c - a, (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    d = p[:, None, :2] - a[None, :, :2]
    s = (d[..., 0] * v[:, 1] - d[..., 1] * v[:, 0]) / size
    t = (u[:, 0] * d[..., 1] - u[:, 1] * d[..., 0]) / size
    ahead = a[:, 2] + s * u[:, 2] + t * v[:, 2] > p[:, None, 2]
    return np.asarray(((s >= 0.0) & (t >= 0.0) & (s + t <= 1.0) & ahead).sum(axis=1))


def distances(point: Float, corners: Float) -> Float:
    """(f,) from a point to every triangle, by its plane and its three edges."""
    a, edges = corners, np.roll(corners, -1, axis=1) - corners
    share = np.clip(((point - a) * edges).sum(-1) / (edges**2).sum(-1), 0.0, 1.0)
    to_edge = np.linalg.norm(a + share[..., None] * edges - point, axis=-1).min(axis=1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    above = ((point - a[:, 0]) * normal).sum(-1)
    foot = point - above[:, None] * normal
    inside = ((np.cross(edges, foot[:, None] - a) * normal[:, None]).sum(-1) >= 0.0).all(axis=1)
    return np.where(inside, np.abs(above), to_edge)


@pytest.mark.full
def test_no_point_is_ever_inside() -> None:
    simulation, positions = fit()
    corners = corners_of(simulation)
    for x in positions:
        assert (crossings(x, corners) % 2 == 0).all()
    inside = corners.mean(axis=(0, 1))[None] * [0.0, 1.0, 0.0]
    assert crossings(inside, corners)[0] % 2 == 1  # and would tell
    nearest = np.array([distances(point, corners).min() for point in positions[-1]])
    free = ~simulation.fabric.pinned
    assert nearest[free].min() > 0.98 * GAP and (nearest[free] < 1.1 * GAP).mean() > 0.5


def forces(fabric: Fabric, x: Float) -> tuple[Float, float]:
    """(n, 3) forces of links and of what passes along yarns, written out link by link, and the mean tension."""
    springs, yarns = fabric.springs, fabric.yarns
    assert springs is not None and yarns is not None
    pairs: Int = springs.pairs()
    d = x[pairs[:, 1]] - x[pairs[:, 0]]
    length = np.linalg.norm(d, axis=1)
    own = springs.per_spring(springs.k) * (length - springs.per_spring(springs.rest))
    pull = own.copy()
    for yarn in range(len(yarns.ptr) - 1):
        links = yarns.links[yarns.ptr[yarn] : yarns.ptr[yarn + 1]]
        for a, b in zip(links[:-1].tolist(), links[1:].tolist(), strict=True):
            pull[a] += yarns.mu[yarn] * own[b]
            pull[b] += yarns.mu[yarn] * own[a]
    along = (pull / length)[:, None] * d
    out = np.zeros_like(x)
    np.add.at(out, pairs[:, 0], along)
    np.add.at(out, pairs[:, 1], -along)
    return out, float(np.abs(own).mean())


def left(force: Float, point: Float, corners: Float) -> float:
    """What is left of a force where a surface without friction may push along the normals of the triangles it touches:
    the least |F + a m + b n| over pairs of them with a, b >= 0.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    touched = normal[distances(point, corners) < 1.05 * GAP]
    best = float(np.linalg.norm(force))
    for count in range(1, min(2, len(touched)) + 1):
        for chosen in combinations(touched, count):
            base = np.array(chosen).T
            push = np.linalg.lstsq(base, -force, rcond=None)[0]
            if (push >= 0.0).all():
                best = min(best, float(np.linalg.norm(force + base @ push)))
    return best


@pytest.mark.full
def test_a_fit_without_friction_is_in_balance_by_a_count_of_its_own() -> None:
    simulation, positions = fit("bodies.0.friction=0")
    corners, x = corners_of(simulation), positions[-1]
    force, tension = forces(simulation.fabric, x)
    free = np.flatnonzero(~simulation.fabric.pinned)
    rest = np.array([left(force[i], x[i], corners) for i in free]) / tension
    assert rest.max() <= 1.05 * BALANCED
    assert np.linalg.norm(force[free], axis=1).max() / tension > 20 * BALANCED  # which the skin holds up


def row_heights(simulation: Simulation, x: Float) -> Float:
    """(courses,) mean length of each course's legs: the stitch density along the leg is one over it."""
    rows = x.reshape(30, 30, 3)
    return np.asarray(np.linalg.norm(np.diff(rows, axis=0), axis=-1).mean(axis=1))


@pytest.mark.full
def test_stitches_lie_the_same_at_any_step_and_otherwise_with_other_friction() -> None:
    whole, half = fit(), fit("solver.dt=5 ms")
    assert half[0].steps == 2 * whole[0].steps
    heights, others = (row_heights(simulation, positions[-1]) for simulation, positions in (whole, half))
    by_step = np.abs(others / heights - 1.0).max()
    smooth = fit("bodies.0.friction=0")
    by_friction = np.abs(row_heights(smooth[0], smooth[1][-1]) / heights - 1.0).max()
    assert by_step < 0.01 and by_friction > 5 * by_step, (by_step, by_friction)


@pytest.mark.full
def test_a_fit_that_does_not_settle_says_what_still_moves() -> None:
    simulation, poses = prepare("duration=0.3 s")
    reports = [simulation.advance(poses, poses).report for _ in range(3)]
    assert [report.status for report in reports] == ["ok", "ok", "unconverged"]
    assert "vertex" in reports[-1].message and "of stocking at" in reports[-1].message
    assert reports[-1].unbalance > BALANCED and reports[-1].unsettled > 100
    assert f"{reports[-1].unsettled:,} of {28 * 30:,} free vertices" in reports[-1].message


def test_a_run_that_was_too_short_keeps_what_it_can_go_on_from(tmp_path: Path) -> None:
    """A panel by itself: a stocking's run would show no more, and takes longer."""
    short, longer = str(tmp_path / "short.mcap"), str(tmp_path / "longer.mcap")
    panel = ["knit/stitch-10x10", "--set", "until=balance", "--set", "duration=1 s", "--no-view"]
    assert main(["run", *panel, "--record", short]) == 1
    assert main(["run", "--resume", short, "--set", "duration=60 s", "--no-view", "--record", longer]) == 0
    with nuno.open(short) as first, nuno.open(longer) as second:
        assert first.report()["state"] == "unconverged"
        assert second.report()["state"] == "done" and second.report()["simulated_seconds"] < 59.0


@pytest.mark.full
def test_a_resumed_fit_goes_on_in_the_same_bits() -> None:
    simulation, poses = prepare()
    for _ in range(4):
        simulation.advance(poses, poses)
    other, _ = prepare()
    other.resume(simulation.keep())
    assert [simulation.advance(poses, poses).digest for _ in range(3)] == [
        other.advance(poses, poses).digest for _ in range(3)
    ]


def test_a_profile_leaves_sliding_points_where_they_are() -> None:
    simulation, _ = fit()
    work: Any = simulation.memory.work
    x, v = to_rows(simulation.state.x), to_rows(simulation.state.v)
    loop = simulation.loaded.integrator.plugin.steps_of(work)

    def watched(place: Float, speed: Float, *rest: Any) -> None:
        loop(place, speed, *rest)
        assert np.abs(place - x).max() < 1e-12

    profile_steps(watched, work.packed, x, v, work.stages)


@pytest.mark.full
@pytest.mark.parametrize("side", [1, -1])
def test_a_stocking_fits_both_legs_of_a_body(side: int, shared_data: Path) -> None:
    places = [[side * 0.22, 0.03, 0.08], [side * 0.11, 0.7, 0.02]]
    small = ("objects.0.model.wales=20", "objects.0.model.courses=59", "contact.gap=0.5 mm")
    own = ("bodies.0.collider={plugin: mesh, file: body.obj}", f"objects.0.model.over.between={places}")
    loaded = scene_file.read(shipped.find("knit/stocking-leg"), (*small, *own), [shared_data])
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    simulation = Simulation(loaded, bodies.geometry, poses, 1)
    while not simulation.finished:
        assert simulation.advance(poses, poses).report.status == "ok"
    x, corners = simulation.state.x, corners_of(simulation)
    assert simulation.balanced
    assert all((crossings(part, corners) % 2 == 0).all() for part in np.array_split(x, 8))
    # Its own leg alone, from beyond the toes to the thigh.
    assert (side * x[:, 0] > 0.0).all() and x[:, 2].max() > 0.19 and x[:, 1].max() > 0.68


@pytest.mark.parametrize(
    ("overrides", "problem"),
    [
        (("objects.0.model.over.body=arm",), "no such body to draw it over"),
        (("bodies.0.collider={plugin: sphere, radius: 0.1}",), "only a mesh can be drawn over"),
        (("objects.0.model.over.between=[0.9, 0.2]",), "the first row lies before the last"),
        (("objects.0.model.over.between=[[0, 0.1, 0], [0, 3, 0]]",), "outside of the mesh"),
        (("objects.0.model.form=panel",), "only a tube can be drawn over a body"),
        (("objects.0.model.stretch=[1, 2]",), "leave stretch out"),
        (("until=duration",), "or until: balance"),
    ],
)
def test_what_cannot_be_drawn_over_is_refused(overrides: tuple[str, ...], problem: str) -> None:
    with pytest.raises(BadInput, match=problem):
        prepare(*overrides)
