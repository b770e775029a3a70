"""The bench's stocking lies on its leg, and its figures are of one measurement."""

from __future__ import annotations

import numpy as np
import pytest

from nuno.plugin_contract import registry
from nuno_bench.speed import leg as render_speed


def test_the_stocking_lies_on_the_leg_with_all_its_links() -> None:
    worn, links = render_speed.stocking(12)
    assert links == 12 * 11 + 12 * 12 == len(worn.links)
    body = worn.bodies[0]
    near = registry.load("nuno.colliders", "mesh").search(body.vertices, body.faces)(worn.points)
    # Quads of the leg's rings are two triangles, and places on them lie beside both a little.
    assert np.abs(near.distance).max() < 1e-3
    assert np.ptp(worn.points[:, 2]) > 0.4
    assert worn.yarns is not None and (worn.yarns.radius == render_speed.RADIUS).all()


@pytest.mark.full
def test_seconds_and_rays_are_of_the_same_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    small = render_speed.stocking(12)
    monkeypatch.setattr(render_speed, "stocking", lambda: small)
    monkeypatch.setattr(render_speed, "SIDE", 32)
    taken, rays = render_speed.render(2)
    assert taken.bar == render_speed.SLOWEST and taken.at_most and len(taken.samples) == 2
    assert np.allclose(np.array(taken.samples) * rays.samples, render_speed.SAMPLES * 32 * 32 * 1e-6)
