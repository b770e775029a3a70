"""Where cloth passes through cloth, and how near it comes: as ipc-toolkit finds it on meshes in disorder."""

from __future__ import annotations

from math import sqrt

import ipctk
import numpy as np
import pytest

from nuno.collision import crossings
from nuno.collision import crossings as pairs
from nuno.collision.crossings import Mesh, NearPairs, cross, find_crossings, mesh_of, near_pairs
from nuno.collision.distance import least_distance, vertex_distances
from nuno_bench import piles
from nuno_schemas.fabric import Float

SEEDS = range(20)
quick = pytest.mark.quick(seed=range(4))


def disorder(seed: int) -> tuple[Float, Mesh]:
    """Triangles in disorder: flat, long and small."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((int(rng.integers(6, 50)), 3)) * rng.choice([0.1, 1.0, 5.0], 3)
    return x, mesh_of(np.array([rng.choice(len(x), 3, replace=False) for _ in range(40)], np.int32))


def all_pairs(mesh: Mesh) -> list[tuple[int, int]]:
    """Edges and triangles by number that share no vertex."""
    return [
        (e, f)
        for e, edge in enumerate(mesh.edges.tolist())
        for f, face in enumerate(mesh.faces.tolist())
        if not {*edge} & {*face}
    ]


@quick
@pytest.mark.parametrize("seed", SEEDS)
def test_crossings_are_those_that_ipctk_finds(seed: int) -> None:
    """Each pair once."""
    x, mesh = disorder(seed)
    near = near_pairs(x, mesh, 0.0)
    assert len(set(zip(*(number.tolist() for number in near), strict=True))) == len(near[0])
    found = find_crossings(x, mesh, near)
    through = [(*a, *b) for a, b in zip(found.edges.tolist(), found.triangles.tolist(), strict=True)]
    expected = [
        (*mesh.edges[e].tolist(), *mesh.faces[f].tolist())
        for e, f in all_pairs(mesh)
        if ipctk.is_edge_intersecting_triangle(*x[mesh.edges[e]], *x[mesh.faces[f]])
    ]
    assert sorted(set(through)) == sorted(set(expected))
    assert len(found.places) == len(found.edges)


@quick
@pytest.mark.parametrize("seed", SEEDS)
def test_the_least_distance_is_that_which_ipctk_finds(seed: int) -> None:
    """Of vertices from triangles and of edges from edges, over all that share no vertex; and no less is found of more
    than what is looked for.
    """
    x, mesh = disorder(seed)
    apart = [
        (e, f)
        for e, f in all_pairs(mesh)
        if not ipctk.is_edge_intersecting_triangle(*x[mesh.edges[e]], *x[mesh.faces[f]])
    ]
    squares = [ipctk.point_triangle_distance(x[v], *x[mesh.faces[f]]) for e, f in apart for v in mesh.edges[e]] + [
        ipctk.edge_edge_distance(*x[mesh.edges[e]], *x[mesh.edges[s]]) for e, f in apart for s in mesh.sides[f]
    ]
    least = sqrt(min(squares))
    for within in (1.01 * least, 0.99 * least):
        edge, face = near_pairs(x, mesh, within)
        kept = [pair in set(apart) for pair in zip(edge.tolist(), face.tolist(), strict=True)]
        found = least_distance(x, mesh, (edge[kept], face[kept]), within)
        assert found == (pytest.approx(least, rel=1e-9, abs=1e-15) if within > least else None)


@quick
@pytest.mark.parametrize("seed", SEEDS)
def test_each_vertex_is_as_near_as_ipctk_finds(seed: int) -> None:
    """Of its triangles, and of the vertices of others from the triangles that it is a corner of."""
    x, mesh = disorder(seed)
    expected = np.full(len(x), np.inf)
    for e, f in all_pairs(mesh):
        for v in mesh.edges[e].tolist():
            distance = sqrt(ipctk.point_triangle_distance(x[v], *x[mesh.faces[f]]))
            expected[[v, *mesh.faces[f]]] = np.minimum(expected[[v, *mesh.faces[f]]], distance)
    within = float(np.median(expected))
    found = vertex_distances(x, mesh, near_pairs(x, mesh, within), within)
    assert found == pytest.approx(np.minimum(expected, within), rel=1e-9, abs=1e-15)


@quick
@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_found_of_near_pairs_has_the_bits_of_all_pairs(seed: int) -> None:
    """On triangles large and small, far from the origin."""
    x, mesh = disorder(seed)
    x = 0.1 * x + np.random.default_rng(seed).choice([0.0, 1.0, 100.0], 3)
    every = np.array(all_pairs(mesh)).T
    found, expected = find_crossings(x, mesh), find_crossings(x, mesh, (every[0], every[1]))
    for name in ("edges", "triangles", "places"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    apart = every[:, ~cross(x[mesh.edges[every[0]]], x[mesh.faces[every[1]]])]
    least = least_distance(x, mesh, (apart[0], apart[1]), np.inf)
    assert least is not None
    edge, face = near_pairs(x, mesh, 1.1 * least)
    kept = ~cross(x[mesh.edges[edge]], x[mesh.faces[face]])
    assert least_distance(x, mesh, (edge[kept], face[kept]), 1.1 * least) == least


@pytest.mark.parametrize("within", [0.0, 0.01])
def test_pairs_of_frame_after_frame_are_those_of_each_alone(within: float) -> None:
    """Of a sheet that lies still askew in another, creeps on in it, leaps, and creeps on."""
    across, along = np.meshgrid(np.arange(12.0), np.arange(12.0))
    sheet = np.stack([across.ravel(), along.ravel(), np.zeros(144)], axis=1)
    low = (np.arange(11)[:, None] * 12 + np.arange(11)).ravel()
    faces = np.stack([low, low + 1, low + 12], axis=1)
    x = np.concatenate([sheet, sheet @ np.array([[1.0, 0.0, 0.1], [0.0, 1.0, 0.1], [0.0, 0.0, 1.0]]) - [3.0, 3.0, 0.7]])
    mesh, way = mesh_of(np.concatenate([faces, faces + 144]).astype(np.int32)), np.repeat([0.0, 1.0], 144)[:, None]
    kept, looked = NearPairs(mesh, within), 0
    for pace in [0.0, 0.0, *[0.05] * 40, 1.5, *[0.05] * 40, *[0.3] * 5]:
        x = x + pace * way * [0.8, 0.6, 0.0]
        before = kept.found_at
        for found, expected in zip(kept.at(x), near_pairs(x, mesh, within), strict=True):
            np.testing.assert_array_equal(found, expected)
        looked += kept.found_at is not before
    assert looked < 30


@pytest.mark.parametrize("at_once", [1, 7, 100])
def test_pairs_are_the_same_however_many_are_looked_at_together(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    x, mesh = disorder(3)
    expected = near_pairs(x, mesh, 0.1)
    monkeypatch.setattr(pairs, "AT_ONCE", at_once)
    assert np.array_equal(near_pairs(x, mesh, 0.1), expected)


@pytest.mark.parametrize("most", [0, 1, 30])
def test_pairs_are_the_same_however_many_cells_a_box_is_looked_for_in(
    most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    x, mesh = disorder(3)
    expected = near_pairs(x, mesh, 0.1)
    monkeypatch.setattr(pairs, "MOST_OF_ONE", most)
    for one, other in zip(near_pairs(x, mesh, 0.1), expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_vertex_far_away_takes_no_room() -> None:
    """Cells as wide as triangles, all about one with a side of 100 m, would be 10^10."""
    sheet = piles.sheet(40, 0.4)
    x, mesh = sheet.position.copy(), mesh_of(sheet.faces)
    x[800] += [0.0, 100.0, 50.0]
    edge, face = near_pairs(x, mesh, 0.0)
    assert 0 < len(edge) < 20 * len(mesh.faces)
    assert len(find_crossings(x, mesh, (edge, face)).edges) == 0


def test_an_edge_that_ends_next_to_a_triangle_is_told_from_one_that_goes_through() -> None:
    """By 1e-12 m, at ten metres from the origin."""
    triangle = np.array([[[12.1, 0.3, 7.7], [13.9, 0.1, 8.3], [12.7, 1.9, 9.1]]])
    foot = triangle[0].mean(axis=0)
    normal = np.cross(triangle[0, 1] - triangle[0, 0], triangle[0, 2] - triangle[0, 0])
    start = foot - 1e-3 * normal
    ends = foot + 1e-12 * normal, foot - 1e-12 * normal
    assert [bool(cross(np.array([[start, end]]), triangle)[0]) for end in ends] == [True, False]


def test_flat_cloth_is_told_apart_without_fractions(monkeypatch: pytest.MonkeyPatch) -> None:
    """All signs of a level or leaning sheet are 0 but for rounding; and one that it goes through is still found."""
    row, column = np.divmod(np.arange(64), 8)
    at = np.arange(64).reshape(8, 8)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    mesh = mesh_of(np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32))
    for lean in (0.0, 0.3):
        x = 0.01 * np.stack([column, lean * row, row], axis=1)
        near = near_pairs(x, mesh, 0.02)
        assert len(near[0]) > 100
        with monkeypatch.context() as patch:
            patch.setattr(crossings, "_exact_side", lambda *points: pytest.fail("in fractions"))
            assert not len(find_crossings(x, mesh, near).places)
        x[0] = x[27] + [0.003, -0.05, 0.002]  # the corner is drawn through the middle
        x[1] = x[27] + [0.003, 0.05, 0.002]
        assert len(find_crossings(x, mesh, near_pairs(x, mesh, 0.0)).places)
