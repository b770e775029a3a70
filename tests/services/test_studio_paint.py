"""What is painted in the studio is in the solver's cells, at its place and as large as it was painted."""

from __future__ import annotations

import base64
import io
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from nuno.scene import shipped
from nuno.studio import scenes
from nuno.studio.desk import Desk
from nuno.studio.dye import Flat, at_start, simplified
from nuno_schemas.errors import BadInput

CELL, CELLS = 1e-4, (120, 80)
SCENE = """\
# mine
nuno: 1
name: cloth
duration: 10 s
frame_rate: 1 Hz
dye:
  cloth:
    plugin: woven   # plain
    cells: [120, 80]
    cell_size: 0.1 mm
    weft: {width: 4, gap: 0, porosity: 0.5}
    warp: {width: 4, gap: 0, porosity: 0.5}
    tau3: {I: 0.02, II: 0.005, III: 0, V: 0.02}
  dyes: [indigo, weld]
"""
LINE = [[2.03e-3, 2.02e-3], [9.04e-3, 2.02e-3], [9.04e-3, 6.03e-3]]
WIDTH = 1.47e-3
LONG = 11.02e-3


@pytest.fixture(autouse=True)
def scene(desk: Desk) -> None:
    """In the desk's folder."""
    Path("cloth.yaml").write_text(SCENE)


def painted(desk: Desk, text: str = SCENE, **said: Any) -> str:
    answer = desk.act({"do": "paint", "scene": "cloth.yaml", "text": text, **said})
    assert answer["mistakes"] == []
    return str(answer["text"])


def start_of(text: str) -> tuple[Any, NDArray[np.float64]]:
    """Cells, and mobile dye, that a run of a text begins with."""
    cells, phi, _ = at_start(scenes.load(text, Path("cloth.yaml")))
    return cells, phi


def middles() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = ((np.arange(n) + 0.5) * CELL for n in CELLS)
    return np.meshgrid(x, y)


def away(line: list[list[float]]) -> NDArray[np.float64]:
    """(ny, nx) distance of each cell's middle from a line of points [m]."""
    x, y = middles()
    found = np.full(x.shape, np.inf)
    for (ax, ay), (bx, by) in pairwise(line):
        share = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2), 0.0, 1.0)
        found = np.minimum(found, np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay)))
    return found


def shaken(line: list[list[float]], pieces: int = 200) -> list[list[float]]:
    """The same line, as a hand's many events give it, a hundredth of a cell to and fro."""
    at = np.linspace(0.0, len(line) - 1.0, pieces)
    points = np.stack([np.interp(at, range(len(line)), column) for column in np.array(line).T], axis=1)
    return (points + 0.01 * CELL * np.cos(np.arange(pieces))[:, None]).tolist()


def test_paste_keeps_dye_out_of_the_cells_that_were_painted_and_of_no_others(desk: Desk) -> None:
    """Its area is that of the brush along the line, within a cell's width all round, and its cells are those of a mask
    that is made by hand, but for the rim.
    """
    text = painted(desk, tool="paste", points=shaken(LINE), width=WIDTH)
    assert text.startswith("# mine") and "# plain" in text and text.count("[") < SCENE.count("[") + 12
    covered = start_of(text)[0].resist[0] > 0.5
    distance = away(LINE)
    assert covered[distance < WIDTH / 2 - CELL].all() and not covered[distance > WIDTH / 2 + CELL].any()
    turned = WIDTH**2 / 4 * (1 - np.pi / 4)  # what the two pieces share at the corner, less what the brush turns in
    area = WIDTH * LONG + np.pi * WIDTH**2 / 4 - turned
    rim = 2 * LONG + np.pi * WIDTH
    assert abs(covered.sum() * CELL**2 - area) < rim * CELL / 2
    Image.fromarray((255 * (distance <= WIDTH / 2)).astype(np.uint8), "L").save("mine.png")
    by_hand = SCENE.replace("  dyes:", "    resist: [{kind: image, file: mine.png}]\n  dyes:")
    assert (covered != (start_of(by_hand)[0].resist[0] > 0.5)).sum() * CELL**2 < 0.1 * rim * CELL


def test_dye_is_given_to_the_cells_that_were_painted_up_to_its_amount(desk: Desk) -> None:
    cells, phi = start_of(painted(desk, tool="dye", dye="weld", amount=0.6, points=LINE, width=WIDTH))
    inside = away(LINE) <= WIDTH / 2
    assert not phi[0].any()
    assert np.array_equal(phi[1], 0.6 * cells.mobile_room * inside)


def test_a_second_stroke_and_a_dab_stand_behind_the_first(desk: Desk) -> None:
    text = painted(desk, tool="dye", dye="indigo", amount=1, points=[[3e-3, 3e-3]], width=2e-3)
    text = painted(desk, text, tool="dye", dye="weld", amount=0.5, points=[[8e-3, 4e-3]], width=2e-3)
    assert text.count("- {kind: stroke") == 2
    cells, phi = start_of(text)
    x, y = middles()
    for dye, (place, amount) in enumerate([((3e-3, 3e-3), 1.0), ((8e-3, 4e-3), 0.5)]):
        dab = np.hypot(x - place[0], y - place[1]) <= 1e-3
        assert np.array_equal(phi[dye], amount * cells.mobile_room * dab)


def png(picture: NDArray[np.uint8], mode: str) -> str:
    out = io.BytesIO()
    Image.fromarray(picture, mode).save(out, "PNG")
    return base64.b64encode(out.getvalue()).decode()


@pytest.mark.parametrize("invert", [False, True])
def test_a_stencil_keeps_dye_out_where_it_was_put_and_as_large(desk: Desk, invert: bool) -> None:
    """A white disc on nothing, or a black one on white: area and middle of what it keeps dye out of are the disc's."""
    row, column = np.mgrid[:300, :300] + 0.5
    disc = np.hypot(row - 150, column - 150) <= 100
    grey = np.where(disc, 0, 255) if invert else np.where(disc, 255, 0)
    place, width = (4.03e-3, 3.5e-3), 6e-3
    said = {"image": png(grey.astype(np.uint8), "L"), "invert": invert, "place": place, "width": width}
    text = painted(desk, tool="stencil", **said | {"place": list(place)})
    assert "{kind: image, file: cloth-stencil.png}" in text and Path("cloth-stencil.png").is_file()
    resist = start_of(text)[0].resist
    assert np.array_equal(resist[0], resist[1])
    x, y = middles()
    total, radius = resist[0].sum(), width / 3
    assert total * CELL**2 == pytest.approx(np.pi * radius**2, rel=0.01)
    assert (resist[0] * x).sum() / total == pytest.approx(place[0], abs=CELL / 4)
    assert (resist[0] * y).sum() / total == pytest.approx(place[1], abs=CELL / 4)
    again = painted(desk, text, tool="stencil", **said | {"place": list(place)})
    assert "cloth-stencil-2.png" in again


def test_what_cannot_be_painted_is_said(desk: Desk) -> None:
    white = {"image": png(np.full((9, 9), 255, np.uint8), "L"), "width": 1e-3}
    for more, problem in (
        ({"place": [4e-3, 4e-3], "live": True}, "takes no new image"),
        ({"place": [1.0, 1.0]}, "beside"),
    ):
        with pytest.raises(BadInput, match=problem):
            desk.act({"do": "paint", "scene": "cloth.yaml", "text": SCENE, "tool": "stencil"} | white | more)
    assert not list(Path().glob("*.png"))
    for said, problem in [
        ({"tool": "paste", "points": [[0.1, 0.1]], "width": 1e-3}, "the part holds no cell"),
        ({"tool": "dye", "dye": "madder", "amount": 1, "points": LINE, "width": 1e-3}, "madder"),
    ]:
        with pytest.raises(BadInput, match=problem):
            desk.act({"do": "paint", "scene": "cloth.yaml", "text": SCENE, **said})
    for said, field in [
        ({"tool": "paste", "points": [], "width": 1e-3}, "points"),
        ({"tool": "paste", "points": LINE, "width": "wide"}, "width"),
        ({"tool": "dye", "dye": "weld", "points": LINE, "width": 1e-3}, "amount"),
        ({"tool": "stencil", "image": "no picture", "place": [1e-3, 1e-3], "width": 1e-3}, "image"),
    ]:
        with pytest.raises(BadInput) as refused:
            desk.act({"do": "paint", "scene": "cloth.yaml", "text": SCENE, **said})
        assert refused.value.field == field
    text = shipped.find("dye/drops").read_text()
    with pytest.raises(BadInput, match="save the scene"):
        desk.act({"do": "paint", "scene": "dye/drops", "text": text, "tool": "stencil"})


def test_a_skirt_covers_its_flat_cloth_once(desk: Desk) -> None:
    """As its texture goes round it: the triangles' areas on the flat cloth, none of which faces down, are that."""
    number = desk.act({"do": "see", "scene": "skirt-dyed", "text": shipped.find("skirt-dyed").read_text()})["number"]
    uv, wide, high = desk._starts.kept[number].sight.uv, 36e-3, 7.2e-3
    assert uv is not None
    corners = uv.reshape(-1, 3, 2).astype(np.float64) * [wide, high]
    (ax, ay), (bx, by) = np.moveaxis(np.diff(corners, axis=1), (0, 1, 2), (2, 0, 1))
    assert (ax * by - ay * bx < 0.0).all()  # y points down there
    assert 0.5 * np.abs(ax * by - ay * bx).sum() == pytest.approx(wide * high, rel=1e-6)
    assert corners.min(axis=(0, 1)) == pytest.approx([0.0, 0.0]) and corners.max(axis=(0, 1)) == pytest.approx(
        [wide, high]
    )


def test_a_line_is_told_by_fewer_points_none_far_from_it() -> None:
    rng = np.random.default_rng(0)
    for points in (np.cumsum(rng.normal(size=(500, 2)), axis=0), np.repeat([[1.0, 2.0]], 5, axis=0), np.zeros((1, 2))):
        found = simplified(points, 0.5)
        assert len(found) <= len(points) and (found[[0, -1]] == points[[0, -1]]).all()
        x, y = points.T
        nearest = np.full(len(points), np.inf)
        for (ax, ay), (bx, by) in pairwise(found):
            long = (bx - ax) ** 2 + (by - ay) ** 2
            share = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / (long or 1.0), 0.0, 1.0)
            nearest = np.minimum(nearest, np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay)))
        assert len(points) == 1 or nearest.max() <= 0.5 + 1e-12
    assert len(simplified(np.array(shaken(LINE)), 0.25 * CELL)) <= 5


def test_a_picture_is_that_of_its_cloth_whatever_was_drawn_before(desk: Desk) -> None:
    """What pictures of like cloth have in common is kept: another cloth, dye or stroke gives what it gives alone."""
    small = SCENE.replace("[120, 80]", "[24, 16]")
    texts = [
        small,
        painted(desk, small, tool="paste", points=[[1e-3, 1e-3]], width=5e-4),
        small.replace("width: 4", "width: 6"),
        small.replace("weld]", "madder]"),
        small + "  picture: {ground: tan}\n",
        small,
    ]
    kept, alone = [], []
    for text in texts:
        number = desk.act({"do": "dyed", "scene": "cloth.yaml", "text": text})["number"]
        kept.append(desk._dyed_cloth.tell({"number": [str(number)]})[1])
        alone.append(Flat().draw(scenes.load(text, Path("cloth.yaml")))[0])
    assert kept == alone
    assert kept[0] == kept[-1] and len(set(kept)) == 4  # a dye that is not on the cloth yet changes nothing
