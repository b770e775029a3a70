"""A `--set` that names a user's own file: read from where the command is typed, by its name alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from nuno.cli.common import find_own
from nuno.scene.yaml_lines import parse_value
from nuno_schemas.errors import BadInput


def test_a_file_is_found_where_the_command_is_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "leg.obj").touch()
    monkeypatch.chdir(tmp_path)
    found = find_own(tmp_path / "scene.yaml", ["bodies.leg.collider.file=scans/leg.obj", "duration=1 s"])
    assert found == (["bodies.leg.collider.file=leg.obj", "duration=1 s"], [tmp_path / "scans"])


def test_files_inside_of_a_mapping_are_found_and_all_else_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "leg, left.obj").touch()
    monkeypatch.chdir(tmp_path)
    value = "{plugin: mesh, file: 'scans/leg, left.obj', scale: 1e-3, up: z, centre: [0, 1 cm, '0'], mend: true}"
    item, folders = find_own(tmp_path / "scene.yaml", [f"bodies.0.collider={value}"])
    key, _, text = item[0].partition("=")
    assert (key, folders) == ("bodies.0.collider", [tmp_path / "scans"])
    assert parse_value(text) == parse_value(value) | {"file": "leg, left.obj"}


def test_another_file_beside_the_scene_is_not_taken_for_it(tmp_path: Path) -> None:
    for folder in ("own", "scene"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "leg.obj").touch()
    with pytest.raises(BadInput, match=r"another file of this name.*\n(.*\n)*.*give yours another name"):
        find_own(tmp_path / "scene" / "scene.yaml", [f"bodies.leg.file={tmp_path / 'own' / 'leg.obj'}"])


@pytest.mark.parametrize(
    "value", ["{points: [" + "0.25, " * 100 + "0.5]}", "1" * 5000 + ".5", "~nobody-of-this-name/leg.obj", "a\0.obj", ""]
)
def test_what_no_file_can_be_called_is_a_value(value: str, tmp_path: Path) -> None:
    assert find_own(tmp_path / "scene.yaml", [f"operations={value}"]) == ([f"operations={value}"], [])
