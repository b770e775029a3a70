"""Cloth whose vertices stand in no order: which order it is stepped in, and that it moves as it did."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scattered_meshes import BALL, SIDE, irregular, mesh, shuffled, simulated

from nuno.scene import scene_file, shipped
from nuno.simulation.cloth import build, numbering
from nuno.simulation.cloth.numbering import find_numbers, invert, keep_numbers, renumber


@pytest.mark.quick(solver=["symplectic_euler"], tension=["membrane"])
@pytest.mark.parametrize(
    ("tension", "solver"),
    [("springs", "symplectic_euler"), ("membrane", "symplectic_euler"), ("membrane", "implicit_euler")],
)
def test_a_shuffled_mesh_moves_as_it_would_in_near_order(tension: str, solver: str, tmp_path: Path) -> None:
    x, faces = irregular(SIDE)
    mixed, corners, old = shuffled(x, faces)
    pins = [0, SIDE - 1]
    fields: dict[str, Any] = {"solver": {"plugin": solver, "dt": "0.1 ms"}, "bodies": [BALL], "frame_rate": 100}
    near = simulated(tmp_path, mesh(tmp_path, "near.obj", x, faces, tension=tension, pin=pins), **fields)
    pinned = np.sort(invert(old)[pins]).tolist()
    far = simulated(tmp_path, mesh(tmp_path, "far.obj", mixed, corners, tension=tension, pin=pinned), **fields)
    assert near.numbers is None and far.numbers is not None
    assert np.array_equal(far.fabric.faces, corners) and np.array_equal(far.fabric.position, mixed)
    for _ in range(3):
        one, other = near.step(), far.step()
    assert one.report.status == other.report.status == "ok"
    moved = np.abs(near.state.x - x).max()
    assert moved > 1e-3 and np.abs(far.state.x - near.state.x[old]).max() < 1e-9 * moved
    assert np.array_equal(far.state.x[pinned], mixed[pinned])
    assert np.flatnonzero((far.state.x == mixed).all(axis=1)).tolist() == pinned
    ours, theirs = far.present_forces(), near.present_forces()
    assert set(ours.parts) == set(theirs.parts)
    for kind, force in ours.parts.items():
        assert np.abs(force - theirs.parts[kind][old]).max() < 1e-6 * np.abs(force).max()
    scale = np.abs(theirs.acceleration).max()
    assert np.abs(ours.acceleration - theirs.acceleration[old]).max() < 1e-6 * scale
    assert near.measure(near.poses).stretch == pytest.approx(far.measure(far.poses).stretch, rel=1e-9)


def test_a_file_in_the_order_of_the_steps_moves_to_the_same_bits(tmp_path: Path) -> None:
    """Its sums are the same sums."""
    mixed, corners, _ = shuffled(*irregular(SIDE))
    far = simulated(tmp_path, mesh(tmp_path, "far.obj", mixed, corners))
    numbers = far.numbers
    assert numbers is not None
    near = simulated(tmp_path, mesh(tmp_path, "near.obj", mixed[numbers], invert(numbers)[corners]))
    assert near.numbers is None
    for _ in range(2):
        far.step(), near.step()
    assert far.state.x[numbers].tobytes() == near.state.x.tobytes()
    assert far.state.v[numbers].tobytes() == near.state.v.tobytes()


def test_every_part_of_a_fabric_is_renumbered(tmp_path: Path) -> None:
    """Springs in runs, too: all keep their order, and join the same places by the same laws."""
    fabric = simulated(tmp_path, {"plugin": "sheet", "resolution": [9, 7], "pin": ["top-corners"]}).fabric
    numbers = np.random.default_rng(3).permutation(fabric.number).astype(np.int32)
    other = renumber(fabric, numbers)
    assert fabric.springs and fabric.hinges and other.springs and other.hinges and other.uv is not None
    assert np.array_equal(numbers[other.springs.pairs()], fabric.springs.pairs())
    assert np.array_equal(numbers[other.hinges.quads()], fabric.hinges.quads())
    assert np.array_equal(numbers[other.faces], fabric.faces)
    for name in ("k", "rest", "c"):
        values = getattr(fabric.springs, name)
        assert np.array_equal(other.springs.per_spring(getattr(other.springs, name)), fabric.springs.per_spring(values))
    assert all(np.array_equal(other.springs.of_kind(kind), fabric.springs.of_kind(kind)) for kind in range(3))
    for name in ("position", "velocity", "mass", "pinned", "uv"):
        assert np.array_equal(getattr(other, name), getattr(fabric, name)[numbers])
    assert [other.told(place) for place in range(fabric.number)] == numbers.tolist()
    assert [fabric.told(vertex) for vertex in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("around", [False, True])
def test_rows_and_rings_are_found_again(around: bool, tmp_path: Path) -> None:
    """A grid that is shuffled has its rows back, one after the other, and a tube its rings, up to where each begins."""
    side = 48
    i, j = np.divmod(np.arange(side * side), side)
    turn = 2.0 * np.pi * (j + 0.5) / side
    size = 0.02 * side / (2.0 * np.pi)
    flat, tube = (0.01 * j, 0.0 * j), (size * np.cos(turn), size * np.sin(turn))
    x = np.column_stack([(tube if around else flat)[0], 0.02 * i, (tube if around else flat)[1]])
    wraps = side if around else side - 1
    corner, beside = (
        (i * side + j)[(i < side - 1) & (j < wraps)],
        (i * side + (j + 1) % side)[(i < side - 1) & (j < wraps)],
    )
    faces = np.concatenate(
        [np.stack(f, 1) for f in ((corner, beside, corner + side), (beside, beside + side, corner + side))]
    )
    mixed, corners, old = shuffled(x, faces.astype(np.int32))
    numbers = simulated(tmp_path, mesh(tmp_path, "far.obj", mixed, corners)).numbers
    assert numbers is not None
    row, column = np.divmod(old[numbers], side)
    assert np.array_equal(row, i)
    steps = np.diff(column.reshape(side, side), axis=1) % side
    assert ((steps == 1).all() or (steps == side - 1).all()) if around else np.array_equal(column, j)


def test_old_vertices_of_changed_cloth_keep_their_places_and_new_ones_come_last() -> None:
    """Of two objects, wherever an operation has put the new ones."""
    numbers = np.array([2, 0, 3, 1, 5, 4], np.int32)
    source = np.array([-1, 0, 1, -1, 2, 3, 4, -1, 5], np.int32)
    pieces = [build.Piece("one", 0, 6), build.Piece("other", 6, 9)]
    kept = keep_numbers(numbers, source, pieces)
    assert kept.tolist() == [4, 1, 5, 2, 0, 3, 8, 6, 7]
    assert source[kept].tolist() == [2, 0, 3, 1, -1, -1, 5, 4, -1]


@pytest.mark.quick(name=["skirt-hula"])
@pytest.mark.parametrize("name", ["skirt-hula", "shirt-on-mannequin", "drape-over-sphere", "stiff-sheet"])
def test_what_stands_in_good_order_is_left_alone(name: str) -> None:
    loaded = scene_file.read(shipped.find(name))
    fabric, pieces = build.build_fabric(loaded)
    assert fabric.number > numbering.FEWEST and find_numbers(fabric, pieces) is None


def test_an_object_in_good_order_is_left_alone_beside_one_in_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It moves in the same bits as beside one that is not renumbered, and a sheet's springs stay runs."""
    x, faces = irregular(SIDE)
    beside = np.array([2.0, 0.0, 0.0])
    mixed, corners, old = shuffled(x + beside, faces)
    objects = [
        {"name": "near", "model": mesh(tmp_path, "near.obj", x, faces)},
        {"name": "far", "model": mesh(tmp_path, "far.obj", mixed, corners)},
    ]
    objects.insert(0, {"name": "sheet", "model": {"plugin": "sheet", "resolution": [48, 48]}})
    simulation = simulated(tmp_path, {}, objects=objects)
    start, numbers = 48 * 48, simulation.numbers
    n = start + len(x)
    assert numbers is not None and np.array_equal(numbers[:n], np.arange(n))
    assert np.array_equal(np.sort(numbers[n:]), np.arange(n, n + len(x)))
    assert not np.array_equal(numbers, np.sort(numbers))
    simulation.step()
    x_end = simulation.state.x
    assert np.abs(x_end[start:n][old] + beside - x_end[n:]).max() < 1e-12
    monkeypatch.setattr(numbering, "FEWEST", 10_000)
    plain = simulated(tmp_path, {}, objects=objects)
    plain.step()
    assert plain.numbers is None and plain.state.x[:n].tobytes() == x_end[:n].tobytes()
