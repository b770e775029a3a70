"""Laws of visibility: which samples a triangle covers, and which triangle is in front."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from nuno_render.raster import rasterise, sample_offsets

SIZE = 64


def draw(clip, faces, samples=1, order=None, near=1e-3, two_sided=True):
    """Covered samples, and the owner (SIZE, SIZE, samples) of each."""
    faces = np.asarray(faces, np.int32).reshape(-1, 3)
    depth = np.zeros((SIZE, SIZE, samples), np.float32)
    owner = np.full(depth.shape, -1, np.int32)
    mesh, sides = np.zeros(len(faces), np.int32), np.array([two_sided])
    covered = rasterise(np.asarray(clip, float), faces, mesh, sides, near, sample_offsets(samples), 128, depth, owner)
    return covered, owner


def flat(points, w=1.0):
    """Homogeneous pixels of points (n, 2) at distance w."""
    return np.column_stack([points, np.ones(len(points))]) * np.broadcast_to(w, len(points))[:, None]


@pytest.mark.parametrize("samples", [1, 4, 8, 16])
def test_area_matches_covered_samples(samples):
    # Jarnik: a closed curve of length L >= 1 holds N lattice points with |N - A| < L. Each of the
    # sample positions is one such lattice; rounding to 1/256 pixel moves the area by less than L/256.
    random = np.random.default_rng(1)
    for _ in range(200):
        p = random.uniform(2, SIZE - 2, (3, 2))
        area = 0.5 * abs(np.linalg.det(np.column_stack([p[1] - p[0], p[2] - p[0]])))
        length = sum(np.linalg.norm(p[i] - p[i - 1]) for i in range(3))
        covered, _ = draw(flat(p), [0, 1, 2], samples)
        assert abs(covered - samples * area) < samples * (length + length / 256)


@pytest.mark.parametrize("seed", range(5))
def test_triangulation_covers_every_sample_once(seed):
    # Points on sample positions and on pixel corners too: the cases where rounding decides.
    random = np.random.default_rng(seed)
    points = random.uniform(0, SIZE, (150, 2))
    points[:60] = np.floor(points[:60]) + 0.5
    points[60:90] = np.floor(points[60:90] * 16) / 16
    points = np.unique(np.vstack([points, [[-9, -9], [SIZE + 9, -9], [-9, SIZE + 9], [SIZE + 9, SIZE + 9]]]), axis=0)
    rounded = np.round(points * 256) / 256
    faces = Delaunay(rounded).simplices
    faces[::2] = faces[::2, ::-1]  # orientation must not matter for two-sided cloth
    for samples in (1, 8):
        covered, owner = draw(flat(rounded), faces, samples)
        assert covered == SIZE * SIZE * samples
        assert (owner >= 0).all()


def test_nearest_surface_wins_whatever_the_order():
    # Two triangles that cross: 1/w is affine on the screen, so the front one follows from it.
    p = np.array([[-40.0, -40.0], [260.0, -40.0], [-40.0, 260.0]])
    depths = [np.array([2.0, 6.0, 3.0]), np.array([2.6, 2.0, 4.0])]
    clip = np.vstack([flat(p, w) for w in depths])
    _, owner = draw(clip, [[0, 1, 2], [3, 4, 5]])
    _, swapped = draw(clip, [[3, 4, 5], [0, 1, 2]])
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    s, t = (x + 40) / 300, (y + 40) / 300
    inverse = [(1 - s - t) / w[0] + s / w[1] + t / w[2] for w in depths]
    clear = np.abs(inverse[0] - inverse[1]) > 1e-6
    expected = np.where(inverse[0] > inverse[1], 0, 1)
    assert 0.2 < expected.mean() < 0.8
    assert (owner[..., 0] == expected)[clear].all()
    assert (swapped[..., 0] == 1 - expected)[clear].all()


def test_triangle_that_crosses_the_near_plane_covers_what_is_in_front():
    # The floor y = 1 below an eye at the origin looks like the half plane under the horizon, up
    # to where it ends; one corner lies far behind the eye.
    focal, middle = 40.0, SIZE / 2
    corners = np.array([[-400.0, 1.0, 50.0], [400.0, 1.0, 50.0], [0.0, 1.0, -400.0]])
    x, y, z = corners.T
    clip = np.column_stack([focal * x + middle * z, focal * y + middle * z, z])
    _, owner = draw(clip, [0, 1, 2])
    rows = np.arange(SIZE) + 0.5
    distance = np.divide(focal, rows - middle, out=np.full(SIZE, np.inf), where=rows > middle)
    seen = (owner[..., 0] == 0).all(axis=1)
    assert (seen == (distance < 50.0)).all()
    assert ((owner[..., 0] == 0).any(axis=1) == seen).all()


def test_nothing_behind_the_eye_is_drawn():
    clip = flat(np.array([[5.0, 5.0], [60.0, 5.0], [5.0, 60.0]]), -1.0)
    assert draw(clip, [0, 1, 2])[0] == 0


def test_one_sided_triangles_show_one_side():
    p = flat(np.array([[5.0, 5.0], [60.0, 5.0], [5.0, 60.0]]))
    front, back = draw(p, [0, 2, 1], two_sided=False)[0], draw(p, [0, 1, 2], two_sided=False)[0]
    assert front == draw(p, [0, 1, 2])[0] > 0
    assert back == 0
