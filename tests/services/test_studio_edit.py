"""One value of a scene's text is changed, and all else in it stays as it was written."""

from __future__ import annotations

import difflib
from copy import deepcopy
from typing import Any

import pytest

from nuno.scene import shipped, yaml_lines
from nuno.scene.edit import drop, put
from nuno.scene.yaml_lines import Path
from nuno_schemas.errors import BadInput

TEXT = """\
# a sheet
nuno: 1
name: sheet   # to be looked at
solver: {plugin: leapfrog, dt: auto}   # as the paper

objects:
  - name: cloth    # the first
    # how it is built
    model:
      plugin: sheet
      size: [1 m, 1 m]
      fabric: denim  # or jacket
  - {name: other, model: {plugin: skirt}}
bodies:
record:
  checkpoint_every: 2 s
# the end
"""


def changed(before: str, after: str) -> list[str]:
    """Lines that went and came."""
    rows = difflib.ndiff(before.splitlines(), after.splitlines())
    return [row for row in rows if row[0] in "+-"]


@pytest.mark.parametrize(
    ("path", "value", "written", "rows"),
    [
        (
            ("name",),
            "other",
            None,
            ["- name: sheet   # to be looked at", "+ name: other   # to be looked at"],
        ),
        (
            ("solver", "dt"),
            "1 ms",
            None,
            [
                "- solver: {plugin: leapfrog, dt: auto}   # as the paper",
                "+ solver: {plugin: leapfrog, dt: 1 ms}   # as the paper",
            ],
        ),
        (("objects", 0, "model", "resolution"), [3, 4], None, ["+       resolution: [3, 4]"]),
        (("objects", 0, "model", "size"), [2, 1], "[2.00, 1]", ["-       size: [1 m, 1 m]", "+       size: [2.00, 1]"]),
        (
            ("objects", 1, "model", "columns"),
            12,
            None,
            [
                "-   - {name: other, model: {plugin: skirt}}",
                "+   - {name: other, model: {plugin: skirt, columns: 12}}",
            ],
        ),
        (("objects", 2), {"name": "third"}, None, ["+   - {name: third}"]),
        (
            ("bodies", 0),
            {"name": "ball", "collider": {"plugin": "sphere"}},
            None,
            ["+   - {name: ball, collider: {plugin: sphere}}"],
        ),
        (("view", "azimuth"), 0.5, "0.50", ["+ view: {azimuth: 0.50}"]),
        (("forces", 0), {"plugin": "wind"}, None, ["+ forces:", "+   - {plugin: wind}"]),
        (("damping",), 2e-05, None, ["+ damping: 2.0e-05"]),
        (
            ("name",),
            "a: b",
            "a: b",
            ["- name: sheet   # to be looked at", '+ name: "a: b"   # to be looked at'],
        ),
        (
            ("objects", 0, "model", "fabric"),
            {"preset": "denim"},
            None,
            ["-       fabric: denim  # or jacket", "+       fabric: {preset: denim}  # or jacket"],
        ),
    ],
)
def test_a_value_is_put_in_its_own_place(path: Path, value: object, written: str | None, rows: list[str]) -> None:
    after = put(TEXT, path, value, "f", written)
    assert [row for row in changed(TEXT, after) if not row.startswith("?")] == rows
    found: Any = yaml_lines.parse(after, "f")[0]
    for part in path:
        found = found[part]
    assert found == value


@pytest.mark.parametrize(
    ("path", "rows"),
    [
        (("solver", "plugin"), ["- solver: {plugin: leapfrog, dt: auto}   # as the paper",
                                "+ solver: {dt: auto}   # as the paper"]),
        (("solver", "dt"), ["- solver: {plugin: leapfrog, dt: auto}   # as the paper",
                            "+ solver: {plugin: leapfrog}   # as the paper"]),
        (("objects", 0, "model", "fabric"), ["-       fabric: denim  # or jacket"]),
        (("objects", 1), ["-   - {name: other, model: {plugin: skirt}}"]),
        (("record", "checkpoint_every"), ["- record:", "+ record: {}", "-   checkpoint_every: 2 s"]),
        (("bodies",), ["- bodies:"]),
    ],
)  # fmt: skip
def test_a_value_is_taken_out_and_nothing_else(path: Path, rows: list[str]) -> None:
    assert changed(TEXT, drop(TEXT, path, "f")) == rows


COMMENTED = """\
nuno: 1
dye:
  cloth:
    supply:                       # dye that is given
      # a bath
      - kind: bath
        amount: 0.9               # of the room
        # dye: 0
      - {kind: drop}
        # layers: both
    resist:                       # what keeps dye out
      - kind: paste
        # width: 1 mm
    # v_max: 1
  # solver: auto
# view: {}
"""


def test_a_value_takes_comments_along_that_are_about_what_it_holds_and_no_others() -> None:
    one = drop(COMMENTED, ("dye", "cloth", "supply", 0), "f")
    assert changed(COMMENTED, one) == ["-       - kind: bath", "-         amount: 0.9               # of the room",
                                       "-         # dye: 0"]  # fmt: skip
    none = drop(one, ("dye", "cloth", "supply", 0), "f")
    assert [row for row in changed(one, none) if row[0] == "+"] == [
        "+     supply: []                       # dye that is given"
    ]
    assert "bath" not in none and "layers" not in none
    none = drop(none, ("dye", "cloth", "resist", 0), "f")
    assert (
        none
        == """\
nuno: 1
dye:
  cloth:
    supply: []                       # dye that is given
    resist: []                       # what keeps dye out
    # v_max: 1
  # solver: auto
# view: {}
"""
    )


def test_a_comment_stays_that_is_about_what_follows() -> None:
    assert changed(TEXT, drop(TEXT, ("objects", 0, "name"), "f")) == ["-   - name: cloth    # the first", "+   -"]


def test_what_an_alias_stands_for_is_not_changed_in_one_of_its_places() -> None:
    text = "nuno: 1\nfirst: &both {x: 1, y: 2}\nother: *both\n"
    for change in (lambda: drop(text, ("other", "x"), "f"), lambda: put(text, ("first", "x"), 3, "f")):
        with pytest.raises(BadInput) as refused:
            change()
        assert refused.value.field in ("other.x", "first.x") and refused.value.remedy


SOME = ("skirt-dyed", "contact/untangle", "knit/stocking-leg")
"""Scenes that are written in different ways: quick ones."""


@pytest.mark.quick(name=SOME)
@pytest.mark.parametrize("name", sorted(shipped.scenes()))
def test_in_every_shipped_scene_each_field_can_be_taken_out_and_put_back(name: str) -> None:
    """What is refused leaves the text alone."""
    text = shipped.scenes()[name].read_text()
    data, lines = yaml_lines.parse(text, name)
    done = 0
    for path in [path for path in lines if path and isinstance(path[-1], str)][:40]:
        value: Any = data
        for part in path:
            value = value[part]
        try:
            without = drop(text, path, name)
        except BadInput:
            continue
        expected = deepcopy(data)
        inside: Any = expected
        for part in path[:-1]:
            inside = inside[part]
        del inside[path[-1]]
        assert yaml_lines.parse(without, name)[0] == expected
        assert yaml_lines.parse(put(without, path, value, name), name)[0] == data
        done += 1
    assert done >= 5
