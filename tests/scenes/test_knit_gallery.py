"""The page of the shipped knits: what the stitches must show shows, and what fails or misses is said."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from nuno.cli import parser_of
from nuno.scene import shipped
from nuno_bench.gallery import command as gallery
from nuno_bench.gallery import knit as knit_gallery
from nuno_bench.gallery.kind import EFFECT, Difference, ShownScene, compare
from nuno_bench.gallery.knit import Knitted, density_at, run_panel, stretch, unevenness, zigzag
from nuno_schemas.errors import BadInput

WALES, COURSES, WIDE, HIGH = 5, 9, 0.02, 0.01


@pytest.fixture(scope="module", autouse=True)
def small_pictures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(knit_gallery, "SIZE", (60, 80))
        yield


PLACES = ("ankle", "calf", "thigh")


def show(folder: Path, *words: str) -> tuple[int, str]:
    """Exit code and page of `nuno gallery knit`."""
    module, parser = parser_of("gallery")
    assert module is gallery
    code = gallery.gallery_command(parser.parse_args(["knit", *words, "--out", str(folder)]))
    return code, (folder / "knit.html").read_text()


@pytest.mark.full
def test_the_stitches_show_what_they_must(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, text = show(tmp_path, "--scenes", "stitch-stretch-course,stitch-stretch-wale")
    assert code == 0 and text.count("data:image/png;base64,") == 4
    assert text.count(">bar met<") == 2 and "missed" not in text and "failed" not in text
    assert "stretch of nylon arcs" in text and ">reproduced</td>" in text
    assert "stiff yarn stretches less" in capsys.readouterr().out


@pytest.mark.full
def test_the_direction_comes_from_the_contrast_of_stiffness() -> None:
    """Figure 9's zigzag stays without continuity, and vanishes with one stiffness."""
    wales = {(ratio, mu): zigzag(run_panel("stitch-stretch-course", ratio, mu)) for ratio, mu in ((10, 0), (1, 0.2))}
    assert wales[10, 0] > 0.5 and wales[1, 0.2] < 0.02


@pytest.mark.full
def test_a_stocking_that_does_not_settle_is_shown_as_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = yaml.safe_load(shipped.find("knit/stocking-150").read_text())
    scene |= {"name": "short", "duration": "0.3 s"}
    scene["objects"][0]["model"] |= {"wales": 15, "courses": 29}
    scene["bodies"][0]["collider"]["resolution"] = 24
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(scene))
    kind = replace(knit_gallery.KIND, scenes=lambda: {"short": tmp_path / "short.yaml"})
    monkeypatch.setitem(gallery.KINDS, "knit", kind)
    code, text = show(tmp_path)
    assert code == 1 and text.count("data:image/png;base64,") == len(knit_gallery.WORN)
    assert "failed, unconverged: the cloth has not come to rest" in text and "recording kept" not in text
    assert "stitches at the knee" in text and "What must show" not in text


def test_differences_are_of_shipped_knits() -> None:
    named = {scene for one in knit_gallery.DIFFERENCES for scene, _ in (one.high, one.low)}
    assert named <= set(knit_gallery.KIND.scenes())


def stocking(*pressures: float) -> dict[str, ShownScene]:
    measured = {knit_gallery.PRESSURE.format(place): p for place, p in zip(PLACES, pressures, strict=True)}
    return {"stocking-compression": ShownScene("stocking-compression", "", measured=measured)}


@pytest.mark.parametrize(
    ("high", "low", "verdict"),
    [
        (3.0, 2.0, "bar met"), (2.0 * EFFECT, 2.0, "bar met"), (2.3, 2.0, "missed"), (2.0, 3.0, "missed"),
        (1.0, -1.0, "bar met"), (-1.0, -2.0, "missed"), (float("nan"), 1.0, "missed"), (1.0, float("nan"), "missed"),
    ],
)  # fmt: skip
def test_a_pressure_that_does_not_fall_misses(high: float, low: float, verdict: str) -> None:
    assert compare(knit_gallery.DIFFERENCES, stocking(high, low, 0.0))[0][-1] == verdict
    assert compare(knit_gallery.DIFFERENCES, stocking(0.0, high, low))[1][-1] == verdict


def test_what_was_not_measured_misses() -> None:
    shown = stocking(3.0, 2.0, 1.0)["stocking-compression"]
    assert compare(knit_gallery.DIFFERENCES, {shown.name: replace(shown, measured={})})[0][-1] == "missed"
    one = ShownScene("a", "", measured={"more": 1.0, "less": 0.0})
    assert compare([Difference("", ("a", "more"), ("a", "less"))], {"a": one})[0][-2:] == ["inf", "bar met"]


@pytest.mark.parametrize(("wanted", "problem"), [("stocking-15", "stocking-150"), ("fig8a", "no such"), (",", "empty")])
def test_names_of_no_knit_are_refused(wanted: str, problem: str) -> None:
    with pytest.raises(BadInput, match=problem):
        gallery.choose(knit_gallery.KIND, wanted)


def panel(shift: float = 0.0, open_by: float = 1.0, ring: bool = False) -> Knitted:
    """A knit at rest apart from this: every other row lies to the right, every other course is open. A ring's are
    of the same points.
    """
    rows, columns = np.mgrid[0 : COURSES + 1, 0 : 2 * WALES]
    heights = np.concatenate([[0.0], np.cumsum(np.where(np.arange(COURSES) % 2, HIGH, open_by * HIGH))])
    x = np.stack([WIDE * columns + shift * (rows % 2), heights[rows], 0.0 * rows], axis=-1)
    number = np.arange(rows.size, dtype=np.int32).reshape(rows.shape)
    legs = np.stack([number[:-1], number[1:]], axis=-1).reshape(-1, 2)
    arcs = np.stack([number[:, :-1], number[:, 1:]], axis=-1).reshape(-1, 2)
    rest = np.repeat([HIGH, WIDE], [len(legs), len(arcs)])
    kind = np.concatenate([(legs[:, 0] // (2 * WALES)) % 2, np.zeros(len(arcs), int)]).astype(np.int8)
    return Knitted(x, np.concatenate([legs, arcs]), rest, kind, ("nylon", "support"), ring)


def test_stitches_are_counted_over_their_area() -> None:
    """A stitch is two cells wide and one high; of one course in three one is twice as high."""
    opened = panel(open_by=2.0)
    assert density_at(opened, 1.75 * HIGH) == pytest.approx(2.0 / 3.0 * 0.5 / (WIDE * HIGH))
    assert np.isnan(density_at(opened, 1.0))


def test_a_ring_has_one_cell_more_to_a_course() -> None:
    angle = np.pi / WALES * np.arange(2 * WALES)
    heights = HIGH * np.arange(COURSES + 1)
    x = np.stack(np.broadcast_arrays(np.cos(angle), heights[:, None], np.sin(angle)), axis=-1)
    girth = 2 * WALES * 2.0 * np.sin(0.5 * np.pi / WALES)
    assert density_at(panel(ring=True)._replace(x=x), 4.5 * HIGH) == pytest.approx(WALES / (girth * HIGH))


def test_links_stretch_by_yarn_and_part() -> None:
    found = stretch(panel(open_by=1.5))
    assert found["nylon legs"] == pytest.approx(0.5) and found["support legs"] == pytest.approx(0.0, abs=1e-12)
    assert found["nylon arcs"] == pytest.approx(0.0, abs=1e-12) and "support arcs" not in found


def test_zigzag_and_opening_are_those_that_were_drawn() -> None:
    straight, shifted = panel(open_by=3.0), panel(shift=0.25 * WIDE)
    assert zigzag(straight) == pytest.approx(0.0, abs=1e-12) and unevenness(straight) == pytest.approx(3.0)
    assert zigzag(shifted) == pytest.approx(0.5 * WIDE / shifted.rest.mean())
    assert unevenness(shifted) == pytest.approx(1.0)
