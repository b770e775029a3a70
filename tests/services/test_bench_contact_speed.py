"""What `nuno bench speed contact` times: the same work with and without contact, and queries of growing meshes."""

from __future__ import annotations

import numpy as np
import pytest

from nuno.collision.crossings import find_crossings
from nuno.collision.pairs import mesh_of
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.piles import pile
from nuno_bench.speed import contact
from nuno_bench.speed.contact import Parts
from nuno_contact.offset.contact_state import LISTED, ContactState
from nuno_schemas.errors import RunFailed

pytestmark = pytest.mark.full


def test_scenes_take_equal_steps_with_and_without() -> None:
    found = contact.on_over_off("hanging-sheet", ("objects.0.model.resolution=[8, 8]",), 0.1)
    assert found.on > 0.0 and found.off > 0.0
    assert found.note.startswith("6 frames of ")
    assert "64 vertices, 0 contacts at the end, 0 of " in found.note


def test_parts_of_contact_are_timed_beside_a_run_that_they_do_not_touch() -> None:
    """Cloth ends in the same bits whether it was looked at; what a step seldom needs counts as seldom."""
    ends = []
    for looked in (False, True):
        loaded = scene_file.read(shipped.find("contact/ribbon"), ("duration=0.1",))
        simulation = Simulation(loaded, None, None, 1)
        simulation.present()
        parts = Parts(simulation)
        while not simulation.finished:
            simulation.step()
            if looked:
                parts.look()
        ends.append(simulation.state.x.tobytes())
    assert ends[0] == ends[1]
    lists, choices, steps = (end - begin for end, begin in zip(parts._counted(), parts.begun, strict=True))
    assert 0 < lists < choices < steps == simulation.frame * simulation.steps
    mean = np.mean([moment["lists"] for moment in parts.moments])
    assert parts.each()["lists"] == pytest.approx(lists / steps * mean)


def test_a_query_finds_what_lies_on_each_other_and_that_nothing_crosses(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many pairs a vertex on a larger mesh, about; exponents are fitted to the times of each repeat."""
    monkeypatch.setattr(contact, "SIDES", (12, 24))
    shares = []
    for side in contact.SIDES:
        system = pile(*contact.layers(side))
        (meeting,) = system.terms[-1].data  # type: ignore[misc]
        assert isinstance(meeting, ContactState)
        contact.listing(meeting)()
        both = meeting.piece[meeting.pair[: meeting.number[LISTED]]][:, [0, 3]]
        shares.append(float((both[:, 0] != both[:, 1]).sum()) / system.fabric.number)
    assert shares[0] > 4.0
    assert shares[1] == pytest.approx(shares[0], rel=0.3)
    times = iter(np.array([1.0, 2.0, 4.0, 8.0] * 2) * 1e-3)
    monkeypatch.setattr(contact, "seconds", lambda ask: next(times))
    found = {one.what: one for one in contact.queries(2)}
    triangles = [4 * (side - 1) ** 2 for side in contact.SIDES]
    slope = np.log(4.0) / np.log(triangles[1] / triangles[0])
    assert found["a list of pairs: exponent over the triangles"].samples == pytest.approx((slope, slope))
    assert found["a list of pairs, 484 triangles"].samples == pytest.approx((1.0, 1.0))


def test_layers_that_cross_are_not_timed() -> None:
    fabric = pile(*contact.layers(8)).fabric
    mesh = mesh_of(fabric.faces)
    contact.look(fabric, mesh)
    fabric.position[64:, 1] -= 1e-3 + contact.GAP * np.linspace(0.0, 2.0, 64)
    assert len(find_crossings(fabric.position, mesh).edges)
    with pytest.raises(RunFailed, match="pass through"):
        contact.look(fabric, mesh)
