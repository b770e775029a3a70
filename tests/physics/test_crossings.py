"""Where cloth passes through cloth, and how near it comes: as ipc-toolkit finds it on meshes in disorder."""

from __future__ import annotations

from math import sqrt

import ipctk
import numpy as np
import pytest

from nuno.collision import crossings
from nuno.collision.crossings import Mesh, cross, find_crossings, look, mesh_of, near_pairs
from nuno.collision.distance import vertex_distances
from nuno_bench import piles
from nuno_schemas.fabric import Float, Int

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
        ipctk.edge_edge_distance(*x[mesh.edges[e]], *x[mesh.faces[f][sides]])
        for e, f in apart
        for sides in ([0, 1], [1, 2], [2, 0])
    ]
    least = sqrt(min(squares))
    for within in (1.01 * least, 0.99 * least):
        edge, face = near_pairs(x, mesh, within)
        kept = [pair in set(apart) for pair in zip(edge.tolist(), face.tolist(), strict=True)]
        found = look(x, mesh, (edge[kept], face[kept]), within)[1]
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
    least = look(x, mesh, (apart[0], apart[1]), np.inf)[1]
    assert least is not None
    edge, face = near_pairs(x, mesh, 1.1 * least)
    kept = ~cross(x[mesh.edges[edge]], x[mesh.faces[face]])
    assert look(x, mesh, (edge[kept], face[kept]), 1.1 * least)[1] == least


def boxes_that_meet(x: Float, mesh: Mesh, some: Int, within: float) -> set[tuple[int, int]]:
    """Some edges, and triangles that share no vertex with them and are near along each axis of space, by number."""
    edges = mesh.edges[some]
    (low, high), (bottom, top) = ((x[each].min(axis=1), x[each].max(axis=1)) for each in (edges, mesh.faces))
    near = ((low[:, None] - within <= top) & (bottom <= high[:, None] + within)).all(axis=2)
    near &= (edges[:, None, :, None] != mesh.faces[:, None]).all(axis=(2, 3))
    edge, face = np.nonzero(near)
    return set(zip(some[edge].tolist(), face.tolist(), strict=True))


@pytest.mark.quick(side=[2, 4, 12])
@pytest.mark.parametrize("side", [2, 4, 12, 34])
def test_all_near_pairs_are_found_in_frame_after_frame(side: int) -> None:
    """Of sheets that lie askew in each other, fly apart, fold, scatter and are drawn out: of 4 to 4,356 triangles, so
    that boxes are full, and not, on each level; few others, and each once.
    """
    sheet, rng = piles.sheet(side, 0.01 * (side - 1)), np.random.default_rng(side)
    n = sheet.number
    x = np.concatenate([sheet.position, sheet.position @ np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.1, 1.0]])])
    x += 3e-4 * rng.standard_normal(x.shape)
    mesh = mesh_of(np.concatenate([sheet.faces, sheet.faces + n]).astype(np.int32))
    some = rng.choice(len(mesh.edges), min(300, len(mesh.edges)), replace=False)
    off, right = np.repeat([[0.0], [1.0]], n, axis=0) * [0.1, 0.3, 0.0], x[:, :1] > 0.8 * x[:, 0].max()
    frames = [x, x + off, np.abs(x - x.mean(axis=0)), 1e-3 * x + 1e3, x + 0.02 * rng.standard_normal(x.shape)]
    frames += [np.where(right, 100.0 * x, x), x]
    for points in frames:
        for within in (0.0, 0.003):
            edge, face = near_pairs(points, mesh, within)
            chosen = np.isin(edge, some)
            found = list(zip(edge[chosen].tolist(), face[chosen].tolist(), strict=True))
            expected = boxes_that_meet(points, mesh, some, within)
            assert len(found) == len(set(found)) and expected <= set(found)
            assert len(found) <= 1.5 * len(expected) + 100 or np.ptp(points) > 1.0


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
