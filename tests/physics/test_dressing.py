"""Patterns put on bodies: bending across seams, rest shapes as they are cut, and starts that are clear of the body."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sewing_patterns import REAL, Body, back, column, front, panel, pattern, read_pattern, stitch, tube

from nuno.scene.files import SceneFiles
from nuno_cloth.fabrics.material import resolve
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.membrane import build_triangles
from nuno_cloth.models.pattern import Pattern, PatternConfig
from nuno_cloth.sewing.sew import sew
from nuno_contact.offset.tree import make_tree
from nuno_contact.untangle.plugin import Untangle, UntangleConfig
from nuno_contact.untangle.search import find_crossings
from nuno_geometry.closest_point import closest_points
from nuno_geometry.mesh_files.mesh import read_closed
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

CLEARANCE = 5e-3
CLOTH = Material(0.1, 1e3, 1e3, 1e2, 2e-5, 1e-5, bend_poisson=0.2)


def through(fabric: Fabric, body: Body) -> tuple[int, int]:
    """How many edges go through triangles, of cloth and body, and of cloth and itself."""
    n, x = fabric.number, np.concatenate([fabric.position, body[0]])
    tree = make_tree(x, np.concatenate([fabric.faces, body[1] + np.int32(n)]), len(fabric.faces))
    piece, meets = (np.arange(len(x)) >= n).astype(np.int32), np.array([[True, True], [True, False]])
    edge, face = find_crossings(tree, x, piece, meets, True)
    of_body = (face >= len(fabric.faces)) | (tree.edges[edge, 0] >= n)
    return int(of_body.sum()), int((~of_body).sum())


def put_on(folder: Path, name: str, body: Body, edge: float, clearance: float = CLEARANCE) -> Fabric:
    config = PatternConfig(file=name, edge=edge, fabric="interlock", over={"body": "wearer", "clearance": clearance})  # type: ignore[arg-type]
    return Pattern().build_over(config, SceneFiles(folder), 0, *body)


@pytest.mark.parametrize("angle", [0.0, 35.0])
def test_bending_goes_on_across_a_seam(tmp_path: Path, angle: float) -> None:
    """Two panels that are sewn, lying beside each other, store under constant curvature what a plate without seam does:
    (B_w k_w^2 + B_f k_f^2 + 2 B_1 k_w k_f + 4 B_t k_t^2) / 2 per area.
    """
    half = panel((0, 0), (10, 0), (10, 20), (0, 20))
    cut = pattern({"one": half, "other": half}, stitch("one[1]", "other[3]"))
    (tmp_path / "plate.json").write_text(json.dumps(cut))
    sewn = sew(read_pattern(SceneFiles(tmp_path), "plate.json"), 0.02)
    side = np.zeros(len(sewn.flat), bool)
    side[sewn.faces[sewn.panel == 1]] = True
    laid = sewn.flat + np.where(side[:, None], [0.1, 0.0], 0.0)
    share = np.bincount(sewn.merged)
    x, y = (np.bincount(sewn.merged, along) / share for along in laid.T)
    np.testing.assert_allclose(x[sewn.merged], laid[:, 0], atol=1e-12)
    corners = np.column_stack([sewn.flat, 0.0 * sewn.flat[:, 0]])[sewn.faces]
    turn = np.radians(angle)
    warp = np.array([-np.sin(turn), np.cos(turn), 0.0])
    parts = build_triangles(CLOTH, corners, sewn.sewn_faces, warp, np.zeros(sewn.number, bool))
    assert parts.bending is not None
    (i, j), weight = parts.bending.pairs.T, parts.bending.weight
    for k_x, k_y in ((1e-3, 0.0), (0.0, 1e-3), (1e-3, -2e-3)):
        z = 0.5 * k_x * x**2 + 0.5 * k_y * y**2
        tensor = np.diag([k_x, k_y])
        w, f = warp[:2], np.array([warp[1], -warp[0]])
        k_w, k_f, k_t = w @ tensor @ w, f @ tensor @ f, w @ tensor @ f
        both = CLOTH.bend_poisson * np.sqrt(CLOTH.bend_warp * CLOTH.bend_weft)
        per_area = CLOTH.bend_warp * k_w**2 + CLOTH.bend_weft * k_f**2 + 2.0 * both * k_w * k_f
        per_area += 4.0 * CLOTH.bend_twist * k_t**2
        energy = 0.5 * float((weight * (z[j] - z[i]) ** 2).sum())
        assert energy == pytest.approx(0.5 * 0.04 * per_area, rel=1e-8)


def test_panels_keep_the_shapes_and_the_weight_that_they_are_cut_to(tmp_path: Path) -> None:
    (tmp_path / "tube.json").write_text(json.dumps(tube()))
    fabric = put_on(tmp_path, "tube.json", column((0.08, 0.06), (0.9, 1.4)), 0.02)
    assert fabric.membrane is not None
    sewn = sew(read_pattern(SceneFiles(tmp_path), "tube.json"), 0.02)
    flat = sewn.flat[sewn.faces]
    sides = np.linalg.norm(np.roll(flat, -1, axis=1) - flat, axis=2)
    np.testing.assert_allclose(fabric.membrane.sides(), sides, rtol=1e-9)
    assert fabric.membrane.area.sum() == pytest.approx(2 * 0.3 * 0.2, rel=1e-12)
    assert fabric.mass.sum() == pytest.approx(resolve("interlock").density * 0.12, rel=1e-12)


def test_warp_runs_as_each_panel_has_it(tmp_path: Path) -> None:
    """The front's up and down, the back's, cut across, from side to side: F_w of triangles as they lie."""
    cut = tube(back=back() | {"grain": 90.0})
    (tmp_path / "tube.json").write_text(json.dumps(cut))
    fabric = put_on(tmp_path, "tube.json", column((0.08, 0.06), (0.9, 1.4)), 0.02)
    sewn = sew(read_pattern(SceneFiles(tmp_path), "tube.json"), 0.02)
    corners = sewn.flat[sewn.faces]
    assert fabric.membrane is not None
    warp = np.einsum("fc,fcd->fd", fabric.membrane.shares()[0], corners)
    np.testing.assert_allclose(np.abs(warp), np.where(sewn.panel[:, None] == 0, [0.0, 1.0], [1.0, 0.0]), atol=1e-9)


@pytest.mark.quick(radii=[(0.08, 0.06)])
@pytest.mark.parametrize("radii", [(0.08, 0.06), (0.105, 0.08)])
def test_a_tube_closes_round_a_column_that_its_panels_start_far_from(
    tmp_path: Path, radii: tuple[float, float]
) -> None:
    """60 cm round, on columns of 44 and 59 cm: hardly stretched, and nowhere nearer than the clearance."""
    (tmp_path / "tube.json").write_text(json.dumps(tube()))
    body = column(radii, (0.9, 1.4))
    fabric = put_on(tmp_path, "tube.json", body, 0.02)
    assert through(fabric, body) == (0, 0)
    assert closest_points(build_tree(*body), fabric.position).distance.min() > CLEARANCE - 1e-5
    assert fabric.membrane is not None
    pairs, rest = fabric.membrane.edges()
    length = np.linalg.norm(fabric.position[pairs[:, 1]] - fabric.position[pairs[:, 0]], axis=1)
    assert np.quantile(np.abs(length / rest - 1.0), 0.95) < 0.15


@pytest.mark.full
def test_a_panel_that_reaches_into_the_body_is_named(tmp_path: Path) -> None:
    """A tube in the middle of a column three metres wide: it is not put outside of that."""
    (tmp_path / "tube.json").write_text(json.dumps(tube()))
    with pytest.raises(BadInput, match=r"panel (front|back) cannot be put round wearer, and starts in it"):
        put_on(tmp_path, "tube.json", column((1.5, 1.5), (-0.5, 2.5)), 0.02)


@pytest.mark.full
@pytest.mark.quick(name=["shirt"], edge=[0.03])
@pytest.mark.parametrize("edge", [0.02, 0.03])
@pytest.mark.parametrize("name", REAL)
def test_real_garments_start_clear_of_their_body(shared_data: Path, name: str, edge: float) -> None:
    """No edge of cloth goes through a triangle of the body, nor one of the body through cloth; and none through
    anything once `untangle` has freed what begins in itself.
    """
    body = read_closed(shared_data / "body-mean.obj")
    fabric = put_on(shared_data / "patterns", f"{name}.json", body, edge, 0.02)
    assert through(fabric, body)[0] == 0
    whole = {"garment": np.arange(fabric.number, dtype=np.int32)}
    freed = Untangle().arrange(UntangleConfig(), fabric, whole, np.ones((1, 1), bool), 2e-3)
    assert through(replace(fabric, position=freed.position), body) == (0, 0)


def test_edges_far_longer_than_the_clearance_go_round_a_column_and_not_through_it(tmp_path: Path) -> None:
    """A chord of 10 cm between vertices 5 mm off a column of 8 by 6 cm would pass through it by a centimetre."""
    (tmp_path / "tube.json").write_text(json.dumps(tube()))
    body = column((0.08, 0.06), (0.9, 1.4))
    assert through(put_on(tmp_path, "tube.json", body, 0.1), body) == (0, 0)


def test_a_missing_print_is_refused_before_anything_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tube.json").write_text(json.dumps(tube()))
    monkeypatch.setattr("nuno_cloth.models.pattern.draw_together", None)
    config = PatternConfig(file="tube.json", texture="print.png", over={"body": "wearer"})  # type: ignore[arg-type]
    for build in (
        lambda: Pattern().build(config, SceneFiles(tmp_path), 0),
        lambda: Pattern().build_over(config, SceneFiles(tmp_path), 0, *column((0.08, 0.06), (0.9, 1.4))),
    ):
        with pytest.raises(BadInput, match=r"print\.png"):
            build()


def test_a_stitch_of_wrong_edges_is_named(tmp_path: Path) -> None:
    """A waist sewn to a side: the panel was laid as a ring without a waist, at nan."""
    sides = (-36, 0), (36, 0), (24, 60), (-24, 60)
    panels = {
        "front": panel(*sides, translation=[0, 45, 20]),
        "back": panel(*(sides[k] for k in (0, 3, 2, 1)), translation=[0, 45, -20]),
    }
    wrong = pattern(panels, stitch("front[2]", "back[2]"), stitch("front[3]", "back[0]"))
    (tmp_path / "wrong.json").write_text(json.dumps(wrong))
    with pytest.raises(BadInput) as caught:
        put_on(tmp_path, "wrong.json", column((0.16, 0.12), (0.0, 1.7)), 0.06)
    assert "stitch 0 (front[2], back[2])" in str(caught.value.remedy)


def test_names_and_labels_match_in_both_forms_of_an_accent(tmp_path: Path) -> None:
    """One character, or a letter and its accent: programs and file systems differ."""
    one, two = "R\u00fccken", "Ru\u0308cken"
    panels = {"front": front(), one: back()}
    panels["front"]["edges"][2]["label"] = panels[one]["edges"][1]["label"] = "\u00e9lastique"
    (tmp_path / "named.json").write_text(
        json.dumps(pattern(panels, stitch("front[1]", f"{two}[2]"), stitch("front[3]", f"{two}[0]")))
    )
    config = {"file": "named.json", "edge": 0.03, "fabrics": {two: "denim"}, "over": {"body": "wearer"}}
    config["elastics"] = [{"along": "e\u0301lastique"}]
    body = column((0.06, 0.05), (0.9, 1.4))
    fabric = Pattern().build_over(PatternConfig(**config), SceneFiles(tmp_path), 0, *body)  # type: ignore[arg-type]
    assert fabric.corners is not None and fabric.corners.panels is not None
    assert fabric.corners.panels.names == ("front", one)
