"""Lines with a width: the rest shape they give to cloth on any mesh, and how it returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from triangle_sheets import square
from wrinkled import draw, ridge, sheet

from nuno.plugin_contract.guards import check_fabric
from nuno.plugin_contract.values import ContractError
from nuno.simulation.operations import fabric_arrays, fabric_from
from nuno_cloth.fabrics.presets import PRESETS
from nuno_cloth.models.delaunay import fill_outline
from nuno_cloth.models.membrane import build_triangles
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.operation import Outcome
from nuno_wrinkle.net import most_stiffness
from nuno_wrinkle.relief import FEWEST

CLOTH = PRESETS["interlock"]
HEIGHT, WIDTH = 0.04, 0.3
LINE = ridge((0.3, 0.45), (0.7, 0.6), height=HEIGHT, width=WIDTH)
LENGTH = float(np.hypot(0.4, 0.15))


def measured(points: Float, faces: Int, angle: float = 90.0) -> Fabric:
    """A flat piece of measured cloth whose warp makes an angle [degrees] with x."""
    x = np.column_stack([points, np.zeros(len(points))])
    warp = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
    elements = build_triangles(CLOTH, x[faces], faces, warp, np.zeros(len(x), np.bool_))
    return Fabric("piece", x, 0.0 * x, pinned=np.zeros(len(x), np.bool_), **elements._asdict())


def ribbon() -> tuple[Float, Int]:
    """A strip of 1 m x 0.08 m, of 4 uneven cells across, along x."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 81) ** 1.2, np.array([0.0, 0.01, 0.035, 0.06, 0.08]))
    row, column = (each.reshape(-1) for each in np.mgrid[:4, :80])
    a = 81 * row + column
    return np.stack([u, v], axis=-1).reshape(-1, 2), np.concatenate(
        [np.column_stack([a, a + 1, a + 82]), np.column_stack([a, a + 82, a + 81])]
    ).astype(np.int32)


def slivers() -> tuple[Float, Int]:
    """Cells five times as long as wide, cut all alike and sheared."""
    points, faces = square("diagonal", 41)
    return points * [1.0, 0.2] + points[:, 1:] * [0.5, 0.0], faces


def scattered() -> tuple[Float, Int]:
    """Triangles of all sizes, thrown into a square."""
    ticks = np.linspace(0.0, 1.0, 30, endpoint=False)
    one, zero = np.ones_like(ticks), np.zeros_like(ticks)
    sides = [(ticks, zero), (one, ticks), (1.0 - ticks, one), (zero, 1.0 - ticks)]
    return fill_outline(np.concatenate([np.column_stack(side) for side in sides]), 0.035)


MESHES: dict[str, tuple[Callable[[], tuple[Float, Int]], dict[str, Any]]] = {
    "diagonal": (lambda: square("diagonal", 21), LINE),
    "irregular": (lambda: square("irregular", 31), LINE),
    "scattered": (scattered, LINE),
    "slivers": (slivers, ridge((0.4, 0.1), (0.9, 0.12), height=0.03, width=0.15)),
    "ribbon": (ribbon, ridge((0.3, 0.04), (0.7, 0.045), height=0.03, width=0.12)),
}


def strains(cloth: Fabric, x: Float) -> Float:
    """Strains of warp, weft and shear (3, t) at x."""
    membrane = cloth.membrane
    assert membrane is not None
    warp, weft = np.einsum("ytc,tck->ytk", membrane.shares(), x[membrane.faces])
    lengths = (np.linalg.norm(yarn, axis=1) - 1.0 for yarn in (warp, weft))
    return np.stack([*lengths, np.einsum("tk,tk->t", warp, weft)])


def take_back(numbers: tuple[int, ...], made: Outcome, *lines: dict[str, Any]) -> Outcome:
    fabric, x = changed(made)
    return draw(fabric, *lines, x=x, take_back=list(numbers), tolerance=0.1)


def changed(made: Outcome) -> tuple[Fabric, Float]:
    assert made.changed is not None
    return made.changed.fabric, made.changed.state.x


def differ(one: Fabric, other: Fabric) -> float:
    """The largest difference of two fabrics' arrays, over the largest value of each."""
    ours, theirs = (fabric_arrays(fabric) for fabric in (one, other))
    for fabric, arrays in ((one, ours), (other, theirs)):
        if (springs := fabric.springs) is not None:
            arrays["springs.rest"] = springs.per_spring(springs.rest)
    apart = [0.0]
    for name, values in ours.items():
        assert theirs[name].shape == values.shape
        if values.dtype == np.float64 and values.any():
            apart.append(float(np.abs(theirs[name] - values).max() / np.abs(values).max()))
    return max(apart)


@pytest.mark.parametrize("angle", [90.0, 25.0])
@pytest.mark.parametrize("mesh", MESHES)
def test_cloth_in_its_raised_shape_is_without_strain_on_any_mesh(mesh: str, angle: float) -> None:
    build, line = MESHES[mesh]
    flat = measured(*build(), angle)
    raised, x = changed(draw(flat, line))
    assert x[:, 2].max() > 0.8 * line["height"] and np.abs(strains(raised, x)).max() < 1e-12
    assert np.abs(strains(raised, flat.position)).max() > 0.05
    check_fabric(raised)


@pytest.mark.parametrize("tension", ["membrane", "springs"])
def test_area_and_mass_grow_as_the_arc_length_asks_for(tension: str) -> None:
    """By order 2 in the length of the edges."""

    def added(s: float, round_end: bool) -> float:
        slope = HEIGHT * np.pi / WIDTH * np.sin(2.0 * np.pi * s / WIDTH)
        return float((np.hypot(1.0, slope) - 1.0) * (2.0 * np.pi * s if round_end else 2.0 * LENGTH))

    exact = sum(quad(added, 0.0, 0.5 * WIDTH, (end,))[0] for end in (False, True))
    errors = []
    for n in (21, 41, 81):
        flat = measured(*square("diagonal", n)) if tension == "membrane" else sheet(n, n, size=[1.0, 1.0])
        shift = 0.0 if tension == "membrane" else -0.5
        ends = [(0.3 + shift, 0.45 + shift), (0.7 + shift, 0.6 + shift)]
        made = draw(flat, ridge(*ends, height=HEIGHT, width=WIDTH))
        density = flat.mass.sum()
        assert made.facts["mass"] == pytest.approx(density * made.facts["area"], rel=1e-9)
        errors.append(abs(made.facts["area"] - exact))
    assert errors[2] < 0.01 * exact and errors[0] > 3.0 * errors[1] > 9.0 * errors[2]


def test_heights_are_those_of_the_distance_and_lines_add_up() -> None:
    flat = measured(*square("irregular", 31))
    other = ridge((0.5, 0.3), (0.5, 0.8), height=-0.02, width=0.2)
    one, two, both = (changed(draw(flat, *lines))[1] for lines in ((LINE,), (other,), (LINE, other)))
    np.testing.assert_allclose(both[:, 2], one[:, 2] + two[:, 2], atol=1e-15)
    start, way = np.array([0.3, 0.45]), np.array([0.4, 0.15])
    along = np.clip((flat.position[:, :2] - start) @ way / LENGTH**2, 0.0, 1.0)
    distance = np.linalg.norm(flat.position[:, :2] - start - along[:, None] * way, axis=1)
    wave = np.where(distance < 0.5 * WIDTH, HEIGHT * np.cos(np.pi * distance / WIDTH) ** 2, 0.0)
    np.testing.assert_allclose(one[:, 2], wave, atol=1e-4 * HEIGHT)


def test_another_layer_of_a_fold_is_not_raised() -> None:
    """A sheet folded onto itself 5 mm apart, by a half turn of that diameter."""
    points, faces = square("diagonal", 41)
    flat = measured(points, faces)
    u, r = points[:, 0] - 0.5, 0.0025
    turn = np.clip(u / r, 0.0, np.pi)
    x = np.column_stack([
        np.where(u < 0.0, u, np.where(u < np.pi * r, r * np.sin(turn), np.pi * r - u)),
        points[:, 1], r - r * np.cos(turn),
    ])  # fmt: skip
    line = {"points": [[-0.3, 0.3, 0.0], [-0.3, 0.7, 0.0]], "height": 0.02, "width": 0.2}
    raised, _ = changed(draw(flat, line, x=x))
    assert raised.relief is not None
    assert points[raised.relief.vertex][:, 0].max() < 0.31 and len(raised.relief.vertex) > 50


def test_pins_stay_and_velocities_are_kept() -> None:
    flat = measured(*square("irregular", 31))
    flat = replace(flat, pinned=np.linalg.norm(flat.position - [0.5, 0.5, 0.0], axis=1) < 0.05)
    raised, x = changed(draw(flat, LINE))
    assert (x[flat.pinned] == flat.position[flat.pinned]).all() and raised.relief is not None
    assert raised.relief.total(flat.number)[flat.pinned].max() > 0.0


@pytest.mark.parametrize("keep", [False, True])
@pytest.mark.parametrize("tension", ["membrane", "springs", "quads"])
def test_a_line_that_is_taken_back_leaves_the_fabric_as_it_was(tension: str, keep: bool) -> None:
    flat, shift = measured(*square("irregular", 31), 25.0), 0.5
    if tension != "membrane":
        cells, shift = ("triangles" if tension == "springs" else "quads"), 0.0
        flat = sheet(31, 31, size=[1.0, 1.0], cells=cells, fabric="denim")
    first = ridge((shift - 0.2, shift), (shift + 0.2, shift), height=HEIGHT, width=WIDTH)
    second = ridge((shift, shift - 0.2), (shift + 0.05, shift + 0.2), height=-0.03, width=0.25)
    one = draw(flat, first, keep=keep)
    two = draw(*changed(one)[:1], second, x=changed(one)[1], keep=keep, tolerance=0.1)
    assert (one.facts["first"], two.facts["first"]) == (1.0, 2.0)
    kept = changed(take_back((2,), two))
    assert differ(replace(changed(one)[0], relief=None), kept[0]) < 1e-12 and (kept[1] == changed(two)[1]).all()
    none, x = changed(take_back((1,), take_back((2,), two)))
    assert differ(flat, none) < 1e-12 and (x == changed(two)[1]).all()
    both, _ = changed(take_back((2, 1), two))
    assert differ(none, both) < 1e-12 and both.relief is not None and len(both.relief.height) == 0
    again, _ = changed(take_back((1,), one, first))
    assert again.relief is not None and again.relief.kind.tolist() == [2, 1]


def test_a_checkpoint_holds_the_relief_and_a_forged_one_is_refused() -> None:
    flat = measured(*square("irregular", 21))
    raised, _ = changed(draw(flat, LINE, keep=True))
    restored = fabric_from(fabric_arrays(raised), flat, {}, [])
    for part in ("relief", "hinges", "membrane"):
        for field in fields(getattr(raised, part)):
            ours, theirs = (getattr(getattr(fabric, part), field.name) for fabric in (raised, restored))
            np.testing.assert_array_equal(ours, theirs)
    check_fabric(restored)
    assert raised.relief is not None
    for forged in (
        replace(raised.relief, vertex=raised.relief.vertex + np.int32(flat.number)),
        replace(raised.relief, hinges=raised.relief.hinges + np.int32(1)),
        replace(raised.relief, kind=raised.relief.kind + np.int8(2)),
        replace(raised.relief, height=raised.relief.height[1:]),
    ):
        with pytest.raises(ContractError, match="relief"):
            check_fabric(replace(raised, relief=forged))


def test_kept_folds_are_at_rest_as_raised_and_no_faster_than_the_cloth() -> None:
    flat = measured(*square("irregular", 31))
    raised, x = changed(draw(flat, LINE, keep=True))
    hinges = raised.hinges
    assert hinges is not None and hinges.number > 100
    quads = hinges.quads()
    a, b, c, d = (x[quads[:, i]] for i in range(4))
    left, right = np.cross(b - a, c - a), np.cross(d - a, b - a)
    cosine = np.einsum("hk,hk->h", left, right) / np.linalg.norm(left, axis=1) / np.linalg.norm(right, axis=1)
    np.testing.assert_allclose(np.cos(hinges.rest), cosine, atol=1e-12)
    assert (hinges.k <= most_stiffness(x, quads, raised)).all() and (hinges.k > 0.0).all()


@pytest.mark.parametrize(
    ("line", "settings", "field"),
    [
        (LINE | {"width": 0.9 * FEWEST * (2 + np.sqrt(2)) / 3 / 20}, {}, "lines[0].width"),
        (LINE | {"points": [[0.3, 0.5, 0.4], [0.6, 0.5, 0.4]]}, {}, "lines[0].points[0]"),
        (LINE | {"points": [[0.3, 0.5, 0.0], [0.6, 1.2, 0.0]]}, {}, "lines[0].points[1]"),
        (LINE, {"take_back": [1]}, "take_back[0]"),
        (LINE | {"width": None}, {}, "lines[0].width"),
        (LINE | {"height": 2.0}, {}, "lines[0].height"),
    ],
)
def test_bad_lines_are_named(line: dict[str, Any], settings: dict[str, Any], field: str) -> None:
    flat = measured(*square("diagonal", 21))
    with pytest.raises(BadInput) as refused:
        draw(flat, line, **settings)
    assert refused.value.field == field and refused.value.remedy
    assert changed(draw(flat, LINE))[0].relief is not None


def test_a_line_that_cannot_be_taken_back_is_named() -> None:
    plain = ridge((-0.2, 0.0), (0.2, 0.0))
    cloth = sheet(21, 21, size=[1.0, 1.0])
    split = draw(cloth, plain)
    wide = draw(changed(split)[0], plain | {"width": 0.3}, x=changed(split)[1])
    gone = take_back((2,), wide)
    for made, number in ((wide, 1), (wide, 3), (gone, 2)):
        with pytest.raises(BadInput) as refused:
            take_back((number,), made)
        assert (refused.value.field, refused.value.value) == ("take_back[0]", number) and refused.value.remedy
    with pytest.raises(BadInput) as refused:
        draw(changed(wide)[0], plain, x=changed(wide)[1])
    assert refused.value.field == "lines[0].width"
    assert changed(draw(changed(gone)[0], plain, x=changed(gone)[1]))[0].relief is not None


def test_a_line_that_would_turn_triangles_over_is_refused() -> None:
    """A valley deeper than the radius of a tube."""
    points, faces = square("diagonal", 41)
    turn = 2.0 * np.pi * points[:, 0] * 0.9
    x = np.column_stack([0.15 * np.sin(turn), points[:, 1], 0.15 * np.cos(turn)])
    line = {"points": [[0.15, 0.3, 0.0], [0.15, 0.7, 0.0]], "width": 0.3}
    flat = measured(points, faces)
    outwards = np.sign(np.cross(x[faces[0, 1]] - x[faces[0, 0]], x[faces[0, 2]] - x[faces[0, 0]]) @ x[faces[0, 0]])
    draw(flat, line | {"height": 0.05 * outwards}, x=x, tolerance=0.01)
    with pytest.raises(BadInput) as refused:
        draw(flat, line | {"height": -0.35 * outwards}, x=x, tolerance=0.01)
    assert refused.value.field == "lines[0].height"


def test_fields_are_for_lines_that_they_concern() -> None:
    flat = measured(*square("diagonal", 21))
    for lines, settings in (
        ((LINE,), {"smoothing": {"passes": 3}}),
        ((LINE,), {"springs": "physical"}),
        ((LINE, LINE | {"width": None}), {}),
        ((), {}),
    ):
        with pytest.raises(ValueError, match=r"width|draw lines"):
            draw(flat, *lines, **settings)


def test_the_state_is_copied_and_the_fabric_stays() -> None:
    flat = measured(*square("diagonal", 21))
    before = {name: values.copy() for name, values in fabric_arrays(flat).items()}
    made = draw(flat, LINE, keep=True)
    for name, values in fabric_arrays(flat).items():
        np.testing.assert_array_equal(values, before[name])
    assert changed(made)[1] is not flat.position
