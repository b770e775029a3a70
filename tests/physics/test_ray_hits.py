"""Rays against triangles and capsules: closed forms, any order of search, samples that fill their grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from straight_yarns import everywhere

from nuno_render.rays.hits import capsule_tree, make_buffers, meet_capsules, meet_triangle, triangle_tree
from nuno_render.sight import permute, place_sample

RNG = np.random.default_rng(4)


def directions(count):
    d = RNG.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def first_capsule(o, d, tree, keep=1, most=math.inf):
    """(item, entry, exit) of the first capsules that rays meet."""
    found = []
    for p, v in zip(o, d, strict=True):
        buffers = make_buffers(keep)
        buffers.items[:], buffers.enters[:], buffers.leaves[:] = -1, np.inf, -np.inf
        count = meet_capsules(np.asarray(p), np.asarray(v), most, tree, keep, buffers)
        found.append((count, buffers.items.copy(), buffers.enters.copy(), buffers.leaves.copy()))
    return found


def one_capsule(o, d, a, b, r):
    """(entry, exit) of rays that start at o, for one capsule each; NaN where it is missed."""
    rows = []
    for p, v, start, end, radius in zip(o, d, a, b, r, strict=True):
        tree = capsule_tree(start[None], end[None], np.array([radius]))
        count, _, enter, leave = first_capsule([p], [v], tree)[0]
        rows.append((enter[0], leave[0]) if count else (np.nan, np.nan))
    return np.array(rows).T


def test_ray_across_a_cylinder_meets_it_where_pythagoras_says():
    # At right angles to the axis, past it by h: entry and exit sqrt(r^2 - h^2) before and behind the nearest point.
    n, r = 200, 0.01
    axis, side = directions(n), directions(n)
    side -= (side * axis).sum(axis=1, keepdims=True) * axis
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    way, middle = np.cross(axis, side), RNG.normal(size=(n, 3))
    h = RNG.uniform(-1.3, 1.3, n) * r
    away = 10.0 ** RNG.uniform(-1, 4, n)
    o = middle + h[:, None] * side - away[:, None] * way
    length = RNG.uniform(0.1, 0.9, n)[:, None]
    enter, leave = one_capsule(o, way, middle - length * axis, middle + (1 - length) * axis, np.full(n, r))
    with np.errstate(invalid="ignore"):
        half = np.sqrt(r * r - h * h)
    assert np.array_equal(np.isnan(enter), np.isnan(half))
    hit = ~np.isnan(half)
    assert 100 < hit.sum() < 190
    # The eye, up to 10 km away, is known to so many digits; h loses what they do, and grazing roots more.
    limit = 2.0**-50 * (1.0 + away[hit]) * (1.0 + r / half[hit])
    assert (np.abs(enter - (away - half))[hit] < limit).all()
    assert (np.abs(leave - (away + half))[hit] < limit).all()


def test_skew_ray_meets_an_endless_cylinder_in_its_closed_form():
    # Across the axis the picture is a circle: |p + t d| = r for what of p and d is across.
    n, r = 200, 0.02
    axis, d, o = directions(n), directions(n), RNG.normal(size=(n, 3)) * 0.2
    across_o = o - (o * axis).sum(axis=1, keepdims=True) * axis
    across_d = d - (d * axis).sum(axis=1, keepdims=True) * axis
    a, b = (across_d**2).sum(axis=1), (across_o * across_d).sum(axis=1)
    c = (across_o**2).sum(axis=1) - r * r
    with np.errstate(invalid="ignore"):
        root = np.sqrt(b * b - a * c)
    enter, leave = one_capsule(o, d, -1000 * axis, 1000 * axis, np.full(n, r))
    ahead = leave > 0
    assert ahead.sum() > 5
    assert np.abs(enter - (-b - root) / a)[ahead].max() < 1e-7
    assert np.abs(leave - (-b + root) / a)[ahead].max() < 1e-7
    assert not (~ahead & ((-b + root) / a > 1e-9)).any()


@pytest.mark.parametrize("length", [0.0, 0.3])
def test_ray_along_the_axis_enters_by_the_round_end(length):
    n, r = 50, 0.05
    axis, a = directions(n), RNG.normal(size=(n, 3))
    o = a - 2.0 * axis
    enter, leave = one_capsule(o, axis, a, a + length * axis, np.full(n, r))
    assert np.abs(enter - (2.0 - r)).max() < 1e-14
    assert np.abs(leave - (2.0 + length + r)).max() < 1e-14


def test_points_of_entry_and_exit_are_on_the_surface_and_all_between_is_inside():
    n = 300
    a, b, o, d = *(RNG.normal(size=(3, n, 3)) * 0.3), directions(n)
    r = RNG.uniform(0.05, 0.3, n)
    enter, leave = one_capsule(o, d, a, b, r)
    hit = np.isfinite(enter)
    assert hit.sum() > 40

    def depth(t):
        p = (o + t[:, None] * d)[hit]
        axis = (b - a)[hit]
        s = np.clip(((p - a[hit]) * axis).sum(axis=1) / (axis**2).sum(axis=1), 0, 1)
        return r[hit] - np.linalg.norm(p - a[hit] - s[:, None] * axis, axis=1)

    assert np.abs(depth(enter)).max() < 1e-12 and np.abs(depth(leave)).max() < 1e-12
    for share in (0.01, 0.5, 0.99):
        assert (depth(enter + share * (leave - enter)) >= 0).all()
    outside = enter - 0.01
    assert (depth(outside) < 0).all()


@pytest.mark.parametrize("keep", [1, 5])
def test_first_capsules_are_those_of_trying_them_all(keep):
    start = RNG.uniform(-0.6, 0.6, (700, 3))
    tree = capsule_tree(start, start + RNG.normal(size=(700, 3)) * 0.05, RNG.uniform(0.01, 0.04, 700))
    o, d = RNG.uniform(-0.6, 0.6, (300, 3)), directions(300)
    found, tried = first_capsule(o, d, tree, keep, 2.0), first_capsule(o, d, everywhere(tree), keep, 2.0)
    assert sum(count for count, *_ in found) > 100
    for one, other in zip(found, tried, strict=True):
        assert one[0] == other[0]
        assert all(np.array_equal(x[: one[0]], y[: one[0]]) for x, y in zip(one[1:], other[1:], strict=True))


def test_equal_hits_are_the_lowest_number_wherever_it_stands():
    start, end = np.tile([[0.0, 0, 0]], (40, 1)), np.tile([[0.0, 0.1, 0]], (40, 1))
    tree = capsule_tree(start, end, np.full(40, 0.02))
    count, items, _, _ = first_capsule([[1.0, 0.05, 0.0]], [[-1.0, 0, 0]], tree, 3)[0]
    assert count == 3 and items.tolist() == [0, 1, 2]


def test_no_ray_passes_between_triangles_and_each_meets_the_right_one():
    n = 40
    s = np.linspace(-1.0, 1.0, n)
    x, y = np.meshgrid(s, s)
    points = np.stack([x, y, 0.2 * np.sin(3 * x) * np.cos(2 * y)], axis=-1).reshape(-1, 3)
    i, j = np.divmod(np.arange((n - 1) ** 2), n - 1)
    a = i * n + j
    faces = np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)]).astype(np.int32)
    tree = triangle_tree(points, faces)
    buffers = make_buffers(1)
    eye = np.array([0.1, -0.2, 5.0])
    weights = RNG.dirichlet([1, 1, 1], 500)
    weights[:200, 0] = 0.0  # on edges
    weights[:100, 1] = 0.0  # at corners
    weights /= weights.sum(axis=1, keepdims=True)
    inner = (np.abs(points[faces]).max(axis=(1, 2)) < 0.99).nonzero()[0]
    for face, weight in zip(RNG.choice(inner, 500), weights, strict=True):
        target = weight @ points[faces[face]]
        d = (target - eye) / np.linalg.norm(target - eye)
        found, t = meet_triangle(eye, d, tree, buffers)
        assert found >= 0 and abs(t - np.linalg.norm(target - eye)) < 1e-9
        assert found == face or weight.min() < 1e-9
    assert meet_triangle(eye, np.array([0.0, 0.0, 1.0]), tree, buffers)[0] == -1


@pytest.mark.parametrize("count", [1, 2, 3, 7, 16, 37])
def test_permutations_take_every_number_to_another(count):
    for pattern in (0, 1, 12345, 0xFFFFFFFF):
        assert sorted(permute(i, count, pattern) for i in range(count)) == list(range(count))


@pytest.mark.parametrize("grid", [(1, 1), (2, 2), (4, 4), (5, 6)])
def test_samples_stand_one_in_each_cell_row_and_column(grid):
    columns, rows = grid
    n = columns * rows
    for pattern in (3, 99):
        x, y = np.array([place_sample(s, columns, rows, pattern) for s in range(n)]).T
        assert sorted(np.floor(x * columns).astype(int) * rows + np.floor(y * rows).astype(int)) == list(range(n))
        assert sorted(np.floor(x * n).astype(int)) == list(range(n))
        assert sorted(np.floor(y * n).astype(int)) == list(range(n))
