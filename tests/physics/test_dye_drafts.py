"""Drafts of weaving: WIF files as programs write them, and a draft drawn as weavers draw it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pattern_files import Folder
from PIL import Image
from wif_texts import DOBBY, FLOOR_LOOM, SINKING

from nuno.cli import main
from nuno_dye.cloths.woven_cloth import WovenCloth, WovenClothConfig
from nuno_dye.weaving_drafts.drawing import MARGIN, MARK, draw_draft
from nuno_dye.weaving_drafts.weaves import draw_plain, draw_twill
from nuno_dye.weaving_drafts.wif import MOST_TREADLES, find_loom, read_wif, weave, write_wif
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool


@pytest.fixture
def write(tmp_path: Path):  # type: ignore[no-untyped-def]
    def write(text: str | bytes) -> Path:
        path = tmp_path / "draft.wif"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write


def test_floor_loom_s_twill_with_yarns(write) -> None:  # type: ignore[no-untyped-def]
    draft = read_wif(write(FLOOR_LOOM))
    # The first pick lifts shafts 4 and 1, the next 3 and 4: climbs to the left from end 4.
    expected = np.array([[1, 0, 0, 1], [0, 0, 1, 1], [0, 1, 1, 0], [1, 1, 0, 0]], bool)
    assert np.array_equal(draft.drawdown, np.tile(expected, 2))
    assert np.array_equal(np.roll(expected, 1, axis=1), draw_twill(2, 2))
    indigo, white = [0.0, 0.2, 0.4], [1.0, 1.0, 1.0]
    assert draft.warp.colour is not None and draft.weft.colour is not None
    assert np.allclose(draft.warp.colour, [indigo, indigo, white, *[indigo] * 5], atol=1e-15)
    assert (draft.weft.colour == 1.0).all()
    inch = 0.0254
    assert np.allclose(draft.warp.spacing, np.array([0.05, 0.075, *[0.05] * 6]) * inch, rtol=1e-15)
    assert np.allclose(draft.warp.thickness, 0.04 * inch, rtol=1e-15)
    assert np.allclose(draft.weft.spacing, 0.1 * inch, rtol=1e-15) and draft.weft.thickness is None


def test_lift_plan_gives_the_same_cloth_as_tie_up_and_treadling(write) -> None:  # type: ignore[no-untyped-def]
    draft = read_wif(write(DOBBY))
    assert np.array_equal(draft.drawdown, read_wif(write(FLOOR_LOOM)).drawdown[:, :4])
    assert np.allclose(draft.warp.spacing, 2.12e-3) and np.allclose(draft.weft.spacing, 2.54e-3)
    assert np.allclose(draft.weft.thickness, 1.27e-3)
    assert draft.warp.colour is None and draft.warp.thickness is None


def test_sinking_shed_lowers_what_rising_shed_lifts(write) -> None:  # type: ignore[no-untyped-def]
    assert np.array_equal(read_wif(write(SINKING)).drawdown, ~draw_plain())
    assert np.array_equal(read_wif(write(SINKING.replace("=off", "=on"))).drawdown, draw_plain())
    assert np.array_equal(read_wif(write(SINKING.replace("Rising Shed=off\n", ""))).drawdown, draw_plain())


def test_several_shafts_and_treadles_act_together(write) -> None:  # type: ignore[no-untyped-def]
    text = SINKING.replace("=off", "=on").replace("Threads=2", "Threads=3")
    text = text.replace("[TIEUP]", "3=1,2\n[TIEUP]") + "3=1,2\n"
    assert read_wif(write(text)).drawdown.tolist() == [[1, 0, 1], [0, 1, 1], [1, 1, 1]]


def random_drawdowns(number: int) -> Iterator[Bool]:
    """Drawdowns of 1 x 1 to 60 x 60, also with equal yarns and with yarns that are above, or below, all others."""
    rng = np.random.default_rng(20)
    for _ in range(number):
        picks, ends, pick_kinds, end_kinds = rng.integers(1, 61, 4)
        kinds = rng.random((pick_kinds, end_kinds)) < rng.uniform(0.1, 0.9)
        drawdown = kinds[np.ix_(rng.integers(0, pick_kinds, picks), rng.integers(0, end_kinds, ends))]
        for lines in (drawdown, drawdown.T):
            if rng.random() < 0.3:
                lines[rng.integers(0, len(lines))] = rng.random() < 0.5
        yield drawdown


def test_a_written_drawdown_is_read_back_to_the_bit(write) -> None:  # type: ignore[no-untyped-def]
    """A shaft for each kind of end, a treadle for each kind of pick, numbered as they first occur."""
    plans = loose = 0
    for drawdown in random_drawdowns(400):
        loom = find_loom(drawdown)
        assert np.array_equal(weave(loom.threading, loom.moved), drawdown)
        assert (loom.threading.sum(axis=1) == 1).all()
        shafts, treadles = (len(np.unique(lines, axis=0)) for lines in (drawdown.T, drawdown))
        assert loom.threading.shape[1] == shafts
        assert list(dict.fromkeys(loom.threading.argmax(axis=1).tolist())) == list(range(shafts))
        assert (loom.tie_up is None) == (treadles > MOST_TREADLES)
        if loom.tie_up is not None:
            assert loom.tie_up.shape == (treadles, shafts) and (loom.pressed.sum(axis=1) == 1).all()
            assert list(dict.fromkeys(loom.pressed.argmax(axis=1).tolist())) == list(range(treadles))
        path = write(write_wif(loom))
        if drawdown.all() or not drawdown.any():
            loose += 1
            with pytest.raises(BadInput, match="everywhere"):
                read_wif(path)
            continue
        draft = read_wif(path)
        assert np.array_equal(draft.drawdown, drawdown) and draft.left_out == ()
        assert all(np.array_equal(one, other) for one, other in zip(astuple(draft.loom), astuple(loom), strict=True))
        plans += loom.tie_up is None
    assert plans and loose  # both were among them


def test_the_contents_of_a_written_draft_name_its_sections() -> None:
    rng = np.random.default_rng(1)
    for drawdown in (draw_twill(2, 2), rng.random((60, 7)) < 0.5):
        head, *sections = re.findall(r"^\[(.+)\]$", write_wif(find_loom(drawdown)), re.MULTILINE)
        assert (head, sections[0]) == ("WIF", "CONTENTS")
        assert re.findall(r"^(.+)=true$", write_wif(find_loom(drawdown)).split("[WEAVING]")[0], re.M) == sections[1:]


@pytest.mark.parametrize("text", [FLOOR_LOOM, DOBBY, SINKING])
def test_marks_line_ends_case_and_encodings_change_nothing(write, text: str) -> None:  # type: ignore[no-untyped-def]
    draft = read_wif(write(text))
    note = "[NOTES]\n1=Köper für Ärmel\n"
    variants = [
        text.replace("\n", "\r\n").encode(),
        text.replace("\n", "\r").encode(),
        b"\xef\xbb\xbf" + text.encode(),
        (text + note).encode("latin-1"),
        (text + note).encode("utf-8"),
        text.encode("utf-16"),
        text.lower().encode(),
        text.upper().encode(),
        text.replace("=", " = ").encode(),
    ]
    for data in variants:
        other = read_wif(write(data))
        assert np.array_equal(other.drawdown, draft.drawdown)
        assert np.array_equal(other.warp.spacing, draft.warp.spacing)  # type: ignore[arg-type]


def test_treadles_that_are_not_stated_are_those_tied_up(write) -> None:  # type: ignore[no-untyped-def]
    drawdown = read_wif(write(FLOOR_LOOM)).drawdown
    for stated in ("", "Treadles=\n", "Treadles=0\n"):
        assert np.array_equal(read_wif(write(FLOOR_LOOM.replace("Treadles=6\n", stated))).drawdown, drawdown)


def test_tie_up_and_treadling_go_before_a_lift_plan(write) -> None:  # type: ignore[no-untyped-def]
    drawdown = read_wif(write(FLOOR_LOOM)).drawdown
    assert np.array_equal(read_wif(write(FLOOR_LOOM + "[LIFTPLAN]\n1=1\n2=1\n3=1\n4=1\n")).drawdown, drawdown)


def test_colours_of_a_wider_range_and_written_out(write) -> None:  # type: ignore[no-untyped-def]
    text = FLOOR_LOOM.replace("0,255", "0,999").replace("=255,255,255", "=999,999,999").replace("0,51,102", "0,333,666")
    colour = read_wif(write(text)).warp.colour
    assert colour is not None and np.allclose(colour[0], [0, 1 / 3, 2 / 3]) and (colour[2] == 1).all()
    written = read_wif(write(SINKING.replace("[WEFT]\n", "[WEFT]\nColor=7,255,0,51\n"))).weft.colour
    assert written is not None and np.allclose(written, [1.0, 0.0, 0.2])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[WIF]", "[FIW]", "not a Weaving Information File"),
        ("[WEAVING]", "[WOVEN]", r"\[WEAVING\]: the section is missing"),
        ("Shafts=4", "Shafts=", r"\[WEAVING\] Shafts: missing"),
        ("Shafts=4", "Shafts=four", r"draft.wif:21: \[WEAVING\] SHAFTS: not a number of shafts\n.*four"),
        ("[THREADING]", "[THREADING]\n[OTHER]", r":53: \[THREADING\]: the section is empty"),
        ("[TREADLING]", "[X]", r"\[TREADLING\]: the section is missing"),
        ("[TIEUP]", "[X]", r"\[TIEUP\]: the section is missing"),
        ("8=4", "9=4", r"\[THREADING\] 9: no such end\n.*\n.*from 1 to 8"),
        ("8=4", "8=5", r"\[THREADING\] 8: not a shaft\n.*5.*\n.*0 to 4"),
        ("7=3\n8=4\n", "", r"\[THREADING\]: fewer lines.*\n.*6 ends.*\n.*8 ends"),
        ("4=1\n", "4=7\n", r"\[TREADLING\] 4: not a treadle\n.*7.*\n.*0 to 6"),
        ("2=2,3", "2=2,-3", r"\[TIEUP\] 2: not a shaft"),
        ("Threads=8", "Threads=1000000000", r"\[WARP\] THREADS.*\n.*1000000000.*\n.*16384"),
        ("Threads=8", "Threads=9999999999999999999", r"\[WARP\] THREADS"),
        ("Threads=4", "Threads=16385", r"\[WEFT\] THREADS"),
        ("Treadles=6", "Treadles=16385", r"\[WEAVING\] TREADLES"),
        ("Units=Inches", "Units=Furlongs", r"\[WARP\] UNITS: an unknown unit\n.*Furlongs.*\n.*decipoints"),
        ("Spacing=0.05", "Spacing=-0.05", r"\[WARP\] SPACING: not a spacing"),
        ("Spacing=0.05", "Spacing=1e999", r"\[WARP\] SPACING: not a spacing"),
        ("Color=2", "Color=3", r"\[WARP\] COLOR: a colour that is not in \[COLOR TABLE\]"),
        ("Range=0,255", "Range=255,0", r"\[COLOR PALETTE\] RANGE"),
        ("Range=0,255", "Range=,", r"\[COLOR PALETTE\] RANGE"),
        ("Range=0,255", "Range=0,1,255", r"\[COLOR PALETTE\] RANGE"),
        ("0,51,102", "0,51,256", r"\[COLOR TABLE\] 2: not a colour\n.*256.*\n.*0 to 255"),
        ("Rising Shed=true", "Rising Shed=perhaps", r"\[WEAVING\] RISING SHED: neither true nor false"),
        ("[WARP COLORS]\n3=1", "[WARP COLORS]\n0=1", r"\[WARP COLORS\] 0: no such yarn"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(write, old: str, new: str, said: str) -> None:  # type: ignore[no-untyped-def]
    assert old in FLOOR_LOOM
    with pytest.raises(BadInput, match=said):
        read_wif(write(FLOOR_LOOM.replace(old, new, 1)))


@pytest.mark.parametrize(("lines", "named"), [
    ("[TIEUP]\n7=1\n8=9,bad\n", "[TIEUP] has lines of treadles that there are not (6 are stated): 7, 8"),
    ("[WARP COLORS]\n9=1\n10=77\n", "[WARP COLORS] has lines of ends that there are not (8 are stated): 9, 10"),
    ("[WEFT COLORS]\n5=1\n", "[WEFT COLORS] has lines of picks that there are not (4 are stated): 5"),
    ("[WARP SPACING]\n999=3\n", "[WARP SPACING] has lines of ends that there are not (8 are stated): 999"),
    ("[WEFT THICKNESS]\n6=1\n", "[WEFT THICKNESS] has lines of picks that there are not (4 are stated): 6"),
])  # fmt: skip
def test_lines_beyond_the_yarns_and_treadles_are_left_out_and_named(write, lines: str, named: str) -> None:  # type: ignore[no-untyped-def]
    expected, found = read_wif(write(FLOOR_LOOM)), read_wif(write(FLOOR_LOOM + lines))
    assert expected.left_out == () and found.left_out == (named,)
    assert np.array_equal(found.drawdown, expected.drawdown)
    for one, other in ((found.warp, expected.warp), (found.weft, expected.weft)):
        for values, right in zip(astuple(one), astuple(other), strict=True):
            np.testing.assert_array_equal(values, right)
    assert draw_draft(found).facts["left out"] == named and "left out" not in draw_draft(expected).facts


def test_a_treadle_beyond_those_that_are_stated_is_not_pressed_in_silence(write) -> None:  # type: ignore[no-untyped-def]
    text = FLOOR_LOOM.replace("[TREADLING]\n1=4", "7=1\n[TREADLING]\n1=7")
    with pytest.raises(BadInput, match=r"\[TREADLING\] 1: not a treadle"):
        read_wif(write(text))


@pytest.mark.parametrize("lost", ["7=3\n8=4\n", "3=2\n4=1\n"])
def test_the_remedy_for_missing_lines_weaves_what_there_is(write, lost: str) -> None:  # type: ignore[no-untyped-def]
    """And no empty ends or picks."""
    whole, text = read_wif(write(FLOOR_LOOM)).drawdown, FLOOR_LOOM[::-1].replace(lost[::-1], "", 1)[::-1]
    with pytest.raises(BadInput) as refused:
        read_wif(write(text))
    count, section = re.findall(r"Threads=(\d+) in \[(\w+)\]", str(refused.value))[0]
    found = read_wif(write(re.sub(rf"(\[{section}\]\nThreads=)\d+", rf"\g<1>{count}", text))).drawdown
    assert np.array_equal(found, whole[: found.shape[0], : found.shape[1]])
    assert found.shape == ((4, int(count)) if section == "WARP" else (int(count), 8)) and found.any(axis=1).all()


def test_picks_at_which_no_shaft_moves_are_told_of(write) -> None:  # type: ignore[no-untyped-def]
    facts = draw_draft(read_wif(write(FLOOR_LOOM.replace("3=2\n4=1\n", "3=2\n4=0\n")))).facts
    assert facts["without shafts"] == "1 pick, at which no shaft moves: 4"


def test_files_with_lines_too_many_are_woven_as_without_them(write, shared_data: Path) -> None:  # type: ignore[no-untyped-def]
    for name, section, first in (("extra_treadles_tieup", "TIEUP", 5), ("colors_extra", "WARP COLORS", 9)):
        path = shared_data / "cases" / "11-wif" / f"{name}.wif"
        found, text = read_wif(path), path.read_text()
        own = re.search(rf"\[{section}\][^\[]*", text)
        assert own is not None
        kept = "\n".join(
            line for line in own[0].splitlines() if not line[:1].isdigit() or int(line.split("=")[0]) < first
        )
        expected = read_wif(write(text.replace(own[0], kept + "\n")))
        assert found.left_out and not expected.left_out and found.left_out[0].startswith(f"[{section}]")
        assert np.array_equal(found.drawdown, expected.drawdown)
        np.testing.assert_array_equal(found.warp.colour, expected.warp.colour)  # type: ignore[arg-type]


def test_gigantic_sizes_are_refused_before_they_are_allocated(write) -> None:  # type: ignore[no-untyped-def]
    """16,384 shafts and treadles for as many yarns would be a gigabyte of tables."""
    for old, new in (("Threads=8", "Threads=16384"), ("Shafts=4", "Shafts=16384")):
        text = FLOOR_LOOM.replace(old, new).replace("Threads=4", "Threads=16384")
        with pytest.raises(BadInput, match=r"THREADS|SHAFTS"):
            read_wif(write(text))
    with pytest.raises(BadInput, match="bytes"):
        read_wif(write(b""))


LINES = FLOOR_LOOM.splitlines() + DOBBY.splitlines() + SINKING.splitlines()
VALUES = st.sampled_from(["", "0", "1", "2,3", ",", ";", "-1", "1e9", "16384", "999999999", "é", "0,5", "1=1", "\x00"])
KEYS = st.sampled_from(sorted({line.split("=")[0] for line in LINES if "=" in line}))


@settings(deadline=None, suppress_health_check=list(HealthCheck))
@given(
    base=st.sampled_from([FLOOR_LOOM, DOBBY, SINKING]),
    changes=st.lists(st.tuples(st.integers(0, 10**6), st.sampled_from("dsir"), KEYS, VALUES), max_size=6),
    tail=st.binary(max_size=30),
)
def test_any_other_file_is_read_or_refused(
    tmp_path: Path, base: str, changes: list[tuple[int, str, str, str]], tail: bytes
) -> None:
    """Lines dropped, moved, inserted and changed, and bytes after them: nothing but BadInput comes of it."""
    lines = base.splitlines()
    for at, change, key, value in changes:
        place = at % max(1, len(lines))
        if change == "d":
            del lines[place : place + 1]
        elif change == "s":
            lines.insert(place, lines.pop(at // 7 % len(lines)) if lines else "")
        elif change == "i":
            lines.insert(place, f"{key}={value}")
        elif lines:
            lines[place] = f"{lines[place].split('=')[0]}={value}"
    path = tmp_path / "fuzz.wif"
    path.write_bytes("\n".join(lines).encode() + tail)
    try:
        draft = read_wif(path)
    except BadInput:
        return
    assert draft.drawdown.dtype == np.bool_ and draft.drawdown.any() and not draft.drawdown.all()
    for yarns, number in ((draft.weft, draft.drawdown.shape[0]), (draft.warp, draft.drawdown.shape[1])):
        assert yarns.spacing is None or ((yarns.spacing > 0).all() and yarns.spacing.shape == (number,))
        assert yarns.colour is None or (yarns.colour.shape == (number, 3) and (yarns.colour >= 0).all())


@settings(deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.binary(max_size=300))
def test_any_bytes_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "bytes.wif"
    path.write_bytes(data)
    with pytest.raises(BadInput):
        read_wif(path)


ENDS, PICKS = 12, 10
SPACING = [0.05 if k % 4 else 0.1 for k in range(ENDS)]
RED, CREAM, GREEN = (150, 30, 40), (235, 225, 200), (40, 70, 60)
LOOM = f"""[WIF]
[WEAVING]
Shafts=4
Treadles=4
[COLOR PALETTE]
Range=0,255
[COLOR TABLE]
1=150,30,40
2=235,225,200
3=40,70,60
[WARP]
Threads={ENDS}
Units=centimeters
Spacing=0.05
[WEFT]
Threads={PICKS}
Units=centimeters
Spacing=0.08
Color=3
[WARP SPACING]
{"".join(f"{k + 1}={spacing}{chr(10)}" for k, spacing in enumerate(SPACING))}
[WARP COLORS]
{"".join(f"{k + 1}={1 + k // 2 % 2}{chr(10)}" for k in range(ENDS))}
[THREADING]
{"".join(f"{k + 1}={(k * k) % 4 + 1}{chr(10)}" for k in range(ENDS))}
"""
TREADLES = f"""[TIEUP]
1=1,2
2=2,3
3=3
4=1,4
[TREADLING]
{"".join(f"{k + 1}={(3 * k) % 4 + 1}{chr(10)}" for k in range(PICKS))}
"""
LIFTS = "[LIFTPLAN]\n" + "".join(f"{k + 1}={k % 3 + 1},4\n" for k in range(PICKS))
WARP = np.array([(RED, CREAM)[k // 2 % 2] for k in range(ENDS)])


def write_draft(folder: Path, text: str) -> Path:
    path = folder / "a.wif"
    path.write_text(text)
    return path


def middles(start: int, pitches: np.ndarray) -> np.ndarray:
    """Pixels of the middles of yarns or squares that begin at `start`."""
    return np.floor(start + np.cumsum(pitches) - 0.5 * pitches).astype(int)


def pitch_of(pixel: float) -> int:
    """Pixels of the mean yarn, and so of a square beside the drawdown."""
    return round((sum(SPACING) + 0.08 * PICKS) / (ENDS + PICKS) * 0.01 / pixel)


@pytest.mark.parametrize("how", [TREADLES, LIFTS])
def test_the_drawdown_follows_from_the_marks_that_are_drawn_beside_it(how: str, tmp_path: Path) -> None:
    path = write_draft(tmp_path, LOOM + how)
    drawn, draft = WovenCloth().draw_draft(path), read_wif(path)
    assert drawn.pixel is not None
    square = drawn.pixel and round(
        np.concatenate([0.01 * np.array(SPACING), np.full(PICKS, 8e-4)]).mean() / drawn.pixel
    )
    columns = middles(MARGIN, 0.01 * np.array(SPACING) / drawn.pixel)
    head = middles(MARGIN, np.full(4, square))
    below, beyond = MARGIN + 4 * square + square + 2 * (square // 2), MARGIN + 0.01 * sum(SPACING) / drawn.pixel
    rows = middles(below, np.full(PICKS, 8e-4 / drawn.pixel))
    right = middles(round(beyond) + square + 2 * (square // 2), np.full(4, square))
    marked = (drawn.picture == MARK).all(axis=2)
    threading, pressed = marked[np.ix_(head, columns)][::-1].T, marked[np.ix_(rows, right)]
    lifts = pressed if how is LIFTS else (pressed.astype(int) @ marked[np.ix_(head, right)][::-1].T.astype(int)) > 0
    woven = (lifts.astype(int) @ threading.T.astype(int)) > 0
    assert np.array_equal(woven, draft.drawdown) and woven.any() and not woven.all()
    assert marked[np.ix_(head, right)].any() == (how is TREADLES)
    shown = drawn.picture[np.ix_(rows, columns)].astype(int)
    expected = np.where(woven[..., None], WARP[None], np.array(GREEN))
    assert np.abs(shown - expected).max() <= 1


def test_yarns_of_a_drawdown_are_as_wide_as_they_are_apart(tmp_path: Path) -> None:
    """To a pixel, all along: where the warp changes its colour, every two ends. Without spacing there is no scale."""
    drawn = WovenCloth().draw_draft(write_draft(tmp_path, LOOM + TREADLES))
    assert drawn.pixel is not None and drawn.facts["size"] == "7.5 mm x 8 mm"
    square = pitch_of(drawn.pixel)
    width = round(7.5e-3 / drawn.pixel)
    line = drawn.picture[MARGIN + 5 * square, MARGIN : MARGIN + width, 0]
    changes = np.flatnonzero(np.diff(line.astype(int))) + 1
    assert np.abs(changes - np.cumsum(SPACING)[1:-1:2] * 0.01 / drawn.pixel).max() <= 0.5 + 1e-9
    bare = WovenCloth().draw_draft(write_draft(tmp_path, (LOOM + TREADLES).replace("Spacing=0.08\n", "")))
    assert bare.pixel is None and "no spacing" in bare.facts["size"]


def test_undyed_cloth_repeats_the_draft_s_colours_at_their_measure(tmp_path: Path) -> None:
    """In twice and a half as much cloth as the draft's 7.5 mm: where a place lies in it, modulo that."""
    write_draft(tmp_path, LOOM + TREADLES)
    config = WovenClothConfig.model_validate({
        "cells": [375, 100], "cell_size": "0.05 mm", "weave": {"plugin": "wif", "file": "a.wif", "measured": True},
        "tau3": {"I": 1, "II": 1, "III": 1}})  # fmt: skip
    cells, _ = WovenCloth().build(config, Folder(tmp_path), 0, ["dye"])
    assert cells.ground is not None
    ends = np.cumsum(SPACING) * 10
    place = (np.arange(375) + 0.5) * 0.05 % 7.5
    expected = WARP[np.searchsorted(ends, place)] / 255
    assert np.array_equal(cells.ground[1], expected) and (cells.ground[0] == np.array(GREEN) / 255).all()


def test_nuno_weave_draws_a_draft_with_its_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write_draft(tmp_path, LOOM + TREADLES), tmp_path / "out.png"
    assert main(["weave", str(path), "--png", str(out)]) == 0
    said = capsys.readouterr().out
    assert "7.5 mm x 8 mm" in said and str(out) in said
    drawn = WovenCloth().draw_draft(path)
    with Image.open(out) as image:
        picture = np.asarray(image)
    height = len(drawn.picture)
    assert np.array_equal(picture[:height], drawn.picture)
    # The bar of the strip is the longest dark run, and says 1, 2 or 5 times a power of ten of the drawdown's own scale.
    dark = (picture[height + 15, :, 0] < 100).astype(int)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], dark, [0]])))
    assert drawn.pixel is not None
    assert (edges[1::2] - edges[::2]).max() == pytest.approx(2e-3 / drawn.pixel, abs=1)
    assert main(["weave", str(tmp_path / "none.wif")]) == 2
    assert "no such file" in capsys.readouterr().err


def test_what_a_file_lacks_is_said_of_it(tmp_path: Path) -> None:
    text = (LOOM + TREADLES).replace("[COLOR TABLE]", "[COLOURS]").replace("5=1\n", "").replace("4=2\n", "4=3\n", 1)
    facts = WovenCloth().draw_draft(write_draft(tmp_path, text)).facts
    assert facts["colours"].startswith("the file numbers those of warp and weft, but has no [COLOR TABLE]")
    assert not {"colours", "on no shaft"} & WovenCloth().draw_draft(write_draft(tmp_path, LOOM + TREADLES)).facts.keys()
    threads = "".join(f"{k + 1}={(k * k) % 4 + 1}\n" for k in range(ENDS))
    without = LOOM.replace(threads, threads.replace("5=1\n", "5=0\n").replace("9=1\n", "9=0\n"))
    facts = WovenCloth().draw_draft(write_draft(tmp_path, without + TREADLES)).facts
    assert facts["on no shaft"] == "2 ends, which never rise: 5, 9"


def test_yarns_are_measured_or_given_in_cells(tmp_path: Path) -> None:
    write_draft(tmp_path, LOOM + TREADLES)
    config = {"cells": (20, 20), "cell_size": 1e-4, "tau3": {"I": 0.1, "II": 0.1, "III": 0.1},
              "weave": {"plugin": "wif", "file": "a.wif", "measured": True}, "warp": {"width": 3}}  # fmt: skip
    with pytest.raises(BadInput, match="as the file measures them") as refused:
        WovenCloth().build(WovenClothConfig.model_validate(config), Folder(tmp_path), 0, ["indigo"])
    assert refused.value.field == "warp.width"
