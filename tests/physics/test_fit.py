"""How a garment fits: girths of meshes, of cloth as it was cut and as it is worn, strain and pressure."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation
from sewing_patterns import column, moved, panel, pattern, read_pattern, stitch, together, tube

from nuno.cli.fit import describe
from nuno.collision.bodies import outlines
from nuno.python_api.fit import cut, find_heights, map_fit, measure, measure_pressure, measure_seams, trunk
from nuno.scene.files import SceneFiles
from nuno_cloth.models.pattern import Pattern, PatternConfig
from nuno_cloth.sewing.sew import sew
from nuno_schemas.fabric import Bool, Float, Membrane

AROUND, LEVELS = 32, 6


def worn_tube(girth: float, height: float, radius: float, stretch: float = 1.0) -> tuple[Float, Membrane]:
    """A tube cut to a girth and a height [m], weft round it, worn at another radius and so much longer."""
    turn, up = np.meshgrid(np.arange(AROUND + 1), np.arange(LEVELS), indexing="ij")
    flat = np.stack([girth * turn / AROUND, height * up / (LEVELS - 1)], axis=2).reshape(-1, 2)
    a = (turn[:-1, :-1] * LEVELS + up[:-1, :-1]).reshape(-1)
    corners = np.concatenate(
        [np.stack([a, a + LEVELS, a + LEVELS + 1], axis=1), np.stack([a, a + LEVELS + 1, a + 1], axis=1)]
    )
    sides = np.stack([flat[corners[:, 1]] - flat[corners[:, 0]], flat[corners[:, 2]] - flat[corners[:, 0]]], axis=2)
    along, across = (
        np.linalg.solve(sides, np.array([[0.0], [1.0]]))[..., 0],
        np.linalg.solve(sides, np.array([[1.0], [0.0]]))[..., 0],
    )
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    ring = np.stack([radius * np.sin(angle), 0.0 * angle, radius * np.cos(angle)], axis=1)
    x = (
        ring[:, None] + stretch * np.array([0.0, 1.0, 0.0]) * height * np.arange(LEVELS)[:, None] / (LEVELS - 1)
    ).reshape(-1, 3)
    faces = (corners // LEVELS % AROUND * LEVELS + corners % LEVELS).astype(np.int32)
    area = 0.5 * np.abs(np.linalg.det(sides))
    return x, Membrane(faces, along, across, area, np.ones((4, len(area))), np.zeros((3, len(area))))


@pytest.mark.parametrize("height", [0.31, 0.5, 0.2 + 0.6 * 7 / 23])
def test_a_level_cut_of_a_column_is_its_polygon(height: float) -> None:
    """Once round, counter-clockwise seen from above; also at a height of vertices."""
    x, faces = column((0.3, 0.2), (0.2, 0.8))
    (one,) = cut(x, faces, height).curves()
    turn = 2.0 * np.pi * np.arange(65) / 64
    sides = np.diff(np.stack([0.2 * np.cos(turn), 0.3 * np.sin(turn)], axis=1), axis=0)
    # Sides of the mesh's diagonals part those of the polygon, on the same lines.
    assert one.length() == pytest.approx(np.linalg.norm(sides, axis=1).sum(), rel=1e-12)
    assert one.hull()[0] == pytest.approx(one.length(), rel=1e-12)
    assert one.turns(np.zeros(2)) == pytest.approx(1.0, abs=1e-12) and one.turns(np.array([1.0, 0.0])) == pytest.approx(
        0.0, abs=1e-12
    )


def test_of_a_trunk_and_arms_the_tape_goes_round_the_trunk() -> None:
    """And bridges a hollow."""
    parts = [trimesh.creation.box((0.4, 1.0, 0.2)), trimesh.creation.box((0.1, 1.0, 0.1))]
    parts[1].apply_translation((0.5, 0.0, 0.0))
    body = trimesh.util.concatenate(parts)
    found = trunk(cut(np.array(body.vertices), np.array(body.faces, np.int32), 0.123))
    assert found is not None and found.hull()[0] == pytest.approx(1.2, rel=1e-12)


@pytest.mark.parametrize(("girth", "radius"), [(1.3, 0.2), (1.1, 0.19)])
def test_ease_is_what_was_cut_less_the_tape(girth: float, radius: float) -> None:
    x, membrane = worn_tube(girth, 0.4, radius, stretch=1.05)
    body = column((0.18, 0.18), (-0.5, 0.9))
    fit = measure("tube", x, membrane, body, {"waist": 0.17, "neck": 0.8})
    waist, neck = fit.girths
    tape, worn = 128 * 0.18 * np.sin(np.pi / 64), 2 * AROUND * radius * np.sin(np.pi / AROUND)
    assert (waist.body, waist.cut, waist.worn) == pytest.approx((tape, girth, worn), rel=1e-9)
    assert waist.ease == pytest.approx(girth - tape, rel=1e-9)
    assert neck.body == pytest.approx(tape) and neck.cut is None and neck.ease is None
    assert [one.cut for one in fit.openings] == pytest.approx([girth, girth])
    np.testing.assert_allclose([(one.low, one.high) for one in fit.openings], [(0.42, 0.42), (0.0, 0.0)], atol=1e-12)
    for name, strain in (("warp", 0.05), ("weft", worn / girth - 1.0)):
        spread = fit.strains[name]
        assert (spread.median, spread.high, spread.most) == pytest.approx((strain, strain, strain), abs=1e-9)


@pytest.mark.parametrize(("radius", "centre", "tape"), [(0.3, 0.0, 2 * (0.39 + 0.15)), (0.11, -0.12, 0.6)])
def test_below_the_crotch_the_tape_goes_round_what_the_cloth_goes_round(
    radius: float, centre: float, tape: float
) -> None:
    """Two square legs: a skirt is round both, a trouser leg round one."""
    legs = [trimesh.creation.box((0.15, 1.0, 0.15)) for _ in range(2)]
    for leg, x in zip(legs, (0.12, -0.12), strict=True):
        leg.apply_translation((x, 0.0, 0.0))
    both = trimesh.util.concatenate(legs)
    x, membrane = worn_tube(2.0, 0.4, radius)
    x[:, 0] += centre
    body = np.array(both.vertices), np.array(both.faces, np.int32)
    (girth,) = measure("tube", x, membrane, body, {"low": 0.17}).girths
    assert girth.body == pytest.approx(tape, rel=1e-12) and girth.ease == pytest.approx(2.0 - tape, rel=1e-9)


def test_openings_that_share_a_vertex_are_told_apart() -> None:
    """Two squares that meet in a corner: their sides go round each, or round both in one, and none is lost."""
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 4, 5], [2, 5, 6]], np.int32)
    assert sum(map(len, outlines(faces))) == 8


def test_what_touches_the_body_nowhere_is_not_worn() -> None:
    x, membrane = worn_tube(1.3, 0.4, 0.2)
    fit = measure("tube", x, membrane, column((0.18, 0.18), (-0.5, 0.9)), {})
    for force, off in ((0.0, True), (1e-3, False)):
        normal = np.repeat([[1.0, 0.0, 0.0]], len(x), axis=0)
        pressed = replace(fit, pressed=measure_pressure(membrane, force * np.ones_like(x), normal))
        assert pressed.off is off and ("touches the body nowhere" in describe(pressed)) is off


@pytest.mark.parametrize("angle", [0.0, 40.0, 90.0])
def test_an_opening_tells_which_parts_of_the_body_go_through_it(angle: float) -> None:
    """Of two legs and an arm beside the garment, two, by tapes round them; nothing where it has slid off below."""
    x, membrane = worn_tube(1.4, 0.4, 0.22)
    turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    limbs = ((0.06, -0.1, -0.5), (0.08, 0.1, 0.1), (0.05, 0.4, -0.5))
    body = together(*(moved(column((r, r), (low, 0.9)), np.eye(3), [at, 0, 0]) for r, at, low in limbs))
    wearer, there = moved(body, turn, [0.3, 0.1, 0.0]), np.array([0.3, 0.1, 0.0])
    fit = measure("tube", x @ turn.T + there, membrane, wearer, {})
    tapes = [128 * r * np.sin(np.pi / 64) for r in (0.08, 0.06)]
    through = sorted((one.through for one in fit.openings), key=len)
    assert through[0] == pytest.approx(tapes[1:]) and through[1] == pytest.approx(tapes)
    assert "goes through" not in describe(fit)
    fit = measure("tube", (x - [0.0, 1.0, 0.0]) @ turn.T + there, membrane, wearer, {})
    assert [one.through for one in fit.openings] == [(), ()]
    assert "nothing of the body goes through opening 1 (of no panel), 2 (of no panel)" in describe(fit)


@pytest.mark.parametrize("angle", [0.0, 40.0, 180.0])
def test_what_goes_out_through_two_openings_of_a_garment_has_slipped(angle: float) -> None:
    """Of two cuffs on one arm, each below the other as seen from its own hand. Two on two arms have not."""
    x, membrane = worn_tube(0.8, 0.2, 0.1)
    turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    twice = np.concatenate([np.stack([membrane.faces, membrane.faces + len(x)])]).reshape(-1, 3).astype(np.int32)
    both = Membrane(twice, *(np.tile(part, 2 if part.ndim == 1 else (2, 1)) for part in
                             (membrane.along, membrane.across, membrane.area)),
                    np.tile(membrane.moduli, 2), np.tile(membrane.damping, 2))  # fmt: skip
    for apart, expected in (([0.0, 0.5, 0.0], [(), (3,), (0,), ()]), ([0.6, 0.0, 0.0], [()] * 4)):
        arms = [moved(column((0.08, 0.08), (-0.5, 1.5)), np.eye(3), [at, 0.0, 0.0]) for at in (0.0, 0.6)]
        worn = np.concatenate([x, x + apart]) @ turn.T
        fit = measure("cuffs", worn, both, moved(together(*arms), turn, [0.0, 0.0, 0.0]), {})
        assert [one.passed for one in fit.openings] == expected
        assert fit.on is ("slipped" not in describe(fit)) is not any(expected)


def test_an_opening_is_round_the_edges_that_the_check_tells(tmp_path: Path, shared_data: Path) -> None:
    """Of a tube and a T-shirt, at any size of triangles, whichever way round."""
    drawn = {"tube": tube(), "shirt": json.loads((shared_data / "patterns" / "shirt.json").read_text())}
    for name, data in drawn.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(data))
        said = Pattern().check_pattern(SceneFiles(tmp_path), f"{name}.json", 2.0).openings
        for edge in ("2.5 cm", "5 cm"):
            config = PatternConfig.model_validate({"file": f"{name}.json", "edge": edge, "fabric": "denim"})
            fabric = Pattern().build(config, SceneFiles(tmp_path), 0)
            assert fabric.membrane is not None and fabric.corners is not None
            fit = measure(name, fabric.position, fabric.membrane, column((0.1, 0.1), (0, 2)), {}, fabric.corners.panels)
            assert sorted(sorted(one.edges) for one in fit.openings) == sorted(sorted(one.edges) for one in said)


def test_what_is_open_in_front_has_no_ease() -> None:
    x, membrane = worn_tube(1.3, 0.4, 0.2)
    front = (x[membrane.faces].mean(axis=1)[:, 2] > 0.19).nonzero()[0]
    keep = np.setdiff1d(np.arange(membrane.number), front)
    opened = Membrane(membrane.faces[keep], membrane.along[keep], membrane.across[keep], membrane.area[keep],
                      membrane.moduli[:, keep], membrane.damping[:, keep])  # fmt: skip
    (waist,) = measure("tube", x, opened, column((0.18, 0.18), (-0.5, 0.9)), {"waist": 0.17}).girths
    assert waist.ease is None and waist.share is not None and 0.8 < waist.share < 0.95


def test_pressure_is_force_over_the_area_of_cloth() -> None:
    """Forces along the surface press with nothing, and opposite ones between layers of the same cloth cancel."""
    x, membrane = worn_tube(1.3, 0.4, 0.2)
    normal = x * [1.0, 0.0, 1.0] / 0.2
    area = np.bincount(membrane.faces.reshape(-1), np.repeat(membrane.area / 3.0, 3), len(x))
    force = 250.0 * area[:, None] * normal + [0.0, 0.3, 0.0]
    pressed = measure_pressure(membrane, force, normal)
    assert (pressed.mean, pressed.high) == pytest.approx((250.0, 250.0))
    assert pressed.area == pytest.approx(1.3 * 0.4) and pressed.force == pytest.approx(250.0 * 1.3 * 0.4)
    assert measure_pressure(membrane, -force, normal).area == 0.0


def test_a_map_of_the_fit_has_the_strain_of_each_vertex_and_the_pressure_of_its_force() -> None:
    """A tube that is worn 20 % longer, and round a smaller body: the larger strain is the warp's, in each vertex; the
    pressure times area is the force, and a pull outwards presses with nothing.
    """
    x, membrane = worn_tube(2.0 * AROUND * 0.2 * np.sin(np.pi / AROUND), 0.4, 0.2, stretch=1.2)
    area = np.bincount(membrane.faces.reshape(-1), np.repeat(membrane.area / 3.0, 3), len(x))
    outwards = np.where(x[:, 1] > 0.2, 80.0 * area, -3.0)
    over = map_fit(7, x, membrane, outwards)
    assert over.start == 7 and over.strain == pytest.approx(0.2, abs=1e-9)
    assert over.pressure == pytest.approx(np.where(x[:, 1] > 0.2, 80.0, 0.0))
    alone = map_fit(0, np.concatenate([x, [[9.0, 9.0, 9.0]]]), membrane, np.ones(len(x) + 1))
    assert np.isnan(alone.strain[-1]) and alone.pressure[-1] == 0.0


def test_heights_of_a_body_are_where_a_tape_finds_its_girths(shared_data: Path) -> None:
    """Against measurements that came with the body, to a centimetre; wherever it stands, and whatever its size."""
    mesh = trimesh.load(shared_data / "body-mean.obj", process=False)
    x, faces = np.array(mesh.vertices), np.array(mesh.faces, np.int32)
    measured = yaml.safe_load((shared_data / "body-mean.yaml").read_text())["body"]
    size, shift = 0.5, np.array([3.0, -2.0, 1.0])
    for scale, shifted in ((1.0, np.zeros(3)), (size, shift)):
        there = scale * x + shifted
        for name, height in find_heights(there, faces).items():
            found = trunk(cut(there, faces, height))
            assert found is not None
            assert found.hull()[0] / scale == pytest.approx(
                0.01 * measured["hips" if name == "hip" else name], abs=0.01
            )
        assert set(find_heights(there, faces)) == {"bust", "waist", "hip"}


def test_a_column_has_no_waist() -> None:
    assert find_heights(*column((0.3, 0.2), (0.2, 1.8))) == {}


def energy(x: Float, m: Membrane, some: Bool) -> float:
    """Of some triangles (t,) of a membrane, as its class defines it."""
    along, across = (np.einsum("tc,tcd->td", shares, x[m.faces]) for shares in m.shares())
    e, f, g = np.linalg.norm(along, axis=1) - 1.0, np.linalg.norm(across, axis=1) - 1.0, (along * across).sum(axis=1)
    density = m.moduli[0] * e * e + m.moduli[1] * f * f + 2.0 * m.moduli[2] * e * f + m.moduli[3] * g * g
    return float((0.5 * m.area * density)[some].sum())


@pytest.mark.parametrize("grain", [0.0, 30.0])
def test_a_seam_is_pulled_by_what_its_panel_does_work_with(tmp_path: Path, grain: float) -> None:
    """Two panels side by side, strained and sheared the same everywhere, and turned in space: what moves the vertices
    of the seam loses the energy that the pull tells. The ends' share of the free edges cancels.
    """
    half = panel((0, 0), (10, 0), (10, 20), (0, 20)) | {"grain": grain}
    cut_out = pattern({"one": half, "other": half}, stitch("one[1]", "other[3]"))
    (tmp_path / "plate.json").write_text(json.dumps(cut_out))
    config = PatternConfig.model_validate({"file": "plate.json", "edge": "2 cm", "fabric": "denim"})
    fabric = Pattern().build(config, SceneFiles(tmp_path), 0)
    assert fabric.membrane is not None and fabric.corners is not None and fabric.corners.panels is not None
    membrane, corners, panels = fabric.membrane, fabric.corners, fabric.corners.panels
    sewn = sew(read_pattern(SceneFiles(tmp_path), "plate.json"), 0.02)
    laid = np.empty((fabric.number, 2))
    for k in (0, 1):
        own = np.unique(sewn.faces[sewn.panel == k])
        laid[sewn.merged[own]] = sewn.flat[own] + [0.1 * k, 0.0]
    strained = np.array([[1.03, 0.02], [-0.01, 0.98]])
    turned = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0][:, :2]
    x = laid @ (turned @ strained).T
    (seam,) = measure_seams(x, membrane, corners)
    assert (seam.letters, sorted(seam.panels)) == ("A", ["one", "other"]) and seam.length == pytest.approx(0.2)
    assert seam.most == pytest.approx(seam.mean, rel=1e-9)
    on_seam = np.isclose(laid[:, 0], 0.1)
    way = turned @ strained @ [0.0, 1.0]
    out = turned @ strained @ [1.0, 0.0]
    out -= (out @ way) / (way @ way) * way
    out /= np.linalg.norm(out)
    step = 1e-6 * on_seam[:, None] * out
    some = panels.of == panels.names.index("one")
    work = (energy(x + step, membrane, some) - energy(x - step, membrane, some)) / 2e-6
    assert work / seam.length == pytest.approx(seam.mean, rel=1e-6)
