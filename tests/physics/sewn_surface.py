"""What a sewn garment's triangles measure, and whether they are one surface."""

from __future__ import annotations

import numpy as np

from nuno_cloth.models.triangles import find_edges
from nuno_cloth.sewing.pattern import Pattern, find_openings
from nuno_cloth.sewing.sew import Sewn
from nuno_schemas.fabric import Float


def areas(sewn: Sewn) -> Float:
    """(f,) of triangles as they are cut, counter-clockwise more than 0 [m^2]."""
    a, b, c = (sewn.flat[sewn.faces[:, k]] for k in range(3))
    one, two = b - a, c - a
    return np.asarray(0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]))


def angles(sewn: Sewn) -> Float:
    """(f,) least angle of each triangle as it is cut [deg]."""
    found = []
    for k in range(3):
        here, one, two = (sewn.flat[sewn.faces[:, (k + i) % 3]] for i in range(3))
        u, v = one - here, two - here
        found.append(np.degrees(np.arctan2(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]), (u * v).sum(axis=1))))
    return np.min(found, axis=0)


def loops(sewn: Sewn) -> list[set[int]]:
    """Cut vertices, by sewn ones, round each hole of the surface. Each is left once and come to once."""
    faces = sewn.sewn_faces
    ways = {(int(a), int(b)) for k in range(3) for a, b in zip(faces[:, k], faces[:, (k + 1) % 3], strict=True)}
    after = {a: b for a, b in ways if (b, a) not in ways}
    assert len(after) == sum((b, a) not in ways for a, b in ways) and set(after) == set(after.values())
    found = []
    while after:
        first = here = next(iter(after))
        loop = set[int]()
        while here not in loop:
            loop.add(here)
            here = after.pop(here)
        assert here == first
        found.append(loop)
    return found


def require_surface(cut: Pattern, sewn: Sewn) -> None:
    """Two triangles at most share a side, and run along it in opposite ways; holes are the pattern's openings."""
    faces = sewn.sewn_faces
    edges = find_edges(faces)
    assert edges.count.max() <= 2 and len(edges.inner) == (edges.count == 2).sum()
    assert (np.sort(faces, axis=1)[:, :2] != np.sort(faces, axis=1)[:, 1:]).all()
    assert np.array_equal(np.unique(faces), np.arange(sewn.number))
    place = {name: k for k, name in enumerate(sewn.names)}
    expected = []
    for opening in find_openings(cut):
        runs = [sewn.edges[place[name]][edge] for name, edge in opening]
        expected.append({int(sewn.merged[vertex]) for run in runs for vertex in run})
    assert sorted(map(sorted, loops(sewn))) == sorted(map(sorted, expected))


def lengths(sewn: Sewn) -> Float:
    """(3 f,) of triangles' sides as they are cut [m]."""
    return np.asarray(
        np.linalg.norm(np.roll(sewn.flat[sewn.faces], -1, axis=1) - sewn.flat[sewn.faces], axis=2).ravel()
    )
