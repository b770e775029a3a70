"""Ridge and valley lines: what becomes of the mesh, its springs, hinges and masses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import random_wrinkles
from wrinkled import BY_HAND, draw, ridge, sheet

from nuno.plugin_contract import registry
from nuno.scene.files import SceneFiles
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Corners, Fabric, Float, State
from nuno_schemas.operation import Changed, Outcome
from nuno_wrinkle.edges import fold_angles
from nuno_wrinkle.raised import smooth, split_faces
from nuno_wrinkle.surface import link_faces

STEEP = {"passes": 0}


def changed(made: Outcome) -> Changed:
    assert made.changed is not None
    return made.changed


@pytest.mark.parametrize("seeds", [range(80), pytest.param(range(80, 200), marks=pytest.mark.full)], ids=str)
def test_whatever_is_drawn_the_mesh_stays_whole(seeds: range) -> None:
    found = [random_wrinkles.draw(seed) for seed in seeds]
    assert found.count("") > 0.6 * len(seeds)


@pytest.mark.parametrize("kind", ["points", "texture"])
def test_a_texture_cut_along_a_seam_stays_so_under_lines(kind: str) -> None:
    """The image lies half a unit farther on one side of x = 0: a line that crosses by points flips no edge there, and
    one that is drawn on the image stays on its side.
    """
    plain = sheet(13, 12)
    side = (plain.position[plain.faces].mean(axis=1)[:, 0] > 0.0)[:, None]
    key, place = np.unique(plain.faces + plain.number * side, return_inverse=True)
    vertex, right = key % plain.number, key // plain.number
    points = (plain.position[vertex, :2] + np.stack([0.5 + 0.5 * right, 0.5 + 0.0 * right], 1)).astype(np.float32)
    laid = Corners(points, vertex.astype(np.int32), place.reshape(-1, 3).astype(np.int32))
    cloth = replace(plain, uv=None, corners=laid)
    line = ridge((-0.3, -0.2), (0.3, 0.25)) if kind == "points" else {
        "texture": [(0.8 + 0.5, 0.3), (0.6 + 0.5, 0.7)], "height": 0.02
    }  # fmt: skip
    made = changed(draw(cloth, line)).fabric
    assert made.corners is not None and made.uv is None and made.number > plain.number
    np.testing.assert_array_equal(made.corners.vertex[made.corners.faces], made.faces)
    x = made.position[made.faces]
    right = x[:, :, 0].mean(axis=1) > 0.0
    assert np.where(right, x[:, :, 0].min(axis=1) >= -1e-12, x[:, :, 0].max(axis=1) <= 1e-12).all()
    shift = np.stack([0.5 + 0.5 * right, np.full(len(right), 0.5)], axis=1)
    np.testing.assert_allclose(made.corners.points[made.corners.faces], x[..., :2] + shift[:, None], atol=1e-6)


def test_a_line_along_a_skirts_side_changes_the_cloth_as_if_it_had_no_texture() -> None:
    """The image goes on round the side, so that edges there are flipped as others are; nowhere is it torn."""
    model = registry.load("nuno.models", "skirt")
    config = {"cells": "triangles", "columns": 24, "rows": 9, "fabric": BY_HAND}
    skirt = model.build(model.Config.model_validate(config), SceneFiles(Path(".")), 0)
    x = skirt.position.reshape(9, 24, 3)
    line = {"points": (0.5 * (x[1:-1, 0] + x[1:-1, 1])).tolist(), "height": 5e-3}
    made, plain = (changed(draw(cloth, line)) for cloth in (skirt, replace(skirt, corners=None)))
    np.testing.assert_array_equal(made.fabric.faces, plain.fabric.faces)
    np.testing.assert_array_equal(made.state.x, plain.state.x)
    laid = made.fabric.corners
    assert laid is not None and made.fabric.number > skirt.number
    np.testing.assert_array_equal(laid.vertex[laid.faces], made.fabric.faces)
    assert np.ptp(laid.points[laid.faces], axis=1).max() < 0.2
    one, other = np.moveaxis(np.diff(laid.points[laid.faces].astype(float), axis=1), 1, 0)
    area = 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    assert (area > 0.0).all() and area.sum() == pytest.approx(1.0, abs=1e-5)


def test_a_check_that_can_fail() -> None:
    made = changed(draw(sheet(), ridge((-0.3, -0.2), (0.3, 0.25))))
    split = made.fabric.number - 144
    random_wrinkles.require_whole(sheet(), made.fabric, made.state.x, split)
    made.fabric.faces[-1] = made.fabric.faces[-1][::-1]
    with pytest.raises(ValueError, match="two triangles go along"):
        random_wrinkles.require_whole(sheet(), made.fabric, made.state.x, split)


def test_new_vertices_of_a_strip_are_joined_and_stand_k_above_their_triangles() -> None:
    fabric = sheet()
    made = changed(draw(fabric, ridge((-0.31, -0.22), (0.33, 0.27)), smoothing=STEEP))
    n, x = fabric.number, made.state.x
    assert np.array_equal(x[:n], fabric.position) and np.allclose(x[n:, 2], 0.02, atol=1e-15)
    edges = random_wrinkles.edge_table(made.fabric.faces)
    chain = [edge for edge in edges if min(edge) >= n]
    assert len(chain) >= len(x) - n - 1  # n - 1 shared edges, all flipped, and what lies across
    # The middle of a straight part is a point of the line, but for vertices moved off an edge.
    along = np.array([0.64, 0.49]) / np.hypot(0.64, 0.49)
    off = (x[n:, :2] - [-0.31, -0.22]) @ [along[1], -along[0]]
    assert np.abs(off).max() < 0.2 / 11 and np.median(np.abs(off)) < 1e-3


def test_one_triangle_inside_of_which_a_line_lies_is_split() -> None:
    fabric = sheet(4, 4)
    made = draw(fabric, ridge((0.01, 0.03), (0.03, 0.04)), smoothing=STEEP)
    assert made.facts["vertices"] == 1.0
    random_wrinkles.require_whole(fabric, changed(made).fabric, changed(made).state.x, 1)


def test_round_a_vertex_of_valence_3_no_edge_is_made_twice() -> None:
    x = np.array([[0.4, 0, 0], [1, 0, 0], [-0.5, 0.9, 0], [-0.5, -0.9, 0]])
    inner = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3]], np.int32)
    middle = x[inner[:2]].mean(axis=1)
    faces = np.concatenate([inner, np.zeros((4, 3), np.int32)])
    across = np.concatenate([link_faces(inner, 4), np.zeros((4, 3), np.int32)])
    flat = np.concatenate([x, middle])
    split = np.arange(len(middle), dtype=np.int32)
    flipped, left = split_faces(flat, flat, split, 4, faces, across, np.ones(len(faces)))
    edges = random_wrinkles.edge_table(faces)
    assert (len(edges), flipped, left) == (6 + 6, 2, 1)
    assert np.array_equal(across, link_faces(faces, 6))


def test_smoothing_is_taubins_transfer_function() -> None:
    n, passes, shrink, inflate = 24, 7, 0.5, -0.53
    ring = np.arange(n)
    beside = np.stack([(ring - 1) % n, (ring + 1) % n], 1).reshape(-1).astype(np.int32)
    start = np.arange(0, 2 * n + 1, 2, dtype=np.int32)
    for wave in range(n // 2 + 1):
        x = np.repeat(np.cos(2 * np.pi * wave * ring / n)[:, None], 3, axis=1)
        kappa = 1.0 - np.cos(2 * np.pi * wave / n)
        expected = x * ((1 - shrink * kappa) * (1 - inflate * kappa)) ** passes
        smooth(x, ring.astype(np.int32), start, beside, passes, shrink, inflate)
        assert np.allclose(x, expected, rtol=0.0, atol=1e-13)


def test_a_hierarchical_line_stays_a_ridge() -> None:
    line = ridge((-0.3, 0.013), (0.3, 0.013))
    heights = []
    for hierarchical in (False, True):
        made = changed(draw(sheet(), line, smoothing={"passes": 8, "hierarchical": hierarchical}))
        heights.append(float(made.state.x[144:, 2].mean()))
    assert heights[0] < 0.8 * 0.02 < 0.999 * 0.02 < heights[1]


def test_pinned_vertices_stay_and_borders_are_not_drawn_in() -> None:
    fabric = sheet(pin=["top-row"])
    x = changed(draw(fabric, ridge((-0.45, 0.43), (0.45, 0.47)))).state.x
    assert np.array_equal(x[:12], fabric.position[:12])
    x = changed(draw(sheet(), ridge((-0.2, 0.46), (0.2, 0.46)))).state.x
    assert np.allclose(x[:12, 1], 0.5, atol=1e-15)


@pytest.mark.parametrize("height", [0.03, -0.03])
def test_a_line_that_ends_at_a_border_raises_it_as_the_cloth_beside_it(height: float) -> None:
    fabric = sheet(24, 24)
    x = changed(draw(fabric, ridge((0.01, -0.5), (0.01, 0.5), height=height))).state.x[: fabric.number]
    rows = (x.reshape(24, 24, 3) - fabric.position.reshape(24, 24, 3))[..., 2] * np.sign(height)
    crest = rows.max(axis=1)
    assert crest[[0, -1]].min() > 0.5 * crest[12] > 0.0
    assert np.allclose(x[[*range(24), *range(-24, 0)], 1], fabric.position[[*range(24), *range(-24, 0)], 1], atol=1e-15)


def test_a_line_is_the_same_however_it_is_given(tmp_path: Path) -> None:
    fabric = sheet()
    points = [(-0.3, -0.2), (0.05, 0.1), (0.31, 0.22)]
    (tmp_path / "lines.obj").write_text(
        "".join(f"v {x} {y} 0\n" for x, y in points) + "l 1 2 3\n# a line counted from behind\nl -3 -2 -1\n"
    )
    wrinkle = registry.load("nuno.operations", "wrinkle")
    config = wrinkle.Config.model_validate({"lines": [{"file": "lines.obj", "height": 0.02}]})
    read = wrinkle.resolve(config, SceneFiles(tmp_path))
    assert len(read.lines) == 2
    one = wrinkle.apply(
        read.model_copy(update={"lines": read.lines[:1]}), fabric, State(fabric.position, 0 * fabric.position), None
    )
    by_texture = {"texture": [[x + 0.5, y + 0.5] for x, y in points], "height": 0.02}
    for other in (draw(fabric, ridge(*points)), draw(fabric, by_texture)):
        assert np.array_equal(changed(one).fabric.faces, changed(other).fabric.faces)
        assert np.allclose(changed(one).state.x, changed(other).state.x, rtol=0.0, atol=1e-7)


REFUSED = {
    "off": ({"points": [[0, 0, 0], [0.1, 0, 0.5]]}, "off the cloth"),
    "border": ({"points": [[-0.4, 0.4, 0], [0.4, 0.4, 0]]}, "border"),
    "one point": ({"points": [[0, 0, 0], [0, 0, 0]]}, "all points of the line are one"),
    "no triangle": ({"on_faces": [{"face": 0, "at": [1, 0, 0]}, {"face": 999, "at": [1, 0, 0]}]}, "no such triangle"),
    "too high": ({"points": [[0, 0, 0], [0.2, 0, 0]], "height": 3.0}, "further than the cloth is large"),
    "off the texture": ({"texture": [[0.5, 0.5], [1.5, 0.5]]}, "off the cloth"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_lines_are_refused_by_name(name: str) -> None:
    line, problem = REFUSED[name]
    fabric = sheet()
    if name == "border":  # the way leads over a hole
        gone = np.flatnonzero((fabric.faces == 18).any(axis=1))
        faces = np.delete(fabric.faces, gone, axis=0)
        fabric = type(fabric)(**vars(fabric) | {"faces": np.ascontiguousarray(faces)})
    with pytest.raises(BadInput, match=problem) as caught:
        draw(fabric, {"height": 0.02} | line)
    assert caught.value.field is not None and caught.value.field.startswith("lines")


def test_a_ridge_and_a_valley_through_one_triangle_are_refused_and_two_ridges_cross() -> None:
    one, other = ridge((-0.3, 0.02), (0.3, 0.03)), ridge((0.02, -0.3), (0.03, 0.3))
    with pytest.raises(BadInput, match="a ridge and a valley"):
        draw(sheet(), one, other | {"height": -0.02})
    fabric = sheet()
    made = changed(draw(fabric, one, other))
    random_wrinkles.require_whole(fabric, made.fabric, made.state.x, made.fabric.number - fabric.number)


def test_cloth_without_triangle_springs_is_refused() -> None:
    with pytest.raises(BadInput, match="no spring along an edge") as caught:
        draw(sheet(cells="quads"), ridge((-0.3, 0.0), (0.3, 0.1)))
    assert "cells: triangles" in str(caught.value.remedy)
    bare = sheet()
    with pytest.raises(BadInput, match="k_std"):
        draw(type(bare)(**vars(bare) | {"springs": None}), ridge((-0.3, 0.0), (0.3, 0.1)))


SETTINGS = {
    "mu above 0": {"smoothing": {"inflate": 0.1}},
    "mu smaller than lambda": {"smoothing": {"shrink": 0.5, "inflate": -0.4}},
    "no lines": {"lines": []},
    "no height": {"lines": [{"points": [[0, 0, 0], [1, 0, 0]], "height": 0}]},
    "two places": {"lines": [{"points": [[0, 0, 0], [1, 0, 0]], "file": "a.obj", "height": 1}]},
    "one point": {"lines": [{"points": [[0, 0, 0]], "height": 1}]},
    "not whole": {"lines": [{"on_faces": [{"face": 0, "at": [0.5, 0.6, 0]}] * 2, "height": 1}]},
    "k_std": {"k_std": 0.0},
}


@pytest.mark.parametrize("name", SETTINGS)
def test_bad_settings_are_refused(name: str) -> None:
    given = {"lines": [ridge((0, 0), (1, 0))]} | SETTINGS[name]
    with pytest.raises(ValueError):
        registry.load("nuno.operations", "wrinkle").Config.model_validate(given)


LINE = ridge((-0.3, -0.21), (0.31, 0.24))


def structural(fabric: Fabric) -> tuple[np.ndarray, Float, Float]:
    """Pairs, stiffness and rest length of the springs on edges."""
    assert fabric.springs is not None
    springs, own = fabric.springs, fabric.springs.of_kind(0)
    return springs.pairs()[own], springs.per_spring(springs.k)[own], springs.per_spring(springs.rest)[own]


def area(fabric: Fabric, x: Float) -> float:
    a = x[fabric.faces[:, 0]]
    return float(0.5 * np.linalg.norm(np.cross(x[fabric.faces[:, 1]] - a, x[fabric.faces[:, 2]] - a), axis=1).sum())


@pytest.mark.parametrize("rule", ["paper", "physical"])
def test_new_springs_follow_the_rule_with_the_first_models_mean_also_on_a_second_line(rule: str) -> None:
    fabric = sheet()
    _, k, rest = structural(fabric)
    k_std, r_avg = float(k.mean()), float(rest.mean())
    first = changed(draw(fabric, LINE, springs=rule))
    second = changed(draw(first.fabric, ridge((-0.3, 0.3), (0.2, 0.33)), x=first.state.x, springs=rule))
    for made, before in ((first.fabric, fabric), (second.fabric, first.fabric)):
        pairs, k, rest = structural(made)
        new = (pairs >= before.number).any(axis=1)
        expected = k_std * (rest / r_avg if rule == "paper" else r_avg / rest)
        assert new.sum() > 50 and np.allclose(k[new], expected[new], rtol=1e-13)
    _, k, rest = structural(changed(draw(fabric, LINE, springs=rule, k_std=7.0)).fabric)
    assert np.isclose(k, 7.0 * (rest / r_avg if rule == "paper" else r_avg / rest)).sum() > 50


def test_unstretched_cloth_is_unstretched_after_it_and_weighs_what_its_area_does() -> None:
    fabric = sheet(fabric="denim")
    made = draw(fabric, LINE)
    after, x = changed(made).fabric, changed(made).state.x
    pairs, _, rest = structural(after)
    assert np.allclose(rest, np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1), rtol=1e-13)
    density = fabric.mass.sum() / area(fabric, fabric.position)
    assert after.mass.sum() == pytest.approx(density * area(after, x), rel=1e-12)
    assert made.facts["area"] == pytest.approx(area(after, x) - 1.0, rel=1e-9) and made.facts["area"] > 5e-4
    assert made.facts["mass"] == pytest.approx(density * made.facts["area"], rel=1e-9)


def test_cloth_stretched_alike_everywhere_stays_so_and_weighs_no_more() -> None:
    fabric = sheet(fabric="denim")
    longer = ridge((-0.33, -0.231), (0.341, 0.264), height=0.022)
    still, pulled = changed(draw(fabric, LINE)), changed(draw(fabric, longer, x=1.1 * fabric.position))
    pairs, _, rest = structural(pulled.fabric)
    x = pulled.state.x
    assert np.allclose(np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / rest, 1.1, rtol=1e-12)
    assert np.allclose(pulled.fabric.mass, still.fabric.mass, rtol=1e-9)


def test_far_from_the_line_nothing_changes_a_bit() -> None:
    fabric = sheet(24, 24)
    made = changed(draw(fabric, ridge((-0.1, -0.1), (0.1, 0.12))))
    far = np.linalg.norm(fabric.position[:, :2], axis=1) > 0.35
    assert np.array_equal(made.state.x[: fabric.number][far], fabric.position[far])
    assert np.array_equal(made.fabric.mass[: fabric.number][far], fabric.mass[far])
    rows = []
    for cloth in (fabric, made.fabric):
        springs = cloth.springs
        assert springs is not None
        pairs = springs.pairs()
        own = (pairs < fabric.number).all(axis=1) & far[np.minimum(pairs, fabric.number - 1)].all(axis=1)
        values = (springs.per_spring(a)[own] for a in (springs.k, springs.rest, springs.c))
        rows.append(np.column_stack([pairs[own], *values]))
    assert np.array_equal(*rows)


@pytest.mark.parametrize("others", [0, 1])
def test_a_triangle_without_neighbours_gets_bending_springs_across_all_edges_that_divide_it(
    others: int, tmp_path: Path
) -> None:
    """As the model makes them of these triangles, and with the model's stiffness, which no spring shows before."""
    corners = [[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [3, 0, 0], [4, 0, 0], [3.5, 1, 0], [3.5, -1, 0]][: 3 + 4 * others]
    faces = [[0, 1, 2], [3, 4, 5], [4, 3, 6]][: 1 + 2 * others]
    fabric = triangles(tmp_path, corners, faces)
    first = changed(draw(fabric, ridge((0.4, 0.3), (0.6, 0.4), height=0.05)))
    model = triangles(tmp_path, first.state.x.tolist(), first.fabric.faces.tolist()).springs
    assert model is not None and first.fabric.springs is not None and fabric.springs is not None
    bent, expected = (np.sort(net.pairs()[net.of_kind(2)], axis=1) for net in (first.fabric.springs, model))
    assert sorted(map(tuple, bent)) == sorted(map(tuple, expected)) and len(expected) == 3 + others
    springs, old = first.fabric.springs, fabric.springs
    rest = old.per_spring(old.rest)
    mean = rest[old.of_kind(2)].mean() if others else np.sqrt(3.0) * rest.mean()
    own = springs.of_kind(2) & (springs.pairs() < 3).all(axis=1)
    k, rest = springs.per_spring(springs.k)[own], springs.per_spring(springs.rest)[own]
    assert own.sum() == 3 and np.allclose(k, 5.0 * rest / mean, rtol=1e-13)
    second = changed(draw(first.fabric, ridge((0.3, 0.2), (0.7, 0.25), height=0.03), x=first.state.x)).fabric
    assert second.springs is not None
    assert (second.springs.pairs()[second.springs.of_kind(2)] >= first.fabric.number).any()


def triangles(folder: Path, corners: list[list[float]], faces: list[list[int]]) -> Fabric:
    """A mesh from a file, of constants set by hand."""
    text = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "triangles.obj").write_text("\n".join(text))
    model = registry.load("nuno.models", "mesh")
    config = model.Config.model_validate({"file": "triangles.obj", "fabric": BY_HAND})
    built: Fabric = model.build(config, SceneFiles(folder), 0)
    return built


def test_new_springs_are_damped_as_the_others_where_some_have_no_stiffness() -> None:
    fabric = sheet(2, 5, fabric="denim", size=[1.0, 0.4])
    assert fabric.springs is not None and not fabric.springs.per_spring(fabric.springs.k).all()
    made = changed(draw(fabric, ridge((-0.2, -0.05), (0.1, 0.05)))).fabric
    assert made.springs is not None
    first, second = made.springs.pairs().T
    reduced = made.mass[first] * made.mass[second] / (made.mass[first] + made.mass[second])
    new = (first >= fabric.number) | (second >= fabric.number)
    ratio = made.springs.c[new] / (2.0 * np.sqrt(made.springs.k[new] * reduced[new]))
    assert new.sum() > 5 and ratio == pytest.approx(np.full(new.sum(), 0.05), rel=1e-12)


def test_new_hinges_keep_the_rigidity_of_the_cloth() -> None:
    fabric = sheet(fabric={"preset": "denim", "bend_warp": 1e-4, "bend_weft": 1e-4})
    made = changed(draw(fabric, ridge((-0.3, -0.2), (0.3, 0.2), height=1e-9), smoothing={"passes": 0})).fabric
    assert made.hinges is not None
    quads, k = made.hinges.quads(), made.hinges.k
    x = made.position
    e = x[quads[:, 1]] - x[quads[:, 0]]
    size = sum(0.5 * np.linalg.norm(np.cross(e, x[quads[:, i]] - x[quads[:, 0]]), axis=1) for i in (2, 3))
    assert np.allclose(k * size / np.square(e).sum(axis=1), 1e-4, rtol=1e-6)
    assert not made.hinges.rest.any()


def test_kept_folds_are_at_rest_and_others_are_flat() -> None:
    fabric = sheet(fabric="denim")
    made = changed(draw(fabric, LINE, keep=True))
    hinges = made.fabric.hinges
    assert hinges is not None
    angles = fold_angles(made.state.x, hinges.quads())
    assert np.allclose(hinges.rest, angles, atol=1e-12) and np.abs(angles).max() > 0.2
    bare = replace(fabric, hinges=None)
    with pytest.raises(BadInput, match="no hinges"):
        draw(bare, LINE, keep=True)


def test_a_kept_wrinkle_is_at_rest_as_it_is_raised_also_on_bent_cloth() -> None:
    """Else a stiff fold, at rest as the bent cloth lay, would straighten a skirt or a sleeve."""
    skirt = registry.load("nuno.models", "skirt")
    fields = {"cells": "triangles", "columns": 24, "rows": 12, "fabric": "denim"}
    cone = skirt.build(skirt.Config.model_validate(fields), SceneFiles(Path(".")), 0)
    texture = [[[0.1 * i + 0.01, 0.9], [0.1 * i + 0.01, 0.1]] for i in range(10)]
    lines = [{"texture": line, "height": 0.02 * (-1) ** i} for i, line in enumerate(texture)]
    made = draw(cone, *lines, keep=True)
    hinges = changed(made).fabric.hinges
    assert hinges is not None
    quads, new = hinges.quads(), cone.number
    raised = (quads >= new).any(axis=1)
    assert raised.sum() > 1000
    assert np.allclose(hinges.rest[raised], fold_angles(changed(made).state.x, quads[raised]), atol=1e-12)
    x, crests = changed(made).state.x, made.arrays["crests"]
    wave = np.linalg.norm(x[crests[1]] - x[crests[2]], axis=1)
    around = 2.0 * np.pi * np.hypot(x[crests[0], 0], x[crests[0], 2])
    assert np.median(wave / around) == pytest.approx(0.2, rel=0.1)


def test_speed_pins_and_texture_are_those_between_the_corners() -> None:
    fabric = sheet(pin=["top-row"])
    wrinkle = registry.load("nuno.operations", "wrinkle")
    turn = np.array([[0.0, 2.0, 1.0], [-2.0, 0.0, 0.5], [1.0, 0.0, 0.0]])
    state = State(fabric.position.copy(), fabric.position @ turn + [1.0, 2.0, 3.0], 0.5)
    made = wrinkle.apply(wrinkle.Config.model_validate({"lines": [LINE]}), fabric, state, None).changed
    n, at = fabric.number, made.fabric.position
    assert np.allclose(made.state.v[n:], at[n:] @ turn + [1.0, 2.0, 3.0], atol=1e-13)
    assert np.allclose(made.fabric.uv[n:], at[n:, :2] + 0.5, atol=1e-6)
    assert np.array_equal(made.state.v[:n], state.v) and made.state.t == 0.5
    assert np.array_equal(made.fabric.pinned[:n], fabric.pinned) and not made.fabric.pinned[n:].any()
    assert np.array_equal(made.source, np.append(np.arange(n), np.full(made.fabric.number - n, -1)))
