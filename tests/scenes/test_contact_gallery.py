"""The page of cloth that meets cloth: its numbers are those of the runs, and what fails is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import nuno
from nuno.cli import parser_of
from nuno.scene import scene_file
from nuno_bench.gallery import command as gallery
from nuno_bench.gallery import contact as contact_gallery
from nuno_bench.gallery.contact import CONTACTS, CROSSED, CUT, SECONDS, VERTICES
from nuno_bench.report.page import marks
from nuno_schemas.errors import BadInput

PAIR = {
    "nuno": 1, "name": "pair", "description": "One sheet falls on another.", "duration": 0.15, "frame_rate": 60,
    "solver": {"plugin": "symplectic_euler", "dt": "auto"}, "cloth_contact": {"plugin": "offset", "thickness": "2 mm"},
    "objects": [
        {"name": name, "model": {"plugin": "sheet", "size": [0.1, 0.1], "resolution": [6, 6], "plane": "xz",
                                 "centre": [0.01 * high, 0.003 * high, 0], "pin": pin, "fabric": "interlock"}}
        for name, high, pin in (("low", 0, ["left-edge", "right-edge"]), ("high", 1, []))
    ],
}  # fmt: skip


@pytest.fixture(autouse=True)
def one_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The gallery of a scene that is two sheets, in small pictures."""
    path = tmp_path / "pair.yaml"
    path.write_text(yaml.safe_dump(PAIR))
    monkeypatch.setattr(contact_gallery, "SIZE", (64, 48))
    monkeypatch.setitem(gallery.KINDS, "contact", replace(contact_gallery.KIND, scenes=lambda: {"pair": path}))
    return path


def show(folder: Path, *words: str) -> tuple[int, str]:
    """Exit code and page of `nuno gallery contact`."""
    _, parser = parser_of("gallery")
    code = gallery.gallery_command(parser.parse_args(["contact", *words, "--out", str(folder)]))
    return code, (folder / "contact.html").read_text()


def test_a_scene_is_measured_as_its_run_says(one_scene: Path, tmp_path: Path) -> None:
    shown, run = contact_gallery.KIND.run_scene(one_scene), nuno.run(one_scene, record=tmp_path / "run.mcap")
    assert not shown.failed and [label.partition(",")[0] for label, _ in shown.pictures] == list(contact_gallery.SHARES)
    assert shown.measured[VERTICES] == 72 and shown.measured[CROSSED] == 0 < shown.measured[SECONDS]
    steps = run.report["steps_per_frame"] * 9 * 72
    assert shown.measured[CUT] == pytest.approx(1e6 * run.report["counts"]["cut_short"] / steps)
    assert shown.measured[CONTACTS] == run.report["counts"]["cloth_contacts"] > 0
    first, *_, last = (picture for _, picture in shown.pictures)
    assert last.shape == (48, 64, 3) and not np.array_equal(first, last)


@pytest.mark.parametrize(
    "steps", [{"totals": {}, "steps_per_frame": 10}, {"totals": {"steps": 30}, "steps_per_frame": None}]
)
def test_what_was_cut_short_is_a_share_of_all_steps_of_vertices(steps: dict[str, Any]) -> None:
    """Of 3 frames of 10 steps of 50 vertices, and one in which nothing moved, one in 500; solvers that choose their
    steps count them.
    """
    report = steps | {
        "frames": {"sent": 5}, "counts": {"cloth_contacts": 7, "cut_short": 3}, "idle": 1, "stretch": 0.1,
        "size": {"vertices": 50}, "cloth_contact": {"crossed": 0}, "parts_seconds": {"steps": 8.0},
    }  # fmt: skip
    found = contact_gallery.measure(report)
    assert found[CUT] == pytest.approx(2000.0) and found[SECONDS] == 2.0
    assert contact_gallery.measure({}) == {}


def test_the_page_and_the_documentation_have_a_row_a_scene(tmp_path: Path) -> None:
    docs = tmp_path / "page.md"
    docs.write_text("\n".join(["before", *marks("gallery contact"), "after"]))
    code, text = show(tmp_path, "--docs", str(docs))
    assert code == 0 and text.count("data:image/png;base64,") == 3 and "failed" not in text
    (row,) = (line for line in docs.read_text().splitlines() if line.startswith("| pair |"))
    assert row.startswith("| pair | 72 | ") and row.count("|") == 2 + len((*contact_gallery.MEASURES, "published"))


def test_a_scene_that_fails_is_said_to(one_scene: Path, tmp_path: Path) -> None:
    """It is shown where it got to."""
    one_scene.write_text(yaml.safe_dump(PAIR | {"until": "balance"}))
    code, text = show(tmp_path)
    assert code == 1 and "failed, unconverged" in text and text.count("data:image/png;base64,") == 3


def test_a_page_without_the_section_is_refused_before_anything_runs(tmp_path: Path) -> None:
    docs = tmp_path / "page.md"
    docs.write_text("nothing measured\n")
    with pytest.raises(BadInput, match="no section"):
        show(tmp_path, "--docs", str(docs))


def test_what_is_published_is_of_shipped_scenes_in_which_cloth_meets() -> None:
    assert set(contact_gallery.PUBLISHED) <= set(contact_gallery.KIND.scenes())
    for path in contact_gallery.KIND.scenes().values():
        scene = scene_file.read(path).scene
        assert scene.name == path.stem and scene.description.endswith(".") and scene.cloth_contact != "none"
