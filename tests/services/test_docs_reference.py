"""The reference's pages that are made are as made now, and they hold what they are of."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nuno import cli
from nuno.cli import main
from nuno.plugin_contract import registry
from nuno.scene.json_schema import PLACES
from nuno_bench.cli import COMMANDS

REFERENCE = Path(__file__).resolve().parents[2] / "docs" / "reference"


@pytest.mark.parametrize("name", ["messages", "fields", "commands"])
def test_a_page_is_as_made_now(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", f"--{name}"]) == 0
    made = capsys.readouterr().out
    assert (REFERENCE / f"{name}.md").read_text(encoding="utf-8") == made, (
        f"nuno schema --{name} > docs/reference/{name}.md"
    )


@pytest.mark.parametrize("name", ["fields", "commands"])
def test_each_field_and_argument_has_a_meaning(name: str) -> None:
    rows = [line for line in (REFERENCE / f"{name}.md").read_text(encoding="utf-8").splitlines() if line[:3] == "| `"]
    assert len(rows) > 100 and [row for row in rows if not row.rstrip("| ").rpartition(" | ")[2].strip("` ")] == []
    assert [row for row in rows if re.search(r"\| +\|$", row)] == []


def test_every_plugin_of_a_scene_has_its_fields() -> None:
    """A section for each, and in it a row for each field of its Config."""
    sections = re.split(r"^#{2,4} ", (REFERENCE / "fields.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    for group in set(PLACES.values()):
        for name in registry.installed(group):
            rows = [set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)) for text in sections
                    if text.startswith(f"{name} (")]  # fmt: skip
            fields = {field.alias or key for key, field in registry.load(group, name).Config.model_fields.items()}
            assert any(fields <= found for found in rows), (group, name)


def test_every_command_is_there() -> None:
    found = set(re.findall(r"^##+ nuno (.+)$", (REFERENCE / "commands.md").read_text(encoding="utf-8"), re.MULTILINE))
    assert found == {*cli.COMMANDS, *(f"bench {kind}" for kind in COMMANDS)}


def test_defaults_are_written_out() -> None:
    """In whichever of argparse's formats they stand."""
    text = (REFERENCE / "commands.md").read_text(encoding="utf-8")
    assert "%(" not in text and "%%" not in text and "(default: 60)" in text
