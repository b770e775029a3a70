"""Signed distances from points to posed primitives, distance fields among them, one point or a block of vertices at a
time.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from nuno_contact.distance_fields.sample import Fields as SampledFields
from nuno_contact.distance_fields.sample import sample, sample_distance
from nuno_contact.margins import round_margin
from nuno_geometry.poses import Index, Vector, row_at, to_frame, turn_in, turn_out
from nuno_kernels import forced_inline, kernel
from nuno_kernels.formula import INLINE, distance_of
from nuno_kernels.lanes import WIDTH, any_below, dot, higher, lane, load, lower, minus, over, read, splat, times
from nuno_kernels.terms import define
from nuno_schemas.fabric import Float, Int

# Signed distances from points to posed primitives, one point or a block of vertices at a time.
#
# Negative inside. The closest point of a capsule is y = a + s (b - a) with
# s = clamp((x - a).(b - a) / |b - a|^2, 0, 1) (the skirt paper); a = b gives s = 0, a sphere. A box
# is measured in its own axes: q = |local| - half extents, distance |max(q, 0)| outside and max(q)
# inside, where the nearest face gives the normal.
#
# Contact keeps a vertex off by a margin (nuno_contact.margins), from a capsule of radius r by sqrt(r^2 + S) - r.
#
# `posed` (p, 16) holds one primitive a row, in world coordinates:
#
#     0:3   capsule end a, plane point, or centre of a box or field [m]
#     3:6   capsule b - a, plane normal (unit), or half extents of a box or field in the axes of its frame
#     6     1 / |b - a|^2 of a capsule, 0 for a sphere; cosine of a box or field (nuno_contact.margins)
#     7     radius [m]; of a distance field, its number, that of a closed form below 0
#     8:14  lowest and highest corner of its bounds, infinite for a plane; with the largest margin
#     14    radius of a box or field (nuno_contact.margins) [m]
#     15    a margin that is the same for all vertices that have one [m]
#
# `frames` (f, 18) holds one frame a row: 0:9 rotation matrix by rows, 9:12 origin, 12:15 velocity
# of the origin [m/s], 15:18 angular velocity [rad/s].
#
# Loops that should vectorise count with unsigned integers: numba then emits no test for negative
# indices, which would keep LLVM from vectorising (0.8 instead of 4 ns a distance).

Reading = tuple[float, Vector, int]
"""Distance [m], normal, and 1 for a point on a capsule's axis, else 0."""


class Deepest(NamedTuple):
    """The deepest of the examined primitives of one body for each of n vertices."""

    distance: Float
    """(n,) the least of the distances [m], 0 if none is negative"""
    primitive: NDArray[np.int64]
    """(n,) its number, -1 if there is none"""
    spread: Float
    """(2, n) S of the vertices' triangles [m^2], and whether they have a primitive's margin, 0 or 1"""


CAPSULE, PLANE, BOX, FIELD = 0, 1, 2, 4

EPSILON = 2.0**-52

ON_AXIS = 1e-12
"""A point nearer to a capsule's axis than this fraction of its radius has no direction of its own."""

SLACK = 1e-13
"""Relative rounding allowance of the bounds test, about 500 ulp: a primitive is only skipped if its computed distance
cannot be negative, so that skipping changes no bit."""


@kernel
def across(d: Vector) -> Vector:
    """Return a unit vector perpendicular to d: its cross product with the coordinate axis that it leans on least; +y
    for a null vector, so that a point at a sphere's centre goes up.
    """
    ax, ay, az = abs(d[0]), abs(d[1]), abs(d[2])
    longest = max(ax, ay, az)
    if longest == 0.0:
        return 0.0, 1.0, 0.0
    dx, dy, dz = over(d, longest)
    if ay <= ax and ay <= az:
        n = -dz, 0.0, dx
    elif ax <= az:
        n = 0.0, dz, -dy
    else:
        n = dy, -dx, 0.0
    return over(n, math.sqrt(dot(n, n)))


@forced_inline
def capsule_distance(at: Vector, spread: float, margin: float, posed: Float, p: Index) -> Reading:
    """Return (distance, normal, 1 if the point lies on the axis else 0)."""
    reach = margin + math.sqrt(posed[p, 7] * posed[p, 7] + spread)
    axis, e = (posed[p, 3], posed[p, 4], posed[p, 5]), minus(at, row_at(posed, p))
    e = minus(e, times(min(max(dot(e, axis) * posed[p, 6], 0.0), 1.0), axis))
    away = math.sqrt(dot(e, e))
    if away <= ON_AXIS * posed[p, 7]:
        return away - reach, across(axis), 1
    return away - reach, times(1.0 / away, e), 0


@forced_inline
def box_distance(at: Vector, spread: float, margin: float, posed: Float, p: Index, frames: Float, f: Index) -> Reading:
    """Return (distance, normal, 0); the first of several equally near faces gives the normal."""
    lx, ly, lz = turn_in(minus(at, row_at(posed, p)), frames, f)
    margin += round_margin(spread, posed[p, 14], posed[p, 6])
    qx, qy, qz = abs(lx) - posed[p, 3] - margin, abs(ly) - posed[p, 4] - margin, abs(lz) - posed[p, 5] - margin
    distance = max(qx, qy, qz)
    nx, ny, nz = 0.0, 0.0, 0.0
    if distance > 0.0:
        ox, oy, oz = max(qx, 0.0), max(qy, 0.0), max(qz, 0.0)
        distance = math.sqrt(ox * ox + oy * oy + oz * oz)
        nx, ny, nz = ox / distance, oy / distance, oz / distance
    elif qx >= qy and qx >= qz:
        nx = 1.0
    elif qy >= qz:
        ny = 1.0
    else:
        nz = 1.0
    return distance, turn_out((math.copysign(nx, lx), math.copysign(ny, ly), math.copysign(nz, lz)), frames, f), 0


@kernel
def lower_capsule(x: Float, low: int, high: int, posed: Float, p: int, deepest: Deepest) -> None:
    """Lower the distances of vertices [low, high) of x (3, n) to those to capsule p, if they are less.

    Most vertices near a capsule are outside of it: eight at a time are looked at without a root,
    against the squared reach and 16 ulp, more than the rounding of the root and of r^2. Only
    where one of them may be inside are the distances taken.
    """
    ax, ay, az = posed[p, 0], posed[p, 1], posed[p, 2]
    dx, dy, dz = posed[p, 3], posed[p, 4], posed[p, 5]
    inverse, square, margin = posed[p, 6], posed[p, 7] * posed[p, 7], posed[p, 15]  # of those that have one
    # (m + sqrt(r^2 + S))^2 <= (r + m)^2 + S (1 + m / r), since sqrt(r^2 + S) <= r + S / 2 r.
    share = (1.0 + 16.0 * EPSILON) * (1.0 + margin / posed[p, 7])
    limit = (1.0 + 16.0 * EPSILON) * (posed[p, 7] + margin) * (posed[p, 7] + margin)
    zero, one, distance, primitive = splat(0.0), splat(1.0), deepest.distance, deepest.primitive
    spread = deepest.spread
    for q in range(low, high, WIDTH):
        m = min(WIDTH, high - q)
        vx, vy, vz = read(x, 0, q, m) - ax, read(x, 1, q, m) - ay, read(x, 2, q, m) - az
        part = lower(higher((vx * dx + vy * dy + vz * dz) * inverse, zero), one)
        vx, vy, vz = vx - part * dx, vy - part * dy, vz - part * dz
        if any_below(vx * vx + vy * vy + vz * vz - read(spread, 0, q, m) * share, limit):
            for i in range(np.uint64(q), np.uint64(q + m)):
                ex, ey, ez = x[0, i] - ax, x[1, i] - ay, x[2, i] - az
                s = min(max((ex * dx + ey * dy + ez * dz) * inverse, 0.0), 1.0)
                ex, ey, ez = ex - s * dx, ey - s * dy, ez - s * dz
                d = math.sqrt(ex * ex + ey * ey + ez * ez) - (margin * spread[1, i] + math.sqrt(square + spread[0, i]))
                least, which = distance[i], primitive[i]
                distance[i] = min(least, d)
                primitive[i] = p if d < least else which


@kernel
def lower_plane(x: Float, low: int, high: int, posed: Float, p: int, deepest: Deepest) -> None:
    """Lower the distances of vertices [low, high) of x (3, n) to those to plane p, if they are less."""
    distance, primitive, margin, spread = deepest.distance, deepest.primitive, posed[p, 15], deepest.spread
    ax, ay, az = posed[p, 0], posed[p, 1], posed[p, 2]
    nx, ny, nz = posed[p, 3], posed[p, 4], posed[p, 5]
    for i in range(np.uint64(low), np.uint64(high)):
        d = (x[0, i] - ax) * nx + (x[1, i] - ay) * ny + (x[2, i] - az) * nz - margin * spread[1, i]
        least, which = distance[i], primitive[i]
        distance[i] = min(least, d)
        primitive[i] = p if d < least else which


@kernel
def lower_box(x: Float, low: int, high: int, posed: Float, p: int, frames: Float, f: int, deepest: Deepest) -> None:
    """Lower the distances of vertices [low, high) of x (3, n) to those to box p in frame f, if they are less."""
    distance, primitive = deepest.distance, deepest.primitive
    for i in range(low, high):
        margin = posed[p, 15] * deepest.spread[1, i]
        d = box_distance((x[0, i], x[1, i], x[2, i]), deepest.spread[0, i], margin, posed, p, frames, f)[0]
        if d < distance[i]:
            distance[i] = d
            primitive[i] = p


@kernel
def find_bounds(x: Float, low: int, high: int, bounds: Float, block: int) -> None:
    """Set bounds[block] (6,) to the lowest x, y, z, then the highest x, y, z of vertices [low, high).

    A vertex that is NaN takes no part: it is inside of nothing.
    """
    whole = low + (high - low) // WIDTH * WIDTH
    for c in range(3):
        least, most = splat(math.inf), splat(-math.inf)
        for q in range(low, whole, WIDTH):
            value = load(x, c, q)
            least, most = lower(value, least), higher(value, most)
        first, last = math.inf, -math.inf
        for j in range(WIDTH):
            first, last = min(first, lane(least, j)), max(last, lane(most, j))
        for i in range(whole, high):
            value = x[c, i]
            first, last = value if value < first else first, value if value > last else last
        bounds[block, c], bounds[block, 3 + c] = first, last


@kernel
def are_apart(kind: int, posed: Float, p: int, bounds: Float, block: int) -> bool:
    """Return True only if no vertex within bounds[block] can be inside primitive p.

    A capsule or box is tested by its own bounds, a plane at the lowest corner along its normal.
    """
    if kind == PLANE:
        lowest, size = 0.0, 0.0
        for c in range(3):
            corner = bounds[block, c] if posed[p, 3 + c] > 0.0 else bounds[block, 3 + c]
            lowest += (corner - posed[p, c]) * posed[p, 3 + c]
            size += abs(corner) + abs(posed[p, c])
        return bool(lowest - posed[p, 15] > SLACK * size)
    for c in range(3):
        low, high, reach0, reach1 = bounds[block, c], bounds[block, 3 + c], posed[p, 8 + c], posed[p, 11 + c]
        slack = SLACK * (abs(low) + abs(high) + abs(reach0) + abs(reach1))
        if low - reach1 > slack or reach0 - high > slack:
            return True
    return False


# Signed distances from points to posed primitives of any kind, distance fields among them.
#
# Where no body is a field, `fields` is None: what reads them is then not compiled. A field's normal is its interpolated
# gradient at unit length. Where that vanishes, halfway between two parts of the surface that are equally near, it is a
# direction that always is the same.


class Bodies(NamedTuple):
    """Posed primitives of bodies: the arrays of nuno_contact.penalty.contact.Contact of these names."""

    kind: NDArray[np.int8]
    frame: Int
    posed: Float
    frames: Float


STEP = 1e-6
"""Step of the differences for a closed form's gradient [m], whose error is about 1e-10 at a radius of centimetres. At
an edge those to one side could vanish in all directions."""


@forced_inline
def at_unit_length(distance: float, g: Vector) -> Reading:
    """Return a distance with a gradient's direction, and whether that vanishes."""
    size = math.sqrt(dot(g, g))
    return (distance, over(g, size), 0) if size > 0.0 else (distance, g, 1)


@forced_inline
def read_sampled(fields: SampledFields, number: int, x: float, y: float, z: float) -> Reading:
    """Return distance [m] and normal of a sampled field, as `at_unit_length`."""
    distance, gx, gy, gz = sample(x, y, z, number, fields)
    return at_unit_length(distance, (gx, gy, gz))


@kernel
def read_differences(form: Any, x: float, y: float, z: float) -> Reading:
    """Return distance [m] and normal of a closed form by differences, as `at_unit_length`."""
    gx = distance_of(form, x + STEP, y, z) - distance_of(form, x - STEP, y, z)
    gy = distance_of(form, x, y + STEP, z) - distance_of(form, x, y - STEP, z)
    gz = distance_of(form, x, y, z + STEP) - distance_of(form, x, y, z - STEP)
    return at_unit_length(distance_of(form, x, y, z), (gx, gy, gz))


def read_form(form: Any, x: float, y: float, z: float) -> Reading:
    """Return distance [m] and normal of a closed form: its own gradient, if it has one; kernels call it."""
    return float(form.distance(x, y, z)), form.gradient(x, y, z), 0


@overload(read_form, jit_options=INLINE, strict=False)  # type: ignore[untyped-decorator]
def _read_form(form: Any, x: Any, y: Any, z: Any) -> Any:
    gradient = form.instance_class.kernels.get("gradient")

    def read(form: Any, x: Any, y: Any, z: Any) -> Any:
        nx, ny, nz = gradient(form, x, y, z)
        return distance_of(form, x, y, z), (nx, ny, nz), 0

    return (lambda form, x, y, z: read_differences(form, x, y, z)) if gradient is None else read


class Volumes(NamedTuple):
    """The fields of a scene with closed forms: a `number` below 0 is that of form -1 - number."""

    sampled: SampledFields | None
    forms: tuple[Any, ...]


Fields = SampledFields | Volumes
Block = tuple[int, int]
"""first vertex of a block, and the first one after it"""


def by_number(sampled: Any, own: Any) -> Any:
    """Return a function f(fields, number, ...) for kernels: `sampled` of a sampled field, `own` of a closed form.

    A form's parameters are read once, in front of `own`: as a reference each use would read them anew.
    """

    def called(fields: Any, number: int, *rest: Any) -> Any:
        raise TypeError("only compiled code can call this: wrap it in a kernel")

    @overload(called, jit_options=INLINE, strict=False)  # type: ignore[untyped-decorator]
    def typed(fields: Any, number: Any, *rest: Any) -> Any:
        if fields.instance_class is SampledFields:
            return lambda fields, number, *rest: sampled(fields, number, *rest)
        kinds = [kind.instance_class for kind in fields.types[1].types]
        calls = [
            f"own(kinds{k}({', '.join(f'fields.forms[{k}].{name}' for name in kind._fields)}), *rest)"
            for k, kind in enumerate(kinds)
        ]
        if not isinstance(fields.types[0], types.NoneType):
            calls.append("sampled(fields.sampled, number, *rest)")
        lines = [f"    if number == {-1 - k}:\n        return {call}" for k, call in enumerate(calls[:-1])]
        scope: dict[str, Any] = {f"kinds{k}": kind for k, kind in enumerate(kinds)} | {"own": own, "sampled": sampled}
        return define("chosen", "fields, number, *rest", "\n".join([*lines, f"    return {calls[-1]}"]), **scope)

    return called


read_field = by_number(read_sampled, read_form)
"""read_field(fields, number, x, y, z) -> distance [m] and normal, as `at_unit_length`"""


@forced_inline
def field_reading(
    at: Vector, spread: float, margin: float, posed: Float, p: Index, frames: Float, f: Index, fields: Fields
) -> Reading:
    """Return (distance, normal, 1 if the gradient vanishes else 0)."""
    x, y, z = to_frame(at[0], at[1], at[2], frames, f)
    distance, n, mark = read_field(fields, int(posed[p, 7]), x, y, z)
    distance -= margin + round_margin(spread, posed[p, 14], posed[p, 6])
    return (distance, turn_out(n, frames, f), 0) if mark == 0 else (distance, across(n), 1)


@forced_inline
def primitive_distance(
    at: Vector, spread: float, share: float, p: Index, f: Index, bodies: Bodies, fields: Fields | None
) -> Reading:
    """Return (distance, normal, 1 if it has no normal else 0) of any posed primitive p, in frame f, for a
    vertex of triangles of `spread` [m^2] that has a `share`, 0 or 1, of the primitive's margin.
    """
    kind, posed = bodies.kind[p], bodies.posed
    margin = share * posed[p, 15]
    if kind == CAPSULE:
        return capsule_distance(at, spread, margin, posed, p)
    if kind == BOX:
        return box_distance(at, spread, margin, posed, p, bodies.frames, f)
    if fields is not None and kind == FIELD:
        return field_reading(at, spread, margin, posed, p, bodies.frames, f, fields)
    n = posed[p, 3], posed[p, 4], posed[p, 5]
    return dot(minus(at, row_at(posed, p)), n) - margin, n, 0


@kernel
def lower_sampled(
    fields: SampledFields, number: int, x: Float, block: Block, posed: Float, p: int, frames: Float, f: int,
    deepest: Deepest,
) -> None:  # fmt: skip
    """Lower the distances of a block's vertices of x (3, n) that are in the bounds of field p to those to it."""
    low, high = block
    distance, primitive, spread = deepest.distance, deepest.primitive, deepest.spread
    for i in range(np.uint64(low), np.uint64(high)):
        px, py, pz = x[0, i], x[1, i], x[2, i]
        within = posed[p, 8] <= px <= posed[p, 11] and posed[p, 9] <= py <= posed[p, 12]
        if within and posed[p, 10] <= pz <= posed[p, 13]:
            u, v, w = to_frame(px, py, pz, frames, f)
            margin = posed[p, 15] * spread[1, i] + round_margin(spread[0, i], posed[p, 14], posed[p, 6])
            d = sample_distance(u, v, w, number, fields) - margin
            if d < distance[i]:
                distance[i] = d
                primitive[i] = p


@kernel
def lower_form(
    form: Any, x: Float, block: Block, posed: Float, p: int, frames: Float, f: int, deepest: Deepest
) -> None:
    """Lower the distances of a block's vertices of x (3, n) to those to closed form p, if they are less."""
    low, high = block
    distance, primitive, spread = deepest.distance, deepest.primitive, deepest.spread
    margin, ball, cosine = posed[p, 15], posed[p, 14], posed[p, 6]
    # Out of the loop, which vectorises then.
    a, b, c = frames[f, 0], frames[f, 3], frames[f, 6]
    d, e, g = frames[f, 1], frames[f, 4], frames[f, 7]
    h, k, m = frames[f, 2], frames[f, 5], frames[f, 8]
    ox, oy, oz = frames[f, 9], frames[f, 10], frames[f, 11]
    for i in range(np.uint64(low), np.uint64(high)):
        px, py, pz = x[0, i] - ox, x[1, i] - oy, x[2, i] - oz
        off = distance_of(form, a * px + b * py + c * pz, d * px + e * py + g * pz, h * px + k * py + m * pz)
        off -= margin * spread[1, i] + round_margin(spread[0, i], ball, cosine)
        least, which = distance[i], primitive[i]
        distance[i] = min(least, off)
        primitive[i] = p if off < least else which


lower_field = by_number(lower_sampled, lower_form)
"""lower_field(fields, number, x, block, posed, p, frames, f, deepest)"""
