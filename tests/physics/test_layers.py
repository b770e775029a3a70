"""Several garments on one body, and panels of several fabrics."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scenes import write_scene
from sewing_patterns import back, column, front, tube

from nuno.scene.files import SceneFiles
from nuno.scene.scene_file import read
from nuno.simulation.cloth import build_fabrics
from nuno_cloth.fabrics.material import Materials, resolve
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.membrane import build_triangles
from nuno_cloth.models.pattern import Pattern, PatternConfig, enclose
from nuno_cloth.models.placement import require_bare
from nuno_cloth.models.shirt import Shirt, ShirtConfig
from nuno_contact.offset.tree import make_tree
from nuno_contact.untangle.search import find_crossings
from nuno_geometry.check import check_closed
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int

BODY = column((0.08, 0.06), (0.9, 1.4))
CLEARANCE = 1.5e-2
SOFT = Material(0.1, 1e3, 8e2, 1e2, 2e-5, 1e-5, bend_poisson=0.2, hysteresis_warp=1e-3)
STIFF = Material(0.4, 5e4, 2e4, 2e3, 3e-4, 1e-4, damping_ratio=0.2, hysteresis_weft=3e-3)


def put_on(folder: Path, cut: object, worn: list[Fabric], **fields: object) -> Fabric:
    (folder / "cut.json").write_text(json.dumps(cut))
    given = {"file": "cut.json", "edge": 0.02, "over": {"body": "wearer", "clearance": CLEARANCE}} | fields
    config = PatternConfig.model_validate(given)
    return Pattern().build_over(config, SceneFiles(folder), 0, *BODY, worn)


def crossings(layers: list[Fabric]) -> int:
    """Edges of any layer through triangles of another."""
    first = np.cumsum([0, *(one.number for one in layers)])
    x = np.concatenate([one.position for one in layers])
    faces = np.concatenate([one.faces + np.int32(start) for one, start in zip(layers, first, strict=False)])
    piece = np.repeat(np.arange(len(layers), dtype=np.int32), np.diff(first))
    meets = ~np.eye(len(layers), dtype=bool)
    edge, _ = find_crossings(make_tree(x, faces, len(faces)), x, piece, meets, True)
    return len(edge)


def girth(fabric: Fabric) -> float:
    """Mean distance from the column's axis [m]."""
    return float(np.hypot(fabric.position[:, 0], fabric.position[:, 2]).mean())


@pytest.mark.quick(wide=[0.8])
@pytest.mark.parametrize("wide", [1.0, 0.8])
def test_each_layer_starts_outside_of_those_before_it(tmp_path: Path, wide: float) -> None:
    """Also one that is cut narrower than what it is drawn over."""
    layers: list[Fabric] = []
    for share in (1.0, wide, wide):
        cut = tube(front=front(30.0 * share), back=back(30.0 * share))
        layers.append(put_on(tmp_path, cut, layers))
    assert crossings(layers) == 0
    for inner, outer in pairwise(layers):
        away = np.abs(closest_points(build_tree(inner.position, inner.faces), outer.position).distance)
        assert away.min() > 0.6 * CLEARANCE
        assert girth(outer) > girth(inner) + 0.6 * CLEARANCE


@pytest.mark.full
def test_a_bare_body_is_put_on_as_before(tmp_path: Path) -> None:
    """To the last bit whether or not other bodies wear something; a dressed one is not."""
    bare, first = put_on(tmp_path, tube(), []), put_on(tmp_path, tube(), [])
    np.testing.assert_array_equal(bare.position, first.position)
    assert not np.array_equal(put_on(tmp_path, tube(), [bare]).position, bare.position)


def test_what_is_enclosed_is_closed_and_keeps_its_distance() -> None:
    worn = _cloth(*_tube(0.10, 1.0, 1.3))
    x, faces = enclose(*BODY, [worn], CLEARANCE)
    check_closed(x, faces)
    for other in (BODY, (worn.position, worn.faces)):
        away = np.abs(closest_points(build_tree(*other), x).distance)
        assert away.min() > 0.5 * CLEARANCE
    # The room between body and cloth, here 2 to 4 cm wide, is inside.
    between = np.array([[0.0, 1.15, 0.085]])
    assert closest_points(build_tree(x, faces), between).distance[0] < 0.0


def _tube(radius: float, low: float, high: float) -> tuple[Float, Int]:
    x, faces = column((radius, radius), (low, high))
    inside = np.hypot(x[:, 0], x[:, 2])[faces] > 0.99 * radius
    return x, np.ascontiguousarray(faces[inside.all(axis=1)])


def _cloth(x: Float, faces: Int) -> Fabric:
    parts = build_triangles(SOFT, x[faces], faces, np.array([0.0, 1.0, 0.0]), np.zeros(len(x), bool))
    return Fabric(name="worn", position=x, velocity=0.0 * x, pinned=np.zeros(len(x), bool), **parts._asdict())


def test_a_shirt_goes_on_a_bare_body() -> None:
    config = ShirtConfig.model_validate({"over": {"body": "wearer"}, "fabric": "denim"})
    with pytest.raises(BadInput, match="put on a bare body"):
        Shirt().build_over(config, SceneFiles(Path()), 0, *BODY, [_cloth(*_tube(0.10, 1.0, 1.3))])


@pytest.mark.parametrize(("name", "other"), [("shirt", "skirt"), ("skirt", "shirt")])
def test_of_two_that_are_cut_to_a_bare_body_neither_is_told_to_come_first(name: str, other: str) -> None:
    """A pattern goes over what is worn, whatever it is: the way that is said leads out."""
    worn = [replace(_cloth(*_tube(0.10, 1.0, 1.3)), name=other)]
    with pytest.raises(BadInput) as refused:
        require_bare(worn, name, "wearer")
    said = str(refused.value.remedy)
    assert "come first" not in said and other in said and "plugin: pattern" in said
    require_bare([], name, "wearer")
    with pytest.raises(BadInput, match="bare body") as refused:
        require_bare([_cloth(*_tube(0.10, 1.0, 1.3))], name, "wearer")
    assert refused.value.remedy == f"let the {name} come first among the objects"


def test_panels_of_one_fabric_each_are_as_if_cut_alone() -> None:
    """Two plates that no seam joins, in one mesh: each has masses, membrane, bending and friction as by itself."""
    grid = np.stack(np.meshgrid(np.linspace(0.0, 0.1, 5), np.linspace(0.0, 0.2, 7)), axis=-1).reshape(-1, 2)
    x = np.column_stack([grid, 0.0 * grid[:, 0]])
    at = np.arange(35).reshape(7, 5)
    a, b, c, d = (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1])
    faces = np.concatenate([np.stack([a, b, c], 2).reshape(-1, 3), np.stack([a, c, d], 2).reshape(-1, 3)]).astype(
        np.int32
    )
    both, corners = np.concatenate([faces, faces + np.int32(len(x))]), np.concatenate([x[faces], x[faces]])
    warp, held = np.array([0.0, 1.0, 0.0]), np.zeros(2 * len(x), bool)
    of = np.repeat(np.array([1, 0], np.int32), len(faces))
    joined = build_triangles(Materials((SOFT, STIFF), of), corners, both, warp, held)
    for k, material in enumerate((STIFF, SOFT)):
        alone = build_triangles(material, x[faces], faces, warp, held[: len(x)])
        own, at_faces = slice(k * len(x), (k + 1) * len(x)), slice(k * len(faces), (k + 1) * len(faces))
        np.testing.assert_array_equal(joined.mass[own], alone.mass)
        assert joined.membrane is not None and alone.membrane is not None
        np.testing.assert_array_equal(joined.membrane.moduli[:, at_faces], alone.membrane.moduli)
        np.testing.assert_array_equal(joined.membrane.damping[:, at_faces], alone.membrane.damping)
        assert joined.bending is not None and alone.bending is not None
        within = (joined.bending.pairs // len(x) == k).all(axis=1)
        np.testing.assert_array_equal(joined.bending.pairs[within] - k * len(x), alone.bending.pairs)
        np.testing.assert_allclose(joined.bending.weight[within], alone.bending.weight, rtol=1e-9, atol=1e-9)
        assert joined.friction is not None and alone.friction is not None
        mine = joined.friction.vertices[:, 0] // len(x) == k
        np.testing.assert_array_equal(joined.friction.limit[:, mine], alone.friction.limit)


def test_a_panel_of_another_fabric_weighs_and_resists_as_that_does(tmp_path: Path) -> None:
    fabric = put_on(tmp_path, tube(), [], fabric="interlock", fabrics={"back": "denim"})
    assert fabric.membrane is not None and fabric.corners is not None and fabric.corners.panels is not None
    panels = fabric.corners.panels
    knit, denim = resolve("interlock"), resolve("denim")
    assert isinstance(knit, Material) and isinstance(denim, Material)
    assert fabric.mass.sum() == pytest.approx(0.06 * (knit.density + denim.density), rel=1e-12)
    of_back = panels.of == panels.names.index("back")
    np.testing.assert_array_equal(fabric.membrane.moduli[0], np.where(of_back, denim.warp, knit.warp))


@pytest.mark.parametrize(
    ("fabrics", "field", "problem"),
    [
        ({"bakc": "denim"}, "fabrics", "the pattern has no such panel"),
        ({"back": {"density": 0.2, "structural": 100.0}}, "fabrics.back", "constants per spring make no membrane"),
    ],
)
def test_fabrics_of_no_panel_are_refused(tmp_path: Path, fabrics: object, field: str, problem: str) -> None:
    with pytest.raises(BadInput, match=problem) as caught:
        put_on(tmp_path, tube(), [], fabric="interlock", fabrics=fabrics)
    assert caught.value.field == field
    if field == "fabrics":
        assert "back" in (caught.value.remedy or "")


@pytest.mark.full
def test_a_scenes_objects_are_layers_in_their_order(tmp_path: Path) -> None:
    """Those of one body; what another body wears is nothing to it."""
    (tmp_path / "tube.json").write_text(json.dumps(tube()))
    trimesh.Trimesh(*BODY, process=False).export(tmp_path / "column.obj")
    model = {"plugin": "pattern", "file": "tube.json", "edge": "2 cm"}
    on = {"one": "near", "other": "far", "second": "near"}
    scene = write_scene(
        tmp_path,
        objects=[{"name": name, "model": model | {"over": {"body": body}}} for name, body in on.items()],
        bodies=[
            {"name": name, "collider": {"plugin": "mesh", "file": "column.obj"}} for name in ("near", "far")
        ],
        contact={"plugin": "sliding"},
    )  # fmt: skip
    one, other, second = build_fabrics(read(scene))
    np.testing.assert_array_equal(one.position, other.position)
    assert crossings([one, second]) == 0 and girth(second) > girth(one) + 1e-2
