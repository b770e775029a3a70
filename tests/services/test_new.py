"""`nuno new`: scenes with comments say what they said, and name every field that could be set."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel
from refusals import largest_file

from nuno.cli import main
from nuno.cli.run import KINDS
from nuno.scene import scene_file, shipped
from nuno.scene.edit import WIDTH, comment
from nuno.scene.override import item_at, number_or_name, parts_of
from nuno_schemas.scene import Scene

SCENES = sorted(shipped.scenes())


@pytest.mark.quick(name=SCENES[::5])
@pytest.mark.parametrize("name", SCENES)
def test_comments_change_nothing(name: str) -> None:
    """And of every plugin and part each field is there, as it is or commented out, with what it does."""
    loaded = scene_file.read(shipped.find(name))
    text = comment(loaded)
    assert yaml.safe_load(text) == loaded.data
    fields = {**Scene.model_fields}
    for one in loaded.chosen:
        if isinstance(item_at(loaded.data, tuple(map(number_or_name, parts_of(one.field)))), dict):
            fields |= type(one.config).model_fields
    words = " ".join(re.sub(r"(^|\s)# ", " ", text, flags=re.MULTILINE).split())
    for field, known in fields.items():
        assert re.search(rf"^\s*(- |# )?{field}:", text, re.MULTILINE), field
        assert " ".join((known.description or "").split()) in words, field
    assert all(len(line) <= WIDTH for line in text.splitlines() if line.lstrip().startswith("# "))


def test_what_is_left_out_may_be_written_with_its_default() -> None:
    """Uncommented, a field with a default means what it meant without."""
    loaded = scene_file.read(shipped.find("hanging-sheet"))
    names = {*Scene.model_fields, *(name for one in loaded.chosen for name in type(one.config).model_fields)}
    names -= {"texture", "rotate"}  # of no default
    text = re.sub(rf"^(\s*)# (({'|'.join(names)}): [^ ].*)$", r"\1\2", comment(loaded), flags=re.MULTILINE)
    assert "\ngravity: " in text and "\nallow_unstable: false" in text
    written = scene_file.load(yaml.safe_load(text), {}, "x", loaded.files)
    assert [one.config for one in written.chosen] == [one.config for one in loaded.chosen]
    # Those that name plugins have their fields beside the name.
    plain = {name for name in Scene.model_fields if not isinstance(getattr(loaded.scene, name), list | BaseModel)}
    assert written.scene.model_dump(include=plain) == loaded.scene.model_dump(include=plain)


@pytest.mark.parametrize("kind", [*KINDS, "skirt-walk"])
def test_a_new_scene_stands_by_itself(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the files that it needs; it is not written over."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / ("2nd try.yaml" if kind == "dye" else f"my-{kind}.yaml")
    assert main(["new", kind, file.name]) == 0
    assert main(["new", kind]) == 0  # what it needs is there already, and the same
    capsys.readouterr()
    assert scene_file.read(file).scene.name == ("garment-2nd-try" if kind == "dye" else file.stem)
    text = file.read_text()
    assert main(["new", kind, file.name]) == 2
    assert "not written over" in capsys.readouterr().err and file.read_text() == text


def test_what_is_none_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    wrong = {("skrt",): "did you mean 'skirt'", ("skirt", "a.txt"): "a.yaml", ("skirt", "no/a.yaml"): "cannot write"}
    for words, said in wrong.items():
        assert main(["new", *words]) == 2
        assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["sheet", "skirt"])
def test_a_full_disk_leaves_nothing_that_is_in_the_way_of_the_next(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with largest_file(100):
        assert main(["new", kind]) == 2
    assert "cannot write there: File too large" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main(["new", kind]) == 0
    assert scene_file.read(tmp_path / f"{kind}.yaml").scene.name == kind
