"""Ridge and valley lines at random over random meshes: whether what comes out is whole, each time.

Every line is drawn by the operation as a user's would be, or refused; of what it makes everything is counted
again here, in another way.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from nuno.plugin_contract import registry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Hinges, Int, Springs, State

MOST_SIDE = 14
"""Vertices along the side of a mesh, at most."""


def random_mesh(rng: np.random.Generator) -> tuple[Float, Int]:
    """Vertices (n, 3) [m] and faces (f, 3): a sheet, a tube or a ball, its vertices moved, its diagonals at random."""
    kind = rng.integers(3)
    rows, cols = (int(k) for k in rng.integers(4, MOST_SIDE, 2))
    r, c = np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij")
    u = c + rng.uniform(-0.3, 0.3, c.shape) * (rng.random() < 0.7)
    v = r + rng.uniform(-0.3, 0.3, c.shape) * (rng.random() < 0.7)
    around = 2.0 * np.pi * u / cols
    if kind == 0:
        folds = rng.uniform(0.0, 0.6) * np.sin(u * rng.uniform(0.1, 1.5) + v * rng.uniform(-1.0, 1.0))
        x = np.stack([u, -v, folds], -1) / cols
    elif kind == 1:
        radius = (1.0 + rng.uniform(0.0, 1.5) * v / rows) / (2.0 * np.pi)
        x = np.stack([radius * np.cos(around), -v / cols, -radius * np.sin(around)], -1)
    else:
        height = np.pi * (v + 1.0) / (rows + 1.0)
        x = 0.3 * np.stack([np.sin(height) * np.cos(around), np.cos(height), -np.sin(height) * np.sin(around)], -1)
    across = cols if kind else cols - 1
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(across), indexing="ij")
    a, b = i * cols + j, i * cols + (j + 1) % cols
    d, e = a + cols, b + cols
    one = rng.random(a.shape)[..., None] < 0.5
    first = np.where(one, np.stack([a, d, e], -1), np.stack([a, d, b], -1))
    second = np.where(one, np.stack([a, e, b], -1), np.stack([b, d, e], -1))
    faces = np.stack([first, second], 2).reshape(-1, 3)
    points = x.reshape(-1, 3)
    if kind == 2:
        n, ring = len(points), np.arange(cols)
        top = np.stack([np.full(cols, n), ring, (ring + 1) % cols], -1)
        low = np.stack([np.full(cols, n + 1), (rows - 1) * cols + (ring + 1) % cols, (rows - 1) * cols + ring], -1)
        faces = np.concatenate([faces, top, low])
        points = np.concatenate([points, [[0.0, 0.3, 0.0], [0.0, -0.3, 0.0]]])
    return np.ascontiguousarray(points), np.ascontiguousarray(faces, np.int32)


def edge_table(faces: Int) -> dict[tuple[int, int], list[int]]:
    """The vertices opposite each edge (low, high), that of the triangle in which it goes from low to high first.

    Raises ValueError for an edge that two triangles go along in one direction.
    """
    table: dict[tuple[int, int], list[int]] = {}
    for corners in faces.tolist():
        for k in range(3):
            a, b, opposite = corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]
            slots = table.setdefault((min(a, b), max(a, b)), [-1, -1])
            if slots[int(a > b)] >= 0:
                raise ValueError(f"two triangles go along the edge {a}, {b}")
            slots[int(a > b)] = opposite
    return table


def net_of(x: Float, faces: Int, rng: np.random.Generator) -> Fabric:
    """Cloth of springs on edges, bending springs and hinges across them."""
    table = edge_table(faces)
    pairs = np.array(list(table), np.int32)
    rest = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    quads = np.array([[*edge, *ends] for edge, ends in table.items() if min(ends) >= 0], np.int32)
    over = np.ascontiguousarray(quads[:, 2:])
    span = np.maximum(np.linalg.norm(x[over[:, 1]] - x[over[:, 0]], axis=1), 1e-6)
    area = 0.5 * np.linalg.norm(np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]), axis=1)
    mass = np.bincount(faces.reshape(-1), np.repeat(0.2 * area / 3.0, 3), len(x)).astype(np.float64)
    springs = [
        Springs.from_pairs(pairs, np.full(len(rest), 50.0), rest, np.full(len(rest), 1e-3)),
        Springs.from_pairs(over, np.full(len(span), 5.0), span, np.full(len(span), 1e-3), 2),
    ]
    one = np.ones(len(quads), np.int32)
    hinges = Hinges(quads, one, one, np.full(len(quads), 1e-5), np.zeros(len(quads)))
    pinned = rng.random(len(x)) < rng.choice([0.0, 0.05, 0.9])
    uv = x[:, :2].astype(np.float32)
    return Fabric("random", x, np.zeros_like(x), mass, pinned, faces, Springs.join(springs), hinges, uv)


def random_lines(rng: np.random.Generator, x: Float, faces: Int) -> dict[str, Any]:
    """Settings of the operation: lines between places in triangles, or near them, or on vertices."""
    size = float(np.linalg.norm(x[faces[0, 1]] - x[faces[0, 0]]))
    lines: list[dict[str, Any]] = []
    sign = rng.choice([-1.0, 1.0])
    for _ in range(rng.integers(1, 4)):
        points = int(rng.integers(2, 6))
        line: dict[str, Any] = {"height": float(sign * size * 10.0 ** rng.uniform(-2.0, 0.4))}
        sign *= rng.choice([-1.0, 1.0], p=[0.1, 0.9])
        chosen = rng.integers(len(faces), size=points)
        if rng.random() < 0.5:  # a short way: most long ones leave open meshes
            middle = x[faces[chosen[0]]].mean(axis=0)
            near = np.argsort(np.square(x[faces].mean(axis=1) - middle).sum(axis=1))[:60]
            chosen = rng.choice(near, points)
        share = rng.dirichlet(np.ones(3), points)
        if rng.random() < 0.3:
            share = np.eye(3)[rng.integers(3, size=points)]
        if rng.random() < 0.5:
            line["on_faces"] = [{"face": int(f), "at": s.tolist()} for f, s in zip(chosen, share, strict=True)]
        else:
            line["points"] = np.einsum("pc,pck->pk", share, x[faces[chosen]]).tolist()
        line["closed"] = bool(rng.random() < 0.2)
        lines.append(line)
    smoothing = {"passes": int(rng.integers(0, 6)), "hierarchical": bool(rng.random() < 0.5)}
    return {
        "lines": lines,
        "smoothing": smoothing,
        "springs": str(rng.choice(["paper", "physical"])),
        "keep": bool(rng.random() < 0.3),
    }


def require_whole(before: Fabric, after: Fabric, x: Float, split: int) -> None:
    """Raises ValueError where a mesh with `split` new vertices is not what Algorithm 2 makes; x (n + m, 3) [m]."""
    old, new = edge_table(before.faces), edge_table(after.faces)
    counted = (after.number - before.number, len(new) - len(old), len(after.faces) - len(before.faces))
    if counted != (split, 3 * split, 2 * split):
        raise ValueError(f"{split} triangles split add {counted} vertices, edges and triangles")
    if {e for e, ends in old.items() if min(ends) < 0} != {e for e, ends in new.items() if min(ends) < 0}:
        raise ValueError("the border has changed")
    _require_fans(after.faces, after.number)
    normals = []
    for points in (after.position, x):
        a = points[after.faces[:, 0]]
        normals.append(np.cross(points[after.faces[:, 1]] - a, points[after.faces[:, 2]] - a))
    same = np.zeros(len(after.faces), bool)
    same[: len(before.faces)] = (after.faces[: len(before.faces)] == before.faces).all(axis=1)
    if not (np.einsum("fk,fk->f", *normals)[~same] > 0.0).all():
        raise ValueError("a triangle is turned over or has no area")
    _require_net(after, new)


def _require_fans(faces: Int, n: int) -> None:
    """Raises ValueError where the triangles at a vertex are more than one fan."""
    after: list[dict[int, int]] = [{} for _ in range(n)]
    for a, b, c in faces.tolist():
        after[a][b], after[b][c], after[c][a] = c, a, b
    for v, fan in enumerate(after):
        starts = set(fan) - set(fan.values())
        at = next(iter(starts or fan))
        seen = 0
        while at in fan and seen <= len(fan):
            at, seen = fan[at], seen + 1
            if not starts and seen == len(fan):
                break
        if len(starts) > 1 or seen != len(fan):
            raise ValueError(f"the triangles at vertex {v} are not one fan")


def _require_net(fabric: Fabric, edges: dict[tuple[int, int], list[int]]) -> None:
    """Raises ValueError where springs are not on the edges, each once, hinges not across the inner ones."""
    springs, hinges = fabric.springs, fabric.hinges
    assert springs is not None and hinges is not None
    structural = np.sort(springs.pairs()[springs.of_kind(0)], axis=1).tolist()
    if sorted(map(tuple, structural)) != sorted(edges):
        raise ValueError("springs do not lie on the edges")
    inner = {edge: ends for edge, ends in edges.items() if min(ends) >= 0}
    if {(a, b): [c, d] for a, b, c, d in hinges.quads().tolist()} != inner or hinges.number != len(inner):
        raise ValueError("hinges do not lie across the inner edges")
    spans = {(min(ends), max(ends)) for ends in inner.values()}
    bent = set(map(tuple, np.sort(springs.pairs()[springs.of_kind(2)], axis=1).tolist()))
    if not bent <= spans or not spans - bent <= set(edges):
        raise ValueError("bending springs do not lie across the inner edges")
    for values in (springs.k, springs.rest, hinges.k, fabric.mass):
        if not (np.isfinite(values).all() and (values > 0.0).all()):
            raise ValueError("a constant is not above 0")


def draw(seed: int) -> str:
    """One mesh and its lines, drawn twice one after the other; "" or why it was refused. Raises ValueError."""
    rng = np.random.default_rng(seed)
    wrinkle = registry.load("nuno.operations", "wrinkle")
    x, faces = random_mesh(rng)
    fabric = net_of(x, faces, rng)
    state = State(x.copy(), rng.standard_normal(x.shape), 0.0)
    for _ in range(2):
        kept = _bytes(fabric, state)
        config = wrinkle.Config.model_validate(random_lines(rng, state.x, fabric.faces))
        try:
            made = wrinkle.apply(config, fabric, state, None)
        except BadInput as error:
            if kept != _bytes(fabric, state):
                raise ValueError("a refused line left something behind") from None
            return error.problem
        if kept != _bytes(fabric, state):
            raise ValueError("the operation changed its arguments")
        changed = made.changed
        require_whole(fabric, changed.fabric, changed.state.x, int(made.facts["vertices"]))
        state = changed.state
        fabric = replace(changed.fabric, position=state.x.copy())
    return ""


def _bytes(fabric: Fabric, state: State) -> list[bytes]:
    springs, hinges = fabric.springs, fabric.hinges
    assert springs is not None and hinges is not None
    arrays = (
        fabric.position,
        fabric.mass,
        fabric.faces,
        springs.first,
        springs.k,
        springs.rest,
        hinges.first,
        hinges.rest,
    )
    return [array.tobytes() for array in (*arrays, state.x, state.v)]
