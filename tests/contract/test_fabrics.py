"""`nuno fabrics`: every preset with its own values in the table's units, measured, and in the docs."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from nuno.cli import main
from nuno.cli.textiles import KINDS, find_presets, table
from nuno_cloth.fabrics.presets import MEASURES, PRESETS, Material
from nuno_schemas.preset import Preset
from nuno_schemas.units import to_si

DOCS = Path(__file__).parents[2] / "docs" / "reference" / "scenes.md"
SI = {"density": "kg/m^2", "bend_warp": "N*m", "bend_weft": "N*m"}


@pytest.fixture(scope="module")
def presets() -> dict[str, Preset]:
    return find_presets("fabrics")


def test_values_are_the_materials_in_units_that_scenes_take(presets: dict[str, Preset]) -> None:
    assert list(presets) == list(PRESETS)
    for name, preset in presets.items():
        assert preset.source == PRESETS[name].source
        for measure in preset.measures:
            value = to_si(f"{measure.given!r} {measure.unit}", SI.get(measure.name, measure.unit))
            assert value == pytest.approx(getattr(PRESETS[name], measure.name), rel=1e-12), (name, measure.name)


def test_each_value_of_a_preset_is_measured_derived_or_assumed(presets: dict[str, Preset]) -> None:
    """By one word for each, with a reason for all that was not measured; what has no source is as it is without one."""
    own = {each.name: each.default for each in fields(Material) if each.name not in ("source", "how")}
    for name, preset in presets.items():
        material = PRESETS[name]
        assert preset.how.keys() == own.keys() | {"bend_twist"}
        assert material.how.keys() >= set(MEASURES), name
        for field, words in preset.how.items():
            kind, _, reason = words.partition(": ")
            assert kind in KINDS and (kind == "measured" or reason), (name, field)
            if field not in material.how and kind == "assumed":
                assert getattr(material, field) == own[field]


def test_what_is_assumed_as_of_another_preset_is_that_presets() -> None:
    taken = [
        (name, field, found[1])
        for name, material in PRESETS.items()
        for field, words in material.how.items()
        if (found := re.match(r"assumed: as of ([\w-]+),", words))
    ]
    assert {name for name, _, _ in taken} == {"silk", "chiffon", "wool", "linen", "canvas"}
    for name, field, other in taken:
        assert getattr(PRESETS[name], field) == getattr(PRESETS[other], field), (name, field)


def test_bending_is_that_of_free_fibres_where_it_is_derived_of_them() -> None:
    """Half of the weight in fibres each way, each bent by itself: the modulus and the measures that the words say."""
    said = r"derived: of \w+ fibres of (\d+) um, (\d+) GPa and ([\d.]+) g/cm\^3, that slide freely"
    of_fibres = {name: found for name, one in PRESETS.items() if (found := re.match(said, one.how["bend_warp"]))}
    assert of_fibres.keys() == {"silk", "chiffon", "wool", "linen"}
    for name, found in of_fibres.items():
        radius, modulus, density = (
            float(text) * unit for text, unit in zip(found.groups(), (5e-7, 1e9, 1e3), strict=True)
        )
        number = 0.5 * PRESETS[name].density / (density * np.pi * radius**2)
        expected = number * modulus * np.pi * radius**4 / 4.0
        assert PRESETS[name].bend_warp == pytest.approx(expected, rel=1e-9)
        assert PRESETS[name].bend_weft == pytest.approx(expected, rel=1e-9)


def test_leather_is_alike_in_all_directions() -> None:
    """A plate has C_wf = nu C and G = (1 - nu) C / 2; cells have C_wf = G, so that nu is a third."""
    leather = PRESETS["leather"]
    assert leather.warp == leather.weft and leather.bend_warp == leather.bend_weft
    nu = leather.shear / leather.warp
    assert leather.shear == pytest.approx(0.5 * (1.0 - nu) * leather.warp)


def test_held_specimens_give_the_source_and_free_ones_less(presets: dict[str, Preset]) -> None:
    for preset in presets.values():
        by_name = {measure.name: measure for measure in preset.measures}
        for measure in preset.measures[:-1]:
            assert measure.measured["sides held"] == pytest.approx(measure.given, rel=1e-4)
        for name in ("warp", "weft", "shear"):
            assert 0 < by_name[name].measured["sides free"] < by_name[name].given


def test_the_command_prints_units_values_and_sources(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fabrics", "denim", "jacket"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["[g/m^2]", "[N/m]", "[N/m]", "[N/m]", "[uN*m]", "[uN*m]", "[1]"]
    assert lines[2].split() == ["denim", "324", "410.7", "2028", "26.69", "24.24", "16.05", "0.05"]
    assert any(line.startswith("denim: Wang et al. 2011, sample 11oz-black-denim") for line in lines)
    assert lines.count("  measured: density, warp, weft, shear, bend_warp, bend_weft") == 2
    assert lines.count("  derived: bend_bias, bend_twist (from the other rigidities)") == 2
    assert lines.count("  assumed: bend_poisson, hysteresis_warp, hysteresis_weft (0, not measured)") == 2
    assert not any("swimwear" in line for line in lines)


def test_an_unknown_fabric_is_answered_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fabrics", "denm"]) == 2
    assert "did you mean 'denim'?" in capsys.readouterr().err


def test_the_docs_show_what_the_command_prints(presets: dict[str, Preset]) -> None:
    shown = DOCS.read_text()
    for line in table([presets["denim"]]).splitlines():
        assert line in shown
    assert all(f"`{name}`" in shown for name in presets)
