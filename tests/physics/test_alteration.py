"""Laws of altering a pattern: lengths, areas, what stays, what follows along seams, and what is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from sewing_patterns import REAL, back, front, panel, pattern, read, read_pattern, stitch, tube

from nuno.scene import shipped
from nuno.scene.files import SceneFiles
from nuno_cloth.sewing.alter import alter_pattern
from nuno_cloth.sewing.check import check_pattern
from nuno_cloth.sewing.pattern import Pattern, Side
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

CURVES: dict[str, Any] = {
    "straight": None,
    "quadratic": {"type": "quadratic", "params": [[0.4, -0.3]]},
    "cubic": {"type": "cubic", "params": [[0.2, -0.25], [1.1, -0.2]]},
    "circle": {"type": "circle", "params": [19.0, 0, 1]},
    "long arc": {"type": "circle", "params": [16.0, 1, 1]},
    "half circle": {"type": "circle", "params": [15.0, 0, 1]},
}
SLANTED = (0, 0), (30, 0), (34, 21), (12, 25), (-3, 20)


def alter(folder: Path, data: dict[str, Any], side: Side, length: float) -> tuple[Pattern, tuple[str, ...]]:
    """The pattern after an edge has got a length [m], and the seams that are eased."""
    read(folder, data)
    found = alter_pattern(SceneFiles(folder), "pattern.json", side, length)
    (folder / "altered.json").write_text(found.text)
    return read_pattern(SceneFiles(folder), "altered.json"), found.eased


def points(one: Pattern) -> Float:
    """Places (n, 2) of all edges [m], a few on each."""
    return np.concatenate([edge.curve.at(np.linspace(0.0, 1.0, 5)) for p in one.panels.values() for edge in p.edges])


@pytest.mark.parametrize("coords", ["relative", "absolute"])
@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("edge", [0, 2])
def test_the_edge_has_the_length_and_the_former_one_brings_the_pattern_back(
    curve: str, coords: str, edge: int, tmp_path: Path
) -> None:
    """Of any kind, whether it is picked or another one is."""
    curves = {0: CURVES[curve]} if CURVES[curve] else {}
    data = pattern({"one": panel(*SLANTED, curves=curves, translation=[1, 2, 3])}, curvature_coords=coords)
    if coords == "absolute" and curve in ("quadratic", "cubic"):
        control = data["pattern"]["panels"]["one"]["edges"][0]["curvature"]["params"]
        control[:] = [[30 * x, 30 * y] for x, y in control]
    first = read(tmp_path, json.loads(json.dumps(data)))
    former = first.panels["one"].edges[edge].length
    for share in (0.85, 1.3):
        other, eased = alter(tmp_path, data, ("one", edge), share * former)
        assert other.panels["one"].edges[edge].length == pytest.approx(share * former, abs=1e-9) and not eased
        again = alter_pattern(SceneFiles(tmp_path), "altered.json", ("one", edge), former)
        (tmp_path / "again.json").write_text(again.text)
        returned = read_pattern(SceneFiles(tmp_path), "again.json")
        np.testing.assert_allclose(points(returned), points(first), atol=1e-9)
        np.testing.assert_allclose(returned.panels["one"].translation, [0.01, 0.02, 0.03], atol=1e-12)


def test_a_rectangle_grows_by_its_width_and_hangs_from_where_it_did(tmp_path: Path) -> None:
    """The higher end stays where it was placed; of a level edge the middle does."""
    width, height, d = 0.3, 0.2, 0.045
    for side, grown in ((1, width * d), (3, width * d), (0, height * d), (2, height * d)):
        data = pattern({"front": front()})
        first = read(tmp_path, data).panels["front"]
        other, _ = alter(tmp_path, data, ("front", side), first.edges[side].length + d)
        now = other.panels["front"]
        assert now.area - first.area == pytest.approx(grown, abs=1e-12)
        places = [one.place(np.concatenate([edge.ends() for edge in one.edges])) for one in (first, now)]
        if side % 2:
            assert places[1][:, 1].max() == pytest.approx(places[0][:, 1].max(), abs=1e-12)
        else:
            np.testing.assert_allclose(places[1].mean(axis=0), places[0].mean(axis=0), atol=1e-12)


def test_what_is_before_an_edge_stays_and_what_is_beyond_it_moves_as_a_whole(tmp_path: Path) -> None:
    one = panel((0, 0), (10, -4), (20, 0), (20, 10), (24, 30), (10, 36), (0, 30), (0, 10))
    first, (other, _) = read(tmp_path, pattern({"one": one})), alter(tmp_path, pattern({"one": one}), ("one", 7), 0.14)
    moved = points(other) - points(first)
    y = points(first)[:, 1]  # edge 7 goes down from (0, 10) to (0, 0)
    np.testing.assert_allclose(moved[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(moved[y >= 0.1], 0.0, atol=1e-12)
    np.testing.assert_allclose(moved[y <= 0.0], [[0.0, -0.04]] * int((y <= 0.0).sum()), atol=1e-12)


def test_a_front_and_back_stay_sewable_and_other_panels_stay_to_the_byte(tmp_path: Path) -> None:
    data = tube(pocket=panel((0, 0), (10, 0), (10, 12), (0, 12), translation=[50, 100, 30]))
    other, eased = alter(tmp_path, data, ("front", 1), 0.26)
    assert [other.edge(side).length for seam in other.seams for side in seam.sides] == pytest.approx([0.26] * 4)
    assert not eased
    remarks = {one.kind for one in check_pattern(SceneFiles(tmp_path), "altered.json", 1.001).remarks}
    assert remarks <= {"several pieces", "loose panel"}
    texts = [(tmp_path / name).read_text() for name in ("pattern.json", "altered.json")]
    assert len({text[text.index('"pocket"') :] for text in texts}) == 1 and len(set(texts)) == 2
    alone, _ = alter(tmp_path, tube(), ("back", 0), 0.17)
    assert not check_pattern(SceneFiles(tmp_path), "altered.json", 1.001).remarks and alone.panels["front"].area > 0.05


def test_a_gathered_seam_keeps_its_fullness(tmp_path: Path) -> None:
    wide = panel((0, 0), (45, 0), (45, 20), (0, 20), translation=[-22, 79, 15])
    data = pattern({"top": front(), "skirt": wide}, stitch("top[0]", "skirt[2]"))
    other, eased = alter(tmp_path, data, ("top", 0), 0.34)
    assert not eased and other.edge(("skirt", 2)).length == pytest.approx(0.34 * 45 / 30, abs=1e-9)


def test_a_half_that_is_sewn_to_another_becomes_its_mirror_image(tmp_path: Path) -> None:
    """Below the armpit: the seam at the centre goes on above it, where neither half gains."""
    corners = (0, 0), (20, 0), (20, 20), (15, 30), (0, 32)
    mirrored = [(-x, y) for x, y in (corners[0], *corners[:0:-1])]
    data = pattern({"left": panel(*corners), "right": panel(*mirrored)}, stitch("left[4]", "right[0]"))
    other, eased = alter(tmp_path, data, ("left", 1), 0.26)
    left, right = (np.array([edge.ends()[0] for edge in one.edges]) for one in other.panels.values())
    left, right = left - left[0], (right - right[0]) * [-1.0, 1.0]
    np.testing.assert_allclose(left, [left[0], *right[:0:-1]], atol=1e-5)
    np.testing.assert_allclose(left[3] - left[2], [-0.05, 0.10], atol=1e-5)
    assert not eased


def test_a_seam_that_cannot_follow_is_eased_by_what_is_left(tmp_path: Path) -> None:
    """The back's sides gain as much as the front's upright one, and the front's slanted one gains less."""
    slanted = panel((0, 0), (30, 0), (30, 20), (8, 20), translation=[-15, 100, 15])
    other, eased = alter(tmp_path, tube(front=slanted), ("front", 1), 0.24)
    assert other.edge(("front", 1)).length == pytest.approx(0.24, abs=1e-9)
    off = [
        other.edge(seam.one).length * ratio - other.edge(seam.other).length
        for seam, ratio in zip(other.seams, (1.0, 20 / np.hypot(8, 20)), strict=True)
    ]
    told = {
        f"{seam.names}: {1e3 * abs(by):.1f} mm" for seam, by in zip(other.seams, off, strict=True) if abs(by) > 1e-4
    }
    assert told == set(eased) and told


def test_comments_and_spacing_of_yaml_stay(tmp_path: Path) -> None:
    source = shipped.folder() / "sewn" / "patterns" / "top.yaml"
    text = source.read_text()
    shutil.copyfile(source, tmp_path / "top.yaml")
    found = alter_pattern(SceneFiles(tmp_path), "top.yaml", ("front", 1), 0.40)
    assert [line.partition("#")[2] for line in found.text.splitlines()] == [
        line.partition("#")[2] for line in text.splitlines()
    ]
    (tmp_path / "other.yaml").write_text(found.text)
    other = read_pattern(SceneFiles(tmp_path), "other.yaml")
    assert [other.edge(side).length for side in (("front", 1), ("back", 6))] == pytest.approx([0.4, 0.4], abs=1e-9)


LEGACY = {"vertices": [[0, 0], [30, 0], [30, 20], [1e-7, 20]], "edges": [
    {"endpoints": [0, 1], "curvature": [0.5, -0.1]}, {"endpoints": [1, 2]}, {"endpoints": [2, 3]},
    {"endpoints": [3, 0]}]}  # fmt: skip


def test_files_of_2021_and_small_numbers_are_written_again(tmp_path: Path) -> None:
    data = pattern({"Ärmel": LEGACY})
    first = read(tmp_path, data)
    other, _ = alter(tmp_path, data, ("Ärmel", 2), 0.2)
    assert other.panels["Ärmel"].edges[2].length == pytest.approx(0.2, abs=1e-9)
    assert other.panels["Ärmel"].edges[0].length < first.panels["Ärmel"].edges[0].length
    tabs = json.dumps(data, indent="\t", ensure_ascii=False)
    (tmp_path / "tabs.json").write_text(tabs)
    text = alter_pattern(SceneFiles(tmp_path), "tabs.json", ("Ärmel", 2), 0.2).text
    assert text.count("\t") == tabs.count("\t") and json.loads(text) == json.loads(
        (tmp_path / "altered.json").read_text()
    )


BENT = panel((0, 0), (30, 0), (30, 6), (0, 6), curves={0: {"type": "quadratic", "params": [[0.5, -0.4]]}})
DEEP = panel((0, 0), (30, 0), (30, 12), (20, 6), (10, 12), (0, 12),
             curves={0: {"type": "circle", "params": [25.0, 0, 0]}})  # fmt: skip


@pytest.mark.parametrize(
    ("one", "side", "length", "field", "words"),
    [
        (front(), ("front", 0), 0.0, "length", "too short"),
        (front(), ("front", 0), float("nan"), "length", "too short or too long"),
        (front(), ("front", 0), 11.0, "length", "too long"),
        (front(), ("front", 4), 0.2, None, "no such edge"),
        (BENT, ("front", 0), 0.05, "length", "its ends meet"),
        (DEEP, ("front", 0), 0.6, "length", "crosses front"),
    ],
)
def test_what_cannot_be_cut_is_refused(
    one: dict[str, Any], side: Side, length: float, field: str | None, words: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInput, match=words) as refused:
        alter(tmp_path, pattern({"front": one}), side, length)
    error = refused.value
    assert error.field == field and error.value is not None and (error.limit or error.remedy)


def test_a_number_that_stands_for_two_panels_is_not_changed_for_one(tmp_path: Path) -> None:
    data = pattern({"front": front(), "back": back()})
    data["pattern"]["panels"]["back"]["translation"] = data["pattern"]["panels"]["front"]["translation"]
    (tmp_path / "one.yaml").write_text(yaml.dump(data))
    assert "*id" in (tmp_path / "one.yaml").read_text()
    with pytest.raises(BadInput, match="alias"):
        alter_pattern(SceneFiles(tmp_path), "one.yaml", ("front", 0), 0.4)


@pytest.mark.full
@pytest.mark.parametrize("name", REAL)
def test_every_edge_of_real_patterns_gets_another_length_or_a_reason(
    name: str, shared_data: Path, tmp_path: Path
) -> None:
    """What is altered can be sewn, and the edge has its length."""
    files, kept = SceneFiles(shared_data / "patterns"), SceneFiles(tmp_path)
    first, reasons = read_pattern(files, f"{name}.json"), list[tuple[str | None, bool, bool]]()
    for side in [(one, k) for one, panel_ in first.panels.items() for k in range(len(panel_.edges))]:
        for length in (1.05 * first.edge(side).length, 0.95 * first.edge(side).length):
            try:
                text = alter_pattern(files, f"{name}.json", side, length).text
            except BadInput as error:
                reasons.append((error.field, bool(error.value), bool(error.limit)))
                continue
            (tmp_path / "altered.json").write_text(text)
            assert not any(remark.wrong for remark in check_pattern(kept, "altered.json", np.inf).remarks)
            assert read_pattern(kept, "altered.json").edge(side).length == pytest.approx(length, abs=1e-9)
    assert set(reasons) <= {("length", True, True)}
