"""Ridge and valley lines: springs, hinges and masses of what is raised."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wrinkled import BY_HAND, draw, ridge, sheet

from nuno.plugin_contract import registry
from nuno.scene.files import SceneFiles
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.operation import Changed, Outcome
from nuno_wrinkle.edges import fold_angles

LINE = ridge((-0.3, -0.21), (0.31, 0.24))


def changed(made: Outcome) -> Changed:
    assert made.changed is not None
    return made.changed


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
