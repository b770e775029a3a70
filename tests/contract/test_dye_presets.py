"""Dyes by name: the same scene as with their fields written out, each field with what it rests on, and in the docs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from nuno.cli import main
from nuno.cli.textiles import KINDS, find_presets, table
from nuno.scene import scene_file, shipped
from nuno.scene.json_schema import scene_schema
from nuno_schemas.dyeing import PRESETS, DyeColour, Dyestuff
from nuno_schemas.errors import BadInput
from nuno_schemas.scene import Scene
from nuno_schemas.units import to_si

DOCS = Path(__file__).parents[2] / "docs" / "how-to" / "dye-cloth.md"
SCENE = shipped.scenes()["dye/fig9a"]
MASSES = {
    "indigo": {"C": 16, "H": 10, "N": 2, "O": 2},
    "madder": {"C": 14, "H": 8, "O": 4},
    "weld": {"C": 15, "H": 10, "O": 6},
    "walnut": {"C": 10, "H": 6, "O": 3},
}
"""Atoms of indigotin, alizarin, luteolin and juglone."""
ATOMIC = {"C": 12.011, "H": 1.008, "N": 14.007, "O": 15.999}


def dyed(*dyes: object) -> dict[str, Any]:
    scene = dict(yaml.safe_load(SCENE.read_text()))
    scene["dye"]["dyes"] = list(dyes)
    return scene


@pytest.mark.parametrize("name", PRESETS)
def test_a_name_is_the_dye_with_its_fields_written_out(name: str) -> None:
    fields = dict(PRESETS[name].fields)
    scene = Scene.model_validate(dyed({"name": name, **fields}))
    assert Scene.model_validate(dyed(name)) == Scene.model_validate(dyed({"preset": name})) == scene
    assert scene.dye is not None and scene.dye.dyes[0].name == name
    changed = Dyestuff.model_validate({"preset": name, "adsorption": 0.02, "name": "mine"})
    assert changed == Dyestuff.model_validate({**fields, "adsorption": 0.02, "name": "mine"})


@pytest.mark.parametrize("name", MASSES)
def test_diffusion_follows_from_the_atoms_of_what_colours(name: str) -> None:
    """3.6 sqrt(76 / M) mm^2/h."""
    mass = sum(ATOMIC[atom] * number for atom, number in MASSES[name].items())
    expected = to_si(f"{3.6 * math.sqrt(76.0 / mass)!r} mm^2/h", "m^2/s")
    found = Dyestuff.model_validate(name).D0
    assert found == pytest.approx(expected, rel=3e-5)


def test_each_field_of_a_preset_is_measured_derived_or_assumed_with_a_reason() -> None:
    for name, known in PRESETS.items():
        assert known.how.keys() == known.fields.keys() | {"fibre", "mordant"}, name
        assert {"D0", "adsorption", "isotherm"} <= known.fields.keys() <= set(Dyestuff.model_fields)
        for field, words in known.how.items():
            kind, _, reason = words.partition(": ")
            assert kind in KINDS and reason, (name, field)
        assert known.source and known.fibre and known.mordant


def test_of_a_colour_those_that_are_given_are_changed() -> None:
    own, changed = (
        Dyestuff.model_validate(one).colour for one in ("madder", {"preset": "madder", "colour": {"full": 0.4}})
    )
    assert changed == own.model_copy(update={"full": 0.4}) != own
    assert Dyestuff.model_validate("indigo").colour == DyeColour()
    assert Dyestuff.model_validate({"preset": "indigo", "colour": {"full": 0.4}}).colour == DyeColour(full=0.4)


@pytest.mark.parametrize(
    ("dyes", "field", "problem", "advice"),
    [
        (["indgo"], "dye.dyes[0]", "unknown dye preset 'indgo'", "did you mean 'indigo'?"),
        (["weld", {"preset": "madr"}], "dye.dyes[1].preset", "unknown dye preset 'madr'", "did you mean 'madder'?"),
        ([{"preset": 3}], "dye.dyes[0].preset", "unknown dye preset '3'", "known: dye-paper"),
        ([{"preset": ["weld"]}], "dye.dyes[0].preset", "unknown dye preset", "known: dye-paper"),
        ([{"prest": "weld"}], "dye.dyes[0].prest", "no such field", "did you mean 'preset'?"),
        ([{"preset": "weld", "adsorption": -1}], "dye.dyes[0].adsorption", "out of range", "at least 0"),
        (["weld", "weld"], "dye.dyes[1].name", "the name 'weld' is used twice", "rename"),
        ([{"adsorption": 0}], "dye.dyes[0].name", "the field is missing", ""),
    ],
)
def test_mistakes_are_told_where_they_are(
    dyes: list[object], field: str, problem: str, advice: str, tmp_path: Path
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(dyed(*dyes)))
    with pytest.raises(BadInput) as caught:
        scene_file.read(path)
    assert caught.value.field == field
    assert problem in caught.value.problem
    assert advice in f"{caught.value.limit} {caught.value.remedy}"


def test_the_command_line_changes_a_field_of_what_is_named_alone(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(dyed("madder", "indigo")))
    loaded = scene_file.read(path, ["dye.dyes.indigo.adsorption=0.5", "dye.dyes.0.colour.full=0.1"])
    expected = [{"preset": "madder", "colour": {"full": 0.1}}, {"preset": "indigo", "adsorption": 0.5}]
    assert loaded.scene == Scene.model_validate(dyed(*expected))
    cloth = scene_file.read(shipped.scenes("")["hanging-sheet"], ["objects.0.model.fabric.bend_warp=80 uN*m"])
    assert cloth.data["objects"][0]["model"]["fabric"] == {"preset": "denim", "bend_warp": "80 uN*m"}


def test_editors_know_names_and_that_a_preset_needs_no_more() -> None:
    validator = jsonschema.Draft202012Validator(scene_schema())
    good = ("indigo", {"preset": "weld"}, {"preset": "weld", "adsorption": 0.1}, {"name": "mine", "D0": "2 mm^2/h"})
    assert all(validator.is_valid(dyed(one)) for one in good)
    bad = ("indgo", {"preset": "wled"}, {"adsorption": 0.1}, {"name": "mine"}, {"preset": "weld", "adsorbtion": 1})
    assert not any(validator.is_valid(dyed(one)) for one in bad)


def test_the_command_prints_them_and_the_docs_show_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dyes", "walnut"]) == 0
    printed = capsys.readouterr().out
    assert "174.2     2.378" in printed and "derived: D0 (3.6 sqrt(76 / M) mm^2/h of juglone" in printed
    assert "indigo:" not in printed
    assert table(list(find_presets("dyes").values())) in DOCS.read_text()
    assert main(["dyes", "indgo"]) == 2
    assert "did you mean 'indigo'?" in capsys.readouterr().err
