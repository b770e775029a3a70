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
from nuno_bench.gallery.knit import Knitted, density_at, run_panel, stretch, unevenness, zigzag
from nuno_schemas.errors import BadInput

WALES, COURSES, WIDE, HIGH = 5, 9, 0.02, 0.01


@pytest.fixture(scope="module", autouse=True)
def small_pictures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(knit_gallery, "SIZE", (60, 80))
        yield


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
    assert "failed" not in text and "stretch of nylon arcs" in text and ">reproduced</td>" in text
    assert "Stitches deform differently" in capsys.readouterr().out


@pytest.mark.full
def test_the_direction_comes_from_the_contrast_of_stiffness() -> None:
    """Figure 9's zigzag stays without continuity, and vanishes with one stiffness."""
    wales = {(ratio, mu): zigzag(run_panel("stitch-stretch-course", ratio, mu)) for ratio, mu in ((10, 0), (1, 0.2))}
    assert wales[10, 0] > 0.5 and wales[1, 0.2] < 0.02


@pytest.mark.full
def test_stiff_yarn_stretches_less() -> None:
    for scene, part in (("stitch-stretch-course", "arcs"), ("stitch-stretch-wale", "legs")):
        found = stretch(run_panel(scene, 10, 0.2))
        assert 1.2 * found[f"support {part}"] < found[f"nylon {part}"]


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
    assert "stitches at the knee" in text


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
