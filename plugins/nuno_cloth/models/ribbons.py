"""Bending of ribbons one triangle wide, by the moments that are borne across the edges between their triangles.

A ribbon is a chain of triangles that turn about the edges between them, its hinges. Heights of vertices are angles
theta of hinges and a rigid motion; loads at vertices are the hinges' moments m. A triangle between two hinges bears a
moment mu of two components, m = mu n at both, n their normals in its plane. The energy of the ribbon is the highest

    sum over hinges of theta m  -  m^T C m / 2,   C = sum over triangles of L^T c L,   mu = L m,

that is, C m = theta: the mixed element of Hellan, Herrmann and Johnson (Arnold and Brezzi 1985, RAIRO Modelisation
Math. Anal. Numer. 19, 7-32), where no moment passes the border. Our own is the compliance c of a triangle: of a plate
as wide at each place as the ribbon is, not as the triangle is. It is half the integral along the triangle's border of
1 / w, w the ribbon's width, for a moment along the ribbon's middle, and for the torsion that such a moment is where the
middle leans to and fro; the triangle opposite has the other half. A moment that is alike all along the ribbon is in
equilibrium, and curves it as it curves a beam, wherever vertices are (tests/physics/test_ribbons.py).

Distant hinges hardly matter: to each next one a moment falls to a third. The moments of a triangle are those that it
would have if, REACH hinges away from it on either side, moments went on as they do there.

Vertices on one border that are near each other are held together by torsion alone. Triangles there twist more than c
lets them, which hardly matters to how a ribbon bends, and bounds the step.

Rejected: the quadratic functions of wider cloth with curvatures that differ as widths do. There a moment that is alike
all along is not in equilibrium, and of 560 ribbons off by 0.3 of a cell six dropped up to 9 % too far, all with a neck.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from nuno_cloth.models.patches import Sides
from nuno_schemas.fabric import Bool, Float, Int

REACH, SEEN = 8, 4
"""Hinges either way that matter to a triangle's moments, and that show where its ribbon runs and how wide it is."""
THIN = 0.2
"""Triangles with a border of less than THIN of their height twist more. Ribbons with 28 scattered vertices on each
border have steps twice as long with it, the median of 120; ribbons off by 0.3 of a cell drop as far as without."""
FLAT = 0.01
"""The least height of a triangle over its border: at a neck narrower still, cloth bends as wider cloth does."""
TIP = 0.1
"""The least width of a ribbon over a triangle's height: at a tip the integral of 1 / w has no bound."""
AT_ONCE = 2048
"""Triangles whose matrices are in memory at a time."""
SOFTEST = 1e-9
"""The least rigidity over a cloth's largest, so that compliance is finite."""


class Chain(NamedTuple):
    """Triangles (c,) of ribbons, the `row` (f,) of each of a mesh's triangles or -1, and by row: the sides (c, 2, REACH
    + 1) that `leave` it and the next triangles both ways along the ribbon, and by which the next ones are `entered`, or
    -1; whether `wider` cloth is there; compliance (c, 2, 2) [1/(N m)] along and across; what moments of sides add to
    mu (c, 3).
    """

    triangles: Int
    row: Int
    leave: Int
    entered: Int
    wider: Bool
    compliance: Float
    share: Any


def bend_ribbons(
    sides: Sides, rigid: Bool, warp: Float, weft: Float, rigidity: Float
) -> Iterator[tuple[Int, Int, Float]]:
    """Yield triangles (t,) amid ribbons one triangle wide, vertices (t, k) round them, and matrices (t, k, k) [N/m] of
    their energy by the heights of these. Of a mesh's f triangles `rigid` (f,) ones do not bend; warp and weft (f, 3)
    are directions of yarns, and rigidity (f, 3, 3) is D [N m].
    """
    chain = _find_chain(sides, rigid, warp, weft, rigidity)
    amid = np.flatnonzero(~chain.wider[..., :2].any(axis=(1, 2))).astype(np.int32)
    for at in range(0, len(amid), AT_ONCE):
        row = amid[at : at + AT_ONCE]
        vertices, moment = _find_moments(sides, chain, row)
        yield chain.triangles[row], vertices, moment @ chain.compliance[row] @ moment.transpose(0, 2, 1)


def _find_moments(sides: Sides, chain: Chain, row: Int) -> tuple[Int, Float]:
    """Return the vertices (t, k) round triangles of these rows, and mu (t, k, 2) per height of each [N]."""
    # The moments of a triangle's own two hinges, of all angles: rows of C^-1, whose columns are hinges from end to end.
    leave, number = chain.leave[row], 2 * REACH + 2
    moment: Float = np.zeros((len(row), number, 2))
    for way, place in enumerate((REACH + 1, REACH)):
        own = _at(chain.share, row, leave[:, way, 0])
        moment[:, place] = np.stack([own.real, own.imag], axis=1)
    flexible = _find_flexibility(chain, row)
    moment = np.asarray(np.linalg.solve(flexible.transpose(0, 2, 1), moment), np.float64)
    hinge = np.concatenate([leave[:, 1, ::-1], leave[:, 0]], axis=1)
    vertices, angle = _find_angles(sides, np.where(hinge >= 0, hinge, hinge.max(axis=1, keepdims=True)))
    angle = np.where(hinge[..., None] >= 0, angle, 0.0)
    moment = (moment[:, :, None] * angle[..., None]).reshape(len(row), 4 * number, 2)
    return _sum_alike(vertices.reshape(len(row), 4 * number), moment)


def _sum_alike(vertices: Int, moment: Float) -> tuple[Int, Float]:
    """Return each row's different vertices, padded by its first, and the sums of their moments (t, k, 2)."""
    every, order = np.arange(len(vertices))[:, None], np.argsort(vertices, axis=1, kind="stable")
    vertices = np.take_along_axis(vertices, order, axis=1)
    place = np.cumsum(np.diff(vertices, axis=1, prepend=vertices[:, :1]) != 0, axis=1)
    number = int(place.max(initial=0)) + 1
    different, total = np.repeat(vertices[:, :1], number, axis=1), np.zeros((len(vertices), number, 2))
    different[every, place] = vertices
    np.add.at(total, (every, place), moment[every, order])
    return different, total


def _find_flexibility(chain: Chain, row: Int) -> Float:
    """Return C (t, h, h) of the hinges round triangles of these rows, each between an inner and an outer triangle."""
    leave, entered = chain.leave[row], chain.entered[row]
    outer = np.where(entered >= 0, chain.row[entered // 3], -1)
    first = np.broadcast_to(row[:, None, None], (len(row), 2, 1))
    inner = np.append(first, outer[..., :-1], axis=2)
    kept = np.append(leave[:, ::-1, :1], entered[..., :-1], axis=2)
    left = np.append(leave[..., 1:], np.full(first.shape, -1), axis=2)
    out, back = _at(chain.share, inner, leave), _at(chain.share, inner, kept)
    into, onward = _at(chain.share, outer, entered), _at(chain.share, outer, left)
    near, far = chain.compliance[inner], chain.compliance[outer]
    own, before, beyond = _product(near, out, out), _product(near, out, back), _product(far, into, into)
    # Beyond the last hinge, and up to wider cloth, moments go on as they do on this side of it.
    last = np.append(chain.wider[row, :, 1:], np.ones(first.shape, np.bool_), axis=2)
    before *= np.where(last, 1.0 + np.divide(beyond, own, out=np.zeros(own.shape), where=own > 0.0), 1.0)
    place = np.array([REACH + 1 + np.arange(REACH + 1), REACH - np.arange(REACH + 1)])
    flexible = np.zeros((len(row), place.size, place.size))
    flexible[:, place, place] = np.where(leave >= 0, own + beyond, 1.0)
    flexible[:, place, place + np.array([[-1], [1]])] = before
    flexible[:, place[:, :-1], place[:, 1:]] = _product(far, into, onward)[..., :-1]
    return flexible


def _at(values: Any, row: Int, side: Int) -> Any:
    """Return values (c, 3) at sides of rows, 0 where either is -1."""
    return np.where((row >= 0) & (side >= 0), values[row, side % 3], 0.0)


def _product(compliance: Float, one: Any, other: Any) -> Float:
    one, other = (np.stack([moment.real, moment.imag], axis=-1) for moment in (one, other))
    return np.asarray(np.einsum("...a,...ab,...b->...", one, compliance, other))


def _next(values: Any, side: Int, step: int) -> Any:
    """Return values by corner, `step` corners after the start of sides."""
    return values[side - side % 3 + (side + step) % 3]


def _find_angles(sides: Sides, hinge: Int) -> tuple[Int, Float]:
    """Return the vertices (..., 4) of the triangles at hinges (...), and their angles per height of each [1/m]."""
    other, corner, points = sides.other[hinge], sides.faces.reshape(-1), sides.corners.reshape(-1, 3)
    vertices = corner[hinge], _next(corner, hinge, 1), _next(corner, hinge, 2), _next(corner, other, 2)
    length = np.linalg.norm(_next(points, hinge, 1) - points[hinge], axis=-1)
    one, two = 1.0 / sides.high[hinge], 1.0 / sides.high[other]
    near, far = one * sides.along[hinge] / length, two * sides.along[other] / length
    return np.stack(vertices, axis=-1), np.stack([near - one - far, far - two - near, one, two], axis=-1)


def _find_chain(sides: Sides, rigid: Bool, warp: Float, weft: Float, rigidity: Float) -> Chain:
    """Return the triangles with all vertices on borders, whose neighbours are one or two, and what they bear."""
    inside = (sides.other >= 0).reshape(-1, 3)
    number = inside.sum(axis=1)
    found = np.all(sides.border[sides.faces], axis=1) & (number >= 1) & (number <= 2) & ~rigid
    length = np.linalg.norm(np.roll(sides.corners, -1, axis=1) - sides.corners, axis=2)
    high = sides.high.reshape(-1, 3)
    found &= np.all(high > np.where(inside, 0.0, FLAT * length), axis=1)
    triangles = np.flatnonzero(found).astype(np.int32)
    row = np.full(len(rigid), -1, np.int32)
    row[triangles] = np.arange(len(triangles), dtype=np.int32)
    edges = sides.corners[triangles] - sides.corners[triangles, :1]
    place = np.einsum("fcd,fd->fc", edges, weft[triangles]) + 1j * np.einsum("fcd,fd->fc", edges, warp[triangles])
    # Forward from a triangle's border, at its left: out by its next side, in by the one before. An end has one hinge.
    inside, two = inside[triangles], number[triangles, None] == 2
    rim = np.where(two[:, 0], inside.argmin(axis=1), inside.argmax(axis=1) + 2) % 3
    outward = np.stack([(rim + 1) % 3, np.where(two[:, 0], (rim + 2) % 3, -1)], axis=1)
    clear = found[:, None] | rigid[:, None] & (high > FLAT * length)
    leave, entered, wider, middle, start, run = _walk(sides, clear.reshape(-1), row, triangles, place, outward)
    axis = np.where(middle[:, 0] == middle[:, 1], 1.0, middle[:, 0] - middle[:, 1])
    axis /= np.abs(axis)
    into = two & (np.arange(3) == (rim[:, None] + 2) % 3)
    edge = (np.roll(place, -1, axis=1) - place) * axis.conj()[:, None]
    length, high = np.abs(edge), sides.high[3 * triangles + rim]
    normal = np.where(inside, np.where(into, 1.0j, -1.0j) * edge / length, 0.0)
    first, last = (np.take_along_axis(normal, (rim[:, None] + k) % 3, axis=1) for k in (2, 1))
    cross = np.where(two, (first.conj() * last).imag, 1.0)
    share = np.where(inside & two, np.where(into, -1.0j * last, 1.0j * first) / cross, normal)
    parts = [slice(at, at + AT_ONCE) for at in range(0, len(triangles), AT_ONCE)]
    measured = [_measure(axis[k], start[k], run[k], high[k], rigidity[triangles[k]]) for k in parts]
    compliance = np.concatenate([np.zeros((0, 2, 2)), *measured])
    border, ahead, behind = (np.take_along_axis(edge, (rim[:, None] + k) % 3, axis=1)[:, 0] for k in range(3))
    across = (ahead - behind) / np.abs(ahead - behind)
    twist = 0.5 * np.maximum(THIN - np.abs(border) / high, 0.0)
    twist /= rigidity[triangles, 2, 2] + SOFTEST * rigidity.max(initial=0.0)
    compliance += np.einsum("c,ic,jc->cij", twist, *2 * ([across.real, across.imag],))
    return Chain(triangles, row, leave, entered, wider, compliance, share)


def _walk(
    sides: Sides, known: Bool, row: Int, triangles: Int, place: Any, outward: Int
) -> tuple[Int, Int, Bool, Any, Any, Any]:
    """Unfold triangles along ribbons, both ways from `triangles` (c,) with corners at `place` (c, 3), by their sides
    `outward` (c, 2) or -1, into what is `known` by its side. Return the sides left and entered, and whether what is
    there is not known (c, 2, REACH + 1); of the first SEEN, the middle of the last (c, 2), and starts and runs (c, s)
    of all borders, 0 of other sides, the first three the triangles' own.
    """
    leave, entered = np.full((2, *outward.shape, REACH + 1), -1)
    other = np.zeros(leave.shape, np.bool_)
    middle = np.repeat(place.mean(axis=1)[:, None], 2, axis=1)
    rim = sides.other[3 * triangles[:, None] + np.arange(3)] < 0
    start, run = [*place.T], [*np.where(rim, np.roll(place, -1, axis=1) - place, 0.0).T]
    for way in (0, 1):
        side = np.where(outward[:, way] >= 0, 3 * triangles + outward[:, way], -1)
        begin, end = (np.take_along_axis(place, (outward[:, way, None] + k) % 3, axis=1)[:, 0] for k in (0, 1))
        for step in range(REACH + 1):
            enter = np.where(side >= 0, sides.other[side], -1)
            other[:, way, step] = (side >= 0) & ~known[enter]
            on = (side >= 0) & known[enter]
            side, enter = np.where(on, side, -1), np.where(on, enter, -1)
            leave[:, way, step], entered[:, way, step] = side, enter
            if step < SEEN:
                middle[:, way] = np.where(on, 0.5 * (begin + end), middle[:, way])
            apex = end + (sides.along[enter] + 1j * sides.high[enter]) * (begin - end) / np.abs(begin - end)
            sought = [np.where(on, enter - enter % 3 + (enter + k) % 3, -1) for k in (1, 2)]
            free = [on & (sides.other[one] < 0) for one in sought]
            if step < SEEN:
                start += [begin, apex]
                run += [np.where(free[0], apex - begin, 0.0), np.where(free[1], end - apex, 0.0)]
            leaves = on & (row[enter // 3] >= 0) & ~(free[0] & free[1])
            side = np.where(leaves, np.where(free[0], sought[1], sought[0]), -1)
            begin, end = np.where(free[0], apex, begin), np.where(free[0], end, apex)
    return leave, entered, other, middle, np.stack(start, axis=1), np.stack(run, axis=1)


def _measure(axis: Any, start: Any, run: Any, high: Float, rigidity: Float) -> Float:
    """Return the compliances (c, 2, 2) of triangles along and across a ribbon's `axis` (c,), complex along weft and
    warp, by its borders (c, s), the first three the triangle's own: from two Gauss points between all their ends. Where
    only one border is known, the ribbon is as wide as the triangle is `high` (c,).
    """
    start, run = start * axis.conj()[:, None], run * axis.conj()[:, None]
    knots = np.repeat(np.sort(np.concatenate([start, start + run], axis=1).real, axis=1), 2, axis=1)
    length = 0.5 * (knots[:, 2:] - knots[:, :-2])
    place = knots[:, :-2] + length * (1.0 + np.resize([-1.0, 1.0], length.shape[1]) / np.sqrt(3.0))
    ahead = place[:, None] - start.real[..., None]
    over = ahead * (ahead - run.real[..., None]) < 0.0
    rise = np.divide(run.imag, run.real, out=np.zeros(run.shape), where=run.real != 0.0)[..., None]
    way = over * np.sign(run.real)[..., None]
    width = np.abs((way * (start.imag[..., None] + ahead * rise)).sum(axis=1))
    known = (over.sum(axis=1) == 2) & (way.sum(axis=1) == 0.0)
    width = np.where(known, np.maximum(width, TIP * high[:, None]), high[:, None])
    lean = np.where(known, np.clip(0.5 * (over * rise).sum(axis=1), -1.0, 1.0), 0.0)
    middle = np.square(axis)[:, None] * (1.0 + 1.0j * lean) / (1.0 - 1.0j * lean)
    # A moment along the axis is a torsion of the middle too, tan a of it for a beam. Plates whose middle leans to and
    # fro every cell have less, sin a and tan a in equal parts up to 0.7.
    lean /= (1.0 + lean * lean) ** 0.25
    along, across = (
        np.stack([even - 0.5 * twice.real, even + 0.5 * twice.real, twice.imag])
        for even, twice in ((0.5, middle), (0.0, 1.0j * middle))
    )
    moment = np.stack([along - lean * across, lean * along + across])
    least = SOFTEST * rigidity.max(initial=0.0) * np.eye(3)
    soft = np.einsum("iafq,fab,jbfq->fqij", moment, np.linalg.inv(rigidity + least), moment, optimize=True)
    own = 0.5 * over[:, :3].sum(axis=1) * length / width
    return np.asarray(np.einsum("fq,fqij->fij", own, soft))
