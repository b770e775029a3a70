"""Lists of pairs that may come near: none is lost, on any mesh, by boxes that are rounded outward."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from sheets import Pile

from nuno_bench import piles
from nuno_contact.offset.candidate_pairs import choose_near, foretell, keep_strayed, make_list, unit_lanes
from nuno_contact.offset.contact_state import (
    LIST_BEGUN,
    LIST_WINDOW,
    LISTED,
    NEAR,
    NEAR_BEGUN,
    NEAR_WINDOW,
    NOW,
    WITH_FACES,
    ContactState,
)
from nuno_contact.offset.proximity import closest, point, unit, weigh
from nuno_contact.offset.tree import MovingTree, find_pairs, fit_tree, make_tree, near_leaves
from nuno_kernels import kernel
from nuno_kernels.lanes import load, store
from nuno_schemas.fabric import Bool, Float, Int

Mesh = tuple[Float, Int]


def grid(rng: np.random.Generator, rows: int, columns: int, width: float = 0.01, height: float = 0.01) -> Mesh:
    """A waved sheet of triangles between (rows, columns) vertices."""
    i, k = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    x = np.stack([height * i, 0.01 * np.sin(2.0 * k), width * k], axis=-1).reshape(-1, 3)
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b, c, d = a + columns, a + 1, a + columns + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([c, b, d], axis=1)])
    return x + rng.normal(0.0, 2e-4, x.shape), faces.astype(np.int32)


def joined(*meshes: Mesh) -> Mesh:
    """Several pieces."""
    first = np.cumsum([0, *(len(x) for x, _ in meshes)])
    faces = [faces + np.int32(before) for (_, faces), before in zip(meshes, first, strict=False)]
    return np.concatenate([x for x, _ in meshes]), np.concatenate(faces)


def scattered(rng: np.random.Generator, pieces: int, span: float) -> Mesh:
    """Pieces of two triangles and more, near to each other or far apart."""
    sizes = rng.integers(2, 5, (pieces, 2)).tolist()
    meshes = [grid(rng, rows, columns) for rows, columns in sizes]
    return joined(*((x + rng.uniform(-span, span, 3), faces) for x, faces in meshes))


def fan(rng: np.random.Generator, blades: int) -> Mesh:
    """Long triangles round one vertex."""
    angle = np.linspace(0.0, 2.0 * np.pi, blades, endpoint=False)
    rim = np.stack([np.cos(angle), rng.normal(0.0, 0.1, blades), np.sin(angle)], axis=1)
    one = 1 + np.arange(blades)
    faces = np.stack([np.zeros(blades, np.int64), one, np.roll(one, -1)], axis=1)
    return np.concatenate([np.zeros((1, 3)), 0.1 * rim]), faces.astype(np.int32)


MESHES: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "a sheet": lambda rng: grid(rng, 17, 19),
    "slivers": lambda rng: grid(rng, 6, 60, width=3e-5, height=0.05),
    "a ribbon one cell wide": lambda rng: grid(rng, 120, 2),
    "a triangle": lambda rng: (rng.normal(0.0, 0.01, (3, 3)), np.array([[0, 1, 2]], np.int32)),
    "many small pieces": lambda rng: scattered(rng, 40, 0.03),
    "pieces in a wide scene": lambda rng: scattered(rng, 40, 3e3),
    "two sheets far from the origin": lambda rng: joined(*(
        (x + np.array([4e4 + 3e-3 * k, -7e4, 1e4]), faces)
        for k, (x, faces) in enumerate(grid(rng, 12, 12) for _ in range(2))
    )),
    "large triangles and small ones": lambda rng: joined(grid(rng, 3, 3, 5.0, 5.0), grid(rng, 12, 12)),
    "a fan": lambda rng: fan(rng, 150),
}  # fmt: skip


def ways_of(rng: np.random.Generator, x: Float, speed: float) -> Float:
    """Ways of vertices that go somewhere together, and each somewhere else, with room round each."""
    ways = np.zeros((len(x), 8))
    ways[:, :3] = x
    ways[:, 3:6] = x + rng.normal(0.0, speed, 3) + rng.normal(0.0, 0.1 * speed, x.shape)
    ways[:, 6] = rng.uniform(0.0, 2e-3, len(x))
    return ways


def boxes_meet(ways: Float, one: Int, other: Int, radius: float) -> Bool:
    """Which boxes of primitives of vertices one (k, c) and other (l, d), widened, meet at the beginning of the ways or
    at their end, as seen along each axis from each side, (k, l).
    """

    def box(of: Int) -> tuple[Float, Float]:
        room = ways[of, 6:7] + 0.5 * radius
        return (ways[of, :6] - room).min(axis=1), (ways[of, :6] + room).max(axis=1)

    (low, high), (base, top) = box(one), box(other)
    gaps = np.stack([low[:, None] - top, base - high[:, None]], axis=-1).reshape(len(one), len(other), 2, 3, 2)
    return np.asarray((gaps.min(axis=2) <= 0.0).all(axis=(-1, -2)))


def found_by(tree: MovingTree, bodies: bool) -> tuple[Int, Int]:
    """Vertices and triangles (k, 2), and edges (l, 2), lower numbers first, that the tree finds."""
    leaves, found = near_leaves(tree, bodies), []
    room, four = np.empty((2, 10000), np.int32), np.empty((10000, 4), np.int32)
    for of_edges in (False, True):
        first, some = 0, [np.empty((2, 0), np.int32)]
        while first < len(leaves):
            first, number = find_pairs(tree, of_edges, leaves, first, room, four)
            some.append(room[:, :number].copy())
        found.append(np.concatenate(some, axis=1).T)
    return found[0], np.sort(found[1], axis=1)


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("speed", [0.0, 0.02, 3.0])
def test_the_tree_finds_all_pairs_whose_boxes_meet_once(kind: str, speed: float) -> None:
    """And none that share a vertex, nor any of two bodies; rounding adds hardly any where triangles are alike."""
    rng = np.random.default_rng(7)
    x, faces = MESHES[kind](rng)
    for of_cloth in {len(faces), (len(faces) + 1) // 2}:
        bodies = np.unique(faces[of_cloth:])
        if np.intersect1d(bodies, faces[:of_cloth]).size:
            x, faces = joined((x, faces[:of_cloth]), (x, faces[of_cloth:]))
        tree, radius = make_tree(x, faces, of_cloth), 1e-3
        ways = ways_of(rng, x, speed)
        fit_tree(tree, ways, radius)
        found = found_by(tree, of_cloth < len(faces))
        assert all(len(np.unique(pairs, axis=0)) == len(pairs) for pairs in found)
        first, corner = np.isin(np.arange(len(x)), faces[:of_cloth]), np.arange(len(x))[:, None]
        for pairs, of, other in ((found[0], corner, faces), (found[1], tree.edges, tree.edges)):
            met = boxes_meet(ways, of, other, radius) & (first[of[:, :1]] | first[other[:, 0]])
            met &= (of[:, None, :, None] != other[None, :, None, :]).all(axis=(2, 3))
            met &= np.isin(of[:, :1], faces)
            wanted = np.argwhere(np.triu(met) if other is tree.edges else met)
            missing = set(map(tuple, wanted.tolist())) - set(map(tuple, pairs.tolist()))
            assert not missing
            sharing = (of[pairs[:, 0]][:, :, None] == other[pairs[:, 1]][:, None, :]).any()
            assert not sharing
            if kind == "a sheet" and speed < 1.0:
                assert len(pairs) <= 1.02 * len(wanted) + 3


@kernel
def distances(x: Float, four: Int, with_faces: int, out: Float) -> None:
    """Write the distances [m] of pairs four (k, 4), of vertices x (3, n); those with triangles stand first."""
    for p in range(four.shape[0]):
        here = point(x, four[p, 0]), point(x, four[p, 1]), point(x, four[p, 2]), point(x, four[p, 3])
        out[p] = unit(weigh(closest(p >= with_faces, here).weights, here))[1]


def all_pairs(m: ContactState) -> tuple[Int, int]:
    """All pairs (k, 4) of vertices without a common one, and how many of them, the first, have triangles."""
    faces, edges = m.tree.faces, m.tree.edges
    v, f = (one.ravel() for one in np.meshgrid(np.arange(m.last.shape[1]), np.arange(len(faces)), indexing="ij"))
    e, o = np.triu_indices(len(edges), 1)
    with_faces, of_edges = np.column_stack([v, faces[f]]), np.column_stack([edges[e], edges[o]])
    with_faces = with_faces[(with_faces[:, :1] != with_faces[:, 1:]).all(axis=1)]
    of_edges = of_edges[(of_edges[:, :2, None] != of_edges[:, None, 2:]).all(axis=(1, 2))]
    return np.concatenate([with_faces, of_edges]).astype(np.int32), len(with_faces)


def listed(m: ContactState, pairs: Int) -> set[tuple[int, ...]]:
    """The pairs of these numbers, each edge and the two of them with lower numbers first."""
    four, of_edges = m.pairs.vertices[pairs], m.pairs.face[pairs] < 0
    return {alike(one, edge) for one, edge in zip(four.tolist(), of_edges.tolist(), strict=True)}


def alike(four: list[int], of_edges: bool) -> tuple[int, ...]:
    """A pair by numbers that do not depend on their order."""
    if of_edges:
        return tuple(sum(sorted([sorted(four[:2]), sorted(four[2:])]), [-1]))
    return (four[0], *sorted(four[1:]))


def crumpled_sheets(rng: np.random.Generator) -> tuple[ContactState, Float]:
    """Three sheets that meet, and where their vertices are now, (3, n)."""
    pieces = []
    for k in range(3):
        piece = piles.sheet(6, 0.04, irregular=k == 1)
        piece.position[:] += rng.normal(0.0, 1e-4, piece.position.shape) + np.array([0.0, 3e-3 * k, 0.0])
        pieces.append(piece)
    m = Pile(*pieces, dt=1e-3).meeting
    crumpled = (m.surface.start + rng.normal(0.0, 2e-3, m.last.shape)) * [[0.7], [1.0], [0.8]]
    return m, np.ascontiguousarray(crumpled)


def strays_of(rng: np.random.Generator, spread: Float) -> Float:
    """Ways (3, n) of these lengths [m], anywhere."""
    off = rng.normal(0.0, 1.0, (3, len(spread)))
    return np.asarray(off * spread / np.linalg.norm(off, axis=0))


@pytest.mark.parametrize("seed", range(3))
def test_what_comes_within_the_thickness_is_listed_and_near(seed: int) -> None:
    """Of crumpled sheets whose vertices go their ways, and stray from them as far as they may, at any time."""
    rng = np.random.default_rng(seed)
    m, crumpled = crumpled_sheets(rng)
    n, h, plan = m.last.shape[1], float(m.surface.law[0]), m.plan
    motion = rng.normal(0.0, 5e-3, (3, 1)) + rng.normal(0.0, 2e-3, (3, n))
    for which in range(2):
        plan.reference[3 * which : 3 * which + 3], plan.motion[3 * which : 3 * which + 3] = crumpled, motion
        plan.spread[which] = rng.uniform(0.0, 2e-3, n) if which == 0 else 0.5 * plan.spread[0]
    make_list(m, None)
    choose_near(m, None)
    four, with_faces = all_pairs(m)
    names = [alike(one, p >= with_faces) for p, one in enumerate(four.tolist())]
    every, near = listed(m, np.arange(m.counts[LISTED])), listed(m, m.pairs.near[: m.counts[NEAR]])
    assert m.counts[LISTED] == len(every) > len(near) > 100
    assert (m.pairs.face[: m.counts[WITH_FACES]] >= 0).all()
    assert (m.pairs.face[m.counts[WITH_FACES] : m.counts[LISTED]] < 0).all()
    distance, came = np.empty(len(four)), 0
    for share in (0.0, 0.2, 0.5, 0.9, 1.0):
        for which, known in enumerate((every, near)):
            distances(crumpled + share * motion + strays_of(rng, plan.spread[which]), four, with_faces, distance)
            close = np.flatnonzero(distance < h)
            came += len(close)
            assert {names[p] for p in close.tolist()} <= known
    assert came > 100


@pytest.mark.parametrize(("begin", "window"), [(0.0, 0.2), (0.3, 0.1), (0.6, 0.4), (0.8, 0.5)])
def test_what_comes_within_the_thickness_is_chosen_as_the_list_grows_old(begin: float, window: float) -> None:
    """Vertices are off the list's plan by then, and go other ways; few of what stays apart is looked at again."""
    rng = np.random.default_rng(7)
    m, crumpled = crumpled_sheets(rng)
    n, h, plan = m.last.shape[1], float(m.surface.law[0]), m.plan
    plan.reference[:3], plan.motion[:3] = crumpled, rng.normal(0.0, 4e-3, (3, n))
    plan.spread[:] = [[3e-3], [1e-4]]
    plan.reference[3:] = crumpled + begin * plan.motion[:3] + strays_of(rng, rng.uniform(0.0, 1e-3, n))
    plan.motion[3:] = window * (plan.motion[:3] + rng.normal(0.0, 1e-3, (3, n)))
    m.clock[[NOW, LIST_BEGUN, LIST_WINDOW, NEAR_BEGUN, NEAR_WINDOW]] = 5.0, 5.0 - 4.0 * begin, 4.0, 5.0, 4.0 * window
    make_list(m, None)
    choose_near(m, None)
    number, faces, came = int(m.counts[LISTED]), int(m.counts[WITH_FACES]), 0
    near, distance = set(m.pairs.near[: m.counts[NEAR]].tolist()), np.empty(number)
    for share in np.linspace(0.0, min(1.0, (1.0 - begin) / window), 7):
        x = plan.reference[3:] + share * plan.motion[3:] + strays_of(rng, plan.spread[1])
        distances(np.ascontiguousarray(x), m.pairs.vertices[:number], faces, distance)
        close = set(np.flatnonzero(distance < h).tolist())
        came += len(close)
        assert close <= near
    off, kept = np.empty((1, n)), np.empty(number, np.int32)
    at = foretell(m, off)
    strayed = [
        int(keep_strayed(m, of_edges, kept[: stop - start], start, off, *at))
        for of_edges, start, stop in ((False, 0, faces), (True, faces, number))
    ]
    assert came > 100 and len(near) <= sum(strayed) < 0.7 * number


def test_leaves_are_full_and_memory_grows_with_the_mesh_alone() -> None:
    """Bytes of the tree for a triangle, of three sizes of a sheet."""
    sizes = []
    for side in (41, 81, 161):
        tree = make_tree(*grid(np.random.default_rng(0), side, side))
        sizes.append(sum(array.nbytes for array in tree) / len(tree.faces))
        assert (tree.number[tree.start[:-1, 0]] >= 0).all()
        assert len(tree.start) == -(-len(tree.faces) // 16)
    assert max(sizes) < 500.0
    assert max(sizes) < 1.1 * min(sizes)


@kernel
def write_directions(v: Float, out: Float) -> None:
    """Write the directions of eight vectors (3, 8)."""
    n = unit_lanes((load(v, 0, 0), load(v, 1, 0), load(v, 2, 0)))
    for row in range(3):
        store(out, row, 0, n[row])


@pytest.mark.parametrize("size", [0.0, 5e-324, 1e-200, 1e-162, 1e-155, 1e-151, 1e-149, 1e-20, 1.0, 1e100])
def test_no_direction_is_longer_than_1(size: float) -> None:
    """A longer one would keep apart what touches."""
    v, out = np.random.default_rng(5).normal(0.0, 1.0, (3, 8)), np.empty((3, 8))
    write_directions(size * v / np.linalg.norm(v, axis=0), out)
    assert (np.linalg.norm(out, axis=0) <= 1.0 + 1e-15).all()
    assert size < 1e-140 or np.allclose(out, v / np.linalg.norm(v, axis=0), rtol=1e-14)
