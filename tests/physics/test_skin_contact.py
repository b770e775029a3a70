"""Cloth meets a skin that bends as it meets bodies that do not: nothing passes through, and it rubs along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from met_bodies import Met, Motion, geometry_of
from persons import bar, skinned
from sheets import Pile, sheet

from nuno.bus.encodings import BadMessage
from nuno.collision.bodies import surface
from nuno.collision.distance import penetration, signed_distance
from nuno.collision.messages import decode_geometry, encode_geometry
from nuno_bench.piles import Oracle
from nuno_contact.offset.bodies import CATCH_UP, PLACED, STANDS, pose_solids, set_solid_poses
from nuno_contact.offset.contact_state import LEFT_OUT, TOUCHING
from nuno_contact.penalty.plugin import Penalty, PenaltyConfig
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

ASIDE = np.array([0.002, 0.0, 0.001])
"""So that nothing lies above anything exactly."""


class Bent(Met):
    """Pieces, and a skin on two frames."""

    def __init__(self, *pieces: Fabric, motions: Sequence[Motion], rough: float = 0.3, **settings: Any) -> None:
        self.motions, self.geometry = list(motions), skinned(rough)
        Pile.__init__(self, *pieces, bodies=(self.geometry, self.poses(0.0)), **settings)
        faces = np.concatenate([self.fabric.faces, self.geometry.faces + np.int32(self.fabric.number)])
        self.oracle = Oracle(np.concatenate([self.fabric.position, self.places(0.0)]), faces)

    def places(self, t: float) -> Float:
        return self.geometry.placed(0, self.poses(t))[0]


def above(speed: float = 0.0) -> Fabric:
    """A level sheet over the bar."""
    at = ASIDE + np.array([0.0, 0.015 + 2e-3, 0.0])
    return sheet(14, 0.18, at=at, v=np.array([0.0, -speed, 0.0]))


def lifted(sign: float) -> Motion:
    """A half of the bar goes up, turned about the middle, to 0.6 rad and back ten times a second, in haste."""
    return lambda t: (sign * 0.6 * np.sin(20.0 * np.pi * t) ** 2, np.zeros(3))


def sliding(t: float) -> tuple[float, Float]:
    """Sideways, from rest, at 1 m/s^2."""
    return 0.0, np.array([0.0, 0.0, 0.5 * t * t])


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", ["symplectic_euler", "xpbd", "implicit_euler"])
def test_a_bar_that_bends_passes_through_no_cloth(solver: str) -> None:
    """Up to 0.3 m/s at its ends; nothing is behind at the end, and without contact its edges pass through."""
    met, late, most = Bent(above(), motions=[lifted(-1.0), lifted(1.0)], solver=solver), 0, 0
    for _ in range(12):
        met.go(60)
        assert not met.crossed
        late, most = late + (met.behind > 0), max(most, int(met.meeting.counts[TOUCHING]))
    assert late <= 1 and met.meeting.so_far[LEFT_OUT] == 0
    assert most > 10
    met.state.x[:, 1] = 0.015
    assert met.crossed


def test_a_skin_whose_frames_move_as_one_rubs_as_a_rigid_body_does() -> None:
    """Cloth that lies on a bar which slides off sideways: the same to the rounding of both."""
    one = Bent(above(), motions=[sliding, sliding], rough=0.4)
    other = Met(above(), shapes=[bar()], motions=[sliding], rough=0.4)
    for _ in range(8):
        one.go(100)
        other.go(100)
    assert one.meeting.counts[TOUCHING] > 5
    assert np.abs(one.state.x - other.state.x).max() < 1e-9
    assert one.state.v[:, 2].mean() > 0.05  # it is dragged along


def test_vertices_of_a_skin_go_straight_and_as_fast_as_is_said() -> None:
    """From where the frames have them at the start of an interval to where they have them at its end."""
    met = Bent(above(), motions=[lifted(-1.0), lifted(1.0)])
    ends = met.poses(0.004), met.poses(0.009)
    set_solid_poses(met.meeting, *ends)
    n, x, v = met.fabric.number, met.meeting.goal, met.meeting.whole_velocity
    places = [met.geometry.placed(0, poses)[0] for poses in ends]
    for s in (0.0, 0.3, 1.0):
        pose_solids(met.meeting, s)
        assert np.abs(x[:, n:].T - (1.0 - s) * places[0] - s * places[1]).max() < 1e-15
        assert np.abs(v[:, n:].T - (places[1] - places[0]) / 0.005).max() < 1e-9
    set_solid_poses(met.meeting, ends[0], ends[0])
    pose_solids(met.meeting, 1.0)
    assert np.abs(x[:, n:].T - places[0]).max() == 0.0 and np.abs(v[:, n:]).max() == 0.0


def test_bodies_that_stand_are_placed_once_and_are_behind_where_they_were_moved() -> None:
    """In an interval in which nothing moves; in the next, that begins elsewhere, they are behind and catch up."""
    met = Bent(above(), motions=[lifted(-1.0), lifted(1.0)])
    m, n = met.meeting, met.fabric.number
    before = m.last.copy()
    for t, placed in ((0.0, PLACED), (0.004, STANDS)):
        poses = met.poses(t)
        before[:] = m.last
        report = met.solver.advance(met.system, met.state, met.memory, (poses, poses), 1, met.dt)
        assert report.status == "ok"
        assert m.bodies.still[0] == placed and m.bodies.behind.any() == (placed == STANDS)
        assert np.abs(m.goal[:, n:].T - met.geometry.placed(0, poses)[0]).max() < 1e-15
    way = np.linalg.norm(m.last - before, axis=0)[n:]
    assert 0.0 < way.max() <= CATCH_UP * met.dt * (1.0 + 1e-12)


def test_threads_give_the_same_bits() -> None:
    """Of cloth on a bar that bends."""
    found = []
    for threads in (1, 2):
        met = Bent(above(), motions=[lifted(-1.0), lifted(1.0)], threads=threads)
        for _ in range(3):
            met.go(40)
        found.append((met.state.x.tobytes(), met.state.v.tobytes()))
    assert found[0] == found[1]


def test_the_collision_service_measures_and_draws_a_skin_where_it_is() -> None:
    """As it does a mesh of the vertices as they are then."""
    geometry, poses = skinned(), Bent.poses(SimpleBent(), 0.025)
    placed, faces = geometry.placed(0, poses)
    assert np.abs(placed - geometry.vertices).max() > 0.02
    assert np.array_equal(surface(geometry).at(poses), placed)
    still_mesh = geometry_of([(placed, faces)], 0.3)
    world = Poses(0.0, np.eye(4)[:1], np.zeros((1, 3)))
    points = np.random.default_rng(5).uniform(-1.0, 1.0, (400, 3)) * [0.15, 0.1, 0.03]
    assert np.array_equal(signed_distance(points, geometry, poses), signed_distance(points, still_mesh, world))
    depth = penetration(points, geometry, poses)
    assert (depth > 0.0).sum() > 10
    assert np.array_equal(depth, penetration(points, still_mesh, world))


class SimpleBent(Bent):
    """The motions alone."""

    def __init__(self) -> None:
        self.motions = [lifted(-1.0), lifted(1.0)]


def test_skins_cross_the_bus_and_damaged_ones_are_refused() -> None:
    """To the last bit; of a wrong number of vertices, frames that are not there, weights that are not of one sum."""
    geometry = skinned()
    found = decode_geometry(encode_geometry(geometry))
    for name in ("joint", "weight", "place"):
        assert np.array_equal(getattr(found.skins[0], name), getattr(geometry.skins[0], name))
    skin = geometry.skins[0]
    for bad in (
        replace(skin, joint=skin.joint[:-1], weight=skin.weight[:-1]),
        replace(skin, joint=skin.joint + np.int32(1)),
        replace(skin, weight=0.5 * skin.weight),
        replace(skin, place=np.zeros((3, 3))),
    ):
        with pytest.raises(BadMessage):
            decode_geometry(encode_geometry(replace(geometry, skins=(bad,))))


def test_contact_that_cannot_follow_a_skin_refuses_it_with_the_remedy() -> None:
    with pytest.raises(BadInput, match="bend") as caught:
        Penalty().prepare(PenaltyConfig(), above(), skinned(), np.array([0.0, -9.81, 0.0]))
    assert "sliding" in str(caught.value.remedy) and "cloth_contact" in str(caught.value.remedy)
