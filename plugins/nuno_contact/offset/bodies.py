"""Bodies of triangles that cloth meets as it meets cloth: massless vertices after the cloth's own.

They go where their body's frame carries them, each in a straight line within a step, and have a part in lists, planes
and forces like any other vertex. Those of a skin are where its frames have them at both ends of an interval, and go in
a straight line between. Pairs of two bodies are not looked at. One that cloth does not let pass, since it is held
between bodies or pins, is cut short as cloth is: it stays behind its body, follows by CATCH_UP faster than that at
most, and is where its body is again as soon as cloth lets it. To catch up at once would throw cloth about. So the
guarantee for cloth and the vertices in here holds whatever bodies do, and for the bodies themselves wherever none of
their vertices is behind, which is counted.

A fine body under coarse cloth has many vertices below each triangle. They share what one could bear: see
nuno_contact.offset.contact_state.size_of.

Only vertices in listed pairs, and those that are behind, are posed and examined in every step. The others matter to the
list alone, which holds while each is as near to its place in the plan as is allowed. Of what goes straight and evenly
within an interval that distance is convex in time: known at both ends, it says until when. They are posed when a list
is made and at the interval's end. Those of a frame that turns go along arcs, and are always examined.

Kernels of cloth contact see cloth of n vertices, or, where there are bodies, the state's arrays
`whole`, `whole_velocity`, `goal` and `way`, which hold n and b.
"""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.offset.contact_state import LIST_BEGUN, LIST_WINDOW, LISTED, NOW, ContactState, Solids
from nuno_geometry.poses import carry, pose_frame, write_interval
from nuno_geometry.skinning import bend_skin
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_schemas.bodies import NO_SKIN, OF_TRIANGLES, SKIN, Geometry, Poses, Skin, join_skins
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

CATCH_UP = 1.0
"""largest speed by which a vertex behind its body catches up [m/s]"""
SAME = 1e-9
"""A vertex is behind its body if it is farther from its place on that [m] than rounding explains."""


MOVES, STANDS, PLACED = range(3)
"""motion of bodies in an interval; of those that stand, whether m.goal has them and none of their vertices is
behind"""
OF_SKIN = -1
"""stands for the frame of a vertex that several frames carry"""


def make_solids(geometry: Geometry | None, poses: Poses | None) -> Solids:
    """Return bodies' solids as they are at the start. Raises BadInput for one that is not of triangles."""
    if geometry is None or poses is None or not len(geometry.kind):
        empty = np.zeros((0, 3))
        number, faces = np.zeros(0, np.int32), np.zeros((0, 3), np.int32)
        return Solids((), empty, empty, number, number, faces, np.zeros((0, 2)), 0, NO_SKIN, number)
    parts: list[tuple[Float, Float, Int, Int, Int]] = []
    count = 0
    for primitive, kind in enumerate(geometry.kind.tolist()):
        frame, body = int(geometry.frame[primitive]), int(geometry.body[primitive])
        if kind not in OF_TRIANGLES:
            raise BadInput(
                "cloth contact meets bodies of triangles", field="bodies", value=geometry.bodies[body],
                remedy="leave it out here, or give it a mesh as collider",
            )  # fmt: skip
        (x, triangles), (placed, _) = geometry.mesh(primitive), geometry.placed(primitive, poses)
        frame = OF_SKIN if kind == SKIN else frame
        of = np.full(len(x), frame, np.int32), np.full(len(x), body, np.int32)
        parts.append((placed, x, *of, triangles + np.int32(count)))
        count += len(x)
    places, local, frames, bodies, faces = (np.concatenate(part) for part in zip(*parts, strict=True))
    law = np.stack([geometry.friction, geometry.damping], axis=1)
    skin = join_skins(geometry.skins)
    first = geometry.frame[geometry.kind == SKIN]
    each = [at + np.arange(len(one.place), dtype=np.int32) for at, one in zip(first, geometry.skins, strict=True)]
    carrier = np.concatenate([np.zeros(0, np.int32), *each]).astype(np.int32)
    used = int(frames.max(initial=OF_SKIN)) + 1
    return Solids(geometry.bodies, places, local, frames, bodies, faces, law, used, skin, carrier)


def set_solid_poses(m: ContactState, start: Poses, end: Poses) -> None:
    """Write the interval into the state of a contact with bodies."""
    if not len(m.bodies.local):
        return
    write_interval(m.bodies, start, end)
    m.bodies.active[:], m.bodies.is_active[:] = np.arange(len(m.bodies.local)), True
    m.bodies.number[0], m.bodies.posed[0] = len(m.bodies.local), np.nan
    m.bodies.still[0] = STANDS if start.same_place(end) else MOVES
    if len(m.bodies.skin_joint):
        mine, skin, moving = (
            m.bodies.frame == OF_SKIN,
            Skin(m.bodies.skin_place, m.bodies.skin_joint, m.bodies.skin_weight),
            end.t > start.t,
        )
        for poses, to in ((start, m.bodies.skin_begin), (end if moving else start, m.bodies.skin_end)):
            frames = poses.rotation[m.bodies.skin_frame], poses.translation[m.bodies.skin_frame]
            to[mine] = bend_skin(skin, m.bodies.local[mine], *frames)
        m.bodies.skin_rate[0] = 1.0 / (end.t - start.t) if moving else 0.0


@block_kernel
def pose_solids(m: ContactState, s: float) -> None:
    """Write the bodies' vertices at fraction s of the interval to m.goal and m.whole_velocity."""
    bodies = m.bodies
    if bodies.still[0] == PLACED or bodies.posed[0] == s:
        return
    bodies.posed[0] = s
    for f in range(bodies.frames.shape[0]):
        pose_frame(s, f, bodies.rotation0, bodies.origin0, bodies.spin, bodies.shift, bodies.frames)
    for q in range(bodies.number[0]):
        pose_vertex(m, s, bodies.active[q])


@forced_inline
def pose_vertex(m: ContactState, s: float, b: int) -> None:
    """Do so for one of them, when the frames are posed."""
    bodies, x, v = m.bodies, m.goal, m.whole_velocity
    i, begin, end = x.shape[1] - bodies.local.shape[0] + b, bodies.skin_begin, bodies.skin_end
    if bodies.frame[b] >= 0:
        carry(bodies.local, b, bodies.frames, bodies.frame[b], x, v, i)
        return
    for row in range(3):
        x[row, i] = (1.0 - s) * begin[b, row] + s * end[b, row]
        v[row, i] = bodies.skin_rate[0] * (end[b, row] - begin[b, row])


@block_kernel
def pose_others(m: ContactState, now: float, s: float) -> None:
    """Write the other vertices at fraction `now` to m.last, and at s to m.goal."""
    bodies, first = m.bodies, m.goal.shape[1] - m.bodies.local.shape[0]
    if bodies.number[0] == bodies.local.shape[0] or bodies.still[0] == PLACED:
        return
    for b in range(bodies.local.shape[0]):
        if not bodies.is_active[b]:
            pose_vertex(m, now, b)
            for row in range(3):
                m.last[row, first + b] = m.goal[row, first + b]
            pose_vertex(m, s, b)


@block_kernel
def activate(m: ContactState, everything: bool) -> None:
    """Choose which vertices of bodies are posed in every step: those of the list, or all."""
    bodies, pair, first = m.bodies, m.pairs.vertices, m.last.shape[1] - m.bodies.local.shape[0]
    arcs = bodies.still[0] == MOVES
    for b in range(bodies.local.shape[0]):
        bodies.is_active[b] = everything or bodies.behind[b] or (arcs and bodies.frame[b] >= 0)
    for p in range(0 if everything else m.counts[LISTED]):
        for corner in range(4):
            if pair[p, corner] >= first:
                bodies.is_active[pair[p, corner] - first] = True
    bodies.number[0], bodies.posed[0] = 0, np.nan
    for b in range(bodies.local.shape[0]):
        if bodies.is_active[b]:
            bodies.active[bodies.number[0]] = b
            bodies.number[0] += 1
    find_until(m, first)


@block_kernel
def find_until(m: ContactState, first: int) -> None:
    """Find until which fraction of the interval the vertices that are not active are as the list's plan has them."""
    bodies, reference, motion, clock = m.bodies, m.plan.reference, m.plan.motion, m.clock
    bodies.until[0], now, moves = np.inf, clock[NOW], bodies.still[0] == MOVES
    begun, window = clock[LIST_BEGUN], clock[LIST_WINDOW]
    for b in range(bodies.local.shape[0]):
        if bodies.is_active[b]:
            continue
        i, here, there = first + b, 0.0, 0.0
        for row in range(3):
            x, y = m.last[row, i], bodies.skin_end[b, row] if moves else m.last[row, i]
            here += (x - reference[row, i] - (now - begun) / window * motion[row, i]) ** 2
            there += (y - reference[row, i] - (1.0 - begun) / window * motion[row, i]) ** 2
        here, there, room = math.sqrt(here), math.sqrt(there), m.plan.spread[0, i]
        if there > room:
            share = max(0.0, room - here) / (there - here) if there > here else 0.0
            bodies.until[0] = min(bodies.until[0], now + share * (1.0 - now))


@block_kernel
def keep_all(m: ContactState) -> None:
    """Let a method that examines all vertices have all of them posed from the interval's start on."""
    if not m.bodies.always[0]:
        m.bodies.always[0] = True
        activate(m, True)


@block_kernel
def copy_active(m: ContactState, x: Float, to: Float) -> None:
    """Copy cloth's vertices and the active ones of bodies from x (3, n) to another array."""
    first = x.shape[1] - m.bodies.local.shape[0]
    copy_part(x, to, 0, first)
    for q in range(m.bodies.number[0]):
        for row in range(3):
            to[row, first + m.bodies.active[q]] = x[row, first + m.bodies.active[q]]


@block_kernel
def copy_part(x: Float, to: Float, start: int, stop: int) -> None:
    """Copy some columns of x, by number, to another array."""
    for row in range(3):
        for i in range(start, stop):
            to[row, i] = x[row, i]


@kernel
def place_solids(m: ContactState, x: Float, v: Float, s: float) -> None:
    """Place the bodies' vertices for forces at fraction s: on their bodies unless they are behind, and in an implicit
    step where the iterate has them.
    """
    if m.bodies.local.shape[0] == 0 or m.bodies.still[0] == PLACED:
        return
    n, whole, goal, last = x.shape[1], m.whole, m.goal, m.last
    pose_solids(m, s)
    if m.solver.step[0] > 0.0:
        return
    for q in range(m.bodies.number[0]):
        b = m.bodies.active[q]
        for row in range(3):
            whole[row, n + b] = last[row, n + b] if m.bodies.behind[b] else goal[row, n + b]


def is_waiting(m: ContactState) -> bool:
    """Whether an iterate has bodies' vertices that are not at m.goal."""
    first = m.goal.shape[1] - len(m.bodies.local)
    return bool(len(m.bodies.local)) and float(np.abs(m.goal[:, first:] - m.whole[:, first:]).max()) > SAME


@kernel
def limit_ways(m: ContactState, n: int, dt: float) -> None:
    """Limit the ways of bodies' vertices from `last` to m.goal in a step of dt [s] to their largest speed."""
    goal, last, v = m.goal, m.last, m.whole_velocity
    for q in range(m.bodies.number[0] if m.bodies.still[0] != PLACED else 0):
        i = n + m.bodies.active[q]
        a, b, c = goal[0, i] - last[0, i], goal[1, i] - last[1, i], goal[2, i] - last[2, i]
        speed = math.sqrt(v[0, i] * v[0, i] + v[1, i] * v[1, i] + v[2, i] * v[2, i])
        way, most = math.sqrt(a * a + b * b + c * c), dt * (speed + CATCH_UP)
        if way > most:
            m.bodies.posed[0] = np.nan
            for row in range(3):
                goal[row, i] = last[row, i] + most / way * (goal[row, i] - last[row, i])


@kernel
def catch_up(m: ContactState, n: int, dt: float) -> None:
    """Set the velocities at which vertices behind their bodies will follow in a step of dt [s]."""
    goal, last, v = m.goal, m.last, m.whole_velocity
    for q in range(m.bodies.number[0]):
        i = n + m.bodies.active[q]
        if not m.bodies.behind[i - n] or dt == 0.0:
            continue
        m.bodies.posed[0] = np.nan
        x, y, z = (
            v[0, i] + (goal[0, i] - last[0, i]) / dt, v[1, i] + (goal[1, i] - last[1, i]) / dt,
            v[2, i] + (goal[2, i] - last[2, i]) / dt,
        )  # fmt: skip
        speed = math.sqrt(v[0, i] * v[0, i] + v[1, i] * v[1, i] + v[2, i] * v[2, i])
        share = min(1.0, (speed + CATCH_UP) / math.sqrt(x * x + y * y + z * z))
        v[0, i], v[1, i], v[2, i] = share * x, share * y, share * z


@kernel
def find_behind(m: ContactState, n: int) -> None:
    """Find which of the bodies' vertices are behind m.goal at `last`, from where forces are then found, too."""
    goal, last, whole = m.goal, m.last, m.whole
    late = False
    for q in range(m.bodies.number[0]):
        b, way = m.bodies.active[q], 0.0
        for row in range(3):
            way = max(way, abs(goal[row, n + b] - last[row, n + b]))
            whole[row, n + b] = last[row, n + b]
        m.bodies.behind[b] = way > SAME
        late = late or way > SAME
    if m.bodies.still[0] == STANDS and not late:
        m.bodies.still[0] = PLACED
