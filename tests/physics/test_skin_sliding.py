"""Cloth slides on a skin by closest points: they are the nearest ones, and nothing is inside that they keep out."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import trimesh
from cloth_in_bodies import meeting
from persons import as_skin, person, skinned
from sheets import sheet
from sliding_world import G, World, loose

from nuno.collision.distance import measure_inside
from nuno_contact.motions.rotations import from_axis_angle
from nuno_contact.sliding.plugin import Sliding, SlidingConfig
from nuno_contact.sliding.skin import SkinSlides, begin_frame, find_plane, hold_forces
from nuno_geometry.closest_point import closest_points
from nuno_geometry.moving_mesh import make_moving_mesh
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

DOWN = np.array([0.0, -G, 0.0])


def with_slivers(x: Float, faces: Int, count: int) -> tuple[Float, Int]:
    """The same closed surface, some of whose edges are cut a ten-thousandth of their length from an end."""
    x, faces = list(x), faces.tolist()
    for f in range(0, 3 * count, 3):
        a, b = faces[f][0], faces[f][1]
        at, new = len(x), []
        x.append(0.9999 * x[a] + 0.0001 * x[b])
        for number, face in enumerate(faces):
            if a in face and b in face:
                new.append([at if i == a else i for i in face])
                faces[number] = [at if i == b else i for i in face]
        faces += new
    return np.array(x), np.array(faces, np.int32)


def moving_person(points: Float) -> tuple[SkinSlides, Float, Int]:
    """A person with slivers who bends to a side by up to 5 cm in an interval, and points that meet it."""
    x, faces = with_slivers(*person(0.04), 60)
    mesh = make_moving_mesh(x, faces)
    mesh.end[:] = x + 0.05 * np.sin(3.0 * x[:, 1:2]) * np.array([1.0, 0.0, 0.5])
    term = Sliding().prepare(SlidingConfig(), loose(points), skinned(), DOWN)
    return term.data[0]._replace(mesh=mesh), x, faces


def test_the_closest_point_of_a_skin_in_motion_is_that_of_all_triangles() -> None:
    """At an interval's start to rounding, whatever triangle was known; and on the right side throughout. Walked to by
    points that go with the skin by up to 5 cm, it may be another one in a fold, about as near.
    """
    rng = np.random.default_rng(3)
    slides, x, faces = moving_person(np.zeros((2000, 3)))
    corners, weight = faces[rng.integers(0, len(faces), 2000)], rng.dirichlet(np.ones(3), 2000)
    away = 0.007 * rng.normal(size=(2000, 3))
    away[0] = 0.5
    for s, share, most in ((0.0, 0.0, 1e-15), (0.4, 0.03, 3e-3), (1.0, 0.03, 3e-3)):
        now = (1.0 - s) * x + s * slides.mesh.end
        start, at = ((weight[:, :, None] * places[corners]).sum(axis=1) + away for places in (x, now))
        found = closest_points(build_tree(now, faces), at)
        begin_frame(slides, np.ascontiguousarray(start.T), 1.0, None)
        known = slides.face.copy()
        assert slides.plane[0, 10] > 0.1 and (slides.plane[1:, 10] < 0.01).all()
        slides.face[:] = rng.integers(0, len(faces), 2000)
        begin_frame(slides, np.ascontiguousarray(start.T), 1.0, None)
        assert np.array_equal(slides.face, known)
        distance = np.array([find_plane(tuple(point), p, s, slides) for p, point in enumerate(at) if p])
        farther = np.abs(distance) - np.abs(found.distance[1:])
        assert farther.min() > -1e-15 and farther.max() < most
        assert (farther > 1e-13).mean() <= share
        assert np.array_equal(distance < 0.0, found.distance[1:] < 0.0)


def ball(radius: float, at: tuple[float, float, float], sharp: float = 0.0) -> tuple[Float, Int]:
    """A ball with edges of a seventh of its radius; every 40th vertex of it sticks out by `sharp` radii."""
    mesh = trimesh.creation.icosphere(3, radius)
    x = np.array(mesh.vertices)
    x[::40] *= 1.0 + sharp
    return x + at, np.asarray(mesh.faces, np.int32)


def test_no_triangle_enters_a_skin_that_is_sharper_in_places_than_in_all() -> None:
    """Triangles of a ball's edges, over points that stick out of it, are put where corners and middles of sides keep
    their margins; they would enter with the one margin that suits the ball.
    """
    mesh, rng, number = ball(0.1, (0.0, 0.0, 0.0), 0.05), np.random.default_rng(5), 40
    triangles = rng.normal(size=(number, 3, 3))
    way = mesh[0][40 * (np.arange(number) % 16)] / 0.105
    triangles -= (
        triangles.mean(axis=1, keepdims=True) + (triangles * way[:, None]).sum(axis=2)[:, :, None] * way[:, None]
    )
    triangles *= 0.03 / np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)[:, None, None]
    corners = np.arange(3 * number, dtype=np.int32).reshape(-1, 3)
    cloth = replace(loose(triangles.reshape(-1, 3)), faces=corners)
    here, entered = Poses(0.0, np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), np.zeros((2, 3))), []
    geometry = as_skin(*mesh, np.zeros(len(mesh[0])))
    for local in (True, False):
        slides = Sliding().prepare(SlidingConfig(), cloth, geometry, DOWN).data[0]
        if not local:
            slides = slides._replace(spread=np.zeros_like(slides.spread))
        low, high = np.full(number, 0.09), np.full(number, 0.2)
        for _ in range(20):
            half = 0.5 * (low + high)
            placed = (triangles + (half[:, None] * way)[:, None]).reshape(-1, 3)
            begin_frame(slides, np.ascontiguousarray(placed.T), 1e-3, None)
            at = placed[slides.ends].mean(axis=1)
            off = [find_plane(tuple(point), p, 0.0, slides) - slides.plane[p, 11] for p, point in enumerate(at)]
            clear = np.full(number, np.inf)
            np.minimum.at(clear, slides.ends[:, 0] // 3, off)
            low, high = np.where(clear >= 0.0, low, half), np.where(clear >= 0.0, half, high)
        placed = (triangles + (high[:, None] * way)[:, None]).reshape(-1, 3)
        entered.append(int(meeting(placed, corners, geometry, here).sum()))
    assert entered[0] == 0 < entered[1]


def test_a_limb_that_comes_to_a_point_near_another_one_within_a_frame_moves_it_on() -> None:
    """A point 25 mm from a ball, to which another ball of the same skin comes in one frame, from 30 mm away, by 40."""
    one, other = ball(0.05, (-0.075, 0.0, 0.0)), ball(0.05, (0.08, 0.0, 0.0))
    x, faces = np.concatenate([one[0], other[0]]), np.concatenate([one[1], other[1] + len(one[0])])
    world = World(loose(np.zeros((1, 3))), as_skin(x, faces, (x[:, 0] > 0.0).astype(float)), np.zeros(3))
    places = np.array([[[0.0, 0.0, 0.0]] * 2, [[0.0, 0.0, 0.0], [-0.04, 0.0, 0.0]]])
    still = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    start, end = Poses(0.0, still, places[0]), Poses(1.0 / 60.0, still, places[1])
    world.go(50, 1.0 / 3000.0, start, end)
    moved = other[0] + places[1, 1]
    assert closest_points(build_tree(moved, other[1]), world.state.x).distance[0] > 0.0
    assert world.state.x[0, 0] < -0.009


def frames(t: float, turn: float = 0.0, place: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Poses:
    """Both halves of the bar at a place, turned up by an angle about its middle."""
    axis = np.array([0.0, 0.0, 1.0])
    turns = [from_axis_angle(axis, -turn), from_axis_angle(axis, turn)]
    return Poses(t, np.stack(turns), np.tile(np.array(place), (2, 1)))


def bending(t: float) -> Poses:
    """To 0.4 rad and back four times a second, on the way down at 0.3 m/s and up again."""
    return frames(t, 0.4 * math.sin(4.0 * math.pi * t) ** 2, (0.0, -0.03 * math.sin(10.0 * t), 0.0))


class OnSkin(World):
    """A sheet with edges of 14 mm above the bar."""

    def __init__(self, name: str = "symplectic_euler", parts: int = 14, **fields: Any) -> None:
        cloth = sheet(parts, 0.013 * parts, at=np.array([0.002, 0.022, 0.001]))
        super().__init__(cloth, skinned(fields.pop("friction", 0.3)), fields.pop("gravity", DOWN), name)
        self.cloth = cloth

    def frame(self, k: int, steps: int = 100) -> None:
        """A frame of 1/60 s from frame k on."""
        self.go(steps, 1.0 / 60.0 / steps, bending(k / 60.0), bending((k + 1) / 60.0))


@pytest.mark.quick(name=["symplectic_euler"])
@pytest.mark.parametrize("name", ["symplectic_euler", "respa", "rk4", "xpbd", "implicit_euler"])
def test_a_sheet_falls_on_a_skin_that_bends_and_nothing_is_inside(name: str) -> None:
    """In any of 24 frames, in which it lies on the bar and is thrown up by it; it would have fallen by 78 cm."""
    world, touching = OnSkin(name), 0
    for k in range(24):
        world.frame(k, 16 if name in ("xpbd", "implicit_euler") else 100)
        found = measure_inside(world.state.x, world.cloth.faces, world.geometry, bending((k + 1) / 60.0))
        assert found.area == 0.0 and found.depth.max() == 0.0
        touching += world.slides.touching[0] > 0
    assert touching > 18 and world.state.x[:, 1].min() > -0.06


def test_a_run_from_a_frames_start_has_the_same_bits() -> None:
    """Contact has no state: a new solver goes on from positions and velocities alone."""
    world, other = OnSkin(), OnSkin()
    for k in range(12):
        world.frame(k)
    other.state.x[:], other.state.v[:], other.state.t = world.state.x, world.state.v, world.state.t
    for k in range(12, 15):
        world.frame(k)
        other.frame(k)
        assert world.state.x.tobytes() == other.state.x.tobytes()
    assert world.slides.touching[0] > 0


def test_threads_give_the_same_bits() -> None:
    """Of points in several blocks: planes are found in parallel, and points put back one after the other."""
    found = []
    for threads in (1, 2):
        world = OnSkin(parts=34)
        world.system = replace(world.system, threads=threads)
        world.memory = world.plugin.prepare(world.plugin.Config(), world.system, world.state)
        assert (world.memory.work.packed.threads or 1) == threads
        for k in range(4):
            world.frame(k)
        found.append(world.state.x.tobytes() + world.state.v.tobytes())
    assert found[0] == found[1]


def flat(alpha: float, friction: float = 0.3) -> World:
    """Vertices on the upper side of the bar, gravity tilted along it."""
    x = np.array([[-0.08, 0.015 + 5e-5, z] for z in (-0.005, 0.0, 0.005)])
    return World(loose(x), skinned(friction), G * np.array([math.sin(alpha), -math.cos(alpha), 0.0]))


@pytest.mark.parametrize("share", [0.98, 1.5])
def test_vertices_stick_and_slide_as_coulomb_says(share: float) -> None:
    """By g (sin alpha - mu cos alpha) t^2 / 2 in the upper plane of the bar, where both halves lie still."""
    world = flat(alpha := math.atan(0.3 * share))
    start = world.state.x.copy()
    for _ in range(20):
        world.go(10, 1e-3, frames(0.0), frames(0.01))
    pull = max(0.0, G * (math.sin(alpha) - 0.3 * math.cos(alpha)))
    moved = world.state.x - start
    assert np.abs(moved[:, 0] - 0.5 * pull * 0.04).max() < 1e-9 + 0.51 * pull * 0.2 * 1e-3
    assert np.abs(moved[:, 1:]).max() < 1e-9
    assert np.abs(world.state.v[:, 0] - 0.2 * pull).max() < 1e-9


def test_what_lies_on_a_skin_is_carried_along() -> None:
    """At its speed after a second of friction, whether sideways or by a part that turns."""
    world = flat(0.0)
    ways = [frames(0.1 * k, 0.0, (0.0, 0.0, 0.002 * k)) for k in range(11)]
    for one, other in pairwise(ways):
        world.go(50, 2e-3, one, other)
    assert np.abs(world.state.v - np.array([0.0, 0.0, 0.02])).max() < 1e-6


def test_a_force_is_held_by_the_skin_and_by_friction() -> None:
    """Of vertices at rest on it: what presses, and along the skin up to mu times that."""
    world = flat(0.0)
    world.go(1, 1e-3, frames(0.0), frames(1e-3))
    force = np.tile(np.array([[0.6], [-1.0], [0.8]]), (1, 3))
    hold_forces(world.slides, world.memory.work.x, force)
    np.testing.assert_allclose(force, np.tile(0.7 * np.array([[0.6], [0.0], [0.8]]), (1, 3)), atol=1e-9)


def holed() -> Geometry:
    whole = skinned()
    return replace(whole, faces=whole.faces[1:], owner=whole.owner[1:])


def turned() -> Geometry:
    whole = skinned()
    faces = whole.faces.copy()
    faces[0] = faces[0, ::-1]
    return replace(whole, faces=faces)


@pytest.mark.parametrize(
    ("geometry", "words"), [(holed(), "has a hole"), (turned(), "face opposite ways"), (skinned(-1.0), "friction")]
)
def test_skins_without_an_inside_and_wrong_friction_are_refused(geometry: Geometry, words: str) -> None:
    cloth = sheet(5, 0.1, at=np.array([0.0, 0.05, 0.0]))
    with pytest.raises(BadInput, match=words) as caught:
        Sliding().prepare(SlidingConfig(), cloth, geometry, DOWN)
    assert "bar" in str(caught.value)
