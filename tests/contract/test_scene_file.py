"""Scenes that are wrong: every error names file, line, field, value, and what to write instead."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

import nuno
from nuno.plugin_contract import registry
from nuno.scene import scene_file, yaml_lines
from nuno.scene.override import apply_override, overridden
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import GROUPS
from nuno_schemas.scene import Scene

GOOD: dict[str, Any] = {
    "nuno": 1,
    "name": "cloth",
    "duration": "1 s",
    "solver": {"plugin": "rk4", "dt": "1 ms"},
    "objects": [{"name": "sheet", "model": {"plugin": "sheet", "resolution": [4, 4]}}],
    "bodies": [{"name": "ball", "collider": {"plugin": "sphere", "radius": 0.1}}],
}
SKIRT = {"plugin": "skirt", "waist_radius": 0.1, "hem_radius": 0.2, "length": 0.3}


def refused(folder: Path, text: str | bytes, *overrides: str) -> BadInput:
    """The error of a scene's text."""
    path = folder / "scene.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(BadInput) as caught:
        scene_file.read(path, overrides)
    return caught.value


def with_model(**fields: Any) -> dict[str, Any]:
    return {"objects": [{"name": "sheet", "model": {"plugin": "sheet"} | fields}]}


FIELDS: dict[str, tuple[dict[str, Any], str, str, str]] = {
    # What is wrong: the change, the field, and words of the problem and of the remedy or limit.
    "unknown field": ({"durration": 3}, "durration", "no such field", "did you mean 'duration'?"),
    "unknown solver field": ({"solver": {"plugin": "rk4", "dtt": 1}}, "solver.dtt", "no such field", "'dt'"),
    "unknown model field": (with_model(sise=1), "objects[0].model.sise", "no such field", "'size'"),
    "unknown nested field": (
        with_model(rotate={"angel": 1}), "objects[0].model.rotate.angel", "no such field", "'angle'",
    ),
    "unknown field of a union": (
        with_model(fabric={"preset": "denim", "densty": 1}),
        "objects[0].model.fabric.densty", "no such field", "'density'",
    ),
    "unknown field of the other branch": (
        with_model(fabric={"density": 0.2, "structural": 8, "sheer": 1}),
        "objects[0].model.fabric.sheer", "no such field", "'shear'",
    ),
    "field of the part around it": (
        with_model(colour="red"), "objects[0].model.colour", "no such field", "a field of objects[0]: move it there",
    ),
    "field of a plugin inside": (
        {"objects": [{"name": "sheet", "size": [1, 1], "model": {"plugin": "sheet"}}]},
        "objects[0].size", "no such field", "a field of objects[0].model: move it there",
    ),
    "field of a part that is not there": ({"azimuth": 1}, "azimuth", "no such field", "a field of view: move it there"),
    "field of a part that is not there, in another": (
        {"forces": [{"plugin": "wind", "speed": 3}]}, "forces[0].speed", "no such field", "known: density, normal",
    ),
    "field of the scene": (
        {"solver": {"plugin": "rk4", "duration": 1}}, "solver.duration", "no such field", "the scene itself: move",
    ),
    "field of a body": (
        {"friction": 1, "bodies": [{"name": "floor", "collider": {"plugin": "plane"}}]},
        "friction", "no such field", "a field of bodies[0]: move it there",
    ),
    "unknown integrator": ({"solver": {"plugin": "rk5"}}, "solver.plugin", "no plugin 'rk5'", "'rk4'"),
    "mistyped auto": ({"solver": {"plugin": "atuo"}}, "solver.plugin", "no plugin 'atuo'", "did you mean 'auto'?"),
    "unknown model": (with_model(plugin="shet"), "objects[0].model.plugin", "no plugin 'shet'", "'sheet'"),
    "unknown force": ({"forces": [{"plugin": "wnd"}]}, "forces[0].plugin", "no plugin 'wnd'", "'wind'"),
    "field of what may be a name or a mapping": (
        {"objects": [{"name": "knit", "model": {"plugin": "knit", "wales": 4, "courses": 4,
                                                "yarns": [{"k": 1, "denity": "22 dtex"}]}}]},
        "objects[0].model.yarns[0].denity", "no such field", "did you mean 'density'",
    ),
    "pin of a mesh by name": (
        with_model(plugin="mesh", file="m.obj", pin=[0, "top-row"]), "objects[0].model.pin[1]",
        "a mesh has no pins with names", "give vertex numbers, such as pin: [0, 7], or boxes",
    ),
    "unknown preset": (with_model(fabric="denimm"), "objects[0].model.fabric", "unknown fabric preset", "'denim'"),
    "unknown name in a list": (with_model(pin=["top-rwo"]), "objects[0].model.pin[0]", "unknown value", "'top-row'"),
    "unknown choice": (with_model(plane="zy"), "objects[0].model.plane", "unknown value", "known: xy, xz, yz"),
    "unknown unit": ({"duration": "1 secnd"}, "duration", "unknown unit 'secnd'", "write for example '1 s'"),
    "wrong dimension": (with_model(size=["1 m", "1 kg"]), "objects[0].model.size[1]", "converted to m", "1 m"),
    "not a quantity": ({"duration": "soon"}, "duration", "not a quantity", "write for example '1 s'"),
    "neither quantity nor word": (
        {"bodies": [GOOD["bodies"][0] | {"stiffness": "automatic"}]},
        "bodies[0].stiffness", "not a quantity", "or write auto",
    ),
    "dt 0": ({"solver": {"plugin": "rk4", "dt": 0}}, "solver.dt", "out of range", "more than 0"),
    "dt negative": ({"solver": {"plugin": "rk4", "dt": "-1 ms"}}, "solver.dt", "out of range", "more than 0"),
    "dt nan": ({"solver": {"plugin": "rk4", "dt": float("nan")}}, "solver.dt", "must be finite", ""),
    "duration endless": ({"duration": 1e300}, "duration", "out of range", "at most 1e+09"),
    "gravity infinite": ({"gravity": [0, float("-inf"), 0]}, "gravity[1]", "must be finite", ""),
    "gravity of one number": ({"gravity": 9.81}, "gravity", "must be a list", ""),
    "gravity too short": ({"gravity": [0, 1]}, "gravity[2]", "too short", ""),
    "gravity too long": ({"gravity": [0, 1, 2, 3]}, "gravity", "too long", "3 items"),
    "view not finite": ({"view": {"target": [0, float("nan"), 0]}}, "view.target[1]", "must be finite", ""),
    "half a vertex": (with_model(resolution=[3.5, 4]), "objects[0].model.resolution[0]", "must be a whole number", ""),
    "too few vertices": (with_model(resolution=[0, 4]), "objects[0].model.resolution[0]", "out of range", "at least 2"),
    "text for a flag": ({"allow_unstable": "perhaps"}, "allow_unstable", "must be true or false", ""),
    "text for a mapping": ({"contact": "penalty"}, "contact", "must be a mapping of fields", ""),
    "mapping for a list": ({"objects": {"name": "x"}}, "objects", "must be a list", ""),
    "text for an object": ({"objects": ["sheet"]}, "objects[0]", "must be a mapping of fields", ""),
    "nothing for a name": ({"name": None}, "name", "must be text", ""),
    "name with a slash": ({"name": "a/b"}, "name", "not a name", "a letter"),
    "colour in numbers": (
        {"objects": [GOOD["objects"][0] | {"colour": "#12345"}]}, "objects[0].colour", "not a colour", "#rrggbb",
    ),
    "colour by a name that is none": (
        {"objects": [GOOD["objects"][0] | {"colour": "indian red"}]}, "objects[0].colour", "not a colour",
        "did you mean 'indianred'?",
    ),
    "two names alike": ({"bodies": GOOD["bodies"] * 2}, "bodies[1].name", "the name 'ball' is used twice", "rename"),
    "scene version": ({"nuno": 2}, "nuno", "must be 1", ""),
    "plugin left out": ({"solver": {"dt": 1}}, "solver.plugin", "the field is missing", "add it"),
    "part of attach left out": (
        with_model(**SKIRT, attach={"frame": "world"}), "objects[0].model.attach.body", "the field is missing", "",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FIELDS)
def test_wrong_fields_are_named_with_their_line_and_a_remedy(fault: str, tmp_path: Path) -> None:
    change, field, problem, advice = FIELDS[fault]
    text = yaml.safe_dump(GOOD | change, sort_keys=False)
    error = refused(tmp_path, text)
    assert error.field == field
    assert problem in error.problem
    assert advice in f"{error.limit} {error.remedy}"
    assert error.file == str(tmp_path / "scene.yaml")
    assert error.line is not None
    line = text.splitlines()[error.line - 1]
    last = field.split(".")[-1]
    if "missing" in problem or "too short" in problem:
        assert line.strip()  # what is not there has no line; its surroundings have
    else:
        assert line.lstrip().startswith("- ") if last.endswith("]") else f"{last}:" in line


PYDANTIC = ("Input should", "valid ", "Tuple", "String should", "after validation", "function-", "union", "literal[")


@pytest.mark.parametrize("fault", FIELDS)
def test_errors_are_not_in_the_librarys_words(fault: str, tmp_path: Path) -> None:
    message = str(refused(tmp_path, yaml.safe_dump(GOOD | FIELDS[fault][0])))
    assert not [phrase for phrase in PYDANTIC if phrase in message]


BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{after}: &{after} [{', '.join([f'*{before}'] * 10)}]\n"
    for before, after in zip("abcdefghi", "bcdefghij", strict=True)
)
TEXTS: dict[str, tuple[str | bytes, int | None, str]] = {
    # What is wrong: the text, the line that is named, and words of the problem.
    "billion laughs": (BOMB, None, "too large or nests too deep"),
    "alias of itself": ("a: &a [*a]\n", 1, "nests too deep"),
    "deep": ("a: " + "[" * 200 + "]" * 200, None, "nests too deep"),
    "deeper than the stack": ("a: " + "[" * 50_000, None, "nests too deep"),
    "python object": ("nuno: 1\nname: !!python/object/apply:os.system ['exit 1']\n", 2, "tags are not allowed"),
    "python name": ("nuno: !!python/name:os.system x\n", 1, "tags are not allowed"),
    "tag of nothing": ("nuno: 1\nname: !!float\n", 2, "tags are not allowed"),
    "tag of a list": ("nuno: !!str [1]\n", 1, "tags are not allowed"),
    "own tag": ("nuno: !mine x\n", 1, "tags are not allowed"),
    "tag of a mapping": ("solver: !!omap {a: 1}\n", 1, "tags are not allowed"),
    "binary": ("nuno: !!binary aGk=\n", 1, "tags are not allowed"),
    "merge key": ("a: &a {b: 1}\nsolver: {<<: *a,\n  dt: 2}\n", 2, "merge keys of YAML are not supported"),
    "duplicate": ("nuno: 1\nname: a\nname: b\n", 3, "given twice"),
    "duplicate inside": ("nuno: 1\nsolver: {dt: 1,\n  dt: 2}\n", 3, "given twice"),
    "not UTF-8": ("nuno: 1\nname: caf\xe9\n".encode("latin-1"), None, "not a text file"),
    "UTF-16": ("nuno: 1\n".encode("utf-16"), None, "not a text file"),
    "control character": (b"nuno: 1\nname: \x00\n", 2, "the character U+0000 is not allowed"),
    "empty": ("", None, "the file is empty"),
    "only a comment": ("# a scene\n", None, "the file is empty"),
    "a word": ("hello\n", 1, "the file is no mapping"),
    "a list": ("# first\n- a\n", 2, "the file is no mapping"),
    "two documents": ("nuno: 1\n---\nnuno: 1\n", 2, "another document"),
    "open bracket": ("nuno: 1\nname: [a, b\nduration: 3\n", 3, "expected ',' or ']'"),
    "tab": ("nuno: 1\n\tname: a\n", 2, "not valid YAML"),
    "undefined alias": ("nuno: 1\nname: *x\n", 2, "undefined alias"),
    "list as a key": ("? [a, b]\n: 1\n", 1, "a field name must be plain text"),
    "number of 5,000 digits": ("nuno: 1\nseed: " + "9" * 5000, 2, "not a number that can be read"),
}


@pytest.mark.parametrize("fault", TEXTS)
def test_texts_that_are_no_scene(fault: str, tmp_path: Path) -> None:
    text, line, problem = TEXTS[fault]
    error = refused(tmp_path, text)
    assert problem in error.problem
    assert error.file == str(tmp_path / "scene.yaml")
    if line is not None:
        assert error.line == line
    assert error.remedy
    assert "\n" not in error.problem


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    with path.open("wb") as stream:
        stream.truncate(2**40)  # sparse: a terabyte that nobody could read
    with pytest.raises(BadInput, match="too large") as caught:
        scene_file.read(path)
    assert caught.value.limit == f"{yaml_lines.MAX_BYTES} bytes"


def test_a_byte_order_mark_is_no_part_of_the_first_field(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + yaml.safe_dump(GOOD).encode())
    assert scene_file.read(path).scene.name == "cloth"


OVERRIDES = {
    "x": ("", "written key=value"),
    "=3": ("", "written key=value"),
    "solver..dt=1": ("", "written key=value"),
    "objects[1].name=a": ("objects[1].name", "no such field"),
    "objects[-1].name=a": ("objects[-1].name", "no such field"),
    "objects.first=a": ("objects.first", "no such field"),
    "solver.dt.unit=s": ("solver.dt.unit", "no such field"),
    "solver.dtt=1": ("solver.dtt", "no such field"),
    "a.b.c=1": ("a", "no such field"),
    "solver.dt=1 kg": ("solver.dt", "cannot be converted to s"),
    "solver.dt=": ("solver.dt", "must be a quantity"),
    "solver.dt=[1": ("solver.dt", "not a valid value"),
    "solver.dt=*x": ("solver.dt", "not a valid value"),
    "solver.dt=!!python/name:os.system": ("solver.dt", "tags are not allowed"),
    "solver.dt=\0": ("solver.dt", "not a valid value"),
    "seed=" + "9" * 5000: ("seed", "not a number that can be read"),
    "duration=2,1 s": ("duration", "a decimal comma"),
    "solver.dt=0,1": ("solver.dt", "a decimal comma"),
    "gravity=['0,1', 0, 0]": ("gravity[0]", "a decimal comma"),
    "seed=010": ("seed", "YAML reads this as a number of base 8: 8"),
    "duration=1:30": ("duration", "YAML reads this as a number of base 60: 90"),
    "duration=0:01": ("duration", "not a quantity"),
    "objects[0].model.resolution=[4, 1]": ("objects[0].model.resolution[1]", "out of range"),
}


@pytest.mark.parametrize("item", OVERRIDES, ids=lambda item: repr(item[:40]))
def test_wrong_overrides_are_blamed_on_the_command_line(item: str, tmp_path: Path) -> None:
    field, problem = OVERRIDES[item]
    error = refused(tmp_path, yaml.safe_dump(GOOD), item)
    assert error.file == "--set"
    assert error.line is None
    assert error.field == (field or None)
    assert problem in error.problem


def test_a_decimal_comma_is_never_dropped(shared_data: Path, tmp_path: Path) -> None:
    """Neither in YAML nor in Python; with a point the same scene is read."""
    path = shared_data / "cases" / "01-decimal-comma" / "scene.yaml"
    with pytest.raises(BadInput, match=r"write 2\.1 s") as caught:
        scene_file.read(path)
    assert (caught.value.field, caught.value.line) == ("duration", 3)
    with pytest.raises(BadInput, match=r"write 1\.1 m"):
        scene_file.read(path, ["duration=2.1 s"])
    scene = yaml.safe_load(path.read_text().replace(",1", ".1"))
    with pytest.raises(BadInput, match=r"write 2\.1 s"):
        nuno.plan(scene | {"duration": "2,1 s"})
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    assert scene_file.read(tmp_path / "scene.yaml").scene.duration == 2.1


@pytest.mark.parametrize(
    ("friction", "field", "number"),
    [
        ("0,3", "bodies[0].friction", "0.3"),
        ("0,3 m", "bodies[0].friction", "0.3"),
        ("'0,3'", "bodies[0].friction", "0.3"),
        ("'-1,25'", "bodies[0].friction", "-1.25"),
    ],
)
def test_a_decimal_comma_in_a_plain_number_is_named_with_the_point(
    friction: str, field: str, number: str, tmp_path: Path
) -> None:
    """In braces, too, where YAML takes what stands behind the comma for a field of its own."""
    ball = "{name: ball, collider: {plugin: sphere, radius: 0.2 m}, friction: FRICTION}"
    cloth = "{name: s, model: {plugin: sheet, resolution: [5, 5], fabric: denim}}"
    text = f"nuno: 1\nname: a\nduration: 0.1 s\nbodies:\n  - {ball}\nobjects:\n  - {cloth}\n"
    error = refused(tmp_path, text.replace("FRICTION", friction))
    assert (error.field, error.line) == (field, 5)
    assert error.remedy is not None and number in error.remedy.replace(":", " ").split()


@pytest.mark.parametrize(
    ("text", "place", "number"),
    [
        ("[0,3, 1]", "a", "0.3"), ("[1, -0,25 m]", "a", "-0.25 m"), ("[[1, 2], [{b: 0,3}]]", "a[1][0].b", "0.3"),
        ("{b: {c: 1, d: 0,5 ms}}", "a.b.d", "0.5 ms"),
    ],
)  # fmt: skip
def test_a_number_cut_at_a_decimal_comma_is_refused_where_yaml_parts_it(text: str, place: str, number: str) -> None:
    with pytest.raises(BadInput, match="a decimal comma") as caught:
        yaml_lines.parse(f"b: 1\na: {text}\n", "scene.yaml")
    error = caught.value
    assert (error.file, error.line, error.field) == ("scene.yaml", 2, place)
    assert error.remedy is not None and f"write {number}" in error.remedy
    followed = text.replace(str(error.value), number)
    assert followed != text and yaml_lines.parse(f"a: {followed}", "scene.yaml")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("[0,3,1]", [0, 3, 1]), ("[0, 3, 1]", [0, 3, 1]), ("[[0,1], [2,3]]", [[0, 1], [2, 3]]),
        ("[0,1,\n  2,3]", [0, 1, 2, 3]), ("{1: 2,3: 4}", {"1": 2, "3": 4}), ("[0.5,3, 1]", [0.5, 3, 1]),
    ],
)  # fmt: skip
def test_lists_that_are_written_alike_throughout_are_lists(text: str, value: object) -> None:
    assert yaml_lines.parse(f"a: {text}\n", "scene.yaml")[0] == {"a": value}


@pytest.mark.parametrize(
    ("text", "value"),
    [("10", 10), ("1_000", 1000), ("007", 7), ("0", 0), ("010.5", 10.5), ("0x10", 16), ("'010'", "010"), ("08", "08")],
)
def test_numbers_that_are_what_they_look_like_are_read(text: str, value: object) -> None:
    assert yaml_lines.parse_value(text) == value


def test_a_colour_in_an_override_is_no_comment() -> None:
    assert yaml_lines.parse_value("#1e1715") == "#1e1715"
    assert yaml_lines.parse_value("[#aaa,#1e1715, #fff]") == ["#aaa", "#1e1715", "#fff"]
    assert yaml_lines.parse_value("{a: #aaa, b: [#000]}") == {"a": "#aaa", "b": ["#000"]}


@pytest.mark.parametrize(("text", "value"), [("010", 8), ("-017", -15), ("1:30", 90), ("1:30.5", 90.5)])
def test_numbers_of_another_base_are_refused_with_what_they_would_be(text: str, value: float) -> None:
    """In files they are named with their line; what the remedy says is read as just that number."""
    with pytest.raises(BadInput, match=f"of base (8|60): {value}") as caught:
        yaml_lines.parse(f"a: 1\nb: [{text}]\n", "scene.yaml")
    assert (caught.value.file, caught.value.line, caught.value.field) == ("scene.yaml", 2, "b[0]")
    assert yaml_lines.parse_value(str(value)) == value


def test_truth_values_are_no_numbers_wherever_a_field_is_one() -> None:
    """YAML reads `yes` as true, and to pydantic true is 1: `friction: yes` was a coefficient of 1."""
    checked = 0
    for kind in (Scene, *(registry.load(group, name).Config for group in GROUPS for name in registry.installed(group))):
        for name, field in kind.model_fields.items():
            if re.fullmatch(r"<class '(int|float)'>|(int|float) \| None", str(field.annotation)):
                with pytest.raises(ValidationError) as errors:
                    kind.model_validate({name: True})
                assert errors.value.errors()[0].get("ctx", {}).get("inside") == (name,), f"{kind.__name__}.{name}"
                checked += 1
    assert checked > 100


def test_fields_beside_an_override_keep_their_line(tmp_path: Path) -> None:
    text = yaml.safe_dump(GOOD | {"solver": {"plugin": "rk4", "dtt": 1}}, sort_keys=False)
    error = refused(tmp_path, text, "solver.dt=1 ms")
    assert error.file == str(tmp_path / "scene.yaml")
    assert error.line == 1 + text.splitlines().index("  dtt: 1")


def reads_or_refuses(text: str, *overrides: str) -> None:
    """Anything else than BadInput fails the test."""
    with contextlib.suppress(BadInput):
        data, lines = yaml_lines.parse(text, "scene.yaml")
        for item in overrides:
            lines = overridden(lines, apply_override(data, item))
        scene_file.load(data, lines, "scene.yaml", scene_file.SceneFiles(Path()))


VALUES = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.sampled_from(["1 s", "auto"])
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.sampled_from(["plugin", "dt", "name", "x"]), inner, max_size=3)
    ),
    max_leaves=6,
)
PLACES = st.sampled_from(
    [*GOOD, "gravity", "record", "view", "forces", "contact", "solver.dt", "objects.0.model.fabric"]
)


@settings(deadline=None, derandomize=True)
@given(st.one_of(st.text(max_size=40), st.text("{}[]:,-?&*!|>'\"%@ \nab1", max_size=40)))
def test_any_text_is_read_or_refused(text: str) -> None:
    reads_or_refuses(text)


@settings(deadline=None, derandomize=True)
@given(PLACES, VALUES)
def test_any_value_anywhere_is_read_or_refused(place: str, value: object) -> None:
    data = yaml.safe_load(yaml.safe_dump(GOOD))
    here: Any = data
    *parents, last = place.split(".")
    for part in parents:
        here = here[int(part) if part.isdigit() else part]
    here[last] = value
    reads_or_refuses(yaml.safe_dump(data, allow_unicode=True))


@settings(deadline=None, derandomize=True)
@given(st.one_of(st.text(max_size=30), st.builds("{}={}".format, PLACES, st.text("{}[]:,!&*ab1. ms", max_size=20))))
def test_any_override_is_taken_or_refused(item: str) -> None:
    reads_or_refuses(yaml.safe_dump(GOOD), item)
