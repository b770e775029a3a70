"""In no shipped scene's first 360 frames is cloth inside bodies, by the report's measure and tests of triangles."""

from __future__ import annotations

import pytest
from cloth_in_bodies import meeting

from nuno.collision.distance import measure_inside
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation

SCENES = shipped.scenes("", "contact", "sewn", "extreme")
LONGEST = 360
"""Frames of a scene that are looked at: `hand` goes round for 6000."""
EVERY = 5
"""Every so many frames the triangles are tested, too, which takes longer than the frames."""


SLIDING = "cloth_contact.bodies=[]", "bodies.0.contact={plugin: sliding}"


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        *((name, ()) for name in SCENES),
        *(("sewn/dress-walk", (*SLIDING, f"solver.dt={dt} ms")) for dt in (0.3546, 0.5555)),
    ],
)
def test_no_cloth_is_inside_bodies_in_any_frame(name: str, changes: tuple[str, ...]) -> None:
    """The walking dress also by closest points, at 47 and at 30 steps a frame: a knee comes fast at a fold of it."""
    loaded = scene_file.read(SCENES[name], changes)
    if not (loaded.scene.bodies and loaded.scene.moves):
        pytest.skip("no bodies, or nothing moves")
    simulation = Simulation.with_bodies(loaded, threads=1)
    geometry = simulation.geometry
    found: dict[int, tuple[float, int]] = {}
    while not simulation.finished and simulation.frame < LONGEST:
        assert simulation.step().report.status == "ok"
        x, faces, poses = simulation.state.x, simulation.fabric.faces, simulation.poses
        assert geometry is not None and poses is not None
        area = measure_inside(x, faces, geometry, poses).area
        triangles = int(meeting(x, faces, geometry, poses).sum()) if simulation.frame % EVERY == 0 else 0
        if area or triangles:
            found[simulation.frame] = area, triangles
    assert not found
