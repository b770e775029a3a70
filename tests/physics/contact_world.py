"""A small world for contact tests: bodies by hand, and a symplectic Euler loop round the kernels."""

import numba
import numpy as np

from nuno_contact.penalty.contact import Contact, add_contact, commit_contact, make_contact, set_poses
from nuno_schemas.bodies import BOX, CAPSULE, PLANE, Geometry, Poses

G = 9.81
STILL = np.array([1.0, 0.0, 0.0, 0.0])


def capsule(a, b, radius, frame=0, body=0):
    return (CAPSULE, frame, body, a, b, radius)


def plane(point=(0, 0, 0), normal=(0, 1, 0), frame=0, body=0):
    return (PLANE, frame, body, point, normal, 0.0)


def box(centre, half, frame=0, body=0):
    return (BOX, frame, body, centre, half, 0.0)


def geometry(*primitives, friction=0.0, damping=0.3, stiffness=np.nan):
    kind, frame, body, a, b, radius = zip(*primitives, strict=True)
    bodies, frames = max(body) + 1, max(frame) + 1
    return Geometry(
        bodies=tuple(f"body{i}" for i in range(bodies)),
        frames=tuple(f"body0/frame{i}" for i in range(frames)),
        kind=np.array(kind, np.int8),
        frame=np.array(frame, np.int32),
        body=np.array(body, np.int32),
        a=np.array(a, np.float64),
        b=np.array(b, np.float64),
        radius=np.array(radius, np.float64),
        stiffness=np.full(bodies, stiffness),
        damping=np.full(bodies, damping),
        friction=np.full(bodies, friction),
    )


def contact_for(shape: Geometry, mass, k) -> Contact:
    """A contact of the same stiffness for every vertex and body, standing at the identity pose."""
    k = np.broadcast_to(np.asarray(k, np.float64), mass.shape)
    stiffness = np.tile(k, (len(shape.bodies), 1))
    contact = make_contact(shape, stiffness, 2.0 * shape.damping[:, None] * np.sqrt(stiffness * mass))
    move(contact, 1.0)
    return contact


def move(contact, duration, turn=None, shift=None, start=None, turn0=None):
    """Set the interval [0, duration]: rotations (f, 4) from turn0 to turn, translations from start by shift."""
    frames = contact.spin.shape[0]
    turn0 = np.tile(STILL, (frames, 1)) if turn0 is None else np.atleast_2d(turn0)
    turn = turn0 if turn is None else np.atleast_2d(turn)
    start = np.zeros((frames, 3)) if start is None else np.atleast_2d(np.asarray(start, np.float64))
    end = start if shift is None else start + np.atleast_2d(np.asarray(shift, np.float64))
    set_poses(contact, Poses(0.0, turn0, start), Poses(duration, turn, end))


@numba.njit(cache=True)
def fall(x, v, mass, gravity, contact, s0, s1, steps, dt, force):
    """Symplectic Euler over steps of dt while the interval goes from fraction s0 to s1, in place."""
    ds = (s1 - s0) / steps
    for step in range(steps):
        force[:] = 0.0
        add_contact(contact, x, v, s0 + step * ds, force, None)
        for c in range(3):
            for i in range(x.shape[1]):
                v[c, i] += dt * (force[c, i] / mass[i] + gravity[c])
                x[c, i] += dt * v[c, i]
        commit_contact(contact, x, v, s0 + (step + 1) * ds, None)


def settle(contact, x, v, s=0.0):
    """End a step at x, v: an evaluation and the commit that goes by it."""
    add_contact(contact, x, v, s, np.zeros_like(x), None)
    commit_contact(contact, x, v, s, None)


def points(*rows):
    """(3, n) positions from rows of x, y, z."""
    return np.ascontiguousarray(np.array(rows, np.float64).T)
