"""Sampled distance fields: within their tolerance of the exact distance, continuous, the same bits however made."""

from __future__ import annotations

import closed_meshes as meshes
import numpy as np
import pytest

from nuno_contact.fields.build import build_field
from nuno_contact.fields.cells import Exact
from nuno_contact.fields.sample import sample_field
from nuno_contact.figures.leg import leg_mesh
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import DistanceField
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

CASES = {
    "sphere": (meshes.sphere(24), 5e-3),
    "box": (meshes.box((1.0, 0.4, 0.6)), 1e-2),
    "torus": (meshes.torus(48, 24), 1e-2),
    "plate": (meshes.box((1.0, 4e-3, 0.5)), 1e-2),
    "leg": (leg_mesh(24), 2e-3),
}


def places(x: Float, faces: Int, reach: float, count: int = 20_000) -> Float:
    """Half of the points within `reach` of the surface, half anywhere in the box about it."""
    rng = np.random.default_rng(7)
    corners = x[faces[rng.integers(0, len(faces), count)]]
    on = np.einsum("fi,fij->fj", rng.dirichlet(np.ones(3), count), corners)
    low, high = x.min(axis=0) - reach, x.max(axis=0) + reach
    return np.concatenate([on + rng.uniform(-reach, reach, on.shape), rng.uniform(low, high, (count, 3))])


@pytest.mark.parametrize("name", list(CASES))
def test_error_is_within_the_tolerance_near_the_surface_and_in_proportion_far_from_it(name: str) -> None:
    (x, faces), tolerance = CASES[name]
    field = build_field(x, faces, tolerance)
    p = places(x, faces, field.band)
    exact = closest_points(build_tree(x, faces), p).distance
    error = np.abs(sample_field(field, p)[:, 0] - exact)
    assert (error <= tolerance * np.maximum(1.0, np.abs(exact) / field.band)).all()
    assert error.max() > 0.1 * tolerance
    assert np.abs(sample_field(field, x)[:, 0]).max() <= tolerance


def leaf_sizes(field: DistanceField, p: Float) -> Float:
    """(n,) edge [m] of the leaf that each of the points (n, 3) lies in."""
    place = (p - field.low) / field.size
    cell = np.minimum(np.floor(place).astype(np.int64), field.shape - 1)
    place, size = place - cell, np.full(len(p), field.size)
    at = field.child[(cell[:, 0] * field.shape[1] + cell[:, 1]) * field.shape[2] + cell[:, 2]]
    while (inner := at >= 0).any():
        place = np.where(inner[:, None], 2.0 * place, place)
        part = inner[:, None] & (place >= 1.0)
        place -= part
        at = np.where(inner, field.child[np.where(inner, at + part @ [4, 2, 1], 0)], at)
        size[inner] *= 0.5
    return size


def test_gradient_is_a_unit_vector_to_the_second_order_of_the_cells() -> None:
    """Between unit vectors that turn by h / R along an edge: mean 1 - |g| is (h / R)^2 / 6 in cells
    of one size, and no more than twice that where smaller ones take their larger neighbours' values. The gradient
    leans from the ball's normal by as much as facets of pi / 64 do.
    """
    x, faces = meshes.sphere(64)
    way = np.random.default_rng(1).normal(size=(20_000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    sizes, short, lean = [], [], []
    for tolerance in (3.2e-2, 8e-3, 2e-3):
        field = build_field(x, faces, tolerance)
        gradient = sample_field(field, way)[:, 1:]
        length = np.linalg.norm(gradient, axis=1)
        sizes.append(float(np.mean(leaf_sizes(field, way) ** 2)))
        short.append(float(np.mean(1.0 - length)))
        lean.append(float(np.mean(np.linalg.norm(gradient / length[:, None] - way, axis=1))))
    share = np.array(short) / sizes
    assert sizes[0] > 8.0 * sizes[2]
    assert np.all((share > 0.1) & (share < 0.35)), share
    assert max(lean) < 0.25 * np.pi / 64


def test_distance_and_gradient_are_continuous_between_leaves_of_all_sizes() -> None:
    """On lines along x they never jump: steps of a thousandth of the smallest leaf change them by as little."""
    x, faces = CASES["box"][0]
    field = build_field(x, faces, 1e-2)
    smallest, step = field.size / 2**6, 1e-6
    rng = np.random.default_rng(2)
    start = rng.uniform([-0.6, -0.3, -0.4], [0.6, 0.3, 0.4], (200, 3))
    start[:, 0] = field.low[0] + smallest * np.round((start[:, 0] - field.low[0]) / smallest)
    sides = [sample_field(field, start + np.array([way * step, 0.0, 0.0])) for way in (-1.0, 1.0)]
    assert np.abs(sides[1] - sides[0])[:, 0].max() < 4.0 * step
    assert np.abs(sides[1] - sides[0])[:, 1:].max() < 4.0 * 2.0 * step / smallest


def test_threads_change_no_bit() -> None:
    (x, faces), tolerance = CASES["leg"]
    one, many = (build_field(x, faces, tolerance, threads=count) for count in (1, 2))
    assert one.child.tobytes() == many.child.tobytes() and one.corners.tobytes() == many.corners.tobytes()
    p = places(x, faces, one.band, 5000)
    assert sample_field(one, p, threads=1).tobytes() == sample_field(one, p, threads=2).tobytes()


@pytest.mark.full
def test_a_surface_with_a_hole_has_the_signs_of_its_winding_number() -> None:
    x, faces = meshes.sphere(24)
    top = x[faces].mean(axis=1)[:, 1] > 0.97
    tolerance = 2e-2
    field = build_field(x, faces[~top], tolerance, closed=False)
    p = places(x, faces, 0.2, 1000)
    winding = meshes.winding_number(p, x, faces[~top])
    whole = closest_points(build_tree(x, faces), p).distance
    # Where a hole is seen under a wide angle there is no inside: about the missing cap both are right.
    cap = np.linalg.norm(p - [0.0, 1.0, 0.0], axis=1) < 0.35
    clear = (np.abs(whole) > tolerance) & ~cap
    value = sample_field(field, p)[:, 0]
    assert top.sum() > 40 and cap.any()
    assert np.array_equal(value[clear] < 0.0, winding[clear] > 0.5)
    assert np.array_equal(value[clear] < 0.0, whole[clear] < 0.0)


def test_a_leaky_ring_has_the_signs_of_the_exact_solid_angles() -> None:
    """Groups that are far count as dipoles: signs differ from the exact winding number's only beside one half."""
    x, faces = meshes.torus(40, 24)
    faces = np.delete(faces, np.s_[::9], axis=0)
    p = places(x, faces, 0.5, 1000)
    found = Exact(build_tree(x, faces), closed=False).measure(p)[:, 0] < 0.0
    exact = meshes.winding_number(p, x, faces)
    clear = np.abs(exact - 0.5) > 0.05
    assert np.array_equal(found[clear], exact[clear] > 0.5)
    assert 0.1 < np.mean(found) < 0.9


def test_far_from_its_box_a_field_is_never_too_short_and_too_long_by_no_more_than_the_body() -> None:
    (x, faces), tolerance = CASES["torus"]
    field = build_field(x, faces, tolerance)
    p = np.random.default_rng(3).normal(size=(2000, 3)) * 20.0
    exact = closest_points(build_tree(x, faces), p).distance
    value = sample_field(field, p)[:, 0]
    assert (value >= exact * (1.0 - tolerance / field.band)).all()
    assert (value <= exact + np.linalg.norm(np.ptp(x, axis=0))).all()
    assert np.isnan(sample_field(field, np.full((1, 3), np.nan))[0, 0])


def test_a_field_that_would_be_too_large_is_refused_with_its_size_before_it_is_built() -> None:
    x, faces = CASES["box"][0]
    with pytest.raises(BadInput, match="too large") as caught:
        build_field(x, faces, 1e-4, most_bytes=1 << 22)
    size = float(str(caught.value.value).split("at least ")[1].split(" MiB")[0].replace(",", ""))
    assert size > 4.0 and "4 MiB" in str(caught.value.limit)
