"""Supply of dye: parts of the cloth against closed forms, amounts, and when they are due."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from nuno_dye.regions import Disc, Polygon, Rectangle, Region, Stroke, cover
from nuno_dye.supply import Bath, Brush, Drop, Supply, exchange, find_cells, give, is_due
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
    drop = TypeAdapter(Supply).validate_python({"kind": "drop", "place": ["5 mm", "5 mm"], "diameter": "1.5 mm"})
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


def test_giving_fills_to_a_share_takes_nothing_and_counts_what_it_gave() -> None:
    rng = np.random.default_rng(3)
    room = rng.random((2, 30, 40)) * (rng.random((2, 30, 40)) > 0.2)
    phi = room * rng.random(room.shape)
    cells = rng.random(room.shape) > 0.5
    after, given = give(phi, room, cells, 0.6)
    assert np.array_equal(after[~cells], phi[~cells]) and (after >= phi).all() and (after <= room).all()
    assert (after[cells] >= 0.6 * room[cells]).all() and np.array_equal(
        after[phi >= 0.6 * room], phi[phi >= 0.6 * room]
    )
    assert given == pytest.approx(math.fsum(after.ravel()) - math.fsum(phi.ravel()), rel=1e-13)
    assert give(after, room, cells, 0.6).given == 0.0
    assert np.array_equal(give(phi, room, np.ones_like(cells), 1.0).phi, room)


def test_only_the_layer_that_is_named_is_reached() -> None:
    for layers, expected in (("weft", (True, False)), ("warp", (False, True)), ("both", (True, True))):
        cells = find_cells(Bath(layers=layers), (5, 6), SIZE)  # type: ignore[arg-type]
        assert tuple(layer.all() for layer in cells) == expected == tuple(layer.any() for layer in cells)


def test_a_finite_bath_settles_at_equal_shares_and_keeps_the_dye() -> None:
    rng = np.random.default_rng(5)
    room, cells = rng.random((2, 20, 20)), rng.random((2, 20, 20)) > 0.3
    phi, liquor, share = room * rng.random(room.shape), 3.0, 0.9
    total = room[cells].sum()
    after, left = exchange(phi, room, cells, share, liquor)
    assert np.allclose(after[cells], left * room[cells], rtol=1e-15) and np.array_equal(after[~cells], phi[~cells])
    before = phi[cells].sum() + share * liquor * total
    assert after[cells].sum() + left * liquor * total == pytest.approx(before, rel=1e-13)
    # An empty cloth takes up 1 / (L + 1) of the bath; again nothing happens.
    assert exchange(0 * phi, room, cells, share, liquor).share == pytest.approx(share * liquor / (liquor + 1.0))
    assert exchange(after, room, cells, left, liquor).share == pytest.approx(left, rel=1e-14)
    assert exchange(phi, 0 * room, cells, share, liquor).share == share


def test_every_supply_acts_in_its_time() -> None:
    """Steps follow on each other without gap: once is once, and maintained is in every step that it overlaps."""
    edges = np.linspace(0.0, 10.0, 41)
    steps = list(itertools.pairwise(edges))
    for start in (0.0, 0.25, 3.1, 9.99):
        drop = Drop(place=(0.0, 0.0), diameter=1e-3, start=start)
        due = [step for step in steps if is_due(drop, *step)]
        assert len(due) == 1 and due[0][0] <= start < due[0][1]
    kept = Bath(maintained=True, start=2.0, stop=4.0)
    assert [step for step in steps if is_due(kept, *step)] == [s for s in steps if s[0] >= 2.0 and s[1] <= 4.0]
    assert all(is_due(Bath(maintained=True), *step) for step in steps)


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
        TypeAdapter(Supply).validate_python(supply)


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
