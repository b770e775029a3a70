"""The page of garments from patterns of one's own, each put on a body, and the judge of what passes through what."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from sewing_patterns import back, column, front, tube

import nuno
from nuno.cli import main, parser_of
from nuno.python_api.fit import read_fits
from nuno.scene import scene_file
from nuno_bench.gallery import command as worn
from nuno_bench.gallery import sewn
from nuno_bench.piles import Oracle

BODY = ["--body", "column.obj"]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a pattern twice, and a column that wears it; one works in it."""
    monkeypatch.chdir(tmp_path)
    for name in ("tube.json", "other.json", "more/tube.json"):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(json.dumps(tube()))
    trimesh.Trimesh(*column((0.08, 0.06), (0.0, 1.6)), process=False).export("column.obj")
    return tmp_path


REFUSED = {
    "patterns without a body": (["--patterns", "tube.json"], "patterns and a body belong together"),
    "a body without patterns": (BODY, "patterns and a body belong together"),
    "a pattern that is not there": (["--patterns", "tub.json", *BODY], "no such file"),
    "two patterns of one name": (["--patterns", "tube.json", "more/tube.json", *BODY], "two patterns have one name"),
    "a fabric that is none": (["--patterns", "tube.json", *BODY, "--fabric", "demin"], "'denim'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_put_on_is_refused(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    flags, problem = REFUSED[case]
    assert main(["gallery", "sewn", *flags]) == 2
    assert problem in capsys.readouterr().err and not Path("recordings").exists()


def test_other_galleries_sew_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gallery", "dye", "--patterns", "tube.json", *BODY]) == 2
    assert "patterns are sewn" in capsys.readouterr().err


def test_each_pattern_is_put_on_as_by_nuno_sew(here: Path) -> None:
    """The same scene, beside copies of its files."""
    flags = ["--edge", "4 cm", "--fabric", "denim"]
    (here / "body.obj").write_text((here / "column.obj").read_text())  # the name of the copy
    assert main(["sew", "tube.json", "--body", "body.obj", *flags, "--scene", "tube.yaml", "--write"]) == 0
    _, parser = parser_of("gallery")
    given = parser.parse_args(["sewn", "--patterns", "tube.json", "other.json", "third.yaml", *BODY, *flags])
    (here / "third.yaml").write_text((here / "other.json").read_text())  # JSON is YAML
    (here / "scenes").mkdir()
    scenes = worn.write_pattern_scenes(given, here / "scenes")
    assert list(scenes) == ["tube", "other", "third"]
    assert scenes["tube"].read_text() == (here / "tube.yaml").read_text()
    for name in ("other", "third"):
        loaded = scene_file.read(scenes[name])
        assert loaded.scene.name == name and loaded.scene.until == "rest"
        pattern = "other.json" if name == "other" else "third.yaml"
        assert loaded.files.resolve(pattern).read_text() == (here / pattern).read_text()


def test_what_passes_through_what_is_seen_but_for_a_body_through_itself() -> None:
    """A triangle of cloth beside, in and across two boxes that pass through each other."""
    box, n = trimesh.creation.box((0.1, 0.1, 0.1)), 3
    x, faces = np.asarray(box.vertices), np.asarray(box.faces)
    body = np.concatenate([x, x + 0.03])
    of_body = np.concatenate([faces, faces + len(x)]) + n
    triangle = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]])
    every = np.concatenate([[[0, 1, 2]], of_body]).astype(np.int32)
    for at, through in (([0.5, 0.0, 0.0], False), ([0.001, 0.002, 0.003], False), ([0.046, 0.0, 0.0], True)):
        placed = np.concatenate([triangle + np.array(at), body])
        assert Oracle(placed, every, len(body)).crossed(placed) == through
        assert Oracle(placed, every).crossed(placed)


@pytest.mark.full
def test_the_page_shows_and_measures_each_that_can_be_worn(here: Path) -> None:
    """One that is too narrow for the body is told of; the others are shown."""
    Path("narrow.json").write_text(json.dumps(tube(front=front(10.0), back=back(10.0))))
    patterns = ["narrow.json", "tube.json", "other.json"]
    assert main(["gallery", "sewn", "--patterns", *patterns, *BODY, "--edge", "4 cm", "--out", "page"]) == 1
    text = (here / "page" / "sewn.html").read_text()
    assert text.count("data:image/png;base64,") == 6 and text.count("cannot be put round wearer") == 1


@pytest.mark.full
def test_garments_in_layers_are_measured_together(here: Path) -> None:
    """Strain is the larger one; ease that of the inner tube; and one that has fallen off is enough."""
    Path("wide.json").write_text(json.dumps(tube(front=front(40.0), back=back(40.0))))
    assert main(["sew", "tube.json", "wide.json", *BODY, "--edge", "4 cm", "--scene", "both.yaml", "--write"]) == 0
    result = nuno.run("both.yaml", duration="0.1 s")
    with result.recording as recording:
        fits = read_fits(recording)
        found = sewn.measure(recording)
    assert len(fits) == 2
    assert found[sewn.WEFT] == pytest.approx(100.0 * max(fit.strains["weft"].high for fit in fits))
    assert found[sewn.PRESSURE] == fits[0].pressed.mean if fits[0].pressed else False
    assert found[sewn.WORN] == float(all(fit.on for fit in fits))
