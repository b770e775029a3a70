"""`nuno yarns`: every yarn that a knit can name, in units that scenes take, and in the docs."""

from __future__ import annotations

from pathlib import Path

import pytest

from nuno.cli import main
from nuno.cli.textiles import find_presets, show
from nuno_knit.knit import PRESETS
from nuno_schemas.units import to_si

DOCS = Path(__file__).parents[2] / "docs" / "how-to" / "knit.md"
FIELDS = {
    "EA": ("ea", "N"),
    "lock": ("lock", ""),
    "EA_lock": ("ea_lock", "N"),
    "density": ("density", "kg/m"),
    "mu": ("mu", ""),
}


def test_values_are_the_yarns_in_units_that_scenes_take() -> None:
    found = find_presets("yarns")
    assert list(found) == list(PRESETS)
    for name, preset in found.items():
        for measure in preset.measures:
            field, unit = FIELDS[measure.name]
            expected = getattr(PRESETS[name].yarn, field)
            given = None if measure.given is None else to_si(f"{measure.given!r} {measure.unit}", unit)
            assert given == (None if expected is None else pytest.approx(expected, rel=1e-12)), (name, measure.name)


def test_the_command_prints_units_values_and_sources(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["yarns", "support", "nylon"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["[N]", "[1]", "[N]", "[dtex]", "[1]"]
    assert lines[2].split() == ["nylon", "6.6", "22", "0.2"]
    assert lines[3].split() == ["support", "0.024", "2", "6.6", "44", "0.2"]
    assert any(line.startswith("support: 22 dtex of elastane covered") for line in lines)


def test_an_unknown_yarn_is_answered_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["yarns", "nilon"]) == 2
    assert "did you mean 'nylon'?" in capsys.readouterr().err


def test_the_docs_show_what_the_command_prints() -> None:
    assert show(list(find_presets("yarns").values())) in DOCS.read_text()
