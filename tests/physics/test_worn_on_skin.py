"""Cloth that is held on a skin follows the places of the skin where it is worn."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from persons import bar, skinned

from nuno.simulation import cloth
from nuno_integrators.bindings import make_bindings, place_bound, set_binding_poses
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.fabric import Binding, Float
from nuno_schemas.system import Carried

STILL = Poses(0.0, np.eye(4)[[0, 0]], np.zeros((2, 3)))


def bent(half: float, t: float = 1.0) -> Poses:
    """Both halves turned up, by as many radians each, and moved on."""
    turns = np.array([[np.cos(half / 2), 0, 0, -np.sin(half / 2)], [np.cos(half / 2), 0, 0, np.sin(half / 2)]])
    return Poses(t, turns, np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 0.3]]))


def carry(x: Float, frame: str | None = None, poses: Poses = STILL, geometry: Geometry | None = None) -> Carried:
    """What carries vertices x (n, 3) that are held on the bar."""
    fabric: Any = SimpleNamespace(position=x, bindings=(Binding(np.arange(len(x), dtype=np.int32), "bar", frame),))
    (one,) = cloth.bind(SimpleNamespace(), fabric, [], geometry or skinned(), poses)  # type: ignore[arg-type]
    return one


@pytest.mark.parametrize("begun", [STILL, bent(0.4, 0.0)])
def test_what_lies_on_the_skin_goes_where_the_skin_goes(begun: Poses) -> None:
    """In whichever pose it was put on: vertices of the skin itself end where the skin has them, to rounding."""
    geometry, last = skinned(), bent(0.9)
    x = geometry.placed(0, begun)[0]
    one = carry(x, poses=begun)
    assert one.skin is not None and (one.skin.weight >= 0.0).all()
    bindings = make_bindings((one,))
    set_binding_poses(bindings, begun, last)
    assert np.abs(bindings.begin - x).max() < 1e-14
    assert np.abs(bindings.end - geometry.placed(0, last)[0]).max() < 1e-14


def test_what_is_worn_off_the_skin_keeps_its_distance() -> None:
    """A ring 2 mm off the bar, where it bends by 50 degrees; one that goes with a frame is through it."""
    geometry, last = skinned(), bent(0.45)
    rest = geometry.mesh(0)[0]
    middle = rest[np.abs(rest[:, 0]) < 0.03]
    x = middle * [1.0, 1.0 + 2e-3 / 0.015, 1.0 + 2e-3 / 0.015]
    off = {}
    for frame in (None, "left"):
        bindings = make_bindings((carry(x, frame),))
        set_binding_poses(bindings, STILL, last)
        ends = bindings.end if frame is None else _rigid(x, last)
        skin = geometry.placed(0, last)[0][np.abs(rest[:, 0]) < 0.03]
        off[frame] = np.abs(np.linalg.norm(ends - skin, axis=1) - np.linalg.norm(x - middle, axis=1))
    assert off[None].max() < 1e-4 and off["left"].max() > 5e-3


def _rigid(x: Float, poses: Poses) -> Float:
    """Vertices x (n, 3) as the left frame carries them."""
    w, _, _, z = poses.rotation[0]
    c, s = w * w - z * z, 2.0 * w * z
    return x @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + poses.translation[0]


@pytest.mark.full
def test_vertices_go_straight_between_frames_of_animation_with_the_skin() -> None:
    """At every fraction on the line, at one velocity; a rigid frame beside them carries its own as before."""
    geometry, last = skinned(), bent(0.9, 0.25)
    x = geometry.placed(0, STILL)[0][::7]
    rigid = Carried(np.array([len(x)]), np.array([[0.3, 0.0, 0.0]]), np.zeros(1, np.int32))
    bindings = make_bindings((carry(x), rigid))
    set_binding_poses(bindings, STILL, last)
    n = len(x) + 1
    for s in (0.0, 0.3, 1.0):
        at, v = np.full((3, n), np.nan), np.full((3, n), np.nan)
        place_bound(bindings, at, v, s)
        ends = bindings.begin, bindings.end
        assert np.abs(at[:, :-1].T - (ends[0] + s * (ends[1] - ends[0]))).max() < 1e-15
        assert np.abs(v[:, :-1].T - (ends[1] - ends[0]) / 0.25).max() < 1e-12
        assert np.isfinite(at).all() and np.isfinite(v).all()
    assert np.abs(at[:, -1] - _rigid(np.array([[0.3, 0.0, 0.0]]), last)[0]).max() < 1e-15


def test_a_place_on_a_triangle_has_its_corners_weights() -> None:
    """By its barycentric coordinates, of the triangle that it lies on."""
    geometry = skinned()
    skin, (x, faces) = geometry.skins[0], bar()
    shares = np.array([0.2, 0.3, 0.5])
    chosen = np.flatnonzero(np.abs(x[faces, 0]).max(axis=1) < 0.02)
    found = skin.beside(np.einsum("k,fkc->fc", shares, x[faces[chosen]]), x, faces)
    dense, wanted = np.zeros((len(chosen), 2)), np.zeros((len(chosen), 2))
    for k in range(found.joint.shape[1]):
        np.add.at(dense, (np.arange(len(chosen)), found.joint[:, k]), found.weight[:, k])
    for corner, share in enumerate(shares):
        for k in range(2):
            at = faces[chosen, corner]
            np.add.at(wanted, (np.arange(len(chosen)), skin.joint[at, k]), share * skin.weight[at, k])
    assert np.abs(dense - wanted).max() < 1e-14
