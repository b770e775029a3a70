"""Lines with a width: they raise the rest shape of cloth, whatever bears its tension, and can be taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.normals import face_normals, vertex_normals
from nuno_kernels import kernel
from nuno_kernels.lanes import dot, minus
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import ELASTIC, RAISED, SPLIT, TAKEN, Fabric, Float, Hinges, Int, Relief, State
from nuno_schemas.operation import Changed, Outcome
from nuno_wrinkle.edges import any_of, edges_of, fold_angles, heron, keys_of, quads_of
from nuno_wrinkle.lines import Line, scan_triangles, trace_line
from nuno_wrinkle.net import GRAVITY, most_stiffness
from nuno_wrinkle.surface import link_faces

# The rest shape at heights h.
#
# A line of height k and width w raises the rest shape by h = k cos^2(pi d / w) at the distance d < w / 2 from it. So an
# edge of length l has sqrt(l^2 + dh^2), and a triangle on which h has the slope g, along warp and weft, the metric
# I + g g^T and sqrt(1 + g^2) times its area. The unit vectors along its yarns are S F, with F those of the flat
# triangle and S = (I + g g^T)^(-1/2), which turns the yarns least. By the raised triangle's own yarns the slope is
# g' = S g, and the flat one's yarns are (I - g' g'^T)^(-1/2) F': cloth is lowered as it is raised, with the other sign.
#
# Masses grow with the area at rest around their vertices. Stiffness and damping per element stay: of a raised
# triangle's springs those across the line are longer, and those along it stand for a wider strip; and a membrane's
# share of the critical damping along the slope falls to 1 / sqrt(1 + g^2). Bending is at rest flat, as before, by the
# flat cloth's lengths, which is off by a share of g^2.

FEWEST = 4.0
"""Least width of a line, in mean edges of the triangles that it raises."""
WAVE = 0.1
"""B / (rho g L w^2) of kept folds: a wave keeps four fifths of its height under all of the cloth (nuno_wrinkle.net)."""


def tilt(fabric: Fabric, height: Float, sign: float = 1.0) -> Fabric:
    """Return the fabric with its rest shape raised by height (n,) [m], or lowered again for a sign of -1."""
    springs, membrane, n = fabric.springs, fabric.membrane, fabric.number
    if springs is not None:
        pairs, rest = springs.pairs(), springs.per_spring(springs.rest)
        rise = np.where(springs.of_kind(ELASTIC), 0.0, height[pairs[:, 1]] - height[pairs[:, 0]])
        springs = replace(springs, rest=np.where(rise == 0.0, rest, np.sqrt(rest * rest + sign * rise * rise)))
    if membrane is not None:
        yarns, corners = np.stack([membrane.along, membrane.across], axis=1), membrane.faces
        slope = np.einsum("tys,ts->ty", yarns, height[corners[:, 1:]] - height[corners[:, :1]])
        square = np.square(slope).sum(axis=1)
        factor = np.expm1(-0.5 * np.log1p(sign * square)) / np.where(square > 0.0, square, 1.0)
        yarns += np.einsum("t,ty,tz,tzs->tys", factor, slope, slope, yarns)
        along, across = (np.ascontiguousarray(yarns[:, yarn]) for yarn in (0, 1))
        area = membrane.area * np.sqrt(1.0 + sign * square)
        membrane = replace(membrane, along=along, across=across, area=area)
    changed = replace(fabric, springs=springs, membrane=membrane)
    before, after = (
        np.bincount(fabric.faces.reshape(-1), np.repeat(heron(sides_of(one)), 3), n) for one in (fabric, changed)
    )
    return replace(changed, mass=fabric.mass * np.divide(after, before, out=np.ones(n), where=before > 0.0))


def sides_of(fabric: Fabric) -> Float:
    """Return lengths at rest (f, 3) of the sides of a fabric's triangles [m], from each corner to the next. Raises
    BadInput for triangles that bear no tension along their sides.
    """
    springs, edges = fabric.springs, edges_of(fabric.faces)
    if fabric.membrane is not None and np.array_equal(fabric.membrane.faces, fabric.faces):
        return fabric.membrane.sides()
    length = np.zeros(len(edges.key))
    if springs is not None:
        rows, found = edges.rows(keys_of(springs.pairs()))
        length[rows[found]] = springs.per_spring(springs.rest)[found]
    if not length.all():
        raise BadInput("the cloth has no spring along an edge of its triangles", field="object",
                       remedy="springs along all edges, or a measured fabric's membrane")  # fmt: skip
    return length[edges.of_face]


# Lines of a fabric by number, and their heights.


def number_lines(fabric: Fabric, take_back: Sequence[int], lines: Sequence[Line]) -> Relief:
    """Return the lines of a fabric after some are taken back, by numbers from 1, and others are drawn, whose heights
    are still to be found. Raises BadInput.
    """
    none = np.zeros(0, np.int32)
    old = fabric.relief or Relief(none.astype(np.int8), none, none, none, np.zeros(0))
    kinds = old.kind.tolist()
    for i, number in enumerate(take_back):
        kind = kinds[number - 1] if number <= len(kinds) else -1
        if kind != RAISED:
            problem, remedy = {
                -1: ("there is no such line", "take a line that has been drawn on the object before"),
                TAKEN: ("the line is taken back already", "take each back once"),
                SPLIT: ("a line without a width has split triangles, and stays", "draw it with a width"),
            }[kind]
            limit = f"{len(kinds)} lines, counted from 1 as they were drawn"
            raise BadInput(problem, field=f"take_back[{i}]", value=number, limit=limit, remedy=remedy)
        kinds[number - 1] = TAKEN
    if RAISED in kinds and any(line.width is None for line in lines):
        problem = "a line without a width splits triangles, and others have raised this cloth's rest shape"
        raise BadInput(problem, field="lines[0].width", remedy="give it a width, or take those back before")
    kind = np.array([*kinds, *(SPLIT if line.width is None else RAISED for line in lines)], np.int8)
    hinges = np.append(old.hinges, np.zeros(len(lines), np.int32)).astype(np.int32)
    stays = kind[old.line] != TAKEN
    return Relief(kind, np.where(kind == TAKEN, 0, hinges), *(a[stays] for a in (old.line, old.vertex, old.height)))


def heights_of(x: Float, faces: Int, side: Float, line: Line, i: int, path: Int, points: Float) -> tuple[Int, Float]:
    """Return the vertices (e,) that a line raises, and their heights (e,) [m], by their distances in space at x (n, 3)
    [m]. Edges between vertices as near join them to the line: another layer of a fold is not raised. side (f, 3) are
    lengths at rest. Raises BadInput for a mesh that is too coarse.
    """
    width, pieces = float(line.width or 0.0), np.add.outer(np.arange(len(points) - 1), [0, 1, 1]).astype(np.int32)
    distance = scan_triangles(x, points, pieces)[2]
    near, reached, grown = distance < 0.5 * width, np.zeros(len(x), np.bool_), np.zeros(len(x), np.bool_)
    grown[faces[path]] = True
    while (grown & near).sum() > reached.sum():
        reached = grown & near
        grown[faces[any_of(reached, faces)]] = True
    edge = float(side[any_of(grown, faces)].mean())
    if width < FEWEST * edge:
        raise BadInput(
            "the mesh is too coarse for the width of the line", field=f"lines[{i}].width", value=f"{width:.4g} m",
            limit=f"{FEWEST * edge:.4g} m, {FEWEST:g} edges of {edge:.4g} m", remedy="a wider line, or shorter edges",
        )  # fmt: skip
    vertices = np.flatnonzero(reached).astype(np.int32)
    return vertices, line.height * np.square(np.cos(np.pi / width * distance[vertices]))


def keep_folds(fabric: Fabric, across: Int, x: Float, vertices: Int, width: float) -> Hinges:
    """Return hinges across the inner edges of the triangles at `vertices`, at rest as cloth at x (n, 3) [m] is folded,
    stiff enough to bear what hangs from them (nuno_wrinkle.net).
    """
    raised, side, edges = np.zeros(fabric.number, np.bool_), sides_of(fabric), edges_of(fabric.faces)
    raised[vertices] = True
    quads = quads_of(fabric.faces, across, np.flatnonzero(any_of(raised, fabric.faces)).astype(np.int32))
    area, length = heron(side), np.zeros(len(edges.key))
    length[edges.of_face] = side
    row, total = edges.rows(keys_of(quads[:, :2]))[0], np.bincount(edges.of_face.reshape(-1), np.repeat(area, 3))
    load = WAVE * GRAVITY * float(fabric.mass.sum() / area.sum() * np.ptp(x, axis=0).max())
    stiff, most = load * (width * length[row]) ** 2 / total[row], most_stiffness(x, quads, fabric)
    one = np.ones(len(quads), np.int32)
    return Hinges(quads, one, one, np.minimum(stiff, most), fold_angles(x, quads))


def join_hinges(old: Hinges | None, stays: NDArray[np.bool_], new: list[Hinges]) -> Hinges | None:
    """Return old hinges, of whose last only some stay (k,), and then new ones."""
    names, last = ("first", "count", "stride", "k", "rest"), np.flatnonzero(stays) - len(stays)
    if old is not None:
        arrays = [getattr(old, name) for name in names]
        new = [Hinges(*(np.concatenate([a[: len(a) - len(stays)], a[last]]) for a in arrays)), *new]
    return Hinges(*(np.concatenate([getattr(one, name) for one in new]) for name in names)) if new else None


# The operation on cloth whose rest shape lines raise.


def raise_rest(
    lines: Sequence[Line], keep: bool, take_back: Sequence[int], tolerance: float | None, fabric: Fabric, state: State
) -> Outcome:
    """Return the fabric with lines taken back, by number, and others raised at `state`; `tolerance` as for
    `trace_line`, None for a mean edge. Raises BadInput without a change.
    """
    n, faces, across = fabric.number, fabric.faces, link_faces(fabric.faces, fabric.number)
    old, stay = number_lines(fabric, (), ()), number_lines(fabric, take_back, lines)
    base, first = tilt(fabric, old.total(n), -1.0), len(old.kind)
    side, paths, parts = sides_of(base), list[Int](), [(stay.line, stay.vertex, stay.height)]
    for i, line in enumerate(lines):
        path, points = trace_line(fabric, state.x, across, line, i, tolerance or float(side.mean()))
        vertices, height = heights_of(state.x, faces, side, line, i, path, points)
        parts.append((np.full(len(vertices), first + i, np.int32), vertices, height))
        paths.append(path)
    relief = Relief(stay.kind, stay.hinges, *map(np.concatenate, zip(*parts, strict=True)))
    after, rise, normal = relief.total(n), relief.total(n) - stay.total(n), vertex_normals(state.x, faces)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    x = state.x + np.where(fabric.pinned, 0.0, rise)[:, None] * normal
    turned = np.einsum("fk,fk->f", face_normals(state.x, faces), face_normals(x, faces)) < 0.0
    for i, (_, vertices, _) in enumerate(parts[1:]):
        if np.isin(vertices, faces[turned]).any():
            problem, remedy = "the line would turn triangles over", "a smaller height, or a wider line"
            raise BadInput(problem, field=f"lines[{i}].height", value=f"{lines[i].height:g} m", remedy=remedy)
    changed = tilt(base, after)
    folds = [keep_folds(changed, across, x, part[1], float(line.width or 0.0))
             for line, part in zip(lines, parts[1:], strict=True) if keep]  # fmt: skip
    relief.hinges[first:] = [one.number for one in folds] if keep else 0
    stays = np.repeat(relief.kind[:first] != TAKEN, old.hinges)
    changed = replace(changed, relief=relief, hinges=join_hinges(fabric.hinges, stays, folds))
    tops = [np.take_along_axis(c, np.abs(rise[c]).argmax(axis=1)[:, None], 1)[:, 0] for c in (faces[p] for p in paths)]
    chains = [top[np.sort(np.unique(top, return_index=True)[1])] for top in tops]
    beside = np.unique(faces[any_of(after != 0.0, faces)])
    facts = {
        "lines": float(len(lines)), "first": float(first + 1), "taken_back": float(len(take_back)),
        "vertices": float(np.count_nonzero(rise)), "mass": float(changed.mass.sum() - fabric.mass.sum()),
        "area": float(heron(sides_of(changed)).sum() - heron(sides_of(fabric)).sum()),
    }  # fmt: skip
    crests = find_crests(state.x, normal, chains, rise, beside[after[beside] == 0.0])
    place = Changed(changed, State(x, state.v, state.t), np.arange(n, dtype=np.int32))
    return Outcome(facts, arrays={"crests": crests}, changed=place)


# The vertices by which wrinkles are measured: on their lines, and at their feet on both sides.
#
# A wrinkle is measured across each vertex of its line, between its feet on either side: vertices that it leaves in
# place, or where none lies between, the next line that goes the other way, as of a valley between ridges.


@kernel
def _nearest(x: Float, feet: Int, turn: Float, vertices: Int, own: Float, across: Float, nearest: Int) -> None:
    """Find the feet (f,) nearest to each of `vertices` (m,) on the side that across (m, 3) points to, and on the other,
    within 45 degrees of it. x (n, 3); turn (f,) and own (m,) are above 0 on ridges, below in valleys, and 0 elsewhere;
    nearest (m, 2) is the result, -1 without a foot on that side.
    """
    for i in range(len(vertices)):
        best_left, best_right = np.inf, np.inf
        nearest[i, 0], nearest[i, 1] = -1, -1
        size = dot(across[i], across[i])
        for j in range(len(feet)):
            way = minus(x[feet[j]], x[vertices[i]])
            side, distance = dot(way, across[i]), dot(way, way)
            if turn[j] * own[i] > 0.0 or 2.0 * side * side < size * distance:
                continue
            if side > 0.0 and distance < best_left:
                best_left, nearest[i, 0] = distance, feet[j]
            if side < 0.0 and distance < best_right:
                best_right, nearest[i, 1] = distance, feet[j]


def find_crests(x: Float, normal: Float, chains: Sequence[Int], turn: Float, feet: Int) -> Int:
    """Return vertices (5, c): those along lines, the nearest of feet (f,) to the left and to the right of their line,
    and those before and after them. x (n, 3) [m] and normal (n, 3) are of the cloth before it is raised; turn (n,) is
    above 0 on ridges, below in valleys.

    Ends of lines, and vertices with feet on one side only, are left out.
    """
    none = np.zeros(0, np.int32)
    before, inner, after = (
        np.concatenate([none, *(chain[part] for chain in chains)]) for part in (np.s_[:-2], np.s_[1:-1], np.s_[2:])
    )
    pair = np.empty((len(inner), 2), np.int32)
    across = np.cross(normal[inner], x[after] - x[before])
    _nearest(x, feet, turn[feet], inner, turn[inner], across, pair)
    crests = np.stack([inner, *pair.T, before, after])
    return np.ascontiguousarray(crests[:, (pair >= 0).all(axis=1)], np.int32)
