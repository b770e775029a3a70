"""Where cloth passes through cloth: as ipc-toolkit finds it on meshes in disorder, and to the last digits."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest

from nuno.collision.crossings import cross, edges_of, find_crossings


@pytest.mark.parametrize("seed", range(20))
def test_crossings_are_those_that_ipctk_finds(seed: int) -> None:
    """Each pair once, of flat, long and small meshes."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((int(rng.integers(6, 50)), 3)) * rng.choice([0.1, 1.0, 5.0], 3)
    faces = np.array([rng.choice(len(x), 3, replace=False) for _ in range(40)], np.int32)
    edges = edges_of(faces)
    found = find_crossings(x, faces, edges)
    pairs = {(*a, *b) for a, b in zip(found.edges.tolist(), found.triangles.tolist(), strict=True)}
    expected = [
        (*edge, *face)
        for edge in edges.tolist()
        for face in faces.tolist()
        if not {*edge} & {*face} and ipctk.is_edge_intersecting_triangle(*x[edge], *x[face])
    ]
    assert sorted(pairs) == sorted(set(expected))
    assert len(found.places) == len(found.edges)


def test_an_edge_that_ends_next_to_a_triangle_is_told_from_one_that_goes_through() -> None:
    """By 1e-12 m, at ten metres from the origin."""
    triangle = np.array([[[12.1, 0.3, 7.7], [13.9, 0.1, 8.3], [12.7, 1.9, 9.1]]])
    foot = triangle[0].mean(axis=0)
    normal = np.cross(triangle[0, 1] - triangle[0, 0], triangle[0, 2] - triangle[0, 0])
    start = foot - 1e-3 * normal
    ends = foot + 1e-12 * normal, foot - 1e-12 * normal
    assert [bool(cross(np.array([[start, end]]), triangle)[0]) for end in ends] == [True, False]
