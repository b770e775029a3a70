"""Numbers on surfaces: counts of points against brute force, interpolation, colours and their bar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from straight_yarns import above, parallel, plane, worn

from nuno_render.config import DensityConfig, MapConfig
from nuno_render.rays.maps import (
    BACKGROUND,
    COUNTS,
    MEANS,
    Density,
    Map,
    map_values,
    most_of,
    reach_of,
    sort_points,
    sum_near,
)
from nuno_schemas.colour import colours, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import SurfaceValues


@pytest.mark.parametrize("reach", [0.15, 0.4, 5.0])
def test_points_near_a_place_are_those_of_trying_them_all(reach):
    rng = np.random.default_rng(1)
    points, values, places = rng.normal(size=(500, 3)), rng.normal(size=500), 1.3 * rng.normal(size=(200, 3))
    cells = sort_points(points, values, reach)
    near = np.linalg.norm(places[:, None] - points[None], axis=2) <= reach
    found = np.array([sum_near(*place, cells) for place in places])
    assert np.array_equal(found[:, 0], near.sum(axis=1))
    assert np.abs(found[:, 1] - near @ values).max() < 1e-12
    assert near.any()


def scene(half=1.0):
    """A plane with a grid of points on it, finer on the right."""
    x = np.concatenate([np.arange(-2, 0, 0.1), np.arange(0, 2, 0.05)])
    y = np.arange(-2, 2, 0.1)
    points = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)
    return replace(worn(parallel(0.1, 0.01), plane(half)), points=points)


def test_density_is_the_points_in_a_disc_round_each_place():
    # Far from the seam a disc of radius r holds pi r^2 over the area of a cell, to the share of its rim.
    there = scene()
    shown = SurfaceValues("points", np.zeros(len(there.points)), "points")
    found = map_values(MapConfig(radius=0.4), there, above(1.25, (20, 20)), shown, COUNTS)[..., 0]
    assert (found[:2] == BACKGROUND).all() and (found[:, -2:] == BACKGROUND).all()
    left, right = found[4:-4, 3:6], found[4:-4, -6:-3]
    assert abs(left.mean() / (np.pi * 0.16 / 0.01) - 1) < 0.02
    assert abs(right.mean() / (np.pi * 0.16 / 0.005) - 1) < 0.02


def test_values_of_vertices_are_interpolated_and_those_of_faces_are_not():
    there, camera, config = scene(), above(0.9, (16, 16)), MapConfig(samples=1)
    x = there.bodies[0].vertices
    slope = SurfaceValues("vertices", 3.0 * x[:, 0] - 2.0 * x[:, 1] + 1.0, "slope")
    found = map_values(config, there, camera, slope, MEANS)[..., 0, 0]
    # Over a pixel of 0.1125 the value changes by 0.34 and 0.23; samples are anywhere in it.
    at = ((np.arange(16) + 0.5) / 16 * 2 - 1) * 0.9
    assert np.abs(found - (3.0 * at[None] + 2.0 * at[:, None] + 1.0)).max() <= 0.5 * 0.1125 * 5.0
    faces = SurfaceValues("faces", np.array([2.0, 5.0]), "faces")
    assert set(np.unique(map_values(config, there, camera, faces, MEANS)[..., 0])) == {2.0, 5.0}


def test_values_of_points_are_the_mean_of_those_near_and_grey_where_none_is():
    there = scene()
    values = SurfaceValues("points", there.points[:, 1], "y")
    found = map_values(MapConfig(radius=0.3, samples=1), there, above(0.9, (16, 16)), values, MEANS)[..., 0, 0]
    at = -((np.arange(16) + 0.5) / 16 * 2 - 1) * 0.9
    assert np.abs(found - at[:, None]).max() < 0.1
    lonely = replace(there, points=there.points[:1] + 0.0)
    none = map_values(
        MapConfig(radius=0.1, samples=1), lonely, above(0.5, (4, 4)), SurfaceValues("points", np.ones(1), "one"), MEANS
    )
    assert np.isnan(none[..., 0]).all()


def shown(light):
    """sRGB bytes of linear light (n, 3), highlights rolled off."""
    return np.rint(255 * to_srgb(np.where(light > 0.8, 1.0 - 0.2 * np.exp((0.8 - light) / 0.2), light))).astype(int)


def test_colours_are_those_of_the_bar_from_the_least_to_the_largest():
    there = scene(4.0)
    faces = SurfaceValues("faces", np.array([1.0, 9.0]), "pressure [Pa]")
    config = MapConfig(light=(0, 0, 1), samples=1)
    picture = Map().draw(config, replace(there, values=faces), above(1.0, (64, 64))).astype(int)
    least, largest = shown(colours([1.0, 9.0], 1.0, 9.0))
    # The first face is that below the diagonal.
    assert np.abs(picture[35, 60] - least).max() <= 1
    assert np.abs(picture[10, 5] - largest).max() <= 1
    half = MapConfig(light=(0, 0, 1), low=0.0, high=2.0, samples=1)
    middle = Map().draw(half, replace(there, values=SurfaceValues("faces", np.ones(2), "one")), above(1.0, (64, 64)))
    assert np.abs(middle[5, 5].astype(int) - shown(colours([1.0], 0.0, 2.0))[0]).max() <= 1


def test_what_cannot_be_shown_is_refused():
    there, camera = scene(), above()
    with pytest.raises(BadInput, match="no values"):
        Map().draw(MapConfig(), there, camera)
    with pytest.raises(BadInput, match="wrong shape"):
        Map().draw(MapConfig(), replace(there, values=SurfaceValues("vertices", np.ones(3), "")), camera)
    with pytest.raises(BadInput, match="no body"):
        Density().draw(DensityConfig(), replace(there, bodies=()), camera)
    with pytest.raises(BadInput, match="no extent"):
        Density().draw(DensityConfig(low=2.0, high=1.0), there, camera)
    assert reach_of(MapConfig(), there) == pytest.approx(
        5.0 * np.linalg.norm(np.diff(there.points[there.links], axis=1), axis=2).mean()
    )


def test_a_scale_ends_where_19_of_20_places_above_the_least_are_below():
    seen = np.concatenate([np.zeros(500), np.arange(1, 101), [1e6]])
    assert most_of(seen) == 96.0
    assert most_of(np.full(3, 2.0)) == 2.0 and most_of(np.zeros(0)) == -np.inf
