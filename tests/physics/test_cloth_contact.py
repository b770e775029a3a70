"""Cloth meets cloth: momentum is kept, what never meets keeps its bits, and what may pass through does."""

from __future__ import annotations

import numpy as np
import pytest
from sheets import DOWN, Pile, sheet

from nuno.cloth.join import join_fabrics
from nuno_contact.offset.plugin import Offset, OffsetConfig
from nuno_schemas.fabric import Float

pytestmark = pytest.mark.full


def test_what_never_meets_keeps_its_bits() -> None:
    """Two sheets far apart, which swing: as without cloth contact, to the last bit."""
    ends = []
    for contact in (True, False):
        pieces = [sheet(at=np.array([0.0, 0.3 * k, 0.0]), v=np.array([0.3, 0.0, 0.1])) for k in (0, 1)]
        for piece in pieces:
            piece.pinned[:8] = True
        pile = Pile(*pieces, contact=contact)
        for _ in range(10):
            pile.go(50)
        ends.append(pile.state.x.tobytes() + pile.state.v.tobytes())
    assert ends[0] == ends[1]


def collision(damping: float) -> Pile:
    """Two free sheets that fly at each other, without gravity and friction."""
    one, two = (
        sheet(v=np.array([0.1, 0.5, 0.0])),
        sheet(at=np.array([0.003, 0.004, 0.002]), v=np.array([0.0, -0.3, 0.0])),
    )
    return Pile(one, two, gravity=np.zeros(3), friction=0.0, damping=damping, dt=5e-5)


def test_momentum_is_kept_in_a_collision() -> None:
    """And its moment, to rounding."""
    pile = collision(0.5)
    mass = pile.fabric.mass[:, None]

    def kept() -> Float:
        x, v = pile.state.x, pile.state.v
        return np.concatenate([(mass * v).sum(axis=0), (mass * np.cross(x, v)).sum(axis=0)])

    before, most = kept(), 0
    for _ in range(20):
        pile.go(20)
        most = max(most, int(pile.meeting.tally[0]))
    assert most > 20
    assert np.abs(kept() - before)[:3].max() < 1e-12 * np.abs(mass * pile.state.v).sum()
    assert np.abs(kept() - before)[3:].max() < 1e-12 * np.abs(mass * pile.state.v).sum()


def test_objects_that_may_pass_through_each_other_do() -> None:
    """As `allow` says; each alone does not pass through itself."""
    one, two = sheet(), sheet(at=np.array([0.0, 1e-4, 0.0]))
    fabric = join_fabrics([one, two], "both")
    objects = {"one": np.arange(64, dtype=np.int32), "two": np.arange(64, 128, dtype=np.int32)}
    Offset().prepare(OffsetConfig(), fabric, objects, np.eye(2, dtype=bool), DOWN)
