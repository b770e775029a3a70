"""`nuno plan` says where cloth that is worn begins."""

from __future__ import annotations

import re

import pytest

from nuno.cli import main

SMALL = ("--set", "objects.0.model.columns=80", "--set", "objects.0.model.rows=24")


def told(capsys: pytest.CaptureFixture[str], *flags: str) -> str:
    assert main(["plan", "skirt-walk", *SMALL, *flags]) == 0
    return capsys.readouterr().out


def test_cloth_that_starts_in_a_body_is_told_beside_where_its_frame_is(capsys: pytest.CaptureFixture[str]) -> None:
    fits = told(capsys)
    found = re.search(r"^attached +to walker/Hips, which starts at \[(.*)\] m$", fits, re.MULTILINE)
    assert found is not None and "WARNING" not in fits
    x, y, z = (float(value) for value in found[1].split(", "))
    low = told(capsys, "--set", f"objects.0.model.centre=[{x}, {y}, {z}]")
    assert re.search(r"^WARNING +[1-9][0-9]* of 1,920 vertices start in a body, up to [0-9.]+ mm", low, re.MULTILINE)
