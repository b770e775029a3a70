"""`nuno bench speed studio`: what its client takes, and what it says where there is no browser."""

from __future__ import annotations

from pathlib import Path

import pytest

from nuno_bench.speed import studio

SHORT = """\
nuno: 1
name: short
duration: 2 s
frame_rate: 50 Hz
solver: {plugin: symplectic_euler, dt: auto}
objects:
  - {name: cloth, model: {plugin: sheet, size: [40 cm, 40 cm], resolution: [9, 9], fabric: silk, pin: [top-corners]}}
"""


@pytest.mark.full
def test_a_client_is_given_frames_and_a_missing_browser_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    monkeypatch.setattr(studio.shipped, "find", lambda name: path)
    monkeypatch.setattr(studio.shipped, "scenes", lambda: {studio.SCENE: path})
    monkeypatch.setattr(studio, "find_browser", lambda: None)
    found = {result.what: result for result in studio.studio(1)}
    (rate,) = found["frames to a client that draws none"].samples
    assert 0.0 < rate <= 1.1 / studio.SCREEN
    assert "no Chromium" in found["pictures in Chromium"].failure
    assert found["page without the 3-D viewer"].verdict == "bar met"
