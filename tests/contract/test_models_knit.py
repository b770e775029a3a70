"""The structure of plain knit: continuous courses, every link in one yarn, four kinds of points, counts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from model_files import Folder, build, files
from pydantic import ValidationError

from nuno_knit.knit import PRESETS, Knit, KnitConfig, structure
from nuno_knit.structure import Knit as Structure
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Int

__all__ = ["files"]

PAPER = {"yarns": [{"name": "nylon", "k": 1}, {"name": "support", "k": 10}], "spacing": [1, 1], "mass": 1}
SHAPES = [("panel", 5, 9), ("panel", 1, 1), ("panel", 3, 4), ("tube", 2, 1), ("tube", 7, 6), ("tube", 12, 5)]


def knit(files: Folder, form: str, wales: int, courses: int, **more: Any) -> Fabric:
    return build(Knit(), PAPER | {"form": form, "wales": wales, "courses": courses} | more, files)


@pytest.mark.parametrize(("form", "wales", "courses"), SHAPES)
def test_counts(form: str, wales: int, courses: int, files: Folder) -> None:
    fabric = knit(files, form, wales, courses)
    assert fabric.springs is not None and fabric.yarns is not None
    columns, rows = 2 * wales, courses + 1
    across = columns if form == "tube" else columns - 1
    assert fabric.number == columns * rows == Knit().count(KnitConfig(form=form, wales=wales, courses=courses), files)  # type: ignore[arg-type]
    assert fabric.springs.number == courses * columns + rows * across
    # Borrowed: heads below the first course and sinkers above the last, one of each a wale (but for a panel's end).
    assert fabric.yarns.number == courses + wales + (wales if form == "tube" else wales - 1)
    pairs = np.sort(fabric.springs.pairs(), axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)


@pytest.mark.parametrize(("form", "wales", "courses"), SHAPES)
def test_every_link_is_in_exactly_one_yarn(form: str, wales: int, courses: int, files: Folder) -> None:
    fabric = knit(files, form, wales, courses)
    assert fabric.springs is not None and fabric.yarns is not None
    found: list[int] = []
    for y in range(fabric.yarns.number):
        links = fabric.yarns.links[fabric.yarns.ptr[y] : fabric.yarns.ptr[y + 1]].tolist()
        found += links[:-1] if len(links) > 1 and links[0] == links[-1] else links
    assert sorted(found) == list(range(fabric.springs.number))


@pytest.mark.parametrize(("form", "wales", "courses"), SHAPES)
def test_a_course_is_one_continuous_square_wave(form: str, wales: int, courses: int, files: Folder) -> None:
    """Up, along, down, along: each link begins where the one before it ended, and a wale takes four."""
    fabric = knit(files, form, wales, courses)
    assert fabric.springs is not None and fabric.yarns is not None
    pairs, columns = fabric.springs.pairs(), 2 * wales
    for course in range(courses):
        links = fabric.yarns.links[fabric.yarns.ptr[course] : fabric.yarns.ptr[course + 1]]
        assert len(links) == (4 * wales + 1 if form == "tube" else 4 * wales - 1)
        at, path = course * columns, [course * columns]
        for link in links.tolist():
            assert at in pairs[link]
            at = int(pairs[link].sum() - at)
            path.append(at)
        row, column = np.divmod(path, columns)
        q = np.arange(len(path)) // 2
        assert row.tolist() == [course + (i % 4 in (1, 2)) for i in range(len(path))]
        assert column.tolist() == (q % columns).tolist()


def links_around(net: Structure) -> Int:
    """(rows, columns, 4) links up, down, left and right of every point, -1 where there is none."""
    found = np.full((net.points, 4), -1)
    pairs, index = net.pairs(), np.arange(net.links)
    for part, first, second in ((slice(0, net.legs), 0, 1), (slice(net.legs, None), 3, 2)):
        found[pairs[part, 0], first] = index[part]
        found[pairs[part, 1], second] = index[part]
    return found.reshape(net.courses + 1, net.columns, 4)


@pytest.mark.parametrize(("form", "wales", "courses"), [("panel", 5, 8), ("tube", 6, 8)])
def test_two_yarns_in_turn_make_four_kinds_of_points(form: str, wales: int, courses: int, files: Folder) -> None:
    """The yarns up, down, left and right of an inner point depend on the parities of its row and column only."""
    fabric = knit(files, form, wales, courses)
    net = structure(KnitConfig(form=form, wales=wales, courses=courses))  # type: ignore[arg-type]
    assert fabric.springs is not None
    around = links_around(net)
    inner = np.argwhere((around >= 0).all(axis=2))
    yarns = (fabric.springs.k == 10.0).astype(int)[around]
    kinds: dict[int, set[tuple[int, ...]]] = {}
    for row, column in inner.tolist():
        kinds.setdefault(2 * (row % 2) + column % 2, set()).add(tuple(yarns[row, column].tolist()))
    assert kinds == {0: {(0, 1, 0, 1)}, 1: {(0, 1, 1, 0)}, 2: {(1, 0, 1, 0)}, 3: {(1, 0, 0, 1)}}


def test_a_kind_turned_by_a_course_is_the_other_yarns(files: Folder) -> None:
    """One course on, the yarns change places: kinds 0 and 2, 1 and 3 are each other with the yarns exchanged."""
    fabric = knit(files, "panel", 3, 6)
    assert fabric.springs is not None
    around = links_around(structure(KnitConfig(wales=3, courses=6)))[1:-1, 1:-1]
    k = fabric.springs.k[around]
    assert np.array_equal(k[1:] == 1.0, k[:-1] == 10.0)


@pytest.mark.parametrize("form", ["panel", "tube"])
def test_it_starts_at_rest_and_stretched_as_told(form: str, files: Folder) -> None:
    for stretch in ((1.0, 1.0), (1.5, 1.2)):
        fabric = knit(files, form, 6, 7, stretch=stretch)
        assert fabric.springs is not None
        pairs = fabric.springs.pairs()
        length = np.linalg.norm(fabric.position[pairs[:, 1]] - fabric.position[pairs[:, 0]], axis=1)
        legs = np.arange(len(pairs)) < 7 * 12
        assert np.abs(length[legs] - stretch[1]).max() < 1e-14
        assert np.abs(length[~legs] - stretch[0]).max() < 1e-14


def test_yarns_have_their_own_stiffness_length_and_weight(files: Folder) -> None:
    """EA / L of a link, half a link's yarn to each end, and the sequence by course."""
    yarns = ["nylon", "elastane", {"name": "tight", "ea": "2 N", "density": "44 dtex", "length": 0.5, "mu": 0.1}]
    fabric = build(Knit(), {"wales": 4, "courses": 7, "yarns": yarns, "spacing": ["0.4 mm", "0.5 mm"]}, files)
    assert fabric.springs is not None and fabric.yarns is not None
    assert fabric.yarns.names == ("nylon", "elastane", "tight")
    assert fabric.yarns.kind[:7].tolist() == [0, 1, 2, 0, 1, 2, 0]
    assert fabric.yarns.mu[:7].tolist() == [0.2, 0.2, 0.1, 0.2, 0.2, 0.1, 0.2]
    leg, head = fabric.yarns.links[fabric.yarns.ptr[2]], fabric.yarns.links[fabric.yarns.ptr[2] + 1]
    assert np.isclose(fabric.springs.rest[leg], 2.5e-4) and np.isclose(fabric.springs.k[leg], 2.0 / 2.5e-4)
    assert np.isclose(fabric.springs.rest[head], 2e-4) and np.isclose(fabric.springs.k[head], 2.0 / 2e-4)
    course, _ = structure(KnitConfig(wales=4, courses=7)).course()
    weight = fabric.springs.rest * np.array([22e-7, 22e-7, 44e-7])[course % 3]
    assert np.isclose(fabric.mass.sum(), weight.sum(), rtol=1e-14)


@pytest.mark.parametrize("form", ["panel", "tube"])
def test_a_course_takes_four_links_a_wale(form: str, files: Folder) -> None:
    """Its yarn's length, on a panel less the sinker that would go on."""
    fabric = knit(files, form, 6, 5, spacing=[0.3, 0.5])
    assert fabric.springs is not None and fabric.yarns is not None
    lengths = fabric.yarns.lengths(fabric.springs)
    course = 6 * 2 * (0.3 + 0.5) - (0.3 if form == "panel" else 0.0)
    assert np.abs(lengths[:5] - course).max() < 1e-14
    assert np.abs(lengths[5:] - 0.3).max() == 0.0


@pytest.mark.parametrize("name", PRESETS)
def test_presets_say_where_they_come_from(name: str) -> None:
    assert PRESETS[name].yarn.name == name
    assert len(PRESETS[name].source) > 20


def test_what_cannot_be_knitted_is_refused(files: Folder) -> None:
    with pytest.raises(BadInput) as caught:
        knit(files, "tube", 1, 4)
    assert (caught.value.field, caught.value.value) == ("wales", 1)
    with pytest.raises(BadInput) as caught:
        knit(files, "tube", 4, 4, pin=["left-edge"])
    assert caught.value.field == "pin"
    for bad, word in (
        ({"wales": 2.5}, "integer"),
        ({"wales": 0}, "greater"),
        ({"yarns": [{"k": 1, "mu": 0.5}]}, "energy"),
        ({"yarns": [{"k": 1, "ea": 1}]}, "one of them"),
        ({"yarns": [{"mu": 0.1}]}, "one of them"),
        ({"yarns": []}, "at least 1"),
    ):
        with pytest.raises(ValidationError, match=word):
            KnitConfig.model_validate(bad)


def test_a_yarn_that_locks_gives_its_links_both_stiffnesses(files: Folder) -> None:
    """EA / L each; yarns without a lock beside it go on as they are."""
    yarns = [{"name": "covered", "ea": 0.5, "lock": 1.5, "ea_lock": 4.0}, {"name": "plain", "k": 7.0}]
    fabric = knit(files, "panel", 3, 4, yarns=yarns, spacing=[0.5, 0.25])
    assert fabric.springs is not None and fabric.springs.lock is not None and fabric.springs.k_lock is not None
    springs, plain = fabric.springs, fabric.springs.k == 7.0
    assert np.array_equal(springs.k_lock[plain], springs.k[plain])
    assert (springs.lock[~plain] == 1.5).all()
    np.testing.assert_allclose(springs.k_lock[~plain] * springs.rest[~plain], 4.0, rtol=1e-15)
    assert knit(files, "panel", 3, 4).springs.lock is None  # type: ignore[union-attr]


@pytest.mark.parametrize("form", ["panel", "tube"])
def test_yarns_that_no_course_is_left_for_change_nothing(form: str, files: Folder) -> None:
    """Also one that locks: the default's second yarn in a single course."""
    for courses, yarns in ((1, ["nylon", "support"]), (2, ["support", "nylon-6", "support", "elastane"])):
        fabric, without = (knit(files, form, 3, courses, yarns=part) for part in (yarns, yarns[:courses]))
        assert fabric.springs is not None and without.springs is not None
        for name in ("k", "rest", "c"):
            assert np.array_equal(getattr(fabric.springs, name), getattr(without.springs, name))
        assert np.array_equal(fabric.springs.stiffest().k, without.springs.stiffest().k)
        assert np.array_equal(fabric.mass, without.mass)


@pytest.mark.parametrize(
    "change",
    [
        {"ea": 1, "lock": 1},
        {"ea": 1, "ea_lock": 2},
        {"ea": 1, "lock": 1, "k_lock": 2},
        {"k": 2, "lock": 1, "k_lock": 1},
    ],
    ids=["no stiffness", "no strain", "the other's", "softer"],
)
def test_half_a_lock_is_refused(change: dict[str, float], files: Folder) -> None:
    with pytest.raises(ValidationError, match="lock"):
        knit(files, "panel", 3, 4, yarns=[change])
