"""Cloth that is pinched between what is held and a body that pushes on."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from sheets import sheet

from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.piles import Oracle, pile
from nuno_contact.offset.contact_state import CLOSE, LISTED, NEAR
from nuno_contact.offset.impulse import SWEEPS, apply_impulses
from nuno_contact.offset.plugin import find_pinched
from nuno_schemas.fabric import Float

H, DT, SPEED = 2e-3, 1e-3, 3.0


def approach(share: float, held: int) -> tuple[Any, Float]:
    """A meeting in which vertex 0, which nothing moves, comes at SPEED towards a triangle, above the point with this
    share of its last corner, whose first `held` corners are held; and the velocities (3, n).
    """
    (term,) = pile(sheet(3, 0.1), sheet(3, 0.1, at=np.array([0.0, 0.2, 0.0])), thickness=H).terms[-1].data
    m = term._replace(**{name: getattr(term, name).copy() for name in ("mass", "last", "pair", "of", "reach")})
    i, j, k = m.faces[-1]
    weights = 0.5 * (1.0 - share), 0.5 * (1.0 - share), share
    under = sum(w * m.start[:, v] for w, v in zip(weights, (i, j, k), strict=True))
    m.last[:] = m.start
    m.last[:, 0] = under + np.array([0.0, 0.5 * H, 0.0])
    m.mass[[0, *(i, j, k)[:held]]] = 0.0
    m.pair[0], m.of[0], m.reach[0], m.normal[0], m.close[0] = (0, i, j, k), len(m.faces) - 1, H, (0, 1, 0), 0
    m.number[[LISTED, NEAR, CLOSE]] = 1
    v = np.zeros((3, m.last.shape[1]))
    v[1, 0] = -SPEED
    return m, v


@pytest.mark.full
@pytest.mark.parametrize("share", [0.9, 0.5, 0.1, 1e-2, 1e-4])
def test_no_vertex_beside_what_is_held_is_thrown_by_a_lever(share: float) -> None:
    """It would have to go at SPEED / share for the point to give way, ten thousand times as fast as what pushes it."""
    m, v = approach(share, 2)
    apply_impulses(m, v, DT, SWEEPS[1], None)
    moved = np.linalg.norm(v[:, m.faces[-1, 2]])
    assert 0.0 < moved < 8.0 * SPEED
    if share >= 0.5:
        assert share * moved * DT == pytest.approx(SPEED * DT - 0.25 * H, rel=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("share", [0.9, 1.0 / 3.0, 1e-4])
def test_a_triangle_that_is_free_gives_way_as_far_as_it_must(share: float) -> None:
    """The point below stops what comes at a quarter of the thickness: whichever corners it is shared by."""
    m, v = approach(share, 0)
    apply_impulses(m, v, DT, SWEEPS[1], None)
    weights = np.array([0.5 * (1.0 - share), 0.5 * (1.0 - share), share])
    gap = 0.5 * H + DT * (v[1, 0] - weights @ v[1, m.faces[-1]])
    assert gap == pytest.approx(0.25 * H, rel=1e-9)


@pytest.mark.full
def test_what_is_pinched_is_named() -> None:
    m, _ = approach(0.5, 2)
    m.share[:] = 1.0
    assert len(find_pinched(m)[0]) == 0
    m.share[[0, 11]] = 0.3
    pieces, places = find_pinched(m)
    assert pieces.tolist() == [0, 1] and np.array_equal(places, m.last[:, [0, 11]].T)


@pytest.mark.full
def test_bodies_that_pass_through_each_other_are_named_where_nothing_moves() -> None:
    """The two sheets taken for bodies, the second turned upright through the first."""
    m, _ = approach(0.5, 2)
    m = m._replace(body_law=np.zeros((2, 2)))
    second = m.piece == 1
    m.last[:] = m.start
    m.last[:, second] = m.start[:, second][[0, 2, 1]] - np.array([[0.0], [0.02], [0.18]])
    boxes = m.boxes.copy()
    m.share[:] = 0.0
    pieces, places = find_pinched(m)
    assert set(pieces.tolist()) == {0, 1}
    assert np.abs(np.median(places, axis=0) - [0.0, 0.0, 0.02]).max() < 0.06
    assert np.array_equal(boxes, m.boxes, equal_nan=True), "a step that goes on meanwhile has its own"


@pytest.mark.full
def test_a_waist_that_a_walking_body_comes_through_throws_nothing_about(tmp_path: Path) -> None:
    """Held by one joint of a body that bends, it pinches the body's vertices from the 33rd frame on. Before impulses
    were bounded the 34th left millions of pairs out, cut the free cloth three thousand times short, and threw vertices
    metres far in a step.
    """
    (tmp_path / "walk.bvh").write_bytes((Path(__file__).resolve().parents[2] / "scenes" / "walk.bvh").read_bytes())
    over, attach = {"body": "walker", "ease": "1 cm"}, {"body": "walker", "frame": "Hips"}
    model = {"plugin": "skirt", "over": over, "attach": attach, "length": "55 cm", "columns": 96, "rows": 36}
    collider = {"plugin": "skin", "shape": "person", "resolution": 64}
    scene = {
        "nuno": 1, "name": "pinched", "duration": "4 s", "frame_rate": 60, "solver": "respa", "damping": 4,
        "objects": [{"name": "skirt", "model": model | {"fabric": "denim"}}],
        "bodies": [{"name": "walker", "collider": collider, "friction": 0.3,
                    "motion": {"plugin": "bvh", "file": "walk.bvh", "end": "loop"}}],
        "cloth_contact": {"plugin": "offset", "thickness": "2 mm", "bodies": ["walker"]},
    }  # fmt: skip
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    simulation = Simulation.with_bodies(scene_file.read(tmp_path / "scene.yaml"), 1)
    while simulation.frame < 36:
        counts = simulation.step().report.counts
    assert counts["body_vertices_behind"] > 0 and counts["held_cut_short"] > 100
    assert counts["pairs_left_out"] == counts["steps_without_motion"] == 0 and counts["cut_short"] < 100
    assert np.linalg.norm(simulation.state.v, axis=1).max() < 50.0
    assert re.fullmatch(r"\d+ vertices of walker pinched near \(.*\) m: .*", simulation.holds())
    m: Any = simulation.memory.work.packed.bodies[-1]  # type: ignore[attr-defined]
    assert not Oracle(m.start.T, m.faces).crossed(np.ascontiguousarray(m.last.T))
