"""Folded shibori: unfolded, what keeps dye out is mirrored at every fold."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pattern_files import SIZE, Folder
from pydantic import ValidationError

from nuno_dye.supplies.folding import fold_cells
from nuno_dye.supplies.regions import Disc, Polygon, Rectangle, Stroke, contains, cover
from nuno_dye.supplies.resist import Folded, Shibori, find_resist
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

SHAPE = 96, 120
"""Cells: 9.6 mm down, 12 mm across."""
BLOT = {"shape": "polygon", "points": [[0.0003, 0.0004], [0.0014, 0.0007], [0.0011, 0.0019]]}
SIDE, HEIGHT = 0.0041, 0.0041 * math.sqrt(0.75)


def draw(root: Path, *folds: dict[str, Any], **pressed: Any) -> Float:
    item = Folded.model_validate({"folds": folds, **(pressed or {"clamps": [BLOT]})})
    return find_resist(item, SHAPE, SIZE, Folder(root))


def test_pleats_of_whole_cells_mirror_the_resist_to_the_last_bit(tmp_path: Path) -> None:
    """At every fold of both directions, and the first panel is the packet."""
    across, down = {"fold": "pleats", "number": 6}, {"fold": "pleats", "width": 0.0024, "angle": math.pi / 2}
    alone = cover(Polygon.model_validate(BLOT), SHAPE, SIZE)
    for folds in ((across,), (across, down), (down, across)):
        found = draw(tmp_path, *folds)
        panels = found.reshape(96, 6, 20)
        assert np.array_equal(panels[:, 0], alone[:, :20]) or len(folds) == 2
        assert (panels[:, ::2] == panels[:, :1]).all() and (panels[:, 1::2] == panels[:, :1, ::-1]).all()
        if len(folds) == 2:
            rows = found.reshape(4, 24, 120)
            assert (rows[::2] == rows[:1]).all() and (rows[1::2] == rows[:1, ::-1]).all()
            assert np.array_equal(rows[0, :, :20], alone[:24, :20])


def mirrors(kind: str) -> list[tuple[Float, float]]:
    """Fold lines as (normal, distance of the line from the corner along it)."""
    oblique = np.array([math.cos(0.4), math.sin(0.4)])
    if kind == "pleats":
        return [(oblique, k * SIDE) for k in (1, 2, 3)]
    if kind == "right":
        slopes = [np.array([1.0, s]) / math.sqrt(2.0) for s in (1.0, -1.0)]
        return [(np.eye(2)[0], SIDE), (np.eye(2)[1], 2 * SIDE), (slopes[0], math.sqrt(2.0) * SIDE), (slopes[1], 0.0)]
    numbers = {0.0: (1, 2), math.pi / 3: (1, 2, 3), -math.pi / 3: (-1, 0, 1)}
    return [(np.array([math.cos(a), math.sin(a)]), k * HEIGHT) for a, those in numbers.items() for k in those]


@pytest.mark.parametrize("kind", ["pleats", "right", "equilateral"])
def test_a_place_and_its_mirror_image_at_any_fold_lie_upon_each_other(kind: str) -> None:
    """Folding brings no two places farther apart, so the cell that an image falls into lies no farther from the place
    on the packet than its middle does from the image on the cloth: half a cell's diagonal, a 230th of a side.
    """
    fold = {"fold": "pleats", "width": SIDE, "angle": 0.4} if kind == "pleats" else {
        "fold": "triangles", "side": SIDE, "kind": kind}  # fmt: skip
    folded = Folded.model_validate({"folds": [fold], "clamps": [BLOT]})
    fine = SIZE / 4
    shape = 4 * SHAPE[0], 4 * SHAPE[1]
    u = np.stack(fold_cells(folded.folds, shape, fine), axis=-1)
    y, x = np.indices(shape)
    place = (np.stack([x, y], axis=-1) + 0.5) * fine
    for normal, distance in mirrors(kind):
        image = place - 2.0 * ((place @ normal) - distance)[..., None] * normal
        cell = np.floor(image / fine).astype(int)
        there = ((cell >= 0) & (cell < shape[::-1])).all(axis=-1)
        assert there.sum() > 1000
        near = cell[there]
        off = np.linalg.norm((near + 0.5) * fine - image[there], axis=1)
        apart = np.linalg.norm(u[near[:, 1], near[:, 0]] - u[there], axis=1)
        assert (apart <= off + 1e-12).all()


def test_a_packet_of_triangles_is_one_triangle_and_covers_it() -> None:
    """Its corners are said: of places of 12 mm x 9.6 mm all lie in it, evenly."""
    for kind, corners in (
        ("equilateral", [[0, 0], [0, SIDE], [HEIGHT, SIDE / 2]]),
        ("right", [[0, 0], [SIDE, 0], [SIDE, SIDE]]),
    ):
        folds = Folded.model_validate(
            {"folds": [{"fold": "triangles", "side": SIDE, "kind": kind}], "clamps": [BLOT]}
        ).folds
        u, v = fold_cells(folds, (384, 480), SIZE / 4)
        middle = np.mean(corners, axis=0)
        wide = Polygon(points=[tuple(middle + (1 + 1e-9) * (np.array(c) - middle)) for c in corners])
        assert contains(wide, u, v).all()
        half = Polygon(points=[tuple(middle + math.sqrt(0.5) * (np.array(c) - middle)) for c in corners])
        assert contains(half, u, v).mean() == pytest.approx(0.5, abs=0.04)


def test_boards_on_folded_cloth_are_the_ready_pattern_of_squares(tmp_path: Path) -> None:
    squares = Shibori.model_validate({"pattern": {"pattern": "squares", "side": 0.00127}, "fold": [5, 4]})
    board = {
        "shape": "rectangle",
        "low": [0.0012 - 0.000635, 0.0012 - 0.000635],
        "high": [0.0012 + 0.000635, 0.0012 + 0.000635],
    }
    folds = {"fold": "pleats", "number": 5}, {"fold": "pleats", "number": 4, "angle": "90 deg"}
    assert np.array_equal(draw(tmp_path, *folds, clamps=[board]), find_resist(squares, SHAPE, SIZE, Folder(tmp_path)))


def test_stitches_press_every_other_length_along_their_line(tmp_path: Path) -> None:
    """Around a corner, too: 4 mm and 3 mm of stitches of 0.5 mm, 0.4 mm wide."""
    line = {"points": [[0.002, 0.003], [0.006, 0.003], [0.006, 0.006]], "width": 0.0004, "length": 0.0005}
    found = draw(tmp_path, stitches=[line])
    assert np.array_equal(found[28:32, 20:58], np.tile([1.0] * 5 + [0.0] * 5, (4, 4))[:, :38])
    assert np.array_equal(found[32:60, 58:62], np.tile([1.0] * 5 + [0.0] * 5, (4, 3)).T[2:])
    outside = np.ones(SHAPE, bool)
    outside[28:32, 20:62] = outside[28:60, 58:62] = False
    assert not found[outside].any()


@pytest.mark.parametrize(
    "region",
    [
        Disc(centre=(0.004, 0.005), diameter=0.006),
        Rectangle(low=(0.001, 0.002), high=(0.005, 0.0083)),
        Polygon(points=((0.001, 0.001), (0.011, 0.002), (0.003, 0.009), (0.003, 0.0), (0.008, 0.008))),
        Stroke(points=((0.001, 0.001), (0.011, 0.002), (0.003, 0.009)), width=0.0011),
    ],
)
def test_places_are_in_a_part_as_cells_are(region: Any) -> None:
    y, x = np.indices(SHAPE)
    assert np.array_equal(contains(region, (x + 0.5) * SIZE, (y + 0.5) * SIZE), cover(region, SHAPE, SIZE))


def test_what_is_no_packet_is_refused(tmp_path: Path) -> None:
    pleats = {"fold": "pleats", "number": 6}
    for item, words in (({"folds": [pleats]}, "add clamps or stitches"),
                        ({"folds": [pleats | {"width": 1e-3}], "clamps": [BLOT]}, "either a number or a width"),
                        ({"folds": [{"fold": "pleats"}], "clamps": [BLOT]}, "either a number or a width")):  # fmt: skip
        with pytest.raises(ValidationError, match=words):
            Folded.model_validate(item)
    beside = {"shape": "disc", "centre": [0.004, 0.004], "diameter": 0.001}
    with pytest.raises(BadInput, match=r"(?s)clamps\[1\]: beside the packet.*0\.00195, 0\.00955"):
        draw(tmp_path, pleats, clamps=[BLOT, beside])
    with pytest.raises(BadInput, match=r"folds\[1\]: folded finer than a cell"):
        draw(tmp_path, pleats, {"fold": "pleats", "number": 21})
