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

Kernels of cloth contact see cloth of n vertices, or, where there are bodies, the state's arrays
`whole`, `whole_velocity`, `goal` and `way`, which hold n and b.
"""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.offset.contact_state import ContactState, Solids
from nuno_geometry.poses import carry, pose_frame, write_interval
from nuno_kernels import block_kernel, kernel
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
    if geometry is None or poses is None:
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
    return Solids(geometry.bodies, places, local, frames, bodies, faces, law, len(geometry.frames), skin, carrier)


def set_solid_poses(m: ContactState, start: Poses, end: Poses) -> None:
    """Write the interval into the state of a contact with bodies."""
    if not len(m.bodies.local):
        return
    write_interval(m.bodies, start, end)
    m.bodies.still[0] = STANDS if start.same_place(end) else MOVES
    if len(m.bodies.skin_joint):
        mine, skin, moving = (
            m.bodies.frame == OF_SKIN,
            Skin(m.bodies.skin_place, m.bodies.skin_joint, m.bodies.skin_weight),
            end.t > start.t,
        )
        for poses, to in ((start, m.bodies.skin_begin), (end if moving else start, m.bodies.skin_end)):
            to[mine] = skin.bend(
                m.bodies.local[mine], poses.rotation[m.bodies.skin_frame], poses.translation[m.bodies.skin_frame]
            )
        m.bodies.skin_rate[0] = 1.0 / (end.t - start.t) if moving else 0.0


@block_kernel
def pose_solids(m: ContactState, s: float) -> None:
    """Write the bodies' vertices at fraction s of the interval to m.goal and m.whole_velocity."""
    bodies = m.bodies
    if bodies.still[0] == PLACED:
        return
    frames, local, of_frame, begin, end = (
        bodies.frames,
        bodies.local,
        bodies.frame,
        m.bodies.skin_begin,
        m.bodies.skin_end,
    )
    x, v = m.goal, m.whole_velocity
    for f in range(frames.shape[0]):
        pose_frame(s, f, bodies.rotation0, bodies.origin0, bodies.spin, bodies.shift, frames)
    first = x.shape[1] - local.shape[0]
    for b in range(local.shape[0]):
        if of_frame[b] >= 0:
            carry(local, b, frames, of_frame[b], x, v, first + b)
            continue
        for row in range(3):
            x[row, first + b] = (1.0 - s) * begin[b, row] + s * end[b, row]
            v[row, first + b] = m.bodies.skin_rate[0] * (end[b, row] - begin[b, row])


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
    for b in range(m.bodies.local.shape[0]):
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
    for i in range(n, goal.shape[1] if m.bodies.still[0] != PLACED else n):
        a, b, c = goal[0, i] - last[0, i], goal[1, i] - last[1, i], goal[2, i] - last[2, i]
        speed = math.sqrt(v[0, i] * v[0, i] + v[1, i] * v[1, i] + v[2, i] * v[2, i])
        way, most = math.sqrt(a * a + b * b + c * c), dt * (speed + CATCH_UP)
        if way > most:
            for row in range(3):
                goal[row, i] = last[row, i] + most / way * (goal[row, i] - last[row, i])


@kernel
def catch_up(m: ContactState, n: int, dt: float) -> None:
    """Set the velocities at which vertices behind their bodies will follow in a step of dt [s]."""
    goal, last, v = m.goal, m.last, m.whole_velocity
    for b in range(m.bodies.local.shape[0]):
        if not m.bodies.behind[b] or dt == 0.0:
            continue
        i = n + b
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
    for b in range(m.bodies.local.shape[0]):
        way = 0.0
        for row in range(3):
            way = max(way, abs(goal[row, n + b] - last[row, n + b]))
            whole[row, n + b] = last[row, n + b]
        m.bodies.behind[b] = way > SAME
        late = late or way > SAME
    if m.bodies.still[0] == STANDS and not late:
        m.bodies.still[0] = PLACED
