"""Patterns' files: GarmentCode's are read as they are; whatever is wrong is told by panel, edge, number and line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import TypeAdapter
from scipy.spatial.transform import Rotation
from sewing_patterns import REAL, front, panel, pattern, read, read_pattern, stitch, tube

from nuno.scene.files import SceneFiles
from nuno_cloth.sewing import pattern_file
from nuno_cloth.sewing.check import check_pattern
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import Config

BOW = panel((0, 0), (10, 10), (10, 0), (0, 10))


def change(where: tuple[Any, ...], value: Any) -> Callable[[dict[str, Any]], None]:
    def apply(data: dict[str, Any]) -> None:
        for part in where[:-1]:
            data = data[part]
        data[where[-1]] = value

    return apply


FRONT = ("pattern", "panels", "front")
STITCHES = ("pattern", "stitches")
CIRCLE = {"type": "circle", "params": [4.0, 0, 1]}
MOEBIUS = pattern({"band": panel((0, 0), (30, 0), (30, 5), (0, 5))}, stitch("band[1]", "band[3]", "right_wrong"))
FAULTS: dict[str, tuple[Callable[[dict[str, Any]], None], str, str]] = {
    "an unknown field": (change((*FRONT, "rotatoin"), [0, 0, 0]), "rotatoin", "did you mean 'rotation'?"),
    "an unknown curve": (
        change((*FRONT, "edges", 1, "curvature"), {"type": "spline", "params": []}), "edges[1].curvature.type",
        "unknown type",
    ),
    "a curve of no type": (
        change((*FRONT, "edges", 1, "curvature"), {"params": [[0.5, 0.1]]}), "edges[1].curvature", "add type: ...",
    ),
    "control points of another curve": (
        change((*FRONT, "edges", 1, "curvature"), {"type": "cubic", "params": [[0.5, 0.1]]}), "params",
        "for example params: [[0.3, 0.1], [0.7, 0.1]]",
    ),
    "a control point for a list of them": (
        change((*FRONT, "edges", 1, "curvature"), {"type": "quadratic", "params": [0.5, 0.1]}), "params",
        "for example params: [[0.5, 0.1]]",
    ),
    "a length with its unit": (
        change((*FRONT, "vertices", 2), [30, "36 cm"]), "vertices[2][1]",
        "for example vertices: [[-36, 0], [36, 0], [24, 60]]",
    ),
    "a decimal comma": (change((*FRONT, "vertices", 2), [30, "35,5"]), "vertices[2][1]", "write 35.5"),
    "a unit with a decimal comma": (change(("properties", "units_in_meter"), "100,0"), "units_in_meter", "write 100.0"),
    "no number": (change((*FRONT, "vertices", 2), [30, "x"]), "vertices[2][1]", "must be a number"),
    "no finite number": (change((*FRONT, "vertices", 2), [30, float("inf")]), "vertices[2][1]", "must be finite"),
    "no unit": (lambda data: data["properties"].pop("units_in_meter"), "units_in_meter",
                "for example units_in_meter: 100"),
    "a unit of nothing": (change(("properties", "units_in_meter"), 0), "units_in_meter", "more than 0"),
    "unknown coordinates": (change(("properties", "curvature_coords"), "local"), "curvature_coords", "known: absolute"),
    "no panels": (change(("pattern", "panels"), {}), "panels", "list"),
    "no such vertex": (change((*FRONT, "edges", 1, "endpoints"), [1, 7]), "front[1]", "the panel has 0 to 3"),
    "an open outline": (
        lambda data: data["pattern"]["panels"]["front"]["edges"].pop(), "front[2]",
        "ends at vertex 3, and edge 0 starts at vertex 0",
    ),
    "an edge of no length": (change((*FRONT, "vertices", 2), [30, 0]), "front[1]", "is 0 cm long"),
    "two straight edges": (change(FRONT, panel((0, 0), (10, 0))), "front", "give it a third edge"),
    "crossing edges": (change(FRONT, BOW), "front[0]", "crosses front[2] at (5, 5)"),
    "a curve across another": (
        change((*FRONT, "edges", 0, "curvature"), {"type": "quadratic", "params": [[0.5, 3.0]]}), "front[0]",
        "crosses front[2] at (",
    ),
    "an arc that does not reach": (
        change((*FRONT, "edges", 1, "curvature"), CIRCLE), "front[1]", "does not reach from end to end: at least 10",
    ),
    "no such panel": (change((*STITCHES, 0, 1, "panel"), "bak"), "bak[2]", "did you mean 'back'?"),
    "no such edge": (change((*STITCHES, 0, 1, "edge"), 4), "back[4]", "no edge 4: the panel has 0 to 3"),
    "an edge sewn twice": (change((*STITCHES, 1, 1, "edge"), 2), "back[2]", "is sewn twice, in stitches 0 and 1"),
    "an edge sewn to itself": (change((*STITCHES, 1), stitch("front[3]", "front[3]")), "front[3]", "sewn to itself"),
    "a stitch of one edge": (change((*STITCHES, 1), stitch("front[3]", "back[0]")[:1]), "stitch 1", "joins two edges"),
    "a word that means nothing": (change((*STITCHES, 1, 1), "left"), "stitches[1][1]", "right_wrong"),
    "sides that disagree": (change((*STITCHES, 1), stitch("front[3]", "back[0]", "right_wrong")), "front[3], back[0]",
                            "is this stitch meant without right_wrong?"),
    "a Moebius band": (lambda data: data.update(MOEBIUS), "band[1], band[3]", "right_wrong"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_is_told(fault: str, tmp_path: Path) -> None:
    damage, place, words = FAULTS[fault]
    data = tube()
    damage(data)
    with pytest.raises(BadInput) as refusal:
        read(tmp_path, data)
    said = str(refusal.value)
    assert place in said and words in said, said
    assert refusal.value.file == str(tmp_path / "pattern.json") and refusal.value.line is not None


def test_what_is_said_for_example_may_be_written() -> None:
    shown = 0
    for model in (
        value for value in vars(pattern_file).values() if isinstance(value, type) and issubclass(value, Config)
    ):
        for field in model.model_fields.values():
            for example in field.examples or ():
                TypeAdapter(field.annotation).validate_python(example, strict=False)
                shown += 1
    assert shown > 6


@pytest.mark.parametrize(
    ("old", "new", "number"),
    [('"units_in_meter": 100', '"units_in_meter": 39,37', "39.37"), ("[30, 35]", "[30,5, 35]", "30.5")],
)
def test_numbers_that_json_cuts_at_a_decimal_comma_are_refused(tmp_path: Path, old: str, new: str, number: str) -> None:
    data = tube()
    change((*FRONT, "vertices", 2), [30, 35])(data)
    text = json.dumps(data)
    assert old in text
    (tmp_path / "cut.json").write_text(text.replace(old, new))
    with pytest.raises(BadInput, match="a decimal comma") as refusal:
        read_pattern(SceneFiles(tmp_path), "cut.json")
    assert refusal.value.line == 1 and f"write {number}" in str(refusal.value.remedy)


def test_the_line_is_where_the_field_begins(tmp_path: Path) -> None:
    data = tube()
    change((*FRONT, "edges", 2, "endpoints"), [2, 9])(data)
    with pytest.raises(BadInput) as refusal:
        read(tmp_path, data)
    lines = json.dumps(data, indent=1).splitlines()
    third = [number for number, line in enumerate(lines, 1) if '"endpoints"' in line][2]
    assert (refusal.value.line, lines[third + 1].strip()) == (third, "9")


def test_json_with_tabs_and_small_numbers_and_yaml_say_the_same(tmp_path: Path) -> None:
    data = tube()
    data["pattern"]["panels"]["front"]["vertices"][0] = [1e-05, -1e-7]
    (tmp_path / "tabs.json").write_text(json.dumps(data, indent="\t"))
    (tmp_path / "one.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    first = read(tmp_path, data)
    for name in ("tabs.json", "one.yaml"):
        other = read_pattern(SceneFiles(tmp_path), name)
        assert other.seams == first.seams
        for one, two in zip(first.panels.values(), other.panels.values(), strict=True):
            np.testing.assert_array_equal([e.ends() for e in one.edges], [e.ends() for e in two.edges])


def test_units_and_absolute_control_points_mean_the_same_cloth(tmp_path: Path) -> None:
    """(a, b) relative is start + a e + b e', e' being e turned left; in mm every length is ten times the number."""
    curve = {"type": "quadratic", "params": [[0.5, -0.2]]}
    curved = panel((0, 0), (30, 0), (30, 20), (0, 20), curves={0: curve}, translation=[-15, 100, 15])
    relative = read(tmp_path, pattern({"front": curved}))
    absolute = json.loads(json.dumps(pattern({"front": curved}, curvature_coords="absolute", units_in_meter=1000)))
    fields = absolute["pattern"]["panels"]["front"]
    fields["vertices"] = [[10 * x, 10 * y] for x, y in fields["vertices"]]
    fields["translation"] = [10 * x for x in fields["translation"]]
    fields["edges"][0]["curvature"]["params"] = [[150, -60]]
    other = read(tmp_path, absolute).panels["front"]
    one = relative.panels["front"]
    assert [one.area, one.edges[0].length] == pytest.approx([other.area, other.edges[0].length], rel=1e-12)
    np.testing.assert_allclose(one.place(one.edges[0].ends()), other.place(other.edges[0].ends()), atol=1e-15)
    # 2/3 of the triangle of 30 cm by 6 cm, outside of the rectangle of 30 cm by 20 cm.
    assert 1e4 * one.area == pytest.approx(600.0 + 2.0 / 3.0 * 90.0, rel=1e-12)


@pytest.mark.parametrize("angles", [(30.0, 0.0, 0.0), (10.0, 20.0, 30.0), (-120.0, 75.0, 170.0)])
def test_panels_are_turned_as_garmentcode_does(angles: tuple[float, float, float], tmp_path: Path) -> None:
    fields = front() | {"rotation": list(angles), "translation": [1, 2, 3]}
    one = read(tmp_path, pattern({"front": fields})).panels["front"]
    points = np.array([[0.1, 0.2], [-0.3, 0.5]])
    level = np.column_stack([points, np.zeros(2)])
    expected = Rotation.from_euler("XYZ", angles, degrees=True).apply(level) + np.array([0.01, 0.02, 0.03])
    np.testing.assert_allclose(one.place(points), expected, atol=1e-15)


@pytest.mark.parametrize("name", REAL)
def test_real_patterns_can_be_sewn(name: str, shared_data: Path) -> None:
    """Without a seam that looks turned; what stays open is what a body goes through, two to five openings."""
    found = check_pattern(SceneFiles(shared_data / "patterns"), f"{name}.json", 1.1)
    kinds = {remark.kind for remark in found.remarks}
    assert not any(remark.wrong for remark in found.remarks) and kinds <= {"unequal seam", "short edge"}
    assert 2 <= len(found.openings) <= 5
    assert all(0.15 < opening.length < 11.0 for opening in found.openings)


@pytest.mark.parametrize("name", REAL)
def test_real_patterns_have_their_right_sides_outside(name: str, shared_data: Path) -> None:
    """They stand in front of the body, z > 0, or behind it, and look away from it."""
    for one in read_pattern(SceneFiles(shared_data / "patterns"), f"{name}.json").panels.values():
        away = np.sign(one.area) * one.rotation[:, 2]
        middle = np.mean([one.place(edge.ends()) for edge in one.edges], axis=(0, 1))
        assert away @ [0.0, 0.0, 1.0] * middle[2] > 0.0, one.name


def test_a_pattern_of_2021_has_the_curves_of_today(shared_data: Path) -> None:
    file = "skirt2021.json"
    folder = shared_data / "cases" / "18-legacy-pattern"
    found = read_pattern(SceneFiles(folder), file)
    data = json.loads((folder / file).read_text())
    bent = data["pattern"]["panels"]["front"]["edges"][2]["curvature"]
    (side,) = found.panels["front"].edges[2:3]
    # Half of the way along, and by half of a tenth of it to the left.
    start, end = (np.array(data["pattern"]["panels"]["front"]["vertices"][k]) / 100 for k in (2, 3))
    left = np.array([-(end - start)[1], (end - start)[0]])
    np.testing.assert_allclose(
        side.curve.at(np.array([0.5]))[0], 0.5 * (start + end) + 0.5 * bent[1] * left, atol=1e-12
    )
    assert not [one for one in check_pattern(SceneFiles(folder), file, 2.0).remarks if one.wrong]


def test_a_control_point_that_is_none_is_refused_as_written_in_2021(tmp_path: Path) -> None:
    data = tube()
    data["pattern"]["panels"]["front"]["edges"][0]["curvature"] = [0.5]
    with pytest.raises(BadInput) as refusal:
        read(tmp_path, data)
    assert "edges[0].curvature" in str(refusal.value) and refusal.value.line is not None


def test_a_seam_through_the_body_is_noted(tmp_path: Path) -> None:
    """Of a front that is mirrored, or a back turned about y; lengths and directions of its seams agree."""
    mirrored = panel((30, 0), (0, 0), (0, 20), (30, 20), translation=[-15, 100, 15])
    turned = front() | {"rotation": [0, 180, 0], "translation": [15, 100, 15]}
    for changed, number in (({}, 0), ({"front": mirrored}, 2), ({"front": turned}, 2)):
        read(tmp_path, tube(**changed))
        remarks = check_pattern(SceneFiles(tmp_path), "pattern.json", 1.1).remarks
        assert [(one.kind, one.wrong) for one in remarks] == [("crossed seam", False)] * number
        assert all("left to right" in one.text and one.line is not None for one in remarks)


def test_a_notched_hem_can_be_sewn(shared_data: Path) -> None:
    assert read_pattern(SceneFiles(shared_data / "cases" / "38-notched-hem"), "notch.json").panels["front"].area > 0.1
