"""A belt on a turning cylinder: T2/T1 = e^(mu phi) (Euler, Eytelwein)."""

import numba
import numpy as np
import pytest
from contact_world import capsule, contact_for, geometry, move

from nuno_contact.penalty.contact import add_contact, commit_contact


@numba.njit(cache=True)
def pull(x, v, mass, k, rest, c, weight, contact, s0, s1, steps, dt, force):
    """A chain of springs whose first point is held and whose last one carries `weight` [N] along
    -y, on a moving body; returns the tension of the first spring [N] averaged over the steps.
    """
    ds, total, n = (s1 - s0) / steps, 0.0, x.shape[1]
    for step in range(steps):
        force[:] = 0.0
        add_contact(contact, x, v, s0 + step * ds, force, None)
        force[1, n - 1] -= weight
        for i in range(n - 1):
            d = x[:, i + 1] - x[:, i]
            length = np.sqrt((d * d).sum())
            tension = k * (length - rest) + c * ((v[:, i + 1] - v[:, i]) * d).sum() / length
            force[:, i] += tension * d / length
            force[:, i + 1] -= tension * d / length
            total += tension if i == 0 else 0.0
        for i in range(1, n):
            v[:, i] += dt * (force[:, i] / mass[i] - 40.0 * v[:, i])
            x[:, i] += dt * v[:, i]
        commit_contact(contact, x, v, s0 + (step + 1) * ds, None)
    return total / steps


@pytest.mark.full
@pytest.mark.parametrize(("mu", "wrap"), [(0.2, 0.5 * np.pi), (0.4, 0.5 * np.pi), (0.3, np.pi)])
def test_tension_grows_with_e_to_the_mu_phi(mu, wrap):
    """The cylinder turns under the belt, which stands still and slips everywhere. Per point of
    turning angle d the exact ratio is (cos d/2 + mu sin d/2)/(cos d/2 - mu sin d/2) =
    e^(mu d) (1 + O(d^3)); the belt hangs straight down on one side and leaves at the angle `wrap`
    on the other, towards its fixed end.
    """
    radius, spacing, k, weight = 0.1, 0.005, 4000.0, 1.0
    around = int(wrap * radius / spacing)
    straight = 12
    arc = np.arange(-straight, around + straight + 1) * spacing - 0.5 * (around * spacing - wrap * radius)
    angle = np.clip(wrap - arc / radius, 0.0, wrap)
    x = radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    off = np.where(arc < 0.0, -arc, 0.0)
    x += off * np.array([[-np.sin(wrap)], [np.cos(wrap)], [0.0]])
    x[1] -= np.where(arc > wrap * radius, arc - wrap * radius, 0.0)
    n = x.shape[1]
    mass, v, force = np.full(n, 2e-4), np.zeros((3, n)), np.zeros((3, n))
    contact = contact_for(geometry(capsule((0, 0, -1), (0, 0, 1), radius), friction=mu), mass, 4000.0)
    rate, frame_time, dt, tension = -1.0, 0.05, 1e-4, 0.0
    for frame in range(40):
        before, after = (0.5 * rate * frame_time * i for i in (frame, frame + 1))
        turn0, turn = (np.array([np.cos(half), 0.0, 0.0, np.sin(half)]) for half in (before, after))
        move(contact, frame_time, turn, turn0=turn0)
        tension = pull(x, v, mass, k, spacing, 0.3, weight, contact, 0.0, 1.0, 500, dt, force)
    assert np.abs(v).max() < 1e-3
    first, last = x[:, 1] - x[:, 0], x[:, -1] - x[:, -2]
    turned = np.arccos(first @ last / np.linalg.norm(first) / np.linalg.norm(last))
    assert turned == pytest.approx(wrap, abs=0.05)
    assert tension / weight == pytest.approx(np.exp(mu * turned), rel=2e-3)
