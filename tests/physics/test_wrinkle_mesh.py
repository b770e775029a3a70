"""Ridge and valley lines: what becomes of the mesh."""

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
from nuno_schemas.fabric import Corners, State
from nuno_schemas.operation import Changed, Outcome
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
