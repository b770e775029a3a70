"""Supply of dye: parts of the cloth against closed forms, and what is no supply."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from pydantic import TypeAdapter, ValidationError

from nuno_dye.supplies.regions import Disc, Polygon, Rectangle, Region, Stroke, cover
from nuno_dye.supplies.resist import Resists
from nuno_dye.supplies.supply import AnySupply, Bath, Brush, Supplies, find_cells, prepare_supplies
from nuno_schemas.errors import BadInput

SIZE = 5e-5
SHAPE = (200, 240)


def area(region: object) -> float:
    return float(cover(region, SHAPE, SIZE).sum()) * SIZE**2  # type: ignore[arg-type]


def test_areas_are_those_of_the_shapes() -> None:
    """Within half a cell of the rim, at most, on either side."""
    cases = {
        math.pi * 2e-3**2: Disc(centre=(5e-3, 5e-3), diameter=4e-3),
        3e-3 * 1e-3: Rectangle(low=(1e-3, 2e-3), high=(4e-3, 3e-3)),
        0.5 * 6e-3 * 4e-3: Polygon(points=((1e-3, 1e-3), (7e-3, 1e-3), (3e-3, 5e-3))),
        5e-3 * 1e-3 + math.pi * 0.5e-3**2: Stroke(points=((2e-3, 2e-3), (5e-3, 6e-3)), width=1e-3),
    }
    for exact, region in cases.items():
        assert area(region) == pytest.approx(exact, rel=0.02), region


def test_the_drop_of_the_dye_paper_has_a_diameter_of_30_cells() -> None:
    drop = TypeAdapter(AnySupply).validate_python({"kind": "drop", "place": ["5 mm", "5 mm"], "diameter": "1.5 mm"})
    cells = find_cells(drop, (200, 200), SIZE)
    assert cells.shape == (2, 200, 200) and np.array_equal(cells[0], cells[1])
    rows, columns = np.flatnonzero(cells[0].any(axis=1)), np.flatnonzero(cells[0].any(axis=0))
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (85, 114, 85, 114)
    for turned in (cells[0].T, cells[0][::-1], cells[0][:, ::-1]):
        assert np.array_equal(turned, cells[0])


def test_a_polygon_equals_its_rectangle_and_a_crossed_one_is_hollow() -> None:
    low, high = (1e-3, 2e-3), (6e-3, 5e-3)
    corners = (low, (high[0], low[1]), high, (low[0], high[1]))
    exact = cover(Rectangle(low=low, high=high), SHAPE, SIZE)
    for points in (corners, corners[::-1], corners[2:] + corners[:2]):
        assert np.array_equal(cover(Polygon(points=points), SHAPE, SIZE), exact)
    around_twice = cover(Polygon(points=(*corners, *corners, (2e-3, 3e-3))), SHAPE, SIZE)
    assert around_twice.sum() < exact.sum() / 2


def test_a_stroke_is_the_union_of_its_pieces_and_a_single_point_is_a_disc() -> None:
    points = ((1e-3, 1e-3), (4e-3, 2e-3), (2e-3, 6e-3), (2e-3, 6e-3))
    whole = cover(Stroke(points=points, width=8e-4), SHAPE, SIZE)
    pieces = [cover(Stroke(points=pair, width=8e-4), SHAPE, SIZE) for pair in itertools.pairwise(points)]
    assert np.array_equal(whole, np.logical_or.reduce(pieces))
    disc = cover(Disc(centre=points[0], diameter=8e-4), SHAPE, SIZE)
    assert np.array_equal(cover(Stroke(points=points[:1], width=8e-4), SHAPE, SIZE), disc)
    # Beyond the cloth's edge a stroke goes on unseen.
    assert cover(Stroke(points=((-1.0, 1e-3), (1.0, 1e-3)), width=4e-4), SHAPE, SIZE).sum() == 8 * SHAPE[1]


def test_only_the_layer_that_is_named_is_reached() -> None:
    for layers, expected in (("weft", (True, False)), ("warp", (False, True)), ("both", (True, True))):
        cells = find_cells(Bath(layers=layers), (5, 6), SIZE)  # type: ignore[arg-type]
        assert tuple(layer.all() for layer in cells) == expected == tuple(layer.any() for layer in cells)


@pytest.mark.parametrize(
    ("supply", "said"),
    [
        ({"kind": "drop", "place": [0, 0], "diameter": "0 mm"}, "greater than 0"),
        ({"kind": "drop", "place": [0, 0], "diameter": "3 kg"}, "kilogram"),
        ({"kind": "drop", "place": [0, 0], "diameter": 1, "amount": 1.5}, "less than or equal to 1"),
        ({"kind": "drop", "place": [0, 0], "diameter": 1, "radius": 1}, "radius"),
        ({"kind": "splash"}, "splash"),
        ({"kind": "stroke", "points": [], "width": 1}, "at least 1"),
        ({"kind": "bath", "stop": 3}, "maintained: true"),
        ({"kind": "bath", "maintained": True, "start": 3, "stop": 3}, "after start"),
        ({"kind": "bath", "liquor": 20}, "maintained: true"),
        ({"kind": "bath", "region": {"shape": "blot"}}, "blot"),
    ],
)
def test_what_is_no_supply_is_refused(supply: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        TypeAdapter(AnySupply).validate_python(supply)


@pytest.mark.parametrize(
    "region",
    [
        {"shape": "disc", "centre": ["50 mm", 0], "diameter": "1 mm"},
        {"shape": "rectangle", "low": ["2 mm", 0], "high": ["1 mm", "1 mm"]},
        {"shape": "polygon", "points": [[0, 0], ["1 mm", 0], ["2 mm", 0]]},
        {"shape": "stroke", "points": [[0, "-3 mm"]], "width": "1 mm"},
    ],
)
def test_what_reaches_no_cell_is_refused_with_the_cloth_s_size(region: dict[str, object]) -> None:
    with pytest.raises(BadInput, match=r"holds no cell[^$]*0.012 m x 0.01 m"):
        cover(TypeAdapter(Region).validate_python(region), SHAPE, SIZE)


def test_a_brush_covers_what_a_stroke_does() -> None:
    points = ((1e-3, 1e-3), (4e-3, 2e-3))
    brush = find_cells(Brush(points=points, width=1e-3), SHAPE, SIZE)
    assert np.array_equal(brush[0], cover(Stroke(points=points, width=1e-3), SHAPE, SIZE))


def test_what_is_given_is_told_with_its_time_and_its_cells() -> None:
    items = TypeAdapter(tuple[AnySupply, ...]).validate_python(
        [
            {"kind": "drop", "place": ["1 mm", "1 mm"], "diameter": "1 mm", "start": "2 min", "amount": 0.5},
            {"kind": "bath", "maintained": True, "start": 1, "stop": "1 h", "dye": "weld", "layers": "warp"},
            {"kind": "bath", "maintained": True, "liquor": 20},
        ]
    )
    drop, bath, finite = prepare_supplies(items, SHAPE, SIZE, ("madder", "weld"))
    assert (drop.kind, drop.dye, drop.amount, drop.start, drop.stop, drop.liquor) == ("drop", 0, 0.5, 120.0, None, None)
    assert np.array_equal(drop.cells, find_cells(items[0], SHAPE, SIZE))
    assert (bath.dye, bath.start, bath.stop, bath.liquor) == (1, 1.0, 3600.0, None) and not bath.cells[0].any()
    assert (finite.stop, finite.liquor) == (math.inf, 20.0)


def test_the_documented_supplies_are_some() -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "dye-cloth.md").read_text()
    blocks = [yaml.safe_load(block.split("```")[0]) for block in page.split("```yaml\nsupply:")[1:]]
    items = [TypeAdapter(Supplies).validate_python(block) for block in blocks]
    kinds = [[one.kind for one in block] for block in items]
    assert kinds == [["drop", "stroke", "bath", "bath", "rinse"], ["bath", "rinse", "bath", "rinse"]]
    said = [
        yaml.safe_load(line.split("'")[1]) for line in page.splitlines() if line.startswith("nuno control last add")
    ]
    assert TypeAdapter(Supplies).validate_python([said[0]["supply"]]) and list(said[1]) == ["resist"]
    assert TypeAdapter(Resists).validate_python([said[1]["resist"]])
