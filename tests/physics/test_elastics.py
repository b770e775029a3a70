"""Elastics in a garment's edges: how long, how heavy, what they hold, and what is no place for one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.special import ellipe
from sewing_patterns import Body, back, column, front, panel, stitch, tube
from sewing_patterns import pattern as pattern_of

from nuno.scene import scene_file
from nuno.scene.files import SceneFiles
from nuno.simulation.run import Simulation
from nuno.simulation.yarns import structural_edges
from nuno_cloth.models.pattern import DENSITY, HELD, STIFFNESS, Pattern, PatternConfig, girth_inside
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Springs

WIDE, DEEP = 0.08, 0.06
BODY = column((WIDE, DEEP), (0.9, 1.4), around=256)
GIRTH = float(4.0 * WIDE * ellipe(1.0 - (DEEP / WIDE) ** 2))


def labelled(label: str = "waist", only_front: bool = False) -> dict[str, Any]:
    """A tube of 60 cm, whose upper edges have a label."""
    cut = tube()
    for name, edge in (("front", 2), *(() if only_front else (("back", 1),))):
        cut["pattern"]["panels"][name]["edges"][edge]["label"] = label
    return cut


def put_on(folder: Path, cut: dict[str, Any], body: Body = BODY, edge: float = 0.02, **fields: Any) -> Fabric:
    (folder / "tube.json").write_text(json.dumps(cut))
    config = PatternConfig(file="tube.json", edge=edge, over={"body": "wearer"}, **fields)  # type: ignore[arg-type]
    return Pattern().build_over(config, SceneFiles(folder), 0, *body)


def test_a_tape_goes_round_a_body_as_its_section_does_and_bridges_what_is_between_two() -> None:
    ring = np.array([[np.sin(t), 0.0, np.cos(t)] for t in np.linspace(0.0, 6.0, 40)]) * 0.3 + [0.0, 1.1, 0.0]
    assert girth_inside(ring, *BODY) == pytest.approx(GIRTH, rel=1e-3)
    # Tilted by 30 degrees about x: an ellipse that is deeper by 1 / cos.
    turn = np.array([[1, 0, 0], [0, np.cos(np.pi / 6), -np.sin(np.pi / 6)], [0, np.sin(np.pi / 6), np.cos(np.pi / 6)]])
    deep = DEEP / np.cos(np.pi / 6)
    tilted = 4.0 * WIDE * ellipe(1.0 - (deep / WIDE) ** 2)
    assert girth_inside((ring - [0, 1.1, 0]) @ turn.T + [0, 1.1, 0], *BODY) == pytest.approx(tilted, rel=1e-3)
    # Two round legs, 30 cm apart: a tape round both has two straight parts; one round the left has none.
    one, faces = column((0.05, 0.05), (0.9, 1.4), around=256)
    apart = np.array([0.15, 0.0, 0.0])
    legs = np.concatenate([one - apart, one + apart]), np.concatenate([faces, faces + np.int32(len(one))])
    assert girth_inside(ring, *legs) == pytest.approx(2.0 * np.pi * 0.05 + 0.6, rel=1e-3)
    assert girth_inside(0.4 * (ring - [0, 1.1, 0]) + [0.15, 1.1, 0], *legs) == pytest.approx(
        2.0 * np.pi * 0.05, rel=1e-3
    )
    beside, line = ring.copy(), ring.copy()
    beside[:, 0] += 2.0
    line[:, 2] = 0.0
    assert girth_inside(beside, *BODY) == girth_inside(line, *BODY) == 0.0


@pytest.mark.quick(edge=[0.03])
@pytest.mark.parametrize("edge", [0.01, 0.03])
def test_a_band_is_as_long_as_its_share_of_the_body_and_as_heavy(tmp_path: Path, edge: float) -> None:
    """On any triangles; along a seam, or an opening. A band that would be longer than the edges is as long as these."""
    plain = put_on(tmp_path, labelled(), edge=edge)
    assert plain.springs is None
    for share, length in ((0.85, 0.85 * GIRTH), (0.5, 0.5 * GIRTH)):
        cloth = put_on(tmp_path, labelled(), edge=edge, elastics=[{"along": "waist", "girth": share}])
        assert cloth.springs is not None
        assert cloth.springs.rest.sum() == pytest.approx(length, rel=2e-3)
        np.testing.assert_allclose(cloth.springs.k * cloth.springs.rest, STIFFNESS)
        assert cloth.mass.sum() - plain.mass.sum() == pytest.approx(DENSITY * length, rel=2e-3)
        assert np.ptp(cloth.position[np.unique(cloth.springs.pairs()), 1]) < 0.05
    tight = put_on(
        tmp_path, labelled(), column((0.105, 0.1), (0.9, 1.4)), edge, elastics=[{"along": "waist", "girth": 1}]
    )
    assert tight.springs is not None and tight.springs.rest.sum() == pytest.approx(0.6, rel=1e-9)


def test_along_a_gathered_seam_the_shorter_edge_counts(tmp_path: Path) -> None:
    """A flounce of 90 cm, gathered onto a tube of 60 cm whose edges have no label, round more than that."""
    flounce = panel((0, 0), (45, 0), (45, 10), (0, 10), translation=[-22.5, 88, 15])
    behind = panel((0, 0), (0, 10), (45, 10), (45, 0), translation=[-22.5, 88, -15])
    for own, edge in ((flounce, 2), (behind, 1)):
        own["edges"][edge]["label"] = "join"
    seams = [stitch("front[1]", "back[2]"), stitch("front[3]", "back[0]"), stitch("low[1]", "behind[2]"),
             stitch("low[3]", "behind[0]"), stitch("front[0]", "low[2]"), stitch("back[3]", "behind[1]")]  # fmt: skip
    cut = pattern_of({"front": front(), "back": back(), "low": flounce, "behind": behind}, *seams)
    cloth = put_on(tmp_path, cut, column((0.105, 0.1), (0.7, 1.4)), elastics=[{"along": "join", "girth": 1}])
    assert cloth.springs is not None and cloth.springs.rest.sum() == pytest.approx(0.6, rel=1e-9)


@pytest.mark.full
def test_edges_that_garmentcode_holds_are_held_unless_told_otherwise(tmp_path: Path) -> None:
    for label in HELD:
        held = put_on(tmp_path, labelled(label))
        assert held.springs is not None and held.springs.rest.sum() == pytest.approx(0.85 * GIRTH, rel=2e-3)
        assert put_on(tmp_path, labelled(label), elastics=[]).springs is None
    assert put_on(tmp_path, labelled(HELD[0], only_front=True)).springs is None, "half of a waist is not held"


REFUSED: dict[str, tuple[dict[str, Any], list[dict[str, Any]], str, str]] = {
    "no such label": (labelled(), [{"along": "waist"}, {"along": "wiast"}], "elastics.1.along", "did you mean 'waist'"),
    "half of it": (labelled(only_front=True), [{"along": "waist"}], "elastics.0.along", "do not go round"),
}


def test_edges_that_the_body_is_not_in_are_no_place_for_an_elastic(tmp_path: Path) -> None:
    """A tube that stands above a column, in whose top edge nothing is."""
    with pytest.raises(BadInput, match="go round no part of the body") as told:
        put_on(tmp_path, labelled(), column((WIDE, DEEP), (0.2, 0.9)), elastics=[{"along": "waist"}])
    assert told.value.field == "elastics.0.along"


@pytest.mark.full
def test_a_band_is_not_shown_as_the_cloth_s_stretch(tmp_path: Path) -> None:
    held = put_on(tmp_path, labelled(), elastics=[{"along": "waist", "girth": 0.5}])
    plain = put_on(tmp_path, labelled(), elastics=[])
    for one, other in zip(structural_edges(held), structural_edges(plain), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_is_no_place_for_an_elastic_is_refused_by_its_field(tmp_path: Path, name: str) -> None:
    cut, elastics, field, text = REFUSED[name]
    with pytest.raises(BadInput, match=text) as told:
        put_on(tmp_path, cut, elastics=elastics)
    assert told.value.field == field
    config = PatternConfig(file="tube.json", elastics=[{"along": "waist"}])  # type: ignore[list-item]
    with pytest.raises(BadInput, match="as long as the body is round") as told:
        Pattern().build(config, SceneFiles(tmp_path), 0)
    assert told.value.field == "elastics"


SCENE = """\
nuno: 1
name: held
duration: 0.75 s
frame_rate: 60 Hz
solver: {{plugin: {solver}, dt: auto}}
damping: {{first: 400, over: 50 ms, last: 8}}
objects:
  - name: tube
    model:
      plugin: pattern
      file: tube.json
      edge: 2.5 cm
      fabric: {{density: 3 kg/m^2, warp: {warp}, weft: {warp}, shear: 20 N/m, bend_warp: 10 uN*m, bend_weft: 10 uN*m}}
      over: {{body: wearer, clearance: 5 mm}}
      elastics: [{{along: waist}}]
bodies:
  - {{name: wearer, collider: {{plugin: mesh, file: body.obj}}, friction: {friction}}}
cloth_contact: {{plugin: offset, thickness: 2 mm, bodies: [wearer]}}
"""


@pytest.mark.full
@pytest.mark.quick(solver=["respa"])
@pytest.mark.parametrize(("solver", "warp"), [("respa", "100 N/m"), ("symplectic_euler", "400 N/m")])
def test_a_band_bears_two_pi_mu_times_its_pull(tmp_path: Path, solver: str, warp: str) -> None:
    """A heavy tube on a round column, loose but for the band, slides with 0.75 of the law's friction, not with 1.3."""
    trimesh.Trimesh(*column((0.08, 0.08), (0.9, 1.6)), process=False).export(tmp_path / "body.obj")
    (tmp_path / "tube.json").write_text(json.dumps(labelled()))
    scene = tmp_path / "scene.yaml"

    def start(friction: float) -> tuple[Simulation, Springs]:
        scene.write_text(SCENE.format(solver=solver, warp=warp, friction=friction))
        run = Simulation.with_bodies(scene_file.read(scene), 1)
        assert run.fabric.springs is not None
        return run, run.fabric.springs

    run, band = start(0.0)
    # The cloth's middle is half of its thickness off the column.
    pull = STIFFNESS * (2.0 * np.pi * 0.081 / band.rest.sum() - 1.0)
    law, waist = 9.81 * float(run.fabric.mass.sum()) / (2.0 * np.pi * pull), np.unique(band.pairs())
    fallen = {}
    for share in (0.75, 1.3):
        run, _ = start(share * law)
        heights = []
        while not run.finished:
            run.step()
            heights.append(float(run.state.x[waist, 1].mean()))
        fallen[share] = heights[-16] - heights[-1]  # in a quarter of a second, once it no longer bounces
    assert fallen[1.3] < 1e-3 < 0.04 < fallen[0.75], (law, fallen)
