"""The torso is one closed surface with the girths asked for; a zero surface is found where it is."""

from __future__ import annotations

import numpy as np
import pytest

from nuno_contact.body_shapes.leg import LANDMARKS, leg_mesh
from nuno_contact.body_shapes.person import ALONG, GIRTHS, HEIGHTS, JOINT, person_mesh
from nuno_contact.colliders.mesh import MeshConfig, make_mannequin
from nuno_geometry.check import check_closed, check_crossings, volume
from nuno_geometry.isosurface import find_isosurface, net_of
from nuno_geometry.sections import cut_mesh, section_about
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

ARMS = 0.25 * np.pi


def torso(resolution: int, **fields: object) -> tuple[Float, Int]:
    return make_mannequin(MeshConfig.model_validate({"shape": "torso", "resolution": resolution, **fields}))


def girths(x: Float, faces: Int, arms: float = ARMS) -> dict[str, float]:
    """Girths of a torso's mesh, by plane sections; of the trunk where three loops are cut."""
    found = {}
    for name, height in HEIGHTS.items():
        loop = min(cut_mesh(x, faces, x[:, 1] - height), key=lambda one: abs(float(one.centroid()[0])))
        found[name] = loop.girth
    way = np.array([np.sin(arms), -np.cos(arms), 0.0])
    arm = section_about(x, faces, np.array(JOINT) + ALONG * way, way)
    assert arm is not None
    return {**found, "arm": arm.girth}


def euler(x: Float, faces: Int) -> int:
    return len(x) - len(faces) // 2


@pytest.mark.parametrize(
    ("asked", "arms"),
    [({}, 45.0), ({"bust": 1.1, "waist": 0.9, "hip": 1.2}, 60.0), ({"bust": 0.75, "neck": 0.4, "arm": 0.22}, 45.0)],
)
def test_torso_is_closed_and_has_the_girths_asked_for(asked: dict[str, float], arms: float) -> None:
    x, faces = torso(64, girths=asked, arms=np.radians(arms))
    check_closed(x, faces)
    check_crossings(x, faces)
    assert euler(x, faces) == 2
    found = girths(x, faces, np.radians(arms))
    for name, wanted in {**GIRTHS, **asked}.items():
        # A polygon of chords is shorter than the curve by a share of a sixth of its steps' angles squared.
        assert found[name] == pytest.approx(wanted, rel=4e-3), name


def test_torso_is_smooth_and_its_own_mirror_image() -> None:
    x, faces = torso(48)
    mirrored = x * [-1.0, 1.0, 1.0]
    order, other = (np.lexsort(np.round(points, 9).T) for points in (x, mirrored))
    np.testing.assert_allclose(x[order], mirrored[other], atol=1e-9)
    corners = x[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.linalg.norm(normal, axis=1) > 1e-6).all()


def test_girths_that_leave_no_room_are_refused_by_name() -> None:
    with pytest.raises(BadInput, match="arms and trunk of the torso would meet") as wide:
        torso(24, girths={"bust": 1.25})
    assert wide.value.field == "girths.bust"
    with pytest.raises(BadInput, match="no mannequin is made with this girth") as thin:
        torso(24, girths={"waist": 0.3})
    assert thin.value.field == "girths.waist"
    with pytest.raises(BadInput, match="too near to each other for triangles of this size") as coarse:
        person_mesh(32)
    assert coarse.value.field == "resolution"
    with pytest.raises(ValueError, match="only mannequins, torso and person, have arms to choose"):
        MeshConfig.model_validate({"shape": "leg", "arms": 1.0})


@pytest.mark.full
@pytest.mark.parametrize(("resolution", "arms"), [(64, 45.0), (72, 55.0)])
def test_a_person_is_closed_and_has_the_girths_of_torso_and_leg(resolution: int, arms: float) -> None:
    """But the neck's, which the chin covers, and on a floor at 0; both legs are as the one that comes by itself."""
    x, faces = make_mannequin(
        MeshConfig.model_validate({"shape": "person", "resolution": resolution, "arms": np.radians(arms)})
    )
    check_closed(x, faces)
    check_crossings(x, faces)
    assert euler(x, faces) == 2
    found = girths(x, faces, np.radians(arms))
    for name in set(GIRTHS) - {"neck"}:
        assert found[name] == pytest.approx(GIRTHS[name], rel=1e-2), name
    assert x[:, 1].min() == pytest.approx(0.0, abs=2e-3) and x[:, 1].max() == pytest.approx(1.649, abs=2e-3)
    leg, leg_faces = leg_mesh(96)
    for name in ("thigh", "knee", "calf"):
        height = LANDMARKS[name]
        (alone,) = cut_mesh(leg, leg_faces, leg[:, 1] - height)
        pair = [loop for loop in cut_mesh(x, faces, x[:, 1] - height) if loop.girth > 0.2]
        assert len(pair) == 2
        for loop in pair:
            assert loop.girth == pytest.approx(alone.girth, rel=2e-2), name


def test_a_net_is_a_closed_surface_whatever_the_values() -> None:
    """Also where two sheets pass through a cell, of values without any shape."""
    rng = np.random.default_rng(3)
    for share in (0.2, 0.5, 0.8):
        value = np.ones((12, 11, 10))
        value[1:-1, 1:-1, 1:-1] = rng.random((10, 9, 8)) - share
        _, faces = net_of(value, np.zeros(3), 1.0)
        _, count = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1),
                             axis=0, return_counts=True)  # fmt: skip
        assert len(faces) and (count == 2).all()


def sphere(x: Float, y: Float, z: Float) -> Float:
    """A ball of radius 1 whose field is no distance: its gradient is 2 at the surface."""
    return np.asarray(x * x + y * y + z * z - 1.0)


def ring(x: Float, y: Float, z: Float) -> Float:
    return np.asarray(np.hypot(np.hypot(x, y) - 1.0, z) - 0.4)


def test_isosurface_lies_on_the_zero_level_and_converges() -> None:
    off = []
    for spacing in (0.2, 0.1, 0.05):
        x, faces = find_isosurface(sphere, np.full(3, -1.23), np.full(3, 1.23), spacing)
        np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1.0, atol=1e-9)
        assert euler(x, faces) == 2
        off.append(1.0 - volume(x, faces) / (4.0 * np.pi / 3.0))
    np.testing.assert_allclose(np.log2(np.array(off[:-1]) / off[1:]), 2.0, atol=0.1)


def test_isosurface_keeps_a_hole() -> None:
    x, faces = find_isosurface(ring, np.array([-1.5, -1.5, -0.5]), np.array([1.5, 1.5, 0.5]), 0.1)
    check_closed(x, faces)
    assert euler(x, faces) == 0
    assert volume(x, faces) == pytest.approx(2.0 * np.pi**2 * 0.16, rel=0.03)
